"""Drives along the paper's corridor past boxes that the map does not have and people who cross the way.

Each seed is a drive of its own, in a world of its own: the world and the robot's cores in one process (P17 Exp. 1's
corridor, no camera). Where boxes stand and people walk is drawn from the seed; a lane of a metre or more stays free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, distance, distance_to_box, wrap_angle
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import run_all
from hitchhike_ros.experiments.scoring.boxes import beside_m, match_boxes
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.simulation.composed import FRAME_RATE_HZ, ComposedRide
from hitchhike_ros.simulation.people import RADIUS_M, Person
from hitchhike_ros.simulation.physics.world import World, WorldParameters
from hitchhike_ros.simulation.world_file import Box, RobotEntry, WorldFile, load_world

MODELS = ("turtlebot", "p3dx")
_START, _GOAL = Pose2D(6.0, 5.72, 0.0), Pose2D(20.0, 5.72, 0.0)
_SOUTH, _NORTH = 4.60, 6.84  # faces of the corridor's walls, y in m
_MIDDLE = (_SOUTH + _NORTH) / 2
_LIMIT_S = 150.0
_START_SIGMA = np.array([0.05, 0.05, 0.03])  # of the start pose that an operator gives: x, y in m, theta in rad
# A box of the robot's map is a real one when they are no farther apart than this; else it is a phantom.
_MATCH_M = 0.15


@dataclass(frozen=True)
class DriveResult:
    """How one drive went; the errors of boxes are the worst over those that were found."""

    seed: int
    model: str
    outcome: str
    contacts: tuple[str, ...]
    duration_s: float
    goal_error_m: float
    goal_error_rad: float
    boxes: int
    found: int
    phantoms: tuple[Obstacle, ...]
    place_error_m: float
    size_error_m: float
    stood_s: float
    straight_s: float  # what the way takes at cruise speed without anything on it

    @property
    def reached(self) -> bool:
        return Ending.told(self.outcome).reason is Reason.ARRIVED


def draw_world(base: WorldFile, seed: int) -> WorldFile:
    """The corridor with the robot, boxes and people of a seed."""
    random = np.random.default_rng([seed, 17])
    boxes = []
    for number, x in enumerate(np.array([8.8, 12.0, 15.2]) + random.uniform(0.0, 1.6, 3)):
        w, b = random.uniform(0.16, 0.44, 2)
        gap = random.uniform(0.35, 0.6)
        y = _SOUTH + gap if random.random() < 0.5 else _NORTH - gap - b
        boxes.append(Box(f"box{number + 1}", float(x), float(y), float(w), float(b)))
    people = (
        Person("anna", _walk(random, boxes, 23.0, 3.0), float(random.uniform(0.7, 1.3)), float(random.uniform(0, 6))),
        Person("bob", _walk(random, boxes, 21.5, 9.0), float(random.uniform(0.5, 1.0)), float(random.uniform(0, 6))),
    )
    robot = RobotEntry(MODELS[seed % len(MODELS)], _START, _GOAL)
    return replace(base, boxes=tuple(boxes), people=people, robots={robot.model: robot})


def _walk(
    random: np.random.Generator, boxes: Sequence[Box], start_x: float, end_x: float
) -> tuple[tuple[float, float], ...]:
    """Points from one end of the corridor to the other, mostly from side to side, and around the boxes."""
    room, north = RADIUS_M + 0.1, bool(random.random() < 0.5)
    points = [(start_x, _side_y(random, north))]
    while points[-1][0] > end_x:
        for _ in range(100):
            there = north if random.random() < 0.2 else not north
            to = (max(points[-1][0] - float(random.uniform(1.5, 4.0)), end_x), _side_y(random, there))
            if all(_clear(points[-1], to, box, room) for box in boxes):
                break
        else:
            return _walk(random, boxes, start_x, end_x)  # it ended before a box
        north = there
        points.append(to)
    sides = {y > _MIDDLE for _, y in points}
    return tuple(points) if len(sides) == 2 else _walk(random, boxes, start_x, end_x)  # it crosses the way


def _side_y(random: np.random.Generator, north: bool) -> float:
    away = float(random.uniform(0.5, 0.9))
    return _NORTH - away if north else _SOUTH + away


def _clear(a: tuple[float, float], b: tuple[float, float], box: Box, room: float) -> bool:
    return all(distance_to_box(x, y, box) > room for x, y in np.linspace(a, b, 20))


def drive(package: Path, seed: int) -> DriveResult:
    """One drive, from start to the end of its errand."""
    base = load_world(package / "maps" / "p17_exp1.world.yaml")
    file = draw_world(base, seed)
    random = np.random.default_rng([seed, 18])
    params = WorldParameters(renderer="tiny")
    with World(file, seed, params, package=package) as world:
        ride = ComposedRide(world, package)
        (name,) = file.robots
        robot, body = ride.robots[name], world.robots[name]
        error = random.normal(0.0, _START_SIGMA)
        ride.start({name: PoseEstimate(0.0, compose(_START, Pose2D(*error.tolist())), np.diag(_START_SIGMA**2))})
        stood = 0
        while world.now < _LIMIT_S:
            ride.step()
            stood += robot.status.goal is not None and abs(body.odometry().twist.v) < 0.02
            if robot.status.state == "idle" and world.now > 2.0:
                break
        truth, _ = body.ground_truth()
        found, phantoms, place, size = compare_boxes(robot.boxes, file.boxes)
        return DriveResult(
            seed,
            name,
            robot.status.reason if robot.status.state == "idle" else f"not there after {_LIMIT_S:.0f} s",
            tuple(contact.other for contact in world.contacts()),
            world.now,
            distance(truth, _GOAL),
            abs(wrap_angle(truth.theta - _GOAL.theta)),
            len(file.boxes),
            found,
            phantoms,
            place,
            size,
            stood / FRAME_RATE_HZ,
            distance(_START, _GOAL) / robot.params.cruise_speed_mps,
        )


def compare_boxes(
    found: Sequence[Obstacle], true: Sequence[Obstacle]
) -> tuple[int, tuple[Obstacle, ...], float, float]:
    """How many true boxes were found, which found ones are none, and the worst errors of place and of size in m."""
    matches = [m for m in match_boxes(true, found, beside_m, _MATCH_M) if m.found is not None]
    phantoms = tuple(box for box in found if all(match.found is not box for match in matches))
    place = max((max(abs(m.found.x - m.true.x), abs(m.found.y - m.true.y)) for m in matches if m.found), default=0.0)
    return len(matches), phantoms, place, max((match.size_m or 0.0 for match in matches), default=0.0)


@cache
def corridor_drives(package: Path, seeds: range, progress: Progress) -> tuple[DriveResult, ...]:
    """Drives on all cores, in the order of their seeds; the same ones are driven once in a process."""
    return run_all("drives along the corridor", partial(drive, package), seeds, progress)
