"""Rides behind a driver, the pair aligned at the start: courses to be followed, and drivers to be lost.

World, cores and protocol are those of the composed simulation, images are rendered. What a seed changes: the noise of
wheels and laser, how the follower stands at the start, and when and how what goes wrong goes wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import HitchhikingPoint, Pose2D
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.simulation.composed import Changes
from hitchhike_ros.simulation.world_file import Box, RobotEntry, WorldFile, load_world

DRIVER, RIDER = "driver", "rider"
# Of the start poses that an operator gives: x, y in m, theta in rad.
SIGMA = np.diag(np.square([0.05, 0.05, 0.03]))
# From the driver's axle back to the rider's at the start, the gap being 0.8 m or somewhat less.
_BEHIND_M = 1.2
# How the rider may stand beside that: x, y in m, theta in rad, standard deviations.
_ASIDE = np.array([0.03, 0.03, 0.05])


@dataclass(frozen=True)
class Course:
    """A way to be ridden: in which world, from where to where, at which speed, by whom.

    ``boxes`` are those of the world file where it is None; both robots know of ``doors``, which are closed.
    """

    name: str
    world: str
    start: Pose2D
    goal: Pose2D
    speed_mps: float = 0.5
    rider: str = "turtlebot"
    boxes: tuple[Box, ...] | None = None
    doors: tuple[Box, ...] = ()
    limit_s: float = 90.0
    rider_goal: Pose2D | None = None
    changes: Mapping[str, Changes] = field(default_factory=dict)


STRAIGHT = Course("straight, 0.5 m/s", "p17_exp1", Pose2D(3.2, 5.72), Pose2D(15.2, 5.72), boxes=())
FAST = Course("straight, 1.0 m/s", "p17_exp1", Pose2D(3.2, 5.72), Pose2D(19.2, 5.72), 1.0, "p3dx", boxes=())
# Once round, by four corners to the left: the door behind the pair leaves no shorter way.
CORNERS = Course(
    "four corners",
    "corners",
    Pose2D(5.2, 1.1),
    Pose2D(2.2, 1.1),
    doors=(Box("door", 3.2, 0.0, 0.1, 2.2),),
    limit_s=150.0,
)
S_BEND = Course("an S between boxes", "s_bend", Pose2D(17.2, 27.14), Pose2D(27.0, 27.14))


def build(course: Course, package: Path, seed: int) -> WorldFile:
    """The world file of a course with the pair of a seed."""
    base = load_world(package / "maps" / f"{course.world}.world.yaml")
    aside = np.random.default_rng([seed, 31]).normal(0.0, _ASIDE)
    behind = compose(course.start, Pose2D(-_BEHIND_M))
    area = tuple((course.start.x + dx, course.start.y + dy) for dx, dy in ((-2, -1), (2, -1), (2, 1), (-2, 1)))
    point = HitchhikingPoint("start", area, course.start, behind, None)
    robots = {
        DRIVER: RobotEntry("p3dx", course.start, course.goal, 0),
        RIDER: RobotEntry(course.rider, compose(behind, Pose2D(*aside.tolist())), course.rider_goal or course.goal, 1),
    }
    boxes = base.boxes if course.boxes is None else course.boxes
    return replace(base, boxes=(*boxes, *course.doors), robots=robots, sites=Sites(base.sites.markers, (point,)))


def changes_of(course: Course) -> dict[str, Changes]:
    """What differs from the parameter files: rides of any length, at the speed of the course."""
    common = {"min_ride_m": 5.0, "ride_speed_mps": course.speed_mps}
    avoidance = {"obstacle_avoidance": {"rider_speed_mps": course.speed_mps}}
    changes: dict[str, Changes] = {
        DRIVER: {"hitchhiking": {**common, "may_ride": False}, **avoidance},
        RIDER: {"hitchhiking": {**common, "may_ride": True, "marker_id": 1, "profile": 58}, **avoidance},
    }
    for robot, more in course.changes.items():
        sections = changes[robot]
        changes[robot] = {name: {**sections.get(name, {}), **more.get(name, {})} for name in {*sections, *more}}
    return changes
