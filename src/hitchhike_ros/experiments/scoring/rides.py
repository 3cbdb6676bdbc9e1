"""Which rides a run had, and when each of their steps began.

Times are simulated seconds, as P17 Table 2 counts them:

    wait                first ``requesting`` of the hitchhiker to the driver's ``offering``
    couple              the driver starts ``aligning`` to the hitchhiker's ``riding``
    decouple            the driver starts ``decoupling`` to the hitchhiker's return to its own navigation
    driver delay        couple + decouple
    hitchhiker delay    driver delay + wait
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.protocol.phase import ON_BOARD, Phase
from hitchhike_ros.protocol.status import ModuleSwitches, Status

Window = tuple[float, float]
"""From one simulated time to another."""


@dataclass(frozen=True)
class Ride:
    """Who rode with whom, and when each step began; None where it was not reached."""

    hitchhiker: str
    driver: str | None = None
    requested_at: float | None = None
    offered_at: float | None = None
    aligning_at: float | None = None
    riding_at: float | None = None
    decoupling_at: float | None = None
    released_at: float | None = None

    @property
    def window(self) -> Window | None:
        """On the way: from ``riding`` to ``decoupling``, pulling away and stopping included."""
        if self.riding_at is None or self.decoupling_at is None:
            return None
        return self.riding_at, self.decoupling_at

    @property
    def wait_s(self) -> float | None:
        return _difference(self.offered_at, self.requested_at)

    @property
    def couple_s(self) -> float | None:
        return _difference(self.riding_at, self.aligning_at)

    @property
    def decouple_s(self) -> float | None:
        return _difference(self.released_at, self.decoupling_at)

    @property
    def driver_delay_s(self) -> float | None:
        return _sum(self.couple_s, self.decouple_s)

    @property
    def hitchhiker_delay_s(self) -> float | None:
        return _sum(self.driver_delay_s, self.wait_s)


@dataclass(frozen=True)
class ModuleChange:
    """From ``stamp`` on these modules of the robot are on."""

    stamp: float
    robot: str
    state: str
    modules: ModuleSwitches


def find_ride(record: RideRecord) -> Ride | None:
    """The first ride that was coupled, else the newest that was asked for, None when nobody asked."""
    rides = find_rides(record)
    return next((ride for ride in rides if ride.riding_at is not None), rides[-1] if rides else None)


def find_rides(record: RideRecord) -> list[Ride]:
    """Every ride that was coupled, and of each robot what it asked for last; by robot, then in order of time."""
    found: list[Ride] = []
    for name, robot in record.robots.items():
        asked_at: float | None = None
        asked: Ride | None = None
        coupled: set[str] = set()
        for i, status in enumerate(robot.statuses):
            if status.role != "hitchhiker":
                asked_at = None
                continue
            asked_at = status.time_stamp if asked_at is None else asked_at
            if status.ride is not None and status.ride.ride_id in coupled:
                continue
            asked = _ride_of(record, name, asked_at, robot.statuses[i:])
            if asked.riding_at is not None and status.ride is not None:
                coupled.add(status.ride.ride_id)
                found.append(asked)
                asked = None
        if asked is not None:
            found.append(asked)
    return found


def phases(record: RideRecord, ride: Ride | None) -> dict[str, Window]:
    """From when to when: ``coupling`` (request to riding), ``riding``, and ``alone`` (the hitchhiker, afterwards)."""
    if ride is None:
        return {}
    end = record.clock[-1].stamp if record.clock else None
    ends = {
        "coupling": (ride.requested_at, ride.riding_at),
        "riding": (ride.riding_at, ride.decoupling_at),
        "alone": (ride.released_at, end),
    }
    return {name: (a, b) for name, (a, b) in ends.items() if a is not None and b is not None and b > a}


def module_changes(record: RideRecord) -> list[ModuleChange]:
    """Which modules were on over time, all robots in order of time (P17 Table 3)."""
    changes = []
    for name, robot in record.robots.items():
        last: ModuleSwitches | None = None
        for status in robot.statuses:
            if status.modules != last:
                changes.append(ModuleChange(status.time_stamp, name, status.state, status.modules))
            last = status.modules
    return sorted(changes, key=lambda change: change.stamp)


def _ride_of(record: RideRecord, hitchhiker: str, asked_at: float, statuses: Sequence[Status]) -> Ride:
    """The ride that the first of the hitchhiker's ``statuses`` is about."""
    ride = statuses[0].ride
    if ride is None or ride.driver not in record.robots:
        return Ride(hitchhiker, requested_at=asked_at)
    driven = [
        s
        for s in record.robots[ride.driver].statuses
        if hitchhiker in s.convoy or (s.ride is not None and s.ride.ride_id == ride.ride_id)
    ]
    riding_at = statuses[0].time_stamp if statuses[0].state == "riding" else None
    released = (s.time_stamp for s in statuses if s.role != "hitchhiker" or s.phase not in ON_BOARD)
    return Ride(
        hitchhiker=hitchhiker,
        driver=ride.driver,
        requested_at=asked_at,
        offered_at=_first(driven, Phase.ASKING, Phase.MEETING),
        aligning_at=_first(driven, Phase.MEETING, Phase.COUPLING),
        riding_at=riding_at,
        decoupling_at=_decoupling(driven, _first(statuses, Phase.HANDING_OVER)),
        released_at=next(released, None) if riding_at is not None else None,
    )


def _decoupling(driven: Sequence[Status], settled_at: float | None) -> float | None:
    """When the driver began to hand over to the one that settled; in a convoy others may have left before.

    Which of the two is stamped first is not asked: robots' stamps may be a tick of the clock apart.
    """
    began = [s.time_stamp for s in driven if s.phase is Phase.HANDING_OVER]
    return min(began, key=lambda stamp: abs(stamp - settled_at) if settled_at is not None else stamp, default=None)


def _first(statuses: Iterable[Status], *phases: Phase) -> float | None:
    return next((s.time_stamp for s in statuses if s.phase in phases), None)


def _difference(later: float | None, earlier: float | None) -> float | None:
    return None if later is None or earlier is None else later - earlier


def _sum(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a + b
