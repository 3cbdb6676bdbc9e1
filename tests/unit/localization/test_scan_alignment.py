"""Scans aligned to walls: right, robust and aware of what they do not show."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.localization.ekf import Ekf, pose_error
from hitchhike_ros.localization.scan_alignment import (
    Alignment,
    AlignmentParameters,
    Incidence,
    ScanAlignment,
    spread,
)
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise, end_points
from laser_world import LASER, boxes_of, take_scan, walls_of

PRIOR = np.diag([0.05, 0.05, 0.03]) ** 2


def corridor(pillars: bool) -> OccupancyGrid:
    """30 m x 2.2 m at 0.05 m, bare or with pillars."""
    data = np.full((64, 600), 100, dtype=np.int8)
    data[10:54, :] = 0
    if pillars:
        for k in (250, 310, 370):
            data[10:14, k : k + 6] = 100
            data[50:54, k + 25 : k + 33] = 100
    return OccupancyGrid(data, 0.05)


def align(grid: OccupancyGrid, truth: Pose2D, prior: Pose2D, boxes: FloatArray, seed: int = 0) -> Alignment | None:
    alignment = ScanAlignment(DistanceField(grid), grid.resolution, LaserNoise(), AlignmentParameters())
    scan = take_scan(truth, np.vstack([walls_of(grid), boxes]), np.random.default_rng(seed))
    return alignment.align(end_points(scan, LASER), np.array([LASER.x, LASER.y]), prior, PRIOR)


def corrected(prior: Pose2D, measured: Alignment | None) -> Ekf:
    assert measured is not None
    ekf = Ekf(prior, PRIOR)
    ekf.update_information(measured.information, measured.vector)
    return ekf


def test_pillars_and_walls_give_the_whole_pose():
    truth = Pose2D(15.0, 1.7, 0.1)
    for k, off in enumerate([(0.08, -0.06, 0.04), (-0.1, 0.05, -0.05), (0.05, 0.08, 0.0)]):
        prior = Pose2D(truth.x + off[0], truth.y + off[1], truth.theta + off[2])
        ekf = corrected(prior, align(corridor(True), truth, prior, np.zeros((0, 4)), seed=k))
        error = np.abs(pose_error(ekf.pose, truth))
        assert (error < [0.03, 0.01, 0.005]).all()
        assert (error < 4 * np.sqrt(np.diag(ekf.covariance))).all()


def test_along_a_bare_corridor_nothing_is_known_and_nothing_moves():
    truth, prior = Pose2D(15.0, 1.7, 0.0), Pose2D(15.06, 1.65, 0.02)
    measured = align(corridor(False), truth, prior, np.zeros((0, 4)))
    ekf = corrected(prior, measured)
    assert abs(ekf.pose.x - prior.x) < 0.01
    assert ekf.covariance[0, 0] > 0.9 * PRIOR[0, 0]
    assert abs(ekf.pose.y - truth.y) < 0.01
    assert ekf.covariance[1, 1] < 0.05 * PRIOR[1, 1]
    assert measured is not None and measured.explained > 0.95


def test_boxes_and_robots_that_the_map_does_not_have_do_not_pull():
    truth = Pose2D(15.0, 1.7, 0.0)
    things = boxes_of(
        [Obstacle("a", 16.0, 1.0, 0.4, 0.44), Obstacle("b", 17.5, 2.0, 0.5, 0.4), Obstacle("c", 14.9, 0.9, 0.4, 0.3)]
    )
    alone = corrected(truth, align(corridor(True), truth, truth, np.zeros((0, 4))))
    among = corrected(truth, align(corridor(True), truth, truth, things))
    measured = align(corridor(True), truth, truth, things)
    assert measured is not None and measured.explained < 0.9
    assert (np.abs(pose_error(among.pose, alone.pose)) < [0.02, 0.01, 0.005]).all()


def test_a_scan_of_something_else_is_no_measurement():
    closed_in = boxes_of([Obstacle("front", 15.5, 0.6, 0.1, 2.0), Obstacle("back", 14.5, 0.6, 0.1, 2.0)])
    aside = boxes_of([Obstacle("l", 14.6, 2.1, 0.9, 0.1), Obstacle("r", 14.6, 1.1, 0.9, 0.1)])
    truth = Pose2D(15.0, 1.7, 0.0)
    assert align(corridor(True), truth, truth, np.vstack([closed_in, aside])) is None
    assert align(corridor(True), truth, Pose2D(80.0, 80.0, 0.0), np.zeros((0, 4))) is None


def test_beams_are_spread_along_the_walls():
    ends = end_points(take_scan(Pose2D(15.0, 1.7, 0.0), walls_of(corridor(True)), np.random.default_rng(0)), LASER)
    chosen = spread(ends, 100, 0.2)
    assert 60 < len(chosen.points) <= 100
    far = ends.ranges > 4.0
    assert (chosen.ranges > 4.0).mean() > 2 * far.mean()
    assert (np.diff(chosen.beams) > 0).all()


def test_the_measurement_is_consistent():
    rng, nees = np.random.default_rng(8), []
    for k in range(40):
        truth = Pose2D(rng.uniform(13.0, 19.0), rng.uniform(1.3, 2.0), rng.uniform(-0.3, 0.3))
        prior = Pose2D(*(np.array([truth.x, truth.y, truth.theta]) + rng.multivariate_normal(np.zeros(3), PRIOR)))
        ekf = corrected(prior, align(corridor(True), truth, prior, np.zeros((0, 4)), seed=k))
        error = pose_error(ekf.pose, truth)
        nees.append(error @ np.linalg.solve(ekf.covariance, error))
    assert np.mean(nees) < 3.8


def ragged() -> tuple[ScanAlignment, DistanceField, OccupancyGrid]:
    """A corridor whose lower wall has a tooth every other cell, as in a map of a real building."""
    grid = corridor(True)
    data = grid.data.copy()
    data[10, ::2] = 100
    grid = OccupancyGrid(data, 0.05)
    field = DistanceField(grid)
    return ScanAlignment(field, grid.resolution, LaserNoise(), AlignmentParameters()), field, grid


def some_ends(grid: OccupancyGrid, truth: Pose2D, beams: int = 121) -> EndPoints:
    return end_points(take_scan(truth, walls_of(grid), np.random.default_rng(3), beams=beams), LASER)


def test_an_end_point_is_a_measurement_of_its_distance_to_the_walls():
    alignment, field, grid = ragged()
    pose, h = Pose2D(15.03, 1.68, 0.12), 1e-6
    ends, origin = some_ends(grid, Pose2D(15.0, 1.7, 0.1)), np.array([LASER.x, LASER.y])
    at = alignment.incidence(ends, origin, pose)

    def distances(x: float, y: float, theta: float) -> FloatArray:
        return field.lookup(transform_points(Pose2D(x, y, theta), ends.points))[0]

    points = transform_points(pose, ends.points)
    distance, gradient, valid = field.lookup(points)
    np.testing.assert_array_equal(at.distance, distance)
    np.testing.assert_array_equal(at.valid, valid)
    assert valid.sum() > 100
    for k, step in enumerate(np.eye(3) * h):
        plus, minus = (distances(*(np.array([pose.x, pose.y, pose.theta]) + sign * step)) for sign in (1, -1))
        np.testing.assert_allclose(at.J[valid, k], (plus - minus)[valid] / (2 * h), atol=1e-4)
    laser = transform_points(pose, origin[None])[0]
    away = points - laser
    cosine = np.einsum("ni,ni->n", away, gradient) / np.hypot(*away.T)
    np.testing.assert_allclose(at.towards, cosine)
    sigma = np.maximum(0.01, 0.01 * ends.ranges)  # P17 §7.1, a third of 3 %
    np.testing.assert_allclose(at.wall, field.face_variance(points))
    np.testing.assert_allclose(at.variance, (sigma * cosine) ** 2 + 0.003**2 + at.wall)
    assert at.wall.max() > 1e-5
    cells = [tuple(cell) for cell in np.floor(points / 0.05).astype(int)]
    assert at.count.tolist() == [cells.count(cell) for cell in cells]
    assert at.count.max() > 1


def test_end_points_on_one_face_share_its_error():
    """Their mean has the variance of one face, beside the noise that differs from one to the next."""
    n, wall, noise = 7, 4e-4, 1e-4
    J = np.tile([0.0, 1.0, 0.0], (n, 1))
    at = Incidence(
        np.zeros(n), J, np.zeros(n), np.full(n, wall + noise), np.full(n, wall), np.full(n, n), np.full(n, True)
    )
    information = float((at.independence / at.variance).sum())
    assert information == pytest.approx(1.0 / (wall + noise / n))
    sight = at.sight(at.independence / at.variance, np.arange(n) < 5)
    assert sight.explained == pytest.approx(5 / 7)
    expected = np.zeros((3, 3))
    expected[1, 1] = information / (information + 1.0) ** 2 * wall / (wall + noise / n)
    np.testing.assert_allclose(sight.walls, expected, atol=1e-15)


def test_what_walls_are_off_by_moves_the_pose_as_its_weights_say():
    """By drawing errors of the faces: each cell has one, and the pose is the weighted least squares fit."""
    alignment, _, grid = ragged()
    ends = some_ends(grid, Pose2D(15.0, 1.7, 0.1))
    at = alignment.incidence(ends, np.array([LASER.x, LASER.y]), Pose2D(15.0, 1.7, 0.1))
    on_walls = at.valid & (np.abs(at.distance) < 0.05)
    weights = np.where(on_walls, at.independence / at.variance, 0.0)
    cells = np.floor(transform_points(Pose2D(15.0, 1.7, 0.1), ends.points) / 0.05).astype(int)
    _, face = np.unique(cells, axis=0, return_inverse=True)
    rng = np.random.default_rng(0)
    fit = np.linalg.inv((weights[:, None] * at.J).T @ at.J + np.eye(3)) @ (weights[:, None] * at.J).T
    errors = rng.standard_normal((face.max() + 1, 20000))[face] * np.sqrt(at.wall)[:, None]
    drawn = np.cov(fit @ errors)
    walls = at.sight(weights, on_walls).walls
    # A weight counts noise as well, so it is no more than nearly the covariance of what was drawn.
    np.testing.assert_allclose(np.sqrt(np.diag(walls)), np.sqrt(np.diag(drawn)), rtol=0.35)
    assert np.diag(walls).min() > 0.0


def slow_align(
    alignment: ScanAlignment, ends: EndPoints, origin: FloatArray, mean: Pose2D, P: FloatArray
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Information, vector and inliers by the formulas: six steps, or until one is less than 0.1 mm and 0.1 mrad."""
    prior, x, gate, first = np.linalg.inv(P), np.zeros(3), None, None
    for step in range(6):
        at = alignment.incidence(ends, origin, Pose2D(mean.x + x[0], mean.y + x[1], mean.theta + x[2]))
        if first is None:
            first = np.array([j @ P @ j for j in at.J])
            gate = np.minimum(3.5 * np.sqrt(at.variance + first), 0.6)
        inlier = at.valid & (np.abs(at.distance) < gate) & (at.towards < 0.2)
        scale = at.variance + first * 0.2**step
        weights = np.where(inlier, at.independence / at.variance / (1.0 + at.distance**2 / (4.0 * scale)) ** 2, 0.0)
        A = sum(w * np.outer(j, j) for w, j in zip(weights, at.J, strict=True))
        b = A @ x - sum(w * d * j for w, d, j in zip(weights, np.nan_to_num(at.distance), at.J, strict=True))
        before, x = x, np.linalg.solve(prior + A, b)
        if np.abs(x - before)[:2].sum() < 1e-4 and abs(x - before)[2] < 1e-4:
            break
    return A, b, inlier


@pytest.mark.parametrize("off", [(0.05, -0.03, 0.02), (-0.08, 0.05, -0.04), (0.0, 0.0, 0.0)])
def test_the_measurement_is_that_of_gauss_newton_with_the_prior(off):
    alignment, _, grid = ragged()
    truth, origin = Pose2D(15.0, 1.7, 0.1), np.array([LASER.x, LASER.y])
    box = boxes_of([Obstacle("a", 16.0, 1.0, 0.4, 0.44)])
    ends = end_points(take_scan(truth, np.vstack([walls_of(grid), box]), np.random.default_rng(3), beams=141), LASER)
    prior = Pose2D(truth.x + off[0], truth.y + off[1], truth.theta + off[2])
    measured = alignment.align(ends, origin, prior, PRIOR)
    A, b, inlier = slow_align(alignment, ends, origin, prior, PRIOR)
    assert measured is not None
    np.testing.assert_allclose(measured.information, A, rtol=1e-6)
    np.testing.assert_allclose(measured.vector, b, rtol=1e-6)
    assert measured.explained == pytest.approx(inlier.mean())


@pytest.mark.parametrize(("beams", "least", "measures"), [(14, 0.2, False), (15, 0.2, True), (30, 1.0, False)])
def test_a_measurement_takes_enough_beams_on_walls(beams, least, measures):
    grid = corridor(True)
    ends = some_ends(grid, Pose2D(15.0, 1.7, 0.0), 769)
    chosen = np.linspace(0, len(ends.points) - 1, beams).astype(int)
    few = EndPoints(ends.points[chosen], ends.ranges[chosen], ends.beams[chosen])
    if beams == 30:  # one of them is in the middle of the corridor
        points = few.points.copy()
        points[3] = [0.5, 0.0]
        few = EndPoints(points, few.ranges, few.beams)
    alignment = ScanAlignment(
        DistanceField(grid), grid.resolution, LaserNoise(), AlignmentParameters(min_explained=least)
    )
    measured = alignment.align(few, np.array([LASER.x, LASER.y]), Pose2D(15.0, 1.7, 0.0), PRIOR)
    assert (measured is not None) == measures


def test_the_back_of_a_wall_is_no_measurement():
    """A beam that ends on the far side of a wall, a cell thick, went through what the map says."""
    data = np.zeros((60, 200), dtype=np.int8)
    data[20] = 100
    grid = OccupancyGrid(data, 0.05)
    alignment = ScanAlignment(DistanceField(grid), grid.resolution, LaserNoise(), AlignmentParameters(max_gate_m=0.1))
    x = np.linspace(-1.0, 1.0, 40)
    for y, seen in ((0.5, True), (0.55, False)):  # from below: the front of the wall, and its back
        points = np.column_stack([x, np.full(40, y)])
        ends = EndPoints(points, np.hypot(*points.T), np.arange(40))
        measured = alignment.align(ends, np.zeros(2), Pose2D(5.0, 0.5, 0.0), PRIOR)
        assert (measured is not None) == seen


def test_few_beams_are_all_taken_and_neighbours_count_no_farther_than_the_gap():
    points = np.column_stack([np.concatenate([np.arange(0.0, 2.0, 0.01), np.arange(5.0, 7.0, 0.01)]), np.zeros(400)])
    ends = EndPoints(points, points[:, 0] + 1.0, np.arange(400))
    assert spread(ends, 400, 0.2) is ends
    chosen = spread(ends, 41, 0.2)
    assert len(chosen.points) == pytest.approx(41, abs=4)
    np.testing.assert_array_equal(chosen.points, points[chosen.beams])
    np.testing.assert_array_equal(chosen.ranges, ends.ranges[chosen.beams])
    # The gap of 3 m counts as 0.2 m: nearly half of the beams are on either side.
    assert 17 <= (chosen.points[:, 0] < 3.0).sum() <= 23
    assert chosen.beams[0] == 0


def beside_a_wall(off_m: float, beams: int, elsewhere: int = 0) -> Alignment | None:
    """End points so far from a wall, beside others that lie in the open, aligned with a prior that is not known."""
    data = np.zeros((80, 200), dtype=np.int8)
    data[40:] = 100
    grid = OccupancyGrid(data, 0.05)
    alignment = ScanAlignment(DistanceField(grid), grid.resolution, LaserNoise(), AlignmentParameters())
    on = np.column_stack([np.linspace(-1.0, 1.0, beams), np.full(beams, 1.0 - off_m)])
    off = np.column_stack([np.linspace(-1.0, 1.0, elsewhere), np.full(elsewhere, 0.1)])
    points = np.vstack([on, off])
    ends = EndPoints(points, np.hypot(*points.T), np.arange(len(points)))
    return alignment.align(ends, np.zeros(2), Pose2D(5.0, 1.0, 0.0), np.diag([1e-6, 4.0, 1e-6]))


def test_nothing_farther_than_sixty_centimetres_is_taken_for_a_wall():
    assert beside_a_wall(0.59, 40) is not None
    assert beside_a_wall(0.61, 40) is None


def test_a_fifth_of_the_beams_must_lie_on_walls():
    assert beside_a_wall(0.0, 21, 79) is not None
    assert beside_a_wall(0.0, 19, 81) is None
