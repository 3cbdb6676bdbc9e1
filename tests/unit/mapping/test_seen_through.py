"""Space that beams went through: known where they did, and unknown again where one ended."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Obstacle, Pose2D
from hitchhike_ros.core.geometry import compose, transform_points
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import LaserNoise, end_points, passed_through
from hitchhike_ros.mapping.seen_through import SeenThrough
from laser_world import boxes_of, take_scan

ROOM = OccupancyGrid(np.zeros((100, 120), dtype=np.int8), 0.05, Pose2D(-1.0, -2.5, 0.0))
# The same floor in cells that lie askew.
ASKEW = OccupancyGrid(np.zeros((160, 160), dtype=np.int8), 0.05, Pose2D(1.5, -4.5, math.pi / 4))
MOUNT = Pose2D(0.17, 0.0, 0.0)
BOX = Obstacle("box", 1.0, -0.2, 0.4, 0.4)
BEHIND, BEFORE = Obstacle("", 1.5, -0.15, 0.3, 0.3), Obstacle("", 0.6, -0.15, 0.3, 0.3)
WALL = Obstacle("wall", 4.0, -2.0, 0.1, 4.0)


def look(memory: SeenThrough, things: list[Obstacle], stamp: float) -> None:
    scan = take_scan(Pose2D(), boxes_of(things), None, stamp)
    memory.look(scan, MOUNT, end_points(scan, MOUNT).points)


@pytest.mark.parametrize("grid", [ROOM, ASKEW], ids=["straight", "askew"])
def test_beams_cross_what_is_before_a_box_and_not_the_box_nor_its_shadow(grid: OccupancyGrid) -> None:
    memory = SeenThrough(grid, LaserNoise(), 3.0, 0.04)
    look(memory, [BOX, WALL], 1.0)
    assert memory.crosses(BEFORE, 0.06, 0.5)
    assert not memory.crosses(BEFORE, 0.06, 1.5)
    assert not memory.crosses(BOX, 0.06, -math.inf)
    assert not memory.crosses(BEHIND, 0.06, -math.inf)
    look(memory, [WALL], 2.0)
    assert memory.crosses(BOX, 0.06, 1.5)
    assert memory.crosses(BEHIND, 0.06, 1.5)


def test_a_gap_as_wide_as_a_hand_is_crossed_and_nothing_is_beyond_reach_or_the_map() -> None:
    memory = SeenThrough(ROOM, LaserNoise(), 3.0, 0.04)
    look(memory, [Obstacle("", 1.0, 0.06, 0.4, 0.4), Obstacle("", 1.0, -0.46, 0.4, 0.4), WALL], 1.0)
    assert memory.crosses(Obstacle("", 1.0, -0.46, 0.4, 0.92), 0.06, 0.0)
    assert not memory.crosses(Obstacle("", 3.3, -0.2, 0.4, 0.4), 0.0, 0.0)
    assert not memory.crosses(Obstacle("", 9.0, 9.0, 0.4, 0.4), 0.0, 0.0)


def test_where_a_beam_ends_it_was_not_crossed() -> None:
    memory = SeenThrough(ROOM, LaserNoise(), 3.0, 0.04)
    look(memory, [WALL], 1.0)
    front = Obstacle("", 1.01, -0.1, 0.0, 0.2)
    assert memory.crosses(front, 0.0, 0.0)
    look(memory, [BOX, WALL], 2.0)
    assert not memory.crosses(front, 0.0, 0.0)


def test_a_beam_passes_what_it_ends_surely_behind() -> None:
    laser = compose(Pose2D(2.0, 1.0, 2.0), MOUNT)
    scan = take_scan(Pose2D(2.0, 1.0, 2.0), boxes_of([Obstacle("", -10.0, 4.0, 30.0, 1.0)]))
    k = 384  # straight ahead
    ahead = float(scan.ranges[k])
    ranges = np.array([0.01, 1.0, ahead - 3.1 * 0.01 * ahead, ahead - 2.9 * 0.01 * ahead, ahead + 0.1])
    passed, range_m = passed_through(
        scan, laser, transform_points(laser, np.stack([ranges, np.zeros(5)], 1)), LaserNoise(), 0.04
    )
    assert range_m == pytest.approx(ranges)
    assert passed.tolist() == [False, True, True, False, False]
    behind = transform_points(laser, np.array([[-1.0, 0.0]]))
    assert not passed_through(scan, laser, behind, LaserNoise(), 0.04)[0].any()
