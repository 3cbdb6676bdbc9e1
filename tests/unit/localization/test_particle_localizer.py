"""The parts of localization by particles: likelihoods, markers, where lost particles look, and when."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from corridor_drive import odometry
from hitchhike_ros.core.datatypes import FloatArray, Marker, MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import between, transform_points
from hitchhike_ros.localization.ekf import expected_marker, pose_error
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.localization.scan_alignment import spread
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import FREE, OccupancyGrid
from hitchhike_ros.mapping.laser import end_points
from laser_world import LASER, take_scan, walls_of

MARKER = Marker(id=10, x=2.0, y=3.0, z=0.3, yaw=-1.5)
P0 = np.diag([0.05, 0.05, 0.03]) ** 2


def room() -> OccupancyGrid:
    """8 m x 4 m with an alcove in one corner, so that it looks alike from nowhere else; unknown around it."""
    data = np.full((100, 180), -1, dtype=np.int8)
    data[9:91, 9:171] = 100
    data[10:90, 10:170] = 0
    data[10:40, 10:60] = 100
    return OccupancyGrid(data, 0.05, Pose2D(-0.5, -0.5))


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    return room()


@pytest.fixture
def localizer(grid: OccupancyGrid) -> ParticleLocalizer:
    localizer = ParticleLocalizer(grid, [MARKER], LocalizerParameters(), LASER)
    localizer.predict(odometry(0.0))
    return localizer


def start(localizer: ParticleLocalizer, pose: Pose2D, covariance: FloatArray = P0) -> None:
    localizer.initialise(PoseEstimate(0.0, pose, covariance))


def see(localizer: ParticleLocalizer, grid: OccupancyGrid, truth: Pose2D, stamp: float, seed: int = 0) -> bool:
    localizer.predict(odometry(stamp))
    return localizer.update_scan(take_scan(truth, walls_of(grid), np.random.default_rng(seed), stamp, 257))


def test_beams_are_as_likely_as_their_ends_are_near_to_walls(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    rng, field = np.random.default_rng(0), DistanceField(grid)
    poses = rng.uniform([2.0, 2.0, -3.0], [6.0, 3.0, 3.0], (6, 3))
    ends = end_points(take_scan(Pose2D(4.0, 2.4, 0.3), walls_of(grid), rng, beams=41), LASER)
    variance, counts = rng.uniform(0.001, 0.1, len(ends.points)), rng.uniform(0.2, 1.0, len(ends.points))
    log_likelihood, on_walls = localizer._log_likelihood(poses, ends.points, variance, counts)
    for k, pose in enumerate(poses):
        distance, _, valid = field.lookup(transform_points(Pose2D(*pose), ends.points))
        apart = np.where(valid, np.abs(distance), np.inf)
        if (field.distances(poses[k : k + 1], ends.points)[0] < np.inf).tolist() != valid.tolist():
            continue  # lookup wants walls on all four sides, the fast one on one
        expected = counts * np.log(np.exp(-0.5 * apart**2 / variance) + 0.05)
        assert log_likelihood[k] == pytest.approx(expected.sum())
        assert on_walls[k] == pytest.approx((apart < 0.08).mean())
    equal, _ = localizer._log_likelihood(poses, ends.points, variance)
    ones, _ = localizer._log_likelihood(poses, ends.points, variance, np.ones(len(variance)))
    np.testing.assert_array_equal(equal, ones)


def test_a_marker_weighs_each_particle_by_its_innovation(localizer: ParticleLocalizer) -> None:
    truth = Pose2D(4.0, 2.4, 2.9)
    start(localizer, truth, np.diag([0.04, 0.04, 0.04]) ** 2)
    poses = localizer.particles
    known, Q = Pose2D(MARKER.x, MARKER.y, MARKER.yaw), np.array([[4e-3, 1e-3, 0], [1e-3, 9e-3, 0], [0, 0, 6e-3]])
    seen = between(truth, known)
    localizer._cloud.resample = lambda: None  # type: ignore[method-assign]
    assert localizer.update_markers([MarkerObservation(0.0, 10, seen, Q)]) == 1
    expected = []
    for pose in poses:
        e = pose_error(seen, expected_marker(Pose2D(*pose), known)[0])
        expected.append(math.exp(-0.5 * e @ np.linalg.solve(Q, e)))
    np.testing.assert_allclose(localizer._cloud.weights, np.array(expected) / sum(expected), rtol=1e-6)


@pytest.mark.parametrize(("sigmas", "used"), [(4.0, True), (4.1, False)])
def test_a_marker_that_no_particle_explains_is_not_used(
    localizer: ParticleLocalizer, sigmas: float, used: bool
) -> None:
    """A cloud without extent has the gate of the filter: 16.27, which is 4.03 squared."""
    start(localizer, Pose2D(4.0, 2.4, 0.5), np.zeros((3, 3)))
    before = localizer.particles
    seen = between(Pose2D(4.0, 2.4, 0.5), Pose2D(MARKER.x, MARKER.y, MARKER.yaw))
    off = Pose2D(seen.x + 0.02 * sigmas, seen.y, seen.theta)
    assert localizer.update_markers([MarkerObservation(0.0, 10, off, np.eye(3) * 0.02**2)]) == int(used)
    np.testing.assert_allclose(localizer.particles, before, atol=1e-9)


@pytest.mark.parametrize(("share", "used"), [(0.97, 1), (1.03, 0)])
def test_a_wide_cloud_lets_markers_through_that_are_farther_off(
    localizer: ParticleLocalizer, share: float, used: int
) -> None:
    """The gate grows by three standard deviations of the cloud, in units of the marker's noise."""
    about = Pose2D(4.0, 2.4, 0.5)
    start(localizer, about)
    step = np.array([0.03, 0.01, 0.02])
    localizer._cloud.replace(np.array([[4.0, 2.4, 0.5] + step, [4.0, 2.4, 0.5] - step] * 50))
    reach = 9.0 * float(step @ step) / (3 * 0.02**2)
    seen = between(about, Pose2D(MARKER.x, MARKER.y, MARKER.yaw))
    away = math.sqrt(16.27 * (1.0 + reach)) * 0.02 * share
    # So far off that the nearer of the two particles is that many standard deviations away.
    off = brentq(lambda d: nearest_m(localizer, Pose2D(seen.x + d, seen.y, seen.theta)) - away, 0.0, 5.0)
    wrong = Pose2D(seen.x + off, seen.y, seen.theta)
    assert localizer.update_markers([MarkerObservation(0.0, 10, wrong, np.eye(3) * 0.02**2)]) == used


def nearest_m(localizer: ParticleLocalizer, seen: Pose2D) -> float:
    """The least length of a particle's innovation."""
    known = Pose2D(MARKER.x, MARKER.y, MARKER.yaw)
    expected = (expected_marker(Pose2D(*pose), known)[0] for pose in localizer.particles)
    return min(float(np.linalg.norm(pose_error(seen, marker))) for marker in expected)


def test_random_poses_fill_the_free_space_and_all_headings(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    poses = localizer._random_poses(20000)
    cells = grid.world_to_cell(poses[:, :2])
    assert (grid.data[tuple(cells.T)] == FREE).all()
    free = grid.cell_to_world(np.argwhere(grid.data == FREE))
    np.testing.assert_allclose(poses[:, :2].mean(axis=0), free.mean(axis=0), atol=0.08)
    np.testing.assert_allclose(poses[:, :2].std(axis=0), free.std(axis=0), rtol=0.03)
    within = (poses[:, :2] - grid.cell_to_world(cells)) / 0.05
    assert np.abs(within).max() <= 0.5
    np.testing.assert_allclose(within.std(axis=0), 1.0 / math.sqrt(12.0), rtol=0.03)
    assert np.abs(poses[:, 2]).max() <= math.pi
    assert poses[:, 2].std() == pytest.approx(math.pi / math.sqrt(3.0), rel=0.03)


def test_near_poses_lie_in_free_space_about_the_estimate(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    about = Pose2D(7.0, 3.0, 0.7)
    poses = localizer._near_poses(about, 4000)
    assert 3000 < len(poses) <= 4000
    assert len(localizer._near_poses(about, 50)) <= 50
    assert (grid.data[tuple(grid.world_to_cell(poses[:, :2]).T)] == FREE).all()
    assert poses[:, 2].mean() == pytest.approx(0.7, abs=0.01)
    assert poses[:, 2].std() == pytest.approx(0.1, rel=0.1)
    # Of a normal distribution with 4 m about 7.0 what lies in the room, from 0 to 8 m.
    drawn = np.random.default_rng(1).normal(7.0, 4.0, 200000)
    inside = drawn[(drawn > 0.0) & (drawn < 8.0)]
    assert poses[:, 0].mean() == pytest.approx(inside.mean(), abs=0.3)


def test_how_well_scans_fit_is_kept_in_the_long_run_and_of_late(
    localizer: ParticleLocalizer, grid: OccupancyGrid
) -> None:
    truth = Pose2D(4.0, 2.4, 0.3)
    start(localizer, truth, np.diag([0.01, 0.01, 0.005]) ** 2)
    assert see(localizer, grid, truth, 0.1)
    first = localizer._slow
    assert localizer.explained is not None and localizer.explained > 0.95
    assert first == localizer._fast > 0.9
    explained = []
    weigh = localizer._log_likelihood

    def spy(*args: FloatArray) -> tuple[FloatArray, FloatArray]:
        log_likelihood, _ = weigh(*args)
        explained.append(0.5)
        return log_likelihood, np.full(len(args[0]), 0.5)

    localizer._log_likelihood = spy  # type: ignore[assignment,method-assign]
    localizer._recover = lambda ends, origin: None  # type: ignore[method-assign]
    for k in range(2, 5):
        assert see(localizer, grid, truth, 0.1 * k, seed=k)
    assert len(explained) == 3
    assert localizer._slow == pytest.approx(0.5 + (first - 0.5) * (1.0 - 0.005) ** 3)
    assert localizer._fast == pytest.approx(0.5 + (first - 0.5) * (1.0 - 0.2) ** 3)
    localizer.restart()
    assert (localizer._slow, localizer._fast) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("slow", "fast", "looks"),
    [
        (0.9, 0.9, [10]),  # every tenth scan, while nothing is wrong
        (0.9, 0.84, list(range(1, 11))),  # less than 95 % of what it was
        (0.9, 0.87, [10]),
        (0.5, 0.74, list(range(1, 11))),  # poor in itself
        (0.5, 0.76, [10]),
    ],
)
def test_other_places_are_tried_when_scans_fit_badly_and_now_and_then(
    localizer: ParticleLocalizer, grid: OccupancyGrid, slow: float, fast: float, looks: list[int]
) -> None:
    truth = Pose2D(4.0, 2.4, 0.3)
    start(localizer, truth)
    done, tried = [0], []
    scan = end_points(take_scan(truth, walls_of(grid), np.random.default_rng(0), beams=81), LASER)
    random_poses = localizer._random_poses

    def spy(size: int) -> FloatArray:
        tried.append(len(done))
        return random_poses(size)

    localizer._random_poses = spy  # type: ignore[method-assign]
    for _ in range(10):
        localizer._slow, localizer._fast = slow, fast
        localizer._recover(scan, np.array([LASER.x, LASER.y]))
        done.append(1)
    assert tried == looks


def test_a_cloud_of_several_places_looks_at_every_scan(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    localizer.globalize()
    assert len(localizer.particles) == 4000
    localizer._slow = localizer._fast = 0.99
    before = localizer.particles
    ends = end_points(take_scan(Pose2D(4.0, 2.4, 0.3), walls_of(grid), np.random.default_rng(0), beams=81), LASER)
    localizer._recover(ends, np.array([LASER.x, LASER.y]))
    moved = (localizer.particles != before).any(axis=1)
    assert moved.sum() == 800  # a fifth
    np.testing.assert_allclose(localizer.particles[moved].std(axis=0), [0.03, 0.03, 0.02], rtol=0.1)


def test_a_place_that_fits_no_better_is_not_gone_to(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    truth = Pose2D(4.0, 2.4, 0.3)
    start(localizer, truth, np.diag([0.005, 0.005, 0.002]) ** 2)
    ends = end_points(take_scan(truth, walls_of(grid), np.random.default_rng(0), beams=81), LASER)
    before = localizer.particles
    localizer._slow, localizer._fast = 0.9, 0.3
    localizer._recover(ends, np.array([LASER.x, LASER.y]))
    np.testing.assert_array_equal(localizer.particles, before)


@pytest.mark.parametrize("truth", [Pose2D(6.0, 1.0, 0.4), Pose2D(1.0, 3.0, -2.0)])
def test_a_robot_that_was_carried_away_is_found(
    localizer: ParticleLocalizer, grid: OccupancyGrid, truth: Pose2D
) -> None:
    start(localizer, Pose2D(4.0, 2.4, 0.3))
    for k in range(5):
        see(localizer, grid, Pose2D(4.0, 2.4, 0.3), 0.1 * k, seed=k)
    for k in range(5, 45):
        see(localizer, grid, truth, 0.1 * k, seed=k)
    np.testing.assert_allclose(pose_error(localizer.estimate.pose, truth), 0.0, atol=0.05)


def test_too_few_beams_say_nothing(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    start(localizer, Pose2D(4.0, 2.4, 0.3))
    localizer.predict(odometry(0.1))
    before = localizer.particles
    for beams, used in ((14, False), (15, True)):
        scan = take_scan(Pose2D(4.0, 2.4, 0.3), walls_of(grid), stamp=0.1, beams=beams)
        assert localizer.update_scan(scan) == used
        assert (localizer.explained is not None) == used
        if not used:
            np.testing.assert_array_equal(localizer.particles, before)


@pytest.mark.parametrize("one", [True, False])
def test_a_narrow_cloud_takes_walls_as_exact_as_they_are_and_a_wide_one_does_not(
    localizer: ParticleLocalizer, grid: OccupancyGrid, one: bool
) -> None:
    truth = Pose2D(4.0, 2.4, 0.3)
    start(localizer, truth, np.diag([0.05, 0.03, 0.02]) ** 2 if one else np.diag([0.6, 0.6, 0.4]) ** 2)
    scan = take_scan(truth, walls_of(grid), np.random.default_rng(0), 0.0, 81)
    ends = spread(end_points(scan, LASER), 80, 0.2)
    pose, P = localizer._cloud.estimate()
    at = localizer._alignment.incidence(ends, np.array([LASER.x, LASER.y]), pose)
    taken = []
    likelihood = localizer._log_likelihood

    def spy(poses: FloatArray, points: FloatArray, variance: FloatArray, counts: FloatArray) -> tuple:
        taken.append((variance, counts))
        return likelihood(poses, points, variance, counts)

    localizer._log_likelihood = spy  # type: ignore[assignment,method-assign]
    localizer._recover = lambda ends, origin: None  # type: ignore[method-assign]
    assert localizer.update_scan(scan)
    [(variance, counts)] = taken
    # Errors of the cloud move an end point across its beam, on average in any direction: half of them along a wall.
    cloud = (P[0, 0] + P[1, 1]) / 2 + P[2, 2] * ends.ranges**2 / 2
    noise = np.where(at.valid, at.variance, (0.01 * np.maximum(ends.ranges, 1.0)) ** 2)
    np.testing.assert_allclose(variance, noise + cloud if one else 0.15**2)
    np.testing.assert_allclose(counts, at.independence if one else 1.0)
    assert localizer.explained == pytest.approx((at.valid & (np.abs(at.distance) < 0.08)).mean())


def test_half_of_the_tried_poses_are_anywhere_and_half_are_near(
    localizer: ParticleLocalizer, grid: OccupancyGrid
) -> None:
    start(localizer, Pose2D(4.0, 2.4, 0.3))
    sizes: list[int] = []
    anywhere, near = localizer._random_poses, localizer._near_poses

    def random_poses(size: int) -> FloatArray:
        sizes.append(size)
        return anywhere(size)

    def near_poses(about: Pose2D, size: int) -> FloatArray:
        sizes.append(size)
        return near(about, size)

    localizer._random_poses, localizer._near_poses = random_poses, near_poses  # type: ignore[method-assign]
    localizer._slow, localizer._fast = 0.9, 0.3
    ends = end_points(take_scan(Pose2D(4.0, 2.4, 0.3), walls_of(grid), beams=81), LASER)
    localizer._recover(ends, np.array([LASER.x, LASER.y]))
    assert sizes == [300, 300]


def test_of_places_that_fit_as_well_the_near_one_is_gone_to(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    """A bare room is the same turned round; here both are tried, the wrong one a little better aligned."""
    data = np.full((100, 180), 100, dtype=np.int8)
    data[10:90, 10:170] = 0
    bare = OccupancyGrid(data, 0.05, Pose2D(-0.5, -0.5))
    for share in (0.0, 0.02):
        inside = ParticleLocalizer(bare, [], LocalizerParameters(), LASER)
        inside.predict(odometry(0.0))
        start(inside, Pose2D(2.5, 1.4, 0.0))
        truth, turned = Pose2D(3.0, 1.9, 0.05), Pose2D(5.0, 2.1, 0.05 + math.pi)
        poses = [np.array([[p.x, p.y, p.theta]]) for p in (turned, truth)]
        inside._random_poses = lambda size, poses=poses: poses[0].repeat(size, axis=0)  # type: ignore[method-assign]
        inside._near_poses = lambda about, size, poses=poses: poses[1].repeat(size, axis=0)  # type: ignore[method-assign]
        likelihood = inside._log_likelihood

        def favour(
            poses: FloatArray,
            points: FloatArray,
            variance: FloatArray,
            likelihood=likelihood,
            share: float = share,
        ) -> tuple:
            log_likelihood, fit = likelihood(poses, points, variance)
            return log_likelihood, fit + np.where(np.abs(poses[:, 2]) > 1.0, share, 0.0)

        inside._log_likelihood = favour  # type: ignore[assignment,method-assign]
        inside._slow, inside._fast = 0.9, 0.3
        before = inside.particles
        ends = end_points(take_scan(truth, walls_of(bare), beams=161), LASER)
        inside._recover(ends, np.array([LASER.x, LASER.y]))
        moved = inside.particles[(inside.particles != before).any(axis=1)]
        assert len(moved) == 80
        np.testing.assert_allclose(moved.mean(axis=0), [3.0, 1.9, 0.05], atol=0.03)


def test_looking_now_and_then_begins_anew_with_the_localizer(localizer: ParticleLocalizer, grid: OccupancyGrid) -> None:
    ends = end_points(take_scan(Pose2D(4.0, 2.4, 0.3), walls_of(grid), beams=81), LASER)
    for _ in range(2):
        start(localizer, Pose2D(4.0, 2.4, 0.3))
        looked: list[int] = []
        localizer._near_poses = lambda about, size, looked=looked: (looked.append(size), np.zeros((0, 3)))[1]  # type: ignore[method-assign,misc]
        for k in range(1, 11):
            localizer._slow = localizer._fast = 0.9
            localizer._recover(ends, np.array([LASER.x, LASER.y]))
            assert len(looked) == (k == 10)
        localizer.restart()
        localizer.predict(odometry(0.0))
