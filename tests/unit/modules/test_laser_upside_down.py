"""All modules that use a laser which hangs upside down see the world as with one that stands upright."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.control.safety_limiter import SafetyLimiter
from hitchhike_ros.core.datatypes import LaserScan, Odometry, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import RobotModelError
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.localization.ekf import pose_error
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.modules.inputs import InitialPose, PlannedPath
from hitchhike_ros.modules.obstacle_avoidance import ObstacleAvoidance
from hitchhike_ros.modules.robot_files import PlainFiles
from hitchhike_ros.modules.slam import Slam
from hitchhike_ros.modules.visual_servoing import VisualServoing
from hitchhike_ros.protocol.status import GoalCommand, ModuleSwitches, ServoCommand, Status
from laser_world import take_scan, walls_of
from plain_files import plain_files
from repository import ROOT

TRUTH = Pose2D(8.0, 5.4, 0.3)


def files(folder: Path, rpy: str) -> PlainFiles:
    """The P3DX with its laser mounted so."""
    plain = plain_files("p3dx")
    text = plain.urdf.read_text(encoding="utf-8")
    upright = '<origin xyz="0.17 0 0.11"/>'
    assert text.count(upright) == 1
    urdf = folder / "p3dx.urdf"
    urdf.write_text(text.replace(upright, f'<origin xyz="0.17 0 0.11" rpy="{rpy}"/>'), encoding="utf-8")
    return replace(plain, urdf=urdf, grid=load_map(ROOT / "maps" / "p17_exp1.yaml"))


def measured(upright: LaserScan, rpy: str) -> LaserScan:
    """What the laser itself measures: beams go round the other way when it is upside down."""
    return upright if rpy == "0 0 0" else upright.mirrored()


@pytest.mark.parametrize("rpy", ["0 0 0", "3.14159265 0 0"])
def test_slam_finds_the_pose(tmp_path: Path, rpy: str) -> None:
    """It was once 0.56 m off, and sure to 6 mm."""
    slam = Slam.build(files(tmp_path, rpy), alone=True)
    rng = np.random.default_rng(1)
    walls = walls_of(load_map(ROOT / "maps" / "p17_exp1.yaml"))
    slam.step(0.0)
    start = PoseEstimate(0.0, Pose2D(TRUTH.x + 0.1, TRUTH.y - 0.08, TRUTH.theta + 0.03), np.diag([0.02, 0.02, 0.003]))
    slam.sense(InitialPose(start), 0.0)
    said = None
    for k in range(12):
        now = round(0.1 * k, 3)
        slam.sense(Odometry(now, Pose2D(), Twist2D()), now)
        slam.sense(measured(take_scan(TRUTH, walls, rng, now), rpy), now)
        said = slam.step(now).pose or said
    assert said is not None
    x, y, theta = pose_error(said.pose, TRUTH)
    assert np.hypot(x, y) < 0.03
    assert abs(theta) < 0.01


@pytest.mark.parametrize("rpy", ["0 0 0", "3.14159265 0 0"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_driver_and_the_rider_brake_on_the_side_of_the_box(tmp_path: Path, rpy: str, side: float) -> None:
    plain = files(tmp_path, rpy)
    pose = Pose2D(8.0, 5.4)
    box = np.array([[8.45, 5.4 + (0.05 if side > 0 else -0.35), 0.3, 0.3]])
    upright = take_scan(pose, box, stamp=1.0)
    scan = measured(upright, rpy)
    servoing = VisualServoing.build(plain)
    servoing.order(Status(1.0, "p3dx", modules=ModuleSwitches(VS=True), servo=ServoCommand("follow", 0)), 1.0)
    servoing.sense(scan, 1.0)
    limiter = servoing._limiter
    assert isinstance(limiter, SafetyLimiter)
    limits = plain.load(RobotLimits, "robot")
    same, other = SafetyLimiter(limits, Pose2D(0.17)), SafetyLimiter(limits, Pose2D(0.17))
    same.see(upright, 1.0)
    other.see(upright.mirrored(), 1.0)
    found, there, across = (
        [a.limit(1.0, Twist2D(0.4, omega))[0] for omega in (1.2, 0.6, -0.6, -1.2)] for a in (limiter, same, other)
    )
    assert found == there
    assert found != across
    scan = measured(take_scan(pose, box + (0.55, 0.0, 0.0, 0.0), stamp=1.0), rpy)
    avoidance = ObstacleAvoidance.build(plain)
    goal = GoalCommand("1", 11.0, 5.4, 0.0)
    avoidance.order(Status(1.0, "p3dx", goal=goal), 1.0)
    path = np.array([(8.0, 5.4), (9.5, 5.4), (11.0, 5.4)])
    for x in (
        PlannedPath(path, goal.pose),
        Odometry(1.0, Pose2D(), Twist2D(0.2)),
        PoseEstimate(1.0, pose, np.zeros((3, 3))),
        scan,
    ):
        avoidance.sense(x, 1.0)
    command = avoidance.step(1.0).command
    assert command is not None
    assert command.twist.omega * side < 0.0  # around the box, on the side where it is not


def test_a_laser_that_leans_is_refused_by_every_module_that_needs_it(tmp_path: Path) -> None:
    plain = files(tmp_path, "0 0.2 0")
    for build in (Slam.build, ObstacleAvoidance.build, VisualServoing.build):
        with pytest.raises(RobotModelError, match=r"p3dx\.urdf: tilt of link laser is '11\.5°', expected"):
            build(plain)
    assert plain.load(RobotLimits, "robot").front_m > 0.0
