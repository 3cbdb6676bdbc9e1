"""Signed distance to walls: exact on straight ones, silent where there is no wall."""

from __future__ import annotations

import numpy as np

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
