"""Signed distance to walls: exact on straight ones, silent where there is no wall."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import OccupancyGrid


def room(origin: Pose2D | None = None) -> OccupancyGrid:
    """4 m x 3 m at 0.1 m: walls at x 3.0 to 3.1 and of four cells at the bottom; unknown beyond."""
    data = np.zeros((30, 40), dtype=np.int8)
    data[:, 31:] = -1
    data[:, 30] = 100
    data[:4, :30] = 100
    return OccupancyGrid(data, 0.1, origin or Pose2D())


def test_distance_to_a_straight_wall_is_exact_before_in_and_behind_it():
    x = np.linspace(2.0, 3.25, 26)
    distance, gradient, valid = DistanceField(room()).lookup(np.column_stack([x, np.full_like(x, 2.0)]))
    assert valid.all()
    np.testing.assert_allclose(distance, 3.0 - x, atol=1e-9)
    np.testing.assert_allclose(gradient, np.tile([-1.0, 0.0], (26, 1)), atol=1e-9)


def test_gradient_is_that_of_the_interpolated_field():
    field, rng, h = DistanceField(room(Pose2D(1.0, -2.0, 0.4))), np.random.default_rng(0), 1e-6
    points = transform_points(Pose2D(1.0, -2.0, 0.4), rng.uniform([0.2, 0.2], [3.0, 2.8], (200, 2)))
    _, gradient, valid = field.lookup(points)
    for axis, step in enumerate(np.eye(2) * h):
        numerical = (field.lookup(points + step)[0] - field.lookup(points - step)[0]) / (2 * h)
        np.testing.assert_allclose(gradient[valid, axis], numerical[valid], atol=1e-5)
    assert valid.mean() > 0.9


def test_no_wall_at_the_edge_of_the_known():
    data = np.zeros((30, 40), dtype=np.int8)
    data[:, 30:] = -1
    data[0] = 100
    points = np.array([[1.5, 0.3], [2.95, 2.0], [-1.0, 1.0], [9.0, 9.0]])
    distance, _, valid = DistanceField(OccupancyGrid(data, 0.1)).lookup(points)
    np.testing.assert_array_equal(valid & (np.abs(distance) < 0.5), [True, False, False, False])
    behind = DistanceField(room()).lookup(np.array([[3.8, 2.0]]))
    assert behind[0][0] < 0


def test_unmapped_margin_before_a_wall_is_before_it():
    data = np.zeros((20, 20), dtype=np.int8)
    data[:, 10], data[:, 11], data[:, 12:] = -1, 100, -1
    distance, _, valid = DistanceField(OccupancyGrid(data, 0.1)).lookup(np.array([[1.05, 1.0], [1.25, 1.0]]))
    np.testing.assert_allclose(distance, [0.05, -0.15], atol=1e-9)
    assert valid.all()


def test_a_map_without_walls_has_no_valid_field():
    for value in (0, -1, 100):
        _, _, valid = DistanceField(OccupancyGrid(np.full((9, 9), value, dtype=np.int8), 0.1)).lookup(
            np.full((1, 2), 0.45)
        )
        assert not valid.any()


def test_faces_are_uncertain_where_they_end():
    """Beside a straight face the field is exact; at the end of one it is off by up to 0.35 of half a cell."""
    data = np.zeros((30, 40), dtype=np.int8)
    data[10:20, 10:30] = 100
    field = DistanceField(OccupancyGrid(data, 0.1))
    points = np.array([[2.0, 1.0], [1.0, 1.5], [1.0, 1.0], [3.0, 2.0]])
    assert (field.lookup(points)[2]).all()
    off = field.lookup(points)[0]
    np.testing.assert_allclose(off[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(off[2:], 0.3536 * 0.05, atol=1e-5)
    variance = field.face_variance(points)
    np.testing.assert_allclose(variance[:2], 0.0, atol=1e-12)
    # A ninth to a third of the square of the greatest error, by how many straight faces are beside it.
    assert ((variance[2:] > off[2:] ** 2 / 9.1) & (variance[2:] < off[2:] ** 2 / 3.0)).all()


def test_distances_seen_from_many_poses_are_those_of_the_points():
    origin, rng = Pose2D(1.0, -2.0, 0.4), np.random.default_rng(1)
    field = DistanceField(room(origin))
    base = transform_points(origin, rng.uniform([0.3, 0.6], [2.5, 2.5], (20, 2)))
    poses, points = np.column_stack([base, rng.uniform(-4.0, 4.0, 20)]), rng.uniform(-1.0, 1.0, (30, 2))
    distances = field.distances(poses, points)
    for pose, row in zip(poses, distances, strict=True):
        expected, _, valid = field.lookup(transform_points(Pose2D(*pose), points))
        np.testing.assert_allclose(row[valid], expected[valid], atol=1e-9)
    assert 0.5 < np.isfinite(distances).mean() < 1.0


def nearest(mask: np.ndarray) -> np.ndarray:
    """Squared distance (H, W, N), in cells, from each cell to each cell of ``mask``, the slow way."""
    cells = np.argwhere(mask)
    row, column = (i[..., None] for i in np.indices(mask.shape))
    return (row - cells[:, 0]) ** 2 + (column - cells[:, 1]) ** 2


def slow_field(data: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed distance in half cells at half cells' centres, whether its face is a wall's, and whether that is sure.

    Of two edges that are as near, one may be that of a wall and the other not.
    """
    occupied, unknown, free = data == 100, data == -1, data == 0
    behind = unknown & (nearest(occupied).min(axis=2) < nearest(free).min(axis=2))
    solid, walls = ((m.repeat(2, axis=0).repeat(2, axis=1)) for m in (occupied | behind, occupied))
    beside = np.zeros_like(walls)
    for r, c in np.argwhere(walls):
        beside[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2] = True
    signed, wall, sure = np.zeros(solid.shape), np.zeros(solid.shape, bool), np.zeros(solid.shape, bool)
    for own, other, sign in ((~solid, walls, 1.0), (solid, beside, -1.0)):
        squared = nearest(~own)
        least = squared.min(axis=2)
        signed[own] = sign * (np.sqrt(least) - 0.5)[own]
        told = np.where(squared == least[..., None], other[~own], np.nan)
        wall[own] = (np.nanmax(told, axis=2) == 1.0)[own]
        sure[own] = (np.nanmax(told, axis=2) == np.nanmin(told, axis=2))[own]
    return signed, wall, sure


@pytest.mark.parametrize("seed", range(8))
def test_the_field_is_that_of_the_nearest_face_on_any_map(seed):
    rng = np.random.default_rng(seed)
    data = rng.choice([0, 0, 0, 0, 0, 100, -1], (9, 13)).astype(np.int8)
    data[4, 6], data[5, 6] = 100, 0
    signed, wall, sure = slow_field(data)
    field = DistanceField(OccupancyGrid(data, 0.2, Pose2D(-1.0, 2.0)))
    rows, columns = signed.shape
    # Also beside the map: there is no field from the middle of the outermost half cells on.
    xy = rng.uniform([-1.5, -1.5], [columns + 1.5, rows + 1.5], (400, 2))
    distance, _, valid = field.lookup(xy * 0.1 + [-1.0, 2.0])
    alone = field.distances(np.array([[-1.0, 2.0, 0.0]]), xy * 0.1)[0]
    for (x, y), d, is_valid, only in zip(xy - 0.5, distance, valid, alone, strict=True):
        c, r = int(np.floor(x)), int(np.floor(y))
        if not (0 <= c < columns - 1 and 0 <= r < rows - 1):
            assert not is_valid
            assert only == np.inf
            continue
        four = (slice(r, r + 2), slice(c, c + 2))
        if sure[four].all():
            assert is_valid == wall[four].all()
        if sure[r, c]:
            assert (only < np.inf) == wall[r, c]
        u, v = x - c, y - r
        (d00, d10), (d01, d11) = signed[four]
        expected = 0.1 * ((1 - v) * ((1 - u) * d00 + u * d10) + v * ((1 - u) * d01 + u * d11))
        if is_valid:
            assert d == pytest.approx(expected, abs=1e-9)
        if only < np.inf:
            assert only == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_faces_are_as_uncertain_as_the_field_is_off_where_they_end(seed):
    rng = np.random.default_rng(seed)
    data = rng.choice([0, 0, 0, 100], (9, 13)).astype(np.int8)
    data[4, 6], data[5, 6] = 100, 0
    signed = slow_field(data)[0] * 0.1
    rows, columns = signed.shape
    square, face = np.zeros((rows + 2, columns + 2)), np.zeros((rows + 2, columns + 2))
    for r in range(rows - 1):
        for c in range(columns - 1):
            four = signed[r : r + 2, c : c + 2]
            if four.min() < 0.0 < four.max():
                square[r + 1, c + 1], face[r + 1, c + 1] = four.mean() ** 2 / 3.0, 1.0
    field = DistanceField(OccupancyGrid(data, 0.2, Pose2D(-1.0, 2.0)))
    for r in range(rows):
        for c in range(columns):
            around = (slice(r, r + 3), slice(c, c + 3))
            expected = square[around].sum() / max(face[around].sum(), 1.0) if r < rows - 1 and c < columns - 1 else 0.0
            at = np.array([[c + 0.7, r + 0.6]]) * 0.1 + [-1.0, 2.0]
            assert field.face_variance(at)[0] == pytest.approx(expected, abs=1e-12), (r, c)
    # What lies beside the map is as uncertain as its rim.
    inside = np.array([[0.7, 5.6], [5.7, 0.6]]) * 0.1 + [-1.0, 2.0]
    np.testing.assert_array_equal(field.face_variance(inside - [[0.5, 0.0], [0.0, 0.5]]), field.face_variance(inside))
    np.testing.assert_array_equal(field.face_variance(np.array([[9.0, 2.5], [0.0, 9.0]])), 0.0)
