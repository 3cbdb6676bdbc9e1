"""Particles: sizes, moments, motion, and the localizer as a whole on scans of the corridor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from corridor_drive import BOXES, MARKER, odometry
from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, compose, move, wrap_angle
from hitchhike_ros.localization.ekf import Ekf, pose_error
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.localization.methods import make_localizer
from hitchhike_ros.localization.motion import MotionNoise
from hitchhike_ros.localization.particle_filter import (
    ParticleFilter,
    ParticleParameters,
    _low_variance,
    kld_size,
    moments,
)
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


def two_places(heavy: float = 0.7, apart: float = 5.0) -> ParticleFilter:
    """A narrow cloud at (1, 2) that has a share of the weight, and one that has the rest some metres to the right."""
    particles, rng = cloud(), np.random.default_rng(1)
    narrow = rng.normal(0.0, 0.02, (400, 3))
    particles.replace(np.vstack([narrow[:200] + [1.0, 2.0, 3.1], narrow[200:] + [1.0, 2.0 - apart, 0.4]]))
    particles.weights = np.repeat([heavy / 200, (1.0 - heavy) / 200], 200)
    return particles


@pytest.mark.parametrize(("bins", "error", "quantile"), [(2, 0.05, 2.33), (7, 0.05, 2.33), (60, 0.02, 1.28)])
def test_kld_size_follows_fox_eq_7(bins, error, quantile):
    """Written as the Wilson-Hilferty quantile of chi-square with k - 1 degrees of freedom, by 2 error."""
    k = bins - 1
    chi2 = k * (1.0 - 2.0 / (9.0 * k) + quantile * math.sqrt(2.0 / (9.0 * k))) ** 3
    assert kld_size(bins, error, quantile) == math.ceil(chi2 / (2.0 * error))


def test_moments_are_weighted_and_round_the_circle():
    poses = np.array([[0.0, 1.0, 3.0], [4.0, 2.0, -3.0], [1.0, 0.0, 3.1]])
    weights = np.array([1.0, 2.0, 1.0])
    mean, covariance = moments(poses, weights)
    heading = np.angle((weights * np.exp(1j * poses[:, 2])).sum())
    np.testing.assert_allclose(mean, [9.0 / 4.0, 5.0 / 4.0, heading])
    away = poses - mean
    away[:, 2] = np.angle(np.exp(1j * away[:, 2]))
    expected = sum(w / 4.0 * np.outer(d, d) for w, d in zip(weights, away, strict=True))
    np.testing.assert_allclose(covariance, expected)


@pytest.mark.parametrize(("sigma", "size"), [(0.299, 400), (0.301, 4000)])
def test_a_start_that_is_known_badly_gets_the_most_particles(sigma, size):
    particles = cloud()
    particles.seed(Pose2D(1.0, 2.0, 0.5), np.diag([sigma**2 / 2, sigma**2 / 2, 0.01]))
    assert particles.poses.shape == (size, 3)
    particles.seed(Pose2D(1.0, 2.0, 3.1), np.diag([0.01, 0.01, 0.04]))
    assert np.abs(particles.poses[:, 2]).max() <= math.pi
    np.testing.assert_array_equal(particles.weights, np.full(400, 1.0 / 400))


def test_particles_without_noise_move_as_the_robot_does():
    particles, twist = cloud(), Twist2D(0.7, -0.9)
    particles._motion = MotionNoise(1e-30, 1e-30, 1e-30, 1e-30)
    start = np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, -3.1], [0.0, 0.0, 0.4]])
    particles.replace(start)
    particles.predict(twist, 0.25)
    expected = [move(Pose2D(*pose), twist, 0.25) for pose in start]
    np.testing.assert_allclose(particles.poses, [(p.x, p.y, wrap_angle(p.theta)) for p in expected], atol=1e-9)


def test_a_mild_observation_multiplies_the_weights_by_its_likelihood():
    particles = cloud()
    particles.seed(Pose2D(), P0)
    first, second = -0.5 * (particles.poses[:, 0] / 0.3) ** 2, 7.0 - 0.5 * (particles.poses[:, 1] / 0.3) ** 2
    particles.weigh(first)
    particles.weigh(second)
    likelihood = np.exp(first + second)
    np.testing.assert_allclose(particles.weights, likelihood / likelihood.sum(), rtol=1e-9)
    assert not particles._converging


def effective(weights: np.ndarray) -> float:
    return float(weights.sum() ** 2 / (weights**2).sum())


@pytest.mark.parametrize(("sigma", "converging"), [(0.02, False), (0.003, True)])
def test_a_sharp_observation_is_tempered_until_two_fifths_are_effective(sigma, converging):
    particles = cloud()
    particles.seed(Pose2D(), P0)
    log_likelihood = -0.5 * (particles.poses[:, 0] / sigma) ** 2
    particles.weigh(log_likelihood)
    assert effective(particles.weights) == pytest.approx(0.4 * 400, rel=0.02)
    assert effective(particles.weights) >= 0.4 * 400
    # The likelihood to a power, which says whether the cloud has yet to converge.
    power, normal = np.polyfit(log_likelihood, np.log(particles.weights), 1)
    np.testing.assert_allclose(np.log(particles.weights), power * log_likelihood + normal)
    assert (power < 0.1) == converging == particles._converging


def test_of_several_hypotheses_all_but_a_twentieth_may_vanish():
    particles = two_places(0.5)
    particles.weigh(-0.5 * ((particles.poses[:, 0] - 1.0) / 1e-4) ** 2)
    assert effective(particles.weights) == pytest.approx(0.05 * 400, rel=0.02)


def test_injected_particles_take_the_places_of_others_at_the_average_weight():
    particles = cloud()
    particles.seed(Pose2D(), P0)
    particles.weights = np.linspace(1.0, 2.0, 400) / np.linspace(1.0, 2.0, 400).sum()
    before, weights = particles.poses.copy(), particles.weights.copy()
    new = np.column_stack([np.arange(30.0) + 50.0, np.zeros(30), np.zeros(30)])
    particles.inject(new)
    taken = particles.poses[:, 0] > 40.0
    assert sorted(particles.poses[taken, 0]) == list(new[:, 0])
    np.testing.assert_array_equal(particles.poses[~taken], before[~taken])
    total = weights[~taken].sum() + 30 / 400
    np.testing.assert_allclose(particles.weights[taken], 1.0 / 400 / total)
    np.testing.assert_allclose(particles.weights[~taken], weights[~taken] / total)
    particles.inject(np.full((500, 3), 9.0))
    np.testing.assert_array_equal(particles.poses, 9.0)


@pytest.mark.parametrize(
    ("position", "heading", "one"), [(0.29, 0.29, True), (0.31, 0.1, False), (0.1, 0.31, False), (0.2, 0.2, True)]
)
def test_a_narrow_cloud_is_one_hypothesis(position, heading, one):
    particles = cloud()
    side, turn = position / math.sqrt(2.0), heading
    corners = [(x, y, t) for x in (-side, side) for y in (-side, side) for t in (-turn, turn)]
    particles.replace(np.array(corners))
    assert particles.spread() == pytest.approx((position, heading))
    assert particles.is_one_cluster == one


@pytest.mark.parametrize("heavy", [0.7, 0.3])
def test_the_estimate_is_the_heaviest_place_with_the_covariance_of_all(heavy):
    particles = two_places(heavy)
    pose, covariance = particles.estimate()
    members = slice(0, 200) if heavy > 0.5 else slice(200, 400)
    mean, _ = moments(particles.poses[members], particles.weights[members])
    np.testing.assert_allclose([pose.x, pose.y, pose.theta], mean)
    away = particles.poses - mean
    away[:, 2] = np.angle(np.exp(1j * away[:, 2]))
    np.testing.assert_allclose(covariance, (particles.weights[:, None] * away).T @ away)


@pytest.mark.parametrize(
    ("offset", "belongs"),
    [((0.45, 0.0, 0.0), True), ((0.0, 0.55, 0.0), False), ((0.0, 0.0, 0.3), True), ((0.0, 0.0, 0.4), False)],
)
def test_a_cluster_reaches_a_bin_about_its_centre(offset, belongs):
    particles = cloud()
    centre, near = np.array([0.25, 0.25, 0.09]), np.array([0.25, 0.25, 0.09]) + offset
    particles.replace(np.array([centre] * 6 + [near] + [centre + [5.0, 5.0, 2.0]] * 3))
    pose, _ = particles.estimate()
    expected = (6 * centre + near) / 7 if belongs else centre
    np.testing.assert_allclose([pose.x, pose.y, pose.theta], expected, atol=1e-3)


def test_particles_are_kept_while_enough_are_effective():
    particles = cloud(min_particles=400)
    particles.seed(Pose2D(), P0)
    before = particles.poses.copy()
    particles.weigh(-0.5 * (particles.poses[:, 0] / 0.1) ** 2)
    assert 0.5 * 400 < effective(particles.weights) < 0.9 * 400
    weights = particles.weights.copy()
    particles.resample()
    np.testing.assert_array_equal(particles.poses, before)
    np.testing.assert_array_equal(particles.weights, weights)


@pytest.mark.parametrize(("size", "resampled"), [(800, False), (801, True)])
def test_more_than_twice_the_fewest_particles_are_resampled(size, resampled):
    particles = cloud()
    particles.seed(Pose2D(), np.diag([0.01, 0.01, 0.01]) ** 2)
    particles.replace(np.vstack([particles.poses] * 3)[:size])
    particles.resample()
    assert len(particles.poses) == (400 if resampled else size)


def test_the_size_is_that_which_kld_asks_for_the_bins_that_are_occupied():
    particles = cloud(min_particles=10)
    rows = [(0.25 + 0.5 * i, 0.25 + 0.5 * j, 0.08 + 0.1745 * k) for i in range(3) for j in range(4) for k in range(2)]
    particles.replace(np.array(rows * 10))
    particles.resample()
    assert len(particles.poses) == kld_size(24, 0.05, 2.33)
    capped = cloud(min_particles=10, max_particles=100)
    capped.replace(np.array(rows * 10))
    capped.resample()
    assert len(capped.poses) == 100


def test_resampling_draws_each_particle_as_often_as_its_weight_says():
    """With one random number for all (Thrun et al., Table 4.4): as often, but for one."""
    particles = two_places(0.7)
    particles.weights = np.random.default_rng(5).random(400) ** 4
    particles.weights /= particles.weights.sum()
    drawn = np.bincount(_low_variance(particles.weights, 1000, np.random.default_rng(6)), minlength=400)
    assert drawn.sum() == 1000
    assert (np.abs(drawn - 1000 * particles.weights) < 1.0).all()


def spread_of_resampled(converging: bool) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of a cloud, and what resampling makes of it, where many particles are drawn."""
    particles = cloud(min_particles=20000, max_particles=20000)
    particles.seed(Pose2D(1.0, 2.0, 3.1), P0)
    before = moments(particles.poses, particles.weights)
    particles.replace(np.vstack([particles.poses] * 3))
    particles._converging = converging
    particles.resample()
    after = moments(particles.poses, particles.weights)
    np.testing.assert_allclose(after[0], before[0], atol=0.01)
    assert len(np.unique(particles.poses[:, 0])) == 20000
    return before[1], after[1]


def test_a_kernel_keeps_the_covariance_and_lets_a_converging_cloud_spread():
    before, after = spread_of_resampled(converging=False)
    np.testing.assert_allclose(np.diag(after), np.diag(before), rtol=0.03)
    before, after = spread_of_resampled(converging=True)
    np.testing.assert_allclose(np.diag(after), np.diag(before) * (1.0 + 0.5**2), rtol=0.03)


def test_several_hypotheses_get_a_small_kernel_each():
    particles = cloud(min_particles=4000)
    particles.replace(np.repeat([[0.0, 0.0, 0.0], [9.0, 0.0, 1.0]], [7000, 3000], axis=0))
    particles.resample()
    near = particles.poses[particles.poses[:, 0] < 5.0]
    assert len(near) == pytest.approx(0.7 * len(particles.poses), abs=2)
    np.testing.assert_allclose(near.std(axis=0), [0.04, 0.04, 0.03], rtol=0.1)
    np.testing.assert_allclose(near.mean(axis=0), 0.0, atol=0.005)


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
