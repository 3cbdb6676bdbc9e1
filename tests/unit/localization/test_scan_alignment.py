"""Scans aligned to walls: right, robust and aware of what they do not show."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D
from hitchhike_ros.localization.ekf import Ekf, pose_error
from hitchhike_ros.localization.scan_alignment import Alignment, AlignmentParameters, ScanAlignment, spread
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import LaserNoise, end_points
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
