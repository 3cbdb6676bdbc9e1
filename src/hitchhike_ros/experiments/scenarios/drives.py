"""Drives of a simulated robot: what its wheels and its laser measure, and where it truly is.

The world is driven once, steered along the planned path by the ground truth, as a human with a joystick would: no
module of the robot takes part. What is kept are the true distances of the laser's beams and the true angles of the
wheels; the sensors' noise is drawn afterwards, by the simulator's own models, for as many seeds as one likes. So every
method sees the same, and twenty seeds cost one run of the physics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Marker, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.geometry import distance, wrap_angle
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.robot_model import LaserMount, RobotLimits, mount
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.simulation.physics.drive import OdometryParameters, WheelOdometry
from hitchhike_ros.simulation.physics.laser import LaserParameters, as_scan
from hitchhike_ros.simulation.physics.robot import SimulatedRobot, robot_files
from hitchhike_ros.simulation.physics.world import World
from hitchhike_ros.simulation.world_file import Box, WorldFile

SCAN_RATE_HZ = 10
ODOMETRY_PER_SCAN = 2
_LOOKAHEAD_M = 0.5
_SPEED_MPS = 0.5
_ARRIVED_M = 2.0 * _LOOKAHEAD_M


@dataclass(frozen=True, eq=False)
class Moment:
    """Readings of the wheels up to a scan, the scan, and the true pose at its stamp."""

    odometry: tuple[Odometry, ...]
    scan: LaserScan
    truth: Pose2D


@dataclass(frozen=True, eq=False)
class Step:
    """The truth of a moment: stamped wheel angles (2,) in rad, distances (N,) in m along the beams, pose."""

    wheels: tuple[tuple[float, FloatArray], ...]
    stamp: float
    distances: FloatArray
    pose: Pose2D


@dataclass(frozen=True, eq=False)
class Drive:
    """One robot's way through a world whose map it has; boxes and other robots are not in the map.

    ``arrived`` says whether it led to the goal, without touching anything.
    """

    grid: OccupancyGrid
    markers: tuple[Marker, ...]
    T_base_laser: Pose2D
    config: Path
    steps: tuple[Step, ...]
    arrived: bool
    upside_down: bool = False

    def moments(self, seed: int) -> Iterator[Moment]:
        """The drive as the robot's sensors report it, with noise of one seed."""
        odometry_rng, laser_rng = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
        limits = load_parameters(RobotLimits, "robot", self.config)
        laser = load_parameters(LaserParameters, "simulated_laser", self.config)
        wheels = load_parameters(OdometryParameters, "simulated_odometry", self.config)
        encoders = WheelOdometry(limits, wheels, odometry_rng)
        for step in self.steps:
            readings = [encoders.update(stamp, angles) for stamp, angles in step.wheels]
            every = max(len(readings) // ODOMETRY_PER_SCAN, 1)
            reported = tuple(readings[every - 1 :: every])
            scan = as_scan(step.distances, step.stamp, laser, laser_rng)
            yield Moment(reported, scan.mirrored() if self.upside_down else scan, step.pose)


def plan_route(file: WorldFile, grid: OccupancyGrid, robot: str, package: Path) -> FloatArray:
    """Path (N, 2) from the robot's start to its goal, around boxes and other robots, which stand at their starts.

    Raises:
        PlanningError: there is none.
    """
    entry = file.robots[robot]
    around = [*file.boxes]
    for name, other in file.robots.items():
        if name != robot:
            r = _limits(other.model, package).circumscribed_m
            around.append(Box(name, other.start.x - r, other.start.y - r, 2.0 * r, 2.0 * r))
    _, config = robot_files(entry.model, package)
    planner = GlobalPlanner(
        load_parameters(GlobalPlannerParameters, "global_planner", config), _limits(entry.model, package)
    )
    return planner.plan(grid.with_obstacles(around), entry.start, entry.goal or entry.start)


def _limits(model: str, package: Path) -> RobotLimits:
    _, config = robot_files(model, package)
    return load_parameters(RobotLimits, "robot", config)


def record(file: WorldFile, robot: str, package: Path, limit_s: float = 300.0) -> Drive:
    """Drive from start to goal, at most ``limit_s`` of simulated time."""
    with World(file, package=package) as world:
        route = plan_route(world.file, world.grid, robot, package)
        urdf, config = robot_files(file.robots[robot].model, package)
        steps = tuple(_steps(world, world.robots[robot], route, limit_s))
        mounted = LaserMount.of(mount(urdf, "laser"))
        end = Pose2D(*route[-1].tolist())
        arrived = not world.contacts() and distance(steps[-1].pose, end) < _ARRIVED_M
        return Drive(world.grid, tuple(file.sites.markers), mounted.pose, config, steps, arrived, mounted.upside_down)


def _steps(world: World, robot: SimulatedRobot, route: FloatArray, limit_s: float) -> Iterator[Step]:
    nearest, read_every = 0, world.params.encoder_steps
    readings = world.params.physics_rate_hz // SCAN_RATE_HZ // read_every
    while world.now < limit_s:
        wheels = []
        for _ in range(readings):
            for _ in range(read_every):
                world.step()
            wheels.append((world.now, np.array(robot.wheel_angles())))
        truth, _ = robot.ground_truth()
        yield Step(tuple(wheels), world.now, robot.true_distances(), truth)
        twist, nearest = pursue(route, truth, nearest)
        if twist is None:
            return
        robot.command(twist, world.now)


def pursue(route: FloatArray, pose: Pose2D, nearest: int) -> tuple[Twist2D | None, int]:
    """The twist along a path (N, 2) towards a point ahead, None at its end; and the index of the nearest point."""
    # Only a short stretch ahead counts, or a path that comes back would be cut short.
    nearest += int(np.argmin(np.hypot(*(route[nearest : nearest + 30] - (pose.x, pose.y)).T)))
    apart = np.hypot(*(route[nearest:] - (pose.x, pose.y)).T)
    far = np.flatnonzero(apart > _LOOKAHEAD_M)
    if not len(far):
        return None, nearest
    x, y = route[nearest + far[0]]
    error = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.theta)
    slow = max(0.0, math.cos(error)) ** 2
    return Twist2D(_SPEED_MPS * slow, max(-1.0, min(1.0, 2.0 * error))), nearest
