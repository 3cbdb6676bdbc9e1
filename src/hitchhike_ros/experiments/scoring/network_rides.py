"""How the rides of a network are scored: any number of them in one run, one after another or behind one another.

Everything is in simulated seconds and metres, against ground truth. In a convoy the gap is to whichever robot is ahead.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord
from hitchhike_ros.experiments.scoring.tracks import gap_errors, handover_error, metres_driven
from hitchhike_ros.protocol.phase import ON_BOARD, Phase
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.world_file import WorldFile

# Less than a second after it pulls away a driver is not yet followed at the ordered distance (chosen).
_PULL_AWAY_S = 1.0


@dataclass(frozen=True)
class NetworkRide:
    """One ride that was coupled.

    ``alone_m`` is what the hitchhiker drove by itself to where they meet;
    ``driver_waited_s`` what its driver stood aligned. ``followed`` are the robots ahead of it, one after another.
    ``gap_rms_m`` and ``gap_max_m`` are errors of the gap while the driver drove. Errors of the handover are those of
    the pose that was taken over, the last in units of its own covariance. What did not happen has no value.
    """

    ride_id: str
    hitchhiker: str
    driver: str
    followed: tuple[str, ...]
    riding_at: float
    settled_at: float | None
    released_at: float | None
    alone_m: float
    ride_m: float | None
    points: tuple[float, ...]
    driver_waited_s: float | None
    gap_rms_m: float | None
    gap_max_m: float | None
    handover_m: float | None
    handover_deg: float | None
    handover_sigmas: float | None


def markers_of(world: WorldFile) -> dict[int, str]:
    """Whose back carries which marker."""
    return {entry.marker: name for name, entry in world.robots.items() if entry.marker is not None}


def network_rides(record: RideRecord, markers: Mapping[int, str]) -> list[NetworkRide]:
    """All rides that were coupled, in order of time; ``markers`` says whose back carries which marker."""
    rides = []
    for name, robot in record.robots.items():
        coupled: dict[str, int] = {}
        for i, status in enumerate(robot.statuses):
            if status.role == "hitchhiker" and status.state == "riding" and status.ride is not None:
                coupled.setdefault(status.ride.ride_id, i)
        rides += [_score(record, name, i, markers) for i in coupled.values()]
    return sorted(rides, key=lambda ride: ride.riding_at)


def _score(record: RideRecord, hitchhiker: str, riding: int, markers: Mapping[int, str]) -> NetworkRide:
    """The ride that the hitchhiker's status number ``riding`` begins."""
    robot = record.robots[hitchhiker]
    on_board = list(_on_board(robot.statuses[riding:]))
    ride = on_board[0].ride
    assert ride is not None
    driver, begin = record.robots[ride.driver], on_board[0].time_stamp
    released = next((s.time_stamp for s in robot.statuses[riding + len(on_board) :]), None)
    settled = next((s.time_stamp for s in on_board if s.phase is Phase.HANDING_OVER), None)
    own = (s.time_stamp for s in robot.statuses if s.ride is not None and s.ride.ride_id == ride.ride_id)
    end = settled if settled is not None else released
    gaps = _gaps(record, robot, driver, on_board, end, markers)
    taken = None if settled is None else next((p for p in robot.initial_poses if p.stamp > settled), None)
    error = (None, None, None) if taken is None else handover_error(robot, taken)
    points = tuple(award.points for award in driver.awards if award.ride_id == ride.ride_id)
    return NetworkRide(
        ride.ride_id,
        hitchhiker,
        ride.driver,
        tuple(dict.fromkeys(_followed(on_board, markers))),
        begin,
        settled,
        released,
        metres_driven(robot, (next(own), begin)),
        None if end is None else metres_driven(driver, (begin, end)),
        points,
        _stood(driver.statuses, begin),
        None if not gaps.size else float(np.sqrt(np.mean(np.square(gaps)))),
        None if not gaps.size else float(np.abs(gaps).max()),
        *error,
    )


def _on_board(statuses: Sequence[Status]) -> Iterator[Status]:
    """From the first on, as long as the ride lasts."""
    ride = statuses[0].ride
    for status in statuses:
        same = status.ride is None or ride is None or status.ride.ride_id == ride.ride_id
        if status.role != "hitchhiker" or status.phase not in ON_BOARD or not same:
            return
        yield status


def _followed(statuses: Sequence[Status], markers: Mapping[int, str]) -> list[str]:
    return [markers[s.servo.marker_id] for s in statuses if s.servo is not None and s.servo.task == "follow"]


def _gaps(
    record: RideRecord,
    robot: RobotRecord,
    driver: RobotRecord,
    on_board: Sequence[Status],
    end: float | None,
    markers: Mapping[int, str],
) -> FloatArray:
    """Errors of the gap (N,) to the robots ahead while the driver drives."""
    if end is None:
        return np.empty(0)
    driving = [(a + _PULL_AWAY_S, b) for a, b, status in _spans(driver.statuses, end) if status.state == "driving"]
    found = [np.empty(0)]
    for a, b, status in _spans(on_board, end):
        if status.state == "riding" and status.servo is not None:
            ahead = record.robots[markers[status.servo.marker_id]]
            windows = ((max(a, c), min(b, d)) for c, d in driving)
            found += [gap_errors(ahead, robot, window) for window in windows if window[1] > window[0]]
    return np.concatenate(found)


def _spans(statuses: Sequence[Status], end: float) -> Iterator[tuple[float, float, Status]]:
    """Each status with the times from and to which it holds."""
    stamps = [*(s.time_stamp for s in statuses), end]
    for k, status in enumerate(statuses):
        yield stamps[k], min(stamps[k + 1], end), status


def _stood(statuses: Sequence[Status], riding_at: float) -> float | None:
    """For how long the driver that was coupled to at ``riding_at`` stood aligned.

    Whether it pulls away before or after that is not asked: robots' stamps may be a tick of the clock apart.
    """
    stood, aligned = None, None
    for status in statuses:
        if status.phase is Phase.COUPLING and aligned is None:
            if status.time_stamp >= riding_at:
                return stood
            stood, aligned = None, status.time_stamp
        elif status.state == "driving" and aligned is not None:
            stood, aligned = status.time_stamp - aligned, None
        elif status.phase is not Phase.COUPLING:
            aligned = None
    return stood
