"""Corners out of maps and out of scans."""

from __future__ import annotations

import math

import numpy as np
import pytest

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
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise, end_points
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


def slow_corners(data: np.ndarray, steps: int) -> set[tuple[float, int, int]]:
    """Signature, row and column of the corners of a grid by their definition, cell by cell; off the grid is unknown."""

    def value(row: int, column: int) -> int:
        inside = 0 <= row < data.shape[0] and 0 <= column < data.shape[1]
        return int(data[row, column]) if inside else -1

    found = set()
    for row in range(data.shape[0] + 1):
        for column in range(data.shape[1] + 1):
            for dr, dc in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                # The cell at the point on that side, and those behind its two edges.
                r, c = row - (dr < 0), column - (dc < 0)
                down = [(value(r + k * dr, c), value(r + k * dr, c - dc)) for k in range(steps)]
                along = [(value(r, c + k * dc), value(r - dr, c + k * dc)) for k in range(steps)]
                opposite = value(r - dr, c - dc)
                if opposite == 0 and all(own == 100 and beside == 0 for own, beside in down + along):
                    found.add((CONVEX, row, column))
                if opposite != 0 and all(own == 0 and beside == 100 for own, beside in down + along):
                    found.add((CONCAVE, row, column))
    return found


@pytest.mark.parametrize(("resolution", "steps"), [(0.05, 3), (0.04, 3), (0.02, 6), (0.03, 4)])
def test_corners_of_any_map_are_those_of_the_definition(resolution, steps):
    rng, all_found = np.random.default_rng(0), 0
    for _ in range(8):
        data = np.zeros((24, 30), dtype=np.int8)
        for _ in range(5):
            r, c, h, w = rng.integers([0, 0, 3, 3], [22, 28, 12, 12])
            data[r : r + h, c : c + w] = rng.choice([100, 100, 100, 0, -1])
        corners = map_corners(OccupancyGrid(data, resolution), PARAMETERS)
        cells = np.rint(corners.positions / resolution).astype(int)
        found = {(float(s), int(y), int(x)) for s, (x, y) in zip(corners.signatures, cells, strict=True)}
        assert found == slow_corners(data, steps)
        np.testing.assert_allclose(corners.positions, cells * resolution, atol=1e-9)
        all_found += len(found)
    assert all_found > 15


def ends_at(points: np.ndarray, beams: np.ndarray | None = None) -> EndPoints:
    return EndPoints(points, np.hypot(*points.T), np.arange(len(points)) if beams is None else beams)


def side(start: tuple[float, float], angle: float, *along: float) -> np.ndarray:
    """Points on a straight line from a start."""
    return np.array(start) + np.outer(along, [math.cos(angle), math.sin(angle)])


def bent(angle: float, before: np.ndarray | None = None, after: np.ndarray | None = None) -> EndPoints:
    """Two walls that meet at (1.5, 0.5) with a turn by an angle; their points by the distance from there."""
    one = np.arange(0.5, 0.0, -0.03) if before is None else before
    two = np.arange(0.03, 0.5, 0.03) if after is None else after
    return ends_at(
        np.vstack([side((1.5, 0.5), math.pi, *one), [[1.5, 0.5]], side((1.5, 0.5), angle, *two)]),
    )


@pytest.mark.parametrize("angle", [1.3, -1.3, 2.0, -2.0])
def test_a_corner_lies_where_two_walls_meet(angle):
    inside = np.array([math.cos(angle) - 1.0, math.sin(angle)])
    for laser, signature in ((inside, CONCAVE), (-inside, CONVEX)):
        [corner] = scan_corners(bent(angle), laser + [1.5, 0.5], NOISE, PARAMETERS)
        r = math.hypot(1.5, 0.5)
        assert corner.range_m == pytest.approx(r)
        assert corner.bearing_rad == pytest.approx(math.atan2(0.5, 1.5))
        assert corner.signature == signature
        assert corner.range_sigma_m == pytest.approx(0.01 * math.hypot(1.0, r))
        assert corner.bearing_sigma_rad == 0.008


@pytest.mark.parametrize(("turn", "corners"), [(0.98, 0), (1.02, 1), (math.pi - 1.02, 1), (math.pi - 0.98, 0)])
def test_walls_that_turn_by_less_than_a_radian_make_no_corner(turn, corners):
    assert len(scan_corners(bent(turn), np.zeros(2), NOISE, PARAMETERS)) == corners


@pytest.mark.parametrize(
    ("along", "corners"),
    [
        (np.linspace(0.02, 0.14, 7), 1),  # eight standard deviations are 0.127 m there
        (np.linspace(0.02, 0.11, 7), 0),
        (np.linspace(0.08, 0.48, 6), 1),
        (np.linspace(0.10, 0.40, 4), 0),  # with the point at the corner five
    ],
)
def test_a_short_wall_has_no_direction(along, corners):
    for ends in (bent(1.5, before=along[::-1]), bent(1.5, after=along)):
        assert len(scan_corners(ends, np.zeros(2), NOISE, PARAMETERS)) == corners


@pytest.mark.parametrize(("far", "corners"), [(3.9, 1), (4.1, 0)])
def test_corners_farther_than_four_metres_are_not_used(far, corners):
    points = bent(1.5).points + [far - 1.5, -0.5]
    assert len(scan_corners(ends_at(points), np.zeros(2), NOISE, PARAMETERS)) == corners
