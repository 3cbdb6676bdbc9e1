"""How a scenario's run is judged: whether it ended as it should, and its figures beside the papers'.

With a hitchhiking point at hand (P17, ``mode: local``) times are those of :mod:`ride_figures`. In a network (P18) a
ride is agreed upon from afar, so that what the papers call waiting and coupling is seen from where robots are:

    wait                the hitchhiker stands where it will be coupled, its driver is not yet there
    couple              from when both are there to the hitchhiker's ``riding``
    driver waited       the driver is there, its hitchhiker is not yet
    driver delay        couple + decouple + driver waited
    hitchhiker delay    couple + decouple + wait

A robot *is there* within ``_THERE_M`` of where it is when the ride begins.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.experiments.scenarios.paper import PaperTimes
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord
from hitchhike_ros.experiments.scenarios.ride_scenario import ExpectedDenial, ExpectedRide, RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide, markers_of, network_rides
from hitchhike_ros.experiments.scoring.node_costs import real_time_factor
from hitchhike_ros.experiments.scoring.ride_figures import (
    MAX_GAP_RMS_M,
    MAX_HANDOVER_DEG,
    MAX_HANDOVER_M,
    MAX_HANDOVER_SIGMA,
    MAX_RIDE_DEVIATION_PERCENT,
    box_figures,
)
from hitchhike_ros.experiments.scoring.rides import Ride, find_rides
from hitchhike_ros.protocol.messages import Deny, decode
from hitchhike_ros.simulation.world_file import WorldFile

# A robot is where the ride begins within this (chosen: it still has to line up).
_THERE_M = 2.5
# A robot is at its goal within this (move_base's xy_goal_tolerance is 0.1 m; chosen).
_AT_GOAL_M = 0.2


@dataclass(frozen=True)
class StepTimes:
    """Times of one ride in s, as P17 Table 2 and P18 Table 2 have them; None where a step was not reached."""

    couple_s: float | None
    decouple_s: float | None
    wait_s: float | None
    driver_waited_s: float

    @property
    def driver_delay_s(self) -> float | None:
        if self.couple_s is None or self.decouple_s is None:
            return None
        return self.couple_s + self.decouple_s + self.driver_waited_s

    @property
    def hitchhiker_delay_s(self) -> float | None:
        if self.couple_s is None or self.decouple_s is None or self.wait_s is None:
            return None
        return self.couple_s + self.decouple_s + self.wait_s


@dataclass(frozen=True)
class Score:
    """``trouble`` says what did not end as it should, and at which step; empty: nothing."""

    trouble: str
    figures: tuple[Figure, ...]
    rides: tuple[NetworkRide, ...]


def score_in(world: WorldFile, scenario: RideScenario, record: RideRecord) -> Score:
    """Judge a run by the world that it was in."""
    goals = {name: entry.goal for name, entry in world.robots.items()}
    # The mode may stand in the file that the scenario's world is based on.
    local = all(entry.hitchhiking.get("mode", "local") == "local" for entry in world.robots.values())
    found = score(scenario, record, markers_of(world), goals, local)
    if not world.people:
        return found
    # The rider brakes for people who step in between, and so cannot hold the gap.
    figures = (replace(f, bound=None) if f.name == "gap_error_rms" else f for f in found.figures)
    return replace(found, figures=tuple(figures))


def score(
    scenario: RideScenario,
    record: RideRecord,
    markers: Mapping[int, str],
    goals: Mapping[str, Pose2D | None],
    local: bool = True,
) -> Score:
    """Judge a run. ``markers`` says whose back carries which, ``goals`` (in ``map``) where everybody was sent, and
    ``local`` that rides were arranged at hitchhiking points (P17).
    """
    rides = network_rides(record, markers)
    figures = [*_ride_figures(scenario, record, rides, local)]
    if scenario.denial is not None:
        figures += _denial_figures(record, scenario.denial)
    figures += [
        Figure("contacts", float(len(record.contacts)), "", 0.0),
        Figure("goal_error_max", _goal_error(record, goals), "m", _AT_GOAL_M),
        Figure("real_time_factor", real_time_factor(record, None), "", better="higher"),
    ]
    return Score(_trouble(scenario, record, rides), tuple(figures), tuple(rides))


def steps(record: RideRecord, ride: Ride, local: bool) -> StepTimes:
    """Times of a ride. ``local``: that was arranged at a hitchhiking point (P17)."""
    if local:
        return StepTimes(ride.couple_s, ride.decouple_s, ride.wait_s, 0.0)
    if ride.riding_at is None or ride.driver is None or ride.requested_at is None:
        return StepTimes(None, ride.decouple_s, None, 0.0)
    ready_at = _there_since(record.robots[ride.hitchhiker], ride.requested_at, ride.riding_at)
    arrived_at = _there_since(record.robots[ride.driver], ride.requested_at, ride.riding_at)
    if ready_at is None or arrived_at is None:
        return StepTimes(None, ride.decouple_s, None, 0.0)
    both = max(ready_at, arrived_at)
    return StepTimes(ride.riding_at - both, ride.decouple_s, both - ready_at, both - arrived_at)


def _there_since(robot: RobotRecord, since: float, riding_at: float) -> float | None:
    """From when on, not before ``since``, the robot was near to where it is at ``riding_at``."""
    track = np.array([(p.stamp, p.x, p.y) for p in robot.truth if since <= p.stamp <= riding_at]).reshape(-1, 3)
    if not len(track):
        return None
    away = np.flatnonzero(np.hypot(*(track[:, 1:] - track[-1, 1:]).T) > _THERE_M)
    return float(track[away[-1] + 1, 0]) if len(away) else since


def _ride_figures(
    scenario: RideScenario, record: RideRecord, rides: Sequence[NetworkRide], local: bool
) -> Iterator[Figure]:
    timed = {(ride.hitchhiker, ride.riding_at): ride for ride in find_rides(record) if ride.riding_at is not None}
    several = len(scenario.rides) > 1
    for i, expected in enumerate(scenario.rides):
        ride = _found(rides, expected)
        prefix = f"{_label(scenario, expected, i)}_" if several else ""
        found = None if ride is None else timed.get((ride.hitchhiker, ride.riding_at))
        taken = StepTimes(None, None, None, 0.0) if found is None else steps(record, found, local)
        for figure in _of_ride(expected, ride, taken):
            yield replace(figure, name=prefix + figure.name) if prefix else figure
    if scenario.end == "rides":
        first = next((found for found in timed.values()), None)
        yield from box_figures(record, first)


def _label(scenario: RideScenario, expected: ExpectedRide, i: int) -> str:
    """What tells this ride from the others: its driver, its hitchhiker, or its number."""
    for name in ("driver", "hitchhiker"):
        values = [getattr(ride, name) for ride in scenario.rides]
        if len(set(values)) == len(values):
            return str(getattr(expected, name))
    return f"ride_{i + 1}"


def _of_ride(expected: ExpectedRide, ride: NetworkRide | None, taken: StepTimes) -> Iterator[Figure]:
    paper = expected.paper
    for f in fields(PaperTimes):
        peer = None if paper is None else getattr(paper, f.name)
        yield Figure(f.name.removesuffix("_s"), getattr(taken, f.name), "s", peer, peer=peer)
    if expected.driver_waits_s is not None:
        yield Figure("driver_waited", taken.driver_waited_s, "s", peer=expected.driver_waits_s)
    ridden = None if ride is None else ride.ride_m
    points = ride.points[-1] if ride is not None and ride.points else None
    for name, value, unit, peer in (
        ("ride", ridden, "m", expected.ride_m),
        ("award", points, "points", expected.points),
    ):
        yield Figure(name, value, unit, better="higher", peer=peer)
        if peer is not None:
            off = None if value is None else 100.0 * abs(value / peer - 1.0)
            yield Figure(f"{name}_deviation", off, "%", MAX_RIDE_DEVIATION_PERCENT)
    if ride is None or ride.settled_at is None:
        return
    yield Figure("gap_error_rms", ride.gap_rms_m, "m", MAX_GAP_RMS_M)
    yield Figure("gap_error_max", ride.gap_max_m, "m")
    yield Figure("handover_position_error", ride.handover_m, "m", MAX_HANDOVER_M)
    yield Figure("handover_heading_error", ride.handover_deg, "deg", MAX_HANDOVER_DEG)
    yield Figure("handover_mahalanobis", ride.handover_sigmas, "sigma", MAX_HANDOVER_SIGMA)


def _denial_figures(record: RideRecord, denial: ExpectedDenial) -> list[Figure]:
    statuses = record.robots[denial.hitchhiker].statuses
    # In the order in which they came: both may be of one tick.
    since = iter(statuses)
    asked = next((s.time_stamp for s in since if s.state == "requesting"), None)
    gone = next((s.time_stamp for s in since if s.role == "none"), None)
    waited = None if asked is None or gone is None else gone - asked
    return [
        Figure("wait", waited, "s", denial.paper_wait_s, peer=denial.paper_wait_s),
        Figure("denials", float(len(_denials(record, denial))), "", 1.0, "higher"),
    ]


def _denials(record: RideRecord, denial: ExpectedDenial) -> list[Deny]:
    messages = (decode(message.text) for message in record.messages)
    return [m for m in messages if isinstance(m, Deny) and m.to == denial.hitchhiker and m.reason == denial.reason]


def _goal_error(record: RideRecord, goals: Mapping[str, Pose2D | None]) -> float | None:
    errors = [
        float(np.hypot(robot.truth[-1].x - goal.x, robot.truth[-1].y - goal.y))
        for name, robot in record.robots.items()
        if (goal := goals.get(name)) is not None and robot.truth
    ]
    return max(errors) if errors else None


def _trouble(scenario: RideScenario, record: RideRecord, rides: Sequence[NetworkRide]) -> str:
    """What is not as the scenario should end, with the state in which it stuck."""
    for name, robot in record.robots.items():
        if not robot.arrived:
            now = robot.newest_status
            where = "never heard of" if now is None else f"in state {now.state!r} ({now.reason or 'no reason'})"
            return f"{name} is not at its goal: {where}"
    if record.contacts:
        contact = record.contacts[0]
        return f"{contact.robot} touched {contact.other} at {contact.stamp:.1f} s"
    expected = 0 if scenario.end in ("denied", "alone") else len(scenario.rides)
    troubles = [_trouble_of(scenario, record, ride, _found(rides, ride)) for ride in scenario.rides]
    if scenario.denial is not None and not _denials(record, scenario.denial):
        troubles.append(f"{scenario.denial.hitchhiker} was never denied for {scenario.denial.reason!r}")
    if scenario.end != "lost" and len(rides) > expected:
        troubles.append(f"{len(rides)} rides instead of {expected}, {rides[-1].hitchhiker} with {rides[-1].driver}")
    return next((trouble for trouble in troubles if trouble), "")


def _trouble_of(scenario: RideScenario, record: RideRecord, expected: ExpectedRide, ride: NetworkRide | None) -> str:
    who = f"{expected.hitchhiker} with {expected.driver}"
    state = _last_state(record.robots[expected.hitchhiker])
    if ride is None:
        return f"no ride of {who}; its last state: {state}"
    if scenario.end == "rides" and ride.settled_at is None:
        return f"the ride of {who} broke off: {state}"
    if scenario.end == "lost" and ride.settled_at is not None:
        return f"the ride of {who} was completed although its driver should have been lost"
    return ""


def _found(rides: Sequence[NetworkRide], expected: ExpectedRide) -> NetworkRide | None:
    return next((r for r in rides if (r.hitchhiker, r.driver) == (expected.hitchhiker, expected.driver)), None)


def _last_state(robot: RobotRecord) -> str:
    """The last thing that it did as a hitchhiker, else at all."""
    riding = [s for s in robot.statuses if s.role == "hitchhiker"] or robot.statuses
    return f"{riding[-1].state!r} ({riding[-1].reason or 'no reason'})" if riding else "none"
