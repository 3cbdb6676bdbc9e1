"""Particles: sizes, moments, motion, and the localizer as a whole on scans of the corridor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from corridor_drive import BOXES, MARKER, odometry
from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, compose
from hitchhike_ros.localization.ekf import Ekf, pose_error
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.localization.methods import make_localizer
from hitchhike_ros.localization.motion import MotionNoise
from hitchhike_ros.localization.particle_filter import ParticleFilter, ParticleParameters, kld_size, moments
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.mapping.map_file import load_map
from laser_world import LASER, boxes_of, drive, take_scan, walls_of
from repository import ROOT

MAP = ROOT / "maps" / "p17_exp1.yaml"
P0 = np.diag([0.1, 0.1, 0.05]) ** 2


@pytest.fixture(scope="module")
def corridor():
    return load_map(MAP)


@pytest.fixture(scope="module")
def localizer(corridor):
    return ParticleLocalizer(corridor, [MARKER], LocalizerParameters(), LASER)


def cloud(**parameters) -> ParticleFilter:
    return ParticleFilter(MotionNoise(), ParticleParameters(**parameters), np.random.default_rng(0))


def test_kld_size_is_that_of_the_chi_square_quantile():
    """Fox's approximation of chi2(k - 1) / (2 error); 1 % quantile of 99 degrees of freedom is 134.6."""
    assert kld_size(100, 0.05, 2.33) == pytest.approx(134.6 / 0.1, rel=0.01)
    assert kld_size(1, 0.05, 2.33) == 1


def test_seeded_along_the_eigenvectors_of_the_covariance():
    particles = cloud(min_particles=20000, max_particles=20000)
    covariance = np.array([[0.04, 0.015, 0.0], [0.015, 0.01, 0.002], [0.0, 0.002, 0.0025]])
    particles.seed(Pose2D(1.0, 2.0, 3.1), covariance)
    mean, spread = moments(particles.poses, particles.weights)
    np.testing.assert_allclose(mean, [1.0, 2.0, 3.1], atol=0.01)
    np.testing.assert_allclose(spread, covariance, atol=0.001)


@pytest.mark.parametrize("twist", [Twist2D(0.5, 0.0), Twist2D(0.5, 0.8), Twist2D(0.0, 1.0)])
def test_motion_spreads_as_the_filter_of_the_papers_says(twist):
    particles, covariance = cloud(min_particles=20000, max_particles=20000), np.diag([0.01, 0.01, 0.01]) ** 2
    ekf = Ekf(Pose2D(), covariance)
    particles.seed(Pose2D(), covariance)
    for _ in range(20):
        particles.predict(twist, 0.1)
        ekf.predict(twist, 0.1)
    mean, spread = moments(particles.poses, particles.weights)
    np.testing.assert_allclose(pose_error(Pose2D(*mean), ekf.pose), 0.0, atol=2e-3)
    np.testing.assert_allclose(spread, ekf.covariance, atol=0.06 * float(ekf.covariance.max()))


def test_resampling_keeps_mean_and_covariance_and_shrinks_to_what_kld_asks():
    particles = cloud(min_particles=2000, max_particles=8000)
    particles.seed(Pose2D(), P0)
    particles.replace(np.vstack([particles.poses] * 4))
    particles.weigh(-0.5 * (particles.poses[:, 0] / 0.05) ** 2)
    before = moments(particles.poses, particles.weights)
    particles.resample()
    assert len(particles.poses) == 2000
    for was, now in zip(before, moments(particles.poses, particles.weights), strict=True):
        np.testing.assert_allclose(now, was, atol=0.01)


def test_an_observation_leaves_enough_particles_effective():
    particles = cloud()
    particles.seed(Pose2D(), P0)
    particles.weigh(-0.5 * (particles.poses[:, 0] / 1e-4) ** 2)
    assert 1.0 / (particles.weights**2).sum() >= 0.25 * len(particles.poses)


def test_a_drive_past_new_boxes(corridor, localizer):
    rng = np.random.default_rng(0)
    rectangles, errors = np.vstack([walls_of(corridor), boxes_of(BOXES)]), []
    localizer.restart()
    for truth, odo in drive([(6.5, 5.7), (8.5, 5.4), (10.5, 5.8), (12.5, 6.15)], 0.5, rng):
        if not localizer.initialised:
            start = np.array([truth.x, truth.y, truth.theta]) + rng.multivariate_normal(np.zeros(3), P0)
            localizer.initialise(PoseEstimate(0.0, Pose2D(*start), P0))
        localizer.predict(odo)
        assert localizer.update_scan(take_scan(truth, rectangles, rng, odo.stamp))
        if odo.stamp > 3.0:
            errors.append(pose_error(localizer.estimate.pose, truth))
    rmse = np.sqrt(np.mean(np.square(errors), axis=0))
    assert math.hypot(rmse[0], rmse[1]) < 0.03
    assert math.degrees(rmse[2]) < 0.5


def test_anywhere_in_the_map_it_is_found_where_the_map_is_unlike_itself(corridor, localizer):
    truth = Pose2D(2.2, 1.8, math.pi / 2)  # in the lobby
    rng = np.random.default_rng(0)
    localizer.restart()
    localizer.predict(odometry(0.0))
    localizer.globalize()
    assert len(localizer.particles) > 1000
    for k in range(40):
        localizer.predict(odometry(0.1 * k))
        localizer.update_scan(take_scan(truth, walls_of(corridor), rng, 0.1 * k))
    np.testing.assert_allclose(pose_error(localizer.estimate.pose, truth), 0.0, atol=0.05)
    assert len(localizer.particles) < 1000


def test_a_known_marker_counts_and_an_unknown_one_does_not(localizer):
    truth = Pose2D(3.0, 5.72, 0.05)
    localizer.restart()
    localizer.initialise(PoseEstimate(0.0, Pose2D(2.95, 5.75, 0.0), P0))
    localizer.predict(odometry(0.0))
    seen, Q = between(truth, Pose2D(MARKER.x, MARKER.y, MARKER.yaw)), np.diag([1e-4, 1e-4, 4e-4])
    before = localizer.particles
    assert localizer.update_markers([MarkerObservation(0.0, 0, seen, Q)]) == 0
    np.testing.assert_array_equal(localizer.particles, before)
    for _ in range(5):
        assert localizer.update_markers([MarkerObservation(0.0, 10, seen, Q)]) == 1
    assert np.abs(pose_error(localizer.estimate.pose, truth)).max() < 0.04


@pytest.mark.parametrize("method", ["ekf", "particle"])
def test_restart_forgets_estimate_and_odometry(corridor, method):
    localizer = make_localizer(method, corridor, [], LocalizerParameters(), LASER)
    localizer.predict(odometry(100.0, x=4.0))
    localizer.initialise(PoseEstimate(100.0, Pose2D(8.0, 5.72, 0.0), P0))
    localizer.restart()
    assert not localizer.initialised
    with pytest.raises(RuntimeError):
        _ = localizer.estimate
    with pytest.raises(SensorDataError, match="no odometry"):
        localizer.odometry_at(100.0)
    localizer.predict(odometry(0.0, x=9.0))  # neither back in time nor a jump
    localizer.initialise(PoseEstimate(0.0, Pose2D(8.0, 5.72, 0.0), P0 * 1e-4))
    localizer.predict(odometry(0.1, x=9.05))
    np.testing.assert_allclose(
        pose_error(localizer.estimate.pose, compose(Pose2D(8.0, 5.72, 0.0), Pose2D(0.05))), 0.0, atol=0.005
    )
