"""Parallel to the wall beside the robot, however it stands."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flat_world import LASER, TURTLEBOT, FlatWorld
from hitchhike_ros.control.wall_alignment import WallAlignmentParameters, turn_along_wall
from hitchhike_ros.core.datatypes import LaserScan, Pose2D
from hitchhike_ros.core.geometry import wrap_angle

PARAMS = WallAlignmentParameters()
# A corridor along x, 2.9 m wide, with an end wall behind.
WALLS = ((0.0, 2.9, 30.0, 0.2), (0.0, -0.2, 30.0, 0.2), (-0.2, -0.2, 0.2, 3.3))


def scan_at(pose: Pose2D, seed: int = 0) -> LaserScan:
    world = FlatWorld(TURTLEBOT, WALLS, pose, seed, beams=751)
    return world.scan()


@settings(max_examples=60)
@given(
    st.floats(0.6, 20.0),
    st.floats(0.5, 2.4),
    st.floats(-1.9, 1.9),
    st.floats(-0.3, 0.3),
    st.sampled_from(["left", "right"]),
    st.integers(0, 1000),
)
def test_the_turn_ends_along_the_corridor(x, y, theta, wrong, side, seed) -> None:
    turn = turn_along_wall(scan_at(Pose2D(x, y, theta), seed), LASER[TURTLEBOT], side, -theta + wrong, PARAMS)
    wall_bearing = wrap_angle((math.pi / 2 if side == "left" else -math.pi / 2) - theta)
    if abs(wall_bearing) < math.radians(110):  # else much of the wall is out of view
        assert turn is not None
    if turn is not None:
        assert abs(wrap_angle(theta + turn)) <= math.radians(1.5)


def test_the_end_wall_is_not_taken_for_the_side_wall() -> None:
    pose = Pose2D(1.0, 1.4, math.pi)  # looks at the end wall, to which the left wall would lead at -90°
    turn = turn_along_wall(scan_at(pose), LASER[TURTLEBOT], "left", math.pi, PARAMS)
    assert turn is None or abs(wrap_angle(pose.theta + turn)) < 0.03


@pytest.mark.parametrize("ranges", [np.full(271, np.inf), np.full(271, 7.9)])
def test_without_a_wall_there_is_no_turn(ranges: np.ndarray) -> None:
    scan = LaserScan(0.0, -2.356, 0.01745, 0.02, 8.0, ranges)
    assert turn_along_wall(scan, LASER[TURTLEBOT], "left", 0.0, PARAMS) is None
