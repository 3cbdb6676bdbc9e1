"""Corners out of maps and out of scans."""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.localization.landmarks import (
    CONCAVE,
    CONVEX,
    CornerParameters,
    map_corners,
    scan_corners,
)
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import LaserNoise, end_points
from laser_world import LASER, boxes_of, take_scan

PARAMETERS, NOISE = CornerParameters(), LaserNoise()
ORIGIN = np.array([LASER.x, LASER.y])
# A room of 6 m x 4 m with a pillar in the middle of its north wall.
ROOM = boxes_of(
    [
        Obstacle("south", 0.0, -0.2, 6.0, 0.2),
        Obstacle("north", 0.0, 4.0, 6.0, 0.2),
        Obstacle("west", -0.2, -0.2, 0.2, 4.4),
        Obstacle("east", 6.0, -0.2, 0.2, 4.4),
        Obstacle("pillar", 2.8, 3.6, 0.4, 0.4),
    ]
)
CONVEX_CORNERS = [(2.8, 3.6), (3.2, 3.6)]
CONCAVE_CORNERS = [(0.0, 0.0), (6.0, 0.0), (0.0, 4.0), (6.0, 4.0), (2.8, 4.0), (3.2, 4.0)]


def room_grid(resolution: float = 0.05, theta: float = 0.0) -> OccupancyGrid:
    data = np.full((int(5 / resolution), int(7 / resolution)), 100, dtype=np.int8)
    cells = [round(v / resolution) for v in (0.5, 4.5, 0.5, 6.5)]
    data[cells[0] : cells[1], cells[2] : cells[3]] = 0
    pillar = [round(v / resolution) for v in (4.1, 4.5, 3.3, 3.7)]
    data[pillar[0] : pillar[1], pillar[2] : pillar[3]] = 100
    return OccupancyGrid(data, resolution, Pose2D(-0.5, -0.5, theta))


def matched(found: FloatArray, expected: list[tuple[float, float]]) -> float:
    """Largest distance from a point found to the nearest one expected, and the other way round."""
    apart = np.linalg.norm(found[:, None] - np.array(expected)[None], axis=2)
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max()))


def test_corners_of_a_map_lie_on_its_cells_corners():
    corners = map_corners(room_grid(), PARAMETERS)
    assert matched(corners.positions[corners.signatures == CONVEX], CONVEX_CORNERS) < 1e-9
    assert matched(corners.positions[corners.signatures == CONCAVE], CONCAVE_CORNERS) < 1e-9


def test_corners_of_a_map_turn_with_its_origin():
    turned = map_corners(room_grid(theta=0.3), PARAMETERS).positions
    straight = map_corners(room_grid(), PARAMETERS).positions
    moved = transform_points(Pose2D(-0.5, -0.5, 0.3), straight + 0.5)
    np.testing.assert_allclose(turned, moved, atol=1e-9)


def test_ragged_walls_have_no_corners():
    rng = np.random.default_rng(2)
    data = np.full((80, 80), 100, dtype=np.int8)
    data[10:70, 10:70] = 0
    for k in range(10, 70):
        data[rng.integers(8, 13), k] = data[k, rng.integers(67, 72)] = 100
        data[9 + k % 2, k] = data[68 + k % 2, k] = data[k, 9 + k % 2] = data[k, 68 + k % 2] = 100
    assert len(map_corners(OccupancyGrid(data, 0.05), PARAMETERS)) == 0


def test_corners_are_found_in_noisy_scans_and_carry_their_sign():
    rng, errors = np.random.default_rng(3), []
    everything = np.array(CONVEX_CORNERS + CONCAVE_CORNERS)
    signs = np.array([CONVEX] * len(CONVEX_CORNERS) + [CONCAVE] * len(CONCAVE_CORNERS))
    for _ in range(30):
        pose = Pose2D(rng.uniform(1.5, 4.5), rng.uniform(1.0, 2.5), rng.uniform(-math.pi, math.pi))
        ends = end_points(take_scan(pose, ROOM, rng), LASER)
        for seen in scan_corners(ends, ORIGIN, NOISE, PARAMETERS):
            point = seen.range_m * np.array([[math.cos(seen.bearing_rad), math.sin(seen.bearing_rad)]])
            apart = np.linalg.norm(everything - transform_points(pose, point), axis=1)
            assert seen.signature == signs[apart.argmin()]
            errors.append(apart.min())
    assert len(errors) > 60
    assert np.percentile(errors, 90) < 0.05
    assert max(errors) < 0.15


def test_a_straight_wall_has_no_corners():
    wall, rng = boxes_of([Obstacle("wall", -4.0, 1.0, 8.0, 0.2)]), np.random.default_rng(5)
    for _ in range(20):
        ends = end_points(take_scan(Pose2D(0.0, 0.0, 1.5), wall, rng), LASER)
        assert not scan_corners(ends, ORIGIN, NOISE, PARAMETERS)


def test_no_points_no_corners():
    empty = end_points(take_scan(Pose2D(), np.zeros((0, 4))), LASER)
    assert scan_corners(empty, ORIGIN, NOISE, PARAMETERS) == []
