"""Random fleets in a small building, on a network and with robots that fail; every run follows from its seed.

Seeds below a million have a network that loses, doubles, delays and reorders; those above have partitions, crashes and
restarts as well. Numbers are chosen so that most robots meet, and as many as possible at awkward moments.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hitchhike_ros.core.datatypes import HitchhikingPoint, Obstacle, Pose2D
from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.core.geometry import between, compose
from hitchhike_ros.experiments.faults.invariants import BrokenInvariantError, Referee
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.driver.states import DriverState as D
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState as H
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.robot import Errand
from hitchhike_ros.simulation.grid.world import GridWorld
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters, Partition

SEVERE = 1_000_000
"""Seeds from here on have partitions, crashes and restarts."""

_RESOLUTION_M = 0.5
# A rectangle of corridors with one across: x and y of opposite corners in m.
_CORRIDORS = ((3, 3, 63, 6), (3, 33, 63, 36), (3, 3, 6, 36), (32, 3, 35, 36), (60, 3, 63, 36))
# Where one may wait for a ride, in both directions of each corridor.
_POINTS = (
    *((x, y, theta) for y in (4.5, 34.5) for x, theta in ((10.0, 0.0), (28.0, math.pi), (40.0, 0.0), (56.0, math.pi))),
    *((x, y, theta) for x in (4.5, 33.5, 61.5) for y, theta in ((10.0, math.pi / 2), (29.0, -math.pi / 2))),
)
# Boxes beside the middle of corridors, which robots find.
_BOXES = (("a", 20.0, 3.0), ("b", 48.0, 5.0), ("c", 20.0, 35.0), ("d", 48.0, 33.0), ("e", 32.0, 18.0))
_LEAST_TRIP_M = 15.0
# The share of runs in which most robots have one goal.
_COMMON_SHARE = 0.35
# By then every robot is at its goal or has reported why not.
_LIMIT_S = 1500.0
# Steps of a ride in which a robot that falls silent leaves another one waiting.
_AWKWARD = (
    *(H.LOCKING, H.AWAITING_ALIGNED, H.COUPLING, H.RIDING, H.SETTLING, H.RELOCALIZING),
    *(D.ALIGNING, D.ALIGNED, D.DRIVING, D.WAITING_FOR_RIDER, D.DECOUPLING),
)
# One run of so many has its messages as text; in the others they are handed over as objects, which is faster.
_JSON_SHARE = 8
_TRACE = 150  # lines of a run that fails
# Nothing is done to anybody after that.
_LAST_MISHAP_S = 150.0
# Periods and limits that leave a run short; ratios are those of the robots' defaults.
_COMMON: dict[str, Any] = {
    "beacon_period_s": 4.0,
    "robot_timeout_s": 13.0,
    "update_period_s": 1.0,
    "repeat_period_s": 1.0,
    "ack_timeout_s": 3.0,
    "message_timeout_s": 8.0,
    "confirm_timeout_s": 5.0,
    "max_wait_s": 40.0,
    "min_ride_m": 10.0,
    "settle_timeout_s": 6.0,
    "lost_timeout_s": 20.0,
    "exact_goal_wait_s": 30.0,
    "progress_timeout_s": 60.0,
}


@dataclass(frozen=True)
class FaultResult:
    """What came of a seed; ``failure`` and ``trace`` are empty where every invariant held."""

    seed: int
    robots: int
    events: int
    messages: int
    rides: int
    completed: int
    ridden_m: float
    driven_m: float
    failure: str = ""
    trace: tuple[str, ...] = ()


def fault_run(seed: int) -> FaultResult:
    """Everything that happens to the fleet of a seed, until all stand at their goals or something is wrong."""
    world = fault_world(seed)
    slowest = max(robot.params.update_period_s for robot in world.robots.values())
    network = world.network.params
    slack_s = 2.0 * slowest + 2.0 * (network.delay_s + network.jitter_s + network.reorder_delay_s)
    referee, failure = Referee(world, slack_s), ""
    try:
        world.run(_LIMIT_S, lambda: world.idle() and world.now > _LAST_MISHAP_S)
        world.run(world.now + slack_s)
        referee.end(_LIMIT_S)
    except (BrokenInvariantError, TransitionError) as exc:
        failure = f"{type(exc).__name__}: {exc}"
    robots = world.robots.values()
    return FaultResult(
        seed=seed,
        robots=len(robots),
        events=world.events,
        messages=world.messages,
        rides=len({award.ride_id for robot in robots for award in robot.awards}),
        completed=sum(report.reason is Reason.RIDE_COMPLETED for robot in robots for _, report in robot.reports) // 2,
        ridden_m=sum(robot.ridden_m for robot in robots),
        driven_m=sum(robot.body.odometer_m for robot in robots),
        failure=failure,
        trace=tuple(world.trace()) if failure else (),
    )


def fault_world(seed: int) -> GridWorld:
    """The fleet of a seed before anything has happened."""
    luck = random.Random(seed)
    names = [f"r{k}" for k in range(luck.randint(2, 6))]
    severe = seed >= SEVERE
    grid, sites, boxes = _building()
    network = NetworkParameters(
        loss=luck.choice((0.0, luck.uniform(0.0, 0.3))),
        delay_s=luck.choice((0.0, luck.uniform(0.0, 0.5))),
        jitter_s=luck.uniform(0.0, 0.5),
        duplication=luck.choice((0.0, 0.2)),
        reordering=luck.choice((0.0, 0.1)),
        reorder_delay_s=luck.uniform(0.2, 2.0),
        partitions=_partitions(luck, names) if severe else (),
        range_m=luck.choice((math.inf, math.inf, luck.uniform(20.0, 50.0))),
        seed=seed,
    )
    params = GridWorldParameters(
        position_sigma_m=0.005,
        heading_sigma_rad=0.002,
        json_messages=seed % _JSON_SHARE == 0,
        trace_events=_TRACE,
        seed=seed,
    )
    world = GridWorld(grid, sites, NetworkModel(network), params, luck.sample(boxes, luck.randint(0, len(boxes))))
    common = {
        **_COMMON,
        "mode": luck.choice(("network",) * 4 + ("local",)),
        "board_anywhere": luck.random() < 0.3,
        "offer_window_s": luck.uniform(2.0, 4.0),
    }
    point = luck.choice(sites.hitchhiking_points) if luck.random() < 0.8 else None
    meeting = _common_goal(seed)
    for k, name in enumerate(names):
        _add_robot(world, luck, name, {**common, "marker_id": k}, point, meeting)
    if severe:
        _crash(world, luck, names)
    return world


def _add_robot(
    world: GridWorld,
    luck: random.Random,
    name: str,
    params: dict[str, Any],
    point: HitchhikingPoint | None,
    meeting: _CommonGoal | None,
) -> None:
    """Around ``point`` those that ride stand, and those that drive come by; without one everybody is anywhere.

    With a ``meeting`` most have it for their first goal.
    """
    drives = not world.robots or luck.random() < 0.3
    own = {
        "profile": luck.choice((50.0, 70.0, 90.0) if drives else (30.0, 50.0, 70.0)),
        "priority": luck.choice((10, 10, 10, 10, 8, 13, 17)),
        "policy": luck.choice(("profile", "proximity", "arrival")),
        "places": luck.choice((1, 1, 2, 3)),
        "may_ride": luck.random() < (0.3 if drives else 0.9),
        "may_drive": luck.random() < 0.9,
        "role_reversal": luck.random() < 0.7,
    }
    if point is None:
        start, ahead = _place(luck), None
    else:
        back_m = luck.uniform(2.0, 6.0) if drives else luck.choice((0.0, luck.uniform(0.0, 5.0)))
        start = compose(point.waiting_pose, Pose2D(-back_m, luck.uniform(-0.5, 0.5) if back_m else 0.0))
        ahead = point.waiting_pose if luck.random() < 0.8 else None
    goals: list[Pose2D] = []
    for _ in range(luck.randint(1, 2)):
        goals.append(_goal(luck, goals[-1] if goals else start, ahead))
        ahead = None
    if meeting is not None:
        own["exact_goal"] = meeting.luck.random() < 0.3
        if meeting.luck.random() < 0.7:
            goals[0] = meeting.goal(start)
    errands = [Errand(goal, luck.uniform(0.0, 8.0), luck.uniform(0.0, 20.0)) for goal in goals]
    offset_s, begins_s = luck.uniform(-5.0, 5.0), luck.uniform(0.0, 3.0)
    world.add_robot(name, start, HitchhikingParameters(**{**params, **own}), errands, offset_s, begins_s)
    if luck.random() < 0.1:
        goal, when = luck.choice((None, goals[0], _place(luck))), luck.uniform(10.0, _LAST_MISHAP_S)
        world.at(when, lambda: _change_mind(world, name, goal))


@dataclass(frozen=True)
class _CommonGoal:
    """Where several robots want to be at the same time, to within a metre."""

    place: Pose2D
    luck: random.Random

    def goal(self, start: Pose2D) -> Pose2D:
        """The place, or one beside it; one that begins there goes elsewhere first."""
        apart_m, theta = self.luck.choice((0.0, 0.0, 0.2, 0.5, 1.0)), self.luck.uniform(-math.pi, math.pi)
        goal = Pose2D(self.place.x + apart_m * math.cos(theta), self.place.y + apart_m * math.sin(theta), theta)
        return goal if abs(goal.x - start.x) + abs(goal.y - start.y) >= _LEAST_TRIP_M else _goal(self.luck, start, None)


def _common_goal(seed: int) -> _CommonGoal | None:
    """In a third of the runs; the rest of a run is drawn as without it."""
    luck = random.Random(f"{seed}: a common goal")
    return _CommonGoal(_place(luck), luck) if luck.random() < _COMMON_SHARE else None


def _change_mind(world: GridWorld, name: str, goal: Pose2D | None) -> None:
    """Somebody wants the robot elsewhere, or nowhere, whatever it was asked before."""
    world.robots[name].errands.clear()
    world.give_goal(name, goal)


def _goal(luck: random.Random, start: Pose2D, ahead: Pose2D | None) -> Pose2D:
    """A place some way off, and, where a pose is given, ahead of it."""
    while True:
        goal = _place(luck)
        forward = 0.0 if ahead is None else between(ahead, goal).x
        if abs(goal.x - start.x) + abs(goal.y - start.y) >= _LEAST_TRIP_M and (ahead is None or forward > 12.0):
            return goal


def _partitions(luck: random.Random, names: list[str]) -> tuple[Partition, ...]:
    partitions = []
    for _ in range(luck.randint(0, 3)):
        begin = luck.uniform(0.0, _LAST_MISHAP_S)
        one = luck.sample(names, luck.randint(1, len(names) - 1))
        other = [name for name in names if name not in one]
        partitions.append(Partition(begin, begin + luck.expovariate(1.0 / 20.0) + 0.5, (tuple(one), tuple(other))))
    return tuple(partitions)


def _crash(world: GridWorld, luck: random.Random, names: list[str]) -> None:
    """Robots fall silent at any time, or when they or their partners have just come to some step; most come back."""

    def for_s() -> float:
        return math.inf if luck.random() < 0.3 else luck.uniform(0.5, 60.0)

    for name in names:
        if luck.random() < 0.1:
            _fall_silent(world, name, luck.uniform(5.0, _LAST_MISHAP_S), for_s())
    for _ in range(luck.randint(2, 3)):
        after_s = luck.choice((0.0, 0.0, luck.uniform(0.0, 2.0)))
        world.observers.append(_Trigger(world, luck.choice(_AWKWARD).value, luck.random() < 0.7, after_s, for_s()))


def _fall_silent(world: GridWorld, name: str, begin_s: float, for_s: float) -> None:
    world.at(begin_s, lambda: world.crash(name))
    if math.isfinite(for_s):
        world.at(min(begin_s + for_s, max(begin_s + 0.5, _LAST_MISHAP_S)), lambda: world.restart(name))


@dataclass
class _Trigger:
    """An observer: when the first robot with a ride comes to ``state``, it or its ``partner`` falls silent."""

    world: GridWorld
    state: str
    partner: bool
    after_s: float
    for_s: float

    def __call__(self, now: float, name: str, _event: object, _effects: object) -> None:
        status = self.world.robots[name].status
        if not self.state or status.state != self.state or status.ride is None or now > _LAST_MISHAP_S:
            return
        self.state = ""
        other = status.ride.driver if status.role == "hitchhiker" else status.ride.hitchhiker
        _fall_silent(self.world, other if self.partner else name, now + self.after_s, self.for_s)


def _place(luck: random.Random) -> Pose2D:
    x0, y0, x1, y1 = luck.choice(_CORRIDORS)
    return Pose2D(luck.uniform(x0 + 1, x1 - 1), luck.uniform(y0 + 1, y1 - 1), luck.uniform(-math.pi, math.pi))


@cache
def _building() -> tuple[OccupancyGrid, Sites, tuple[Obstacle, ...]]:
    data = np.full((80, 134), 100, dtype=np.int8)
    for x0, y0, x1, y1 in _CORRIDORS:
        rows, columns = (slice(int(a / _RESOLUTION_M), int(b / _RESOLUTION_M)) for a, b in ((y0, y1), (x0, x1)))
        data[rows, columns] = 0
    points = []
    for x, y, theta in _POINTS:
        waiting = Pose2D(x, y, theta)
        area = ((x - 4, y - 4), (x + 4, y - 4), (x + 4, y + 4), (x - 4, y + 4))
        points.append(HitchhikingPoint(f"{x} {y}", area, compose(waiting, Pose2D(1.2)), waiting))
    boxes = tuple(Obstacle(name, x, y, 1.0, 1.0) for name, x, y in _BOXES)
    return OccupancyGrid(data, _RESOLUTION_M), Sites((), tuple(points)), boxes
