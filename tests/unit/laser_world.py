"""Scans of a grid's walls and of boxes, with the noise of the papers' laser, and a robot that drives a route."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from flat_world import cast
from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Obstacle, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.geometry import compose, move, wrap_angle
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.simulation.physics.walls import merge_cells

LASER = Pose2D(0.17, 0.0, 0.0)
PERIOD_S = 0.1


def walls_of(grid: OccupancyGrid) -> FloatArray:
    """Occupied cells as rectangles (N, 4): x, y, width, breadth."""
    r0, c0, r1, c1 = merge_cells(grid.occupied).T * grid.resolution
    return np.column_stack([c0 + grid.origin.x, r0 + grid.origin.y, c1 - c0, r1 - r0])


def boxes_of(obstacles: Iterable[Obstacle]) -> FloatArray:
    """Boxes as rectangles (N, 4)."""
    return np.array([(o.x, o.y, o.w, o.b) for o in obstacles], dtype=float).reshape(-1, 4)


def take_scan(
    pose: Pose2D,
    rectangles: FloatArray,
    rng: np.random.Generator | None = None,
    stamp: float = 0.0,
    beams: int = 769,
    ratio: float = 0.01,
) -> LaserScan:
    """270° to 8 m from the laser of a robot at ``pose``; noise of ``ratio`` of the range, at least of 1 m."""
    increment = 1.5 * math.pi / (beams - 1)
    angles = -0.75 * math.pi + increment * np.arange(beams)
    ranges = cast(compose(pose, LASER), angles, rectangles)
    if rng is not None:
        hit = np.isfinite(ranges)
        ranges[hit] += ratio * np.maximum(ranges[hit], 1.0) * np.clip(rng.standard_normal(hit.sum()), -3.0, 3.0)
    return LaserScan(stamp, float(angles[0]), increment, 0.02, 8.0, np.where(ranges > 8.0, np.inf, ranges))


def drive(
    route: list[tuple[float, float]], speed: float, rng: np.random.Generator, slip: float = 0.002
) -> Iterator[tuple[Pose2D, Odometry]]:
    """True pose and noisy odometry every PERIOD_S along a route; wheels 0.316 m apart slip as in the simulation."""
    x, y = route[0]
    pose = Pose2D(x, y, math.atan2(route[1][1] - y, route[1][0] - x))
    believed, stamp, separation = Pose2D(), 0.0, 0.316
    yield pose, Odometry(stamp, believed, Twist2D())
    for x, y in route[1:]:
        while math.hypot(x - pose.x, y - pose.y) > 0.15:
            error = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.theta)
            twist = Twist2D(speed if abs(error) < 0.6 else 0.0, max(-1.0, min(1.0, 2.0 * error)))
            pose = move(pose, twist, PERIOD_S)
            wheels = (
                np.array([twist.v - twist.omega * separation / 2, twist.v + twist.omega * separation / 2]) * PERIOD_S
            )
            wheels += slip * np.sqrt(np.abs(wheels)) * rng.standard_normal(2)
            seen = Twist2D(float(wheels.mean()) / PERIOD_S, float(wheels[1] - wheels[0]) / separation / PERIOD_S)
            believed, stamp = move(believed, seen, PERIOD_S), stamp + PERIOD_S
            yield pose, Odometry(stamp, believed, seen)
