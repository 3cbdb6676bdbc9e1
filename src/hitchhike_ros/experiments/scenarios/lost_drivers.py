"""Rides on which the driver is lost: covered, hidden behind a person, turned away, the camera or the messages silent.

What goes wrong begins at a drawn place of the ride, and both robots have goals of their own beyond it: a run ends when
each stands at its goal, by riding on, by coupling anew or alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.experiments.scenarios.composed_record import ComposedRecorder
from hitchhike_ros.experiments.scenarios.following_rides import DRIVER, RIDER, SIGMA, Course, build, changes_of
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.faults import Fault
from hitchhike_ros.simulation.people import RADIUS_M, Person
from hitchhike_ros.simulation.physics.world import World

# The driver goes 8 m along the corridor, its rider farther and to the side; both could come there alone.
_COURSE = Course(
    "driver lost",
    "p17_exp1",
    Pose2D(3.2, 5.72),
    Pose2D(11.2, 6.1),
    boxes=(),
    limit_s=150.0,
    rider_goal=Pose2D(13.0, 5.4),
)
# A person steps between so long after the driver was stopped, and goes on after a while: the least and the most, in s.
_STEPS_IN_S, _STAYS_S = 3.0, (1.0, 9.0)
_APART_M = 0.04
_NORTH_Y, _MIDDLE_Y, _SOUTH_Y = 6.5, 5.72, 4.95
_AWAY = Person("eve", ((20.0, _NORTH_Y), (20.0, _SOUTH_Y)), 1.0, 1e6, hurried=True)
# A ride goes on within so long of a short cover.
RIDES_ON_S = 2.0
# So near to its goal a robot is there: 0.1 m is the tolerance, the rest what it knows of its place in a bare corridor.
GOAL_M = 0.5

Plan = Callable[[np.random.Generator, float], list[Fault]]


def _covered(seconds: float) -> Plan:
    return lambda _random, now: [Fault("camera_covered", RIDER, now, now + seconds)]


def _silent(random: np.random.Generator, now: float) -> list[Fault]:
    return [Fault("camera_silent", RIDER, now, now + float(random.choice([1.0, 4.0, 15.0, math.inf])))]


def _unheard(random: np.random.Generator, now: float) -> list[Fault]:
    robot = str(random.choice([DRIVER, RIDER]))
    return [Fault("messages_lost", robot, now, now + float(random.choice([2.0, 4.0, 10.0, math.inf])))]


def _turned(random: np.random.Generator, now: float) -> list[Fault]:
    """Somebody takes the driver's joystick and turns it off its way by a right angle or so."""
    omega = float(random.choice([-1.0, 1.0])) * float(random.uniform(1.0, 1.4))
    return [Fault("steered", DRIVER, now, now + math.radians(90.0) / abs(omega), Twist2D(0.3, omega))]


def _held(random: np.random.Generator, now: float) -> list[Fault]:
    """Somebody holds the driver for a while, and a person steps in between the two robots, which stand."""
    return [Fault("steered", DRIVER, now, now + float(random.uniform(6.0, 12.0)))]


@dataclass(frozen=True)
class Mishap:
    """One way to lose a driver. After a ``short`` one the ride has to go on soon."""

    name: str
    plan: Plan
    short: bool = False
    person: bool = False


MISHAPS = (
    Mishap("marker covered for 1 s", _covered(1.0), short=True),
    Mishap("marker covered for 2 s", _covered(2.0), short=True),
    Mishap("marker covered for good", _covered(math.inf)),
    Mishap("a person stepping between", _held, person=True),
    Mishap("the driver turning sharply", _turned),
    Mishap("the camera silent", _silent),
    Mishap("messages lost", _unheard),
)


@dataclass(frozen=True)
class LostResult:
    """How a ride with a mishap ended.

    ``goal_error_m`` is the farther robot's, by ground truth; ``rides_on_s`` is how long after the mishap's end both
    rode again, None: they did not, or it did not end.
    """

    seed: int
    mishap: str
    driver_end: str
    rider_end: str
    states: tuple[str, ...]
    contacts: tuple[str, ...]
    duration_s: float
    goal_error_m: float
    short: bool
    rides_on_s: float | None

    @property
    def arrived(self) -> bool:
        """Whether both report that they are at their goals, and truly are."""
        ends = (Ending.told(self.driver_end), Ending.told(self.rider_end))
        return all(end.reason is Reason.ARRIVED for end in ends) and self.goal_error_m <= GOAL_M

    @property
    def rode_on(self) -> bool:
        """Whether the ride was completed after all."""
        return "settling" in self.states


def lose(package: Path, seed: int) -> LostResult:
    """The run of a seed: mishaps take turns."""
    mishap = MISHAPS[seed % len(MISHAPS)]
    random = np.random.default_rng([seed, 37])
    after_m = float(random.uniform(2.0, 5.0))
    file = build(_COURSE, package, seed)
    file = replace(file, people=(_AWAY,)) if mishap.person else file
    with World(file, seed, package=package) as world:
        composed = ComposedRide(world, package, changes=changes_of(_COURSE))
        recorder = ComposedRecorder(composed, seed)
        composed.start({name: PoseEstimate(0.0, entry.start, SIGMA) for name, entry in file.robots.items()})
        driver, rider = composed.robots[DRIVER], composed.robots[RIDER]
        steps: list[tuple[float, float, float]] = []  # of the person: when, from y, to y
        for now in recorder.run(_COURSE.limit_s):
            ridden = world.robots[DRIVER].ground_truth()[0].x - _COURSE.start.x
            if not composed.faults and rider.status.state == "riding" and ridden >= after_m:
                composed.faults += mishap.plan(random, now)
                leaves = now + _STEPS_IN_S + float(random.uniform(*_STAYS_S))
                steps = [(now + _STEPS_IN_S, _NORTH_Y, _MIDDLE_Y), (leaves, _MIDDLE_Y, _SOUTH_Y)]
            if mishap.person and steps and now >= steps[0][0]:
                _, from_y, to_y = steps.pop(0)
                x = world.people[0].walker.pose.x if from_y == _MIDDLE_Y else _between(world)
                world.people[0].send(replace(_AWAY, path=((x, from_y), (x, to_y)), start_s=now))
            if all(robot.ended for robot in recorder.record.robots.values()):
                break
        ends = [
            r.status.reason if r.status.state == "idle" else f"{r.status.state} at the end" for r in (driver, rider)
        ]
        fault_end = composed.faults[0].end_s if composed.faults else math.inf
        return LostResult(
            seed,
            mishap.name,
            ends[0],
            ends[1],
            tuple(status.state for status in recorder.record.robots[RIDER].statuses),
            tuple(map(str, world.contacts())),
            world.now,
            max(distance(world.robots[n].ground_truth()[0], e.goal or e.start) for n, e in file.robots.items()),
            mishap.short,
            _rides_on(recorder.record, fault_end),
        )


def _between(world: World) -> float:
    """x of a person close behind the driver, which drives along x: nearer to the camera he would be cut by the
    renderer's near plane."""
    driver = world.robots[DRIVER]
    return driver.ground_truth()[0].x - driver.limits.rear_m - RADIUS_M - _APART_M


def _rides_on(record: RideRecord, since: float) -> float | None:
    """Seconds from ``since`` until rider and driver ride again."""
    if not math.isfinite(since):
        return None
    stamps = sorted({s.time_stamp for robot in record.robots.values() for s in robot.statuses if s.time_stamp > since})
    for stamp in (since, *stamps):
        states = [
            [s.state for s in record.robots[name].statuses if s.time_stamp <= stamp][-1] for name in (RIDER, DRIVER)
        ]
        if states == ["riding", "driving"]:
            return stamp - since
    return None
