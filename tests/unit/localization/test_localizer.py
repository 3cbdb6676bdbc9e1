"""The localizer as a whole: accurate and honest over a drive, sound with late and bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from corridor_drive import BOXES, MARKER, odometry
from hitchhike_ros.core.datatypes import MarkerObservation, Obstacle, Odometry, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, compose, move
from hitchhike_ros.localization.ekf import mahalanobis_squared, pose_error
from hitchhike_ros.localization.ekf_localizer import EkfLocalizer
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from laser_world import LASER, boxes_of, drive, take_scan, walls_of
from repository import ROOT

MAP = ROOT / "maps" / "p17_exp1.yaml"
P0 = np.diag([0.1, 0.1, 0.05]) ** 2


@pytest.fixture(scope="module")
def corridor() -> OccupancyGrid:
    return load_map(MAP)


def started(grid: OccupancyGrid, pose: Pose2D, covariance: np.ndarray = P0) -> EkfLocalizer:
    localizer = EkfLocalizer(grid, [MARKER], LocalizerParameters(), LASER)
    localizer.initialise(PoseEstimate(0.0, pose, covariance))
    return localizer


def state(localizer: EkfLocalizer) -> tuple[float, Pose2D, bytes]:
    estimate = localizer.estimate
    return estimate.stamp, estimate.pose, estimate.covariance.tobytes()


def follow(
    grid: OccupancyGrid,
    route: list[tuple[float, float]],
    seed: int,
    boxes: list[Obstacle],
    beams: int = 769,
    bad: tuple[float, float] = (0.0, 0.0),
):
    """Errors (N, 3) and NEES (N,) of a drive, beginning 2 s after the start with an unknown initial error."""
    rng = np.random.default_rng(seed)
    share, value = bad  # of the beams, and what they say
    rectangles = np.vstack([walls_of(grid), boxes_of(boxes)])
    localizer, errors, nees = None, [], []
    for truth, odo in drive(route, 0.5, rng):
        if localizer is None:
            start = np.array([truth.x, truth.y, truth.theta]) + rng.multivariate_normal(np.zeros(3), P0)
            localizer = started(grid, Pose2D(*start))
        localizer.predict(odo)
        scan = take_scan(truth, rectangles, rng, odo.stamp, beams)
        if share:
            scan = replace(scan, ranges=np.where(rng.random(beams) < share, value, scan.ranges))
        localizer.update_scan(scan)
        if odo.stamp > 2.0:
            errors.append(pose_error(localizer.estimate.pose, truth))
            nees.append(mahalanobis_squared(errors[-1], localizer.estimate.covariance))
    return np.array(errors), np.array(nees)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_drive_past_new_boxes_is_accurate_and_honest(corridor, seed):
    route = [(6.5, 5.7), (8.5, 5.4), (10.5, 5.8), (12.5, 6.15), (14.5, 5.5), (16.5, 5.6)]
    errors, nees = follow(corridor, route, seed, BOXES)
    assert math.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 0.02
    assert math.degrees(math.sqrt((errors[:, 2] ** 2).mean())) < 0.3
    assert np.mean(nees) < 4.0


@pytest.mark.parametrize("bad", [(0.105, math.nan), (0.3, 0.0), (0.5, math.nan)])
def test_beams_that_say_nothing_make_it_no_worse(corridor, bad):
    route = [(6.5, 5.7), (8.5, 5.4), (10.5, 5.8), (12.5, 6.15), (14.5, 5.5), (16.5, 5.6)]
    errors, nees = follow(corridor, route, 0, BOXES, bad=bad)
    assert math.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 0.02
    assert math.degrees(math.sqrt((errors[:, 2] ** 2).mean())) < 0.3
    assert np.mean(nees) < 4.0


def test_ragged_walls_of_a_real_building(shared_data, tmp_path):
    """Its walls are grey: with the file's own threshold hardly any cell is occupied, so a lower one is taken."""
    image = shared_data / "maps" / "willow-2010-02-18-0.10.pgm"
    (tmp_path / "willow.yaml").write_text(
        f"image: {image}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.2\nfree_thresh: 0.196\n"
    )
    whole = load_map(tmp_path / "willow.yaml")
    grid = OccupancyGrid(whole.data[360:560, 60:210], whole.resolution, Pose2D(6.0, 36.0))
    errors, nees = follow(grid, [(15.7, 50.0), (13.6, 45.2), (12.6, 43.0)], 0, [], beams=257)
    assert math.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 0.03
    assert math.degrees(math.sqrt((errors[:, 2] ** 2).mean())) < 0.5
    assert np.mean(nees) < 6.0


def test_what_the_walls_have_wrong_is_not_averaged_out_over_scans(corridor):
    """A robot that stands still sees the same faces again and again."""
    truth = Pose2D(5.1, 5.9, 0.3)
    ragged = corridor.data.copy()
    ragged[::2][ragged[::2] == 100] = np.roll(ragged, 1, axis=1)[::2][ragged[::2] == 100]
    sigma = {}
    for name, grid in (("straight", corridor), ("ragged", OccupancyGrid(ragged, corridor.resolution, corridor.origin))):
        walls, rng, localizer = walls_of(grid), np.random.default_rng(0), started(grid, truth)
        for k in range(60):
            localizer.predict(odometry(0.1 * k))
            localizer.update_scan(take_scan(truth, walls, rng, 0.1 * k, 257))
            sigma[name, k] = math.sqrt(np.linalg.eigvalsh(localizer.estimate.covariance[:2, :2]).max())
    assert sigma["ragged", 59] > 0.8 * sigma["ragged", 29]
    assert sigma["straight", 59] < 0.8 * sigma["straight", 29]


def test_scans_and_images_that_come_late_count_where_they_were_taken(corridor):
    """At 1 m/s, 0.2 s late: taken for fresh they would pull by 0.2 m."""
    walls, localizer = walls_of(corridor), started(corridor, Pose2D(3.0, 5.72, 0.0), P0 * 1e-2)
    Q = np.diag([1e-4, 1e-4, 1e-4])
    for k in range(21):
        stamp = 0.1 * k
        localizer.predict(odometry(stamp, x=0.05 * k, v=0.5))
        if k >= 2:
            then = Pose2D(3.0 + 0.05 * (k - 2), 5.72, 0.0)
            localizer.update_scan(take_scan(then, walls, stamp=stamp - 0.2))
            seen = between(then, Pose2D(MARKER.x, MARKER.y, MARKER.yaw))
            assert localizer.update_markers([MarkerObservation(stamp - 0.2, 10, seen, Q)]) == 1
    np.testing.assert_allclose(pose_error(localizer.estimate.pose, Pose2D(4.0, 5.72, 0.0)), 0.0, atol=0.005)
    past = localizer.estimate_at(1.55)
    assert past.stamp == 1.55
    np.testing.assert_allclose(pose_error(past.pose, Pose2D(3.775, 5.72, 0.0)), 0.0, atol=0.005)


def test_a_known_marker_corrects_and_an_unknown_one_does_not(corridor):
    truth = Pose2D(3.0, 5.72, 0.05)
    localizer = started(corridor, Pose2D(2.9, 5.8, 0.0))
    localizer.predict(odometry(0.0))
    seen = between(truth, Pose2D(MARKER.x, MARKER.y, MARKER.yaw))
    Q = np.diag([1e-4, 1e-4, 4e-4])
    before = state(localizer)
    assert localizer.update_markers([MarkerObservation(0.0, 0, seen, Q)]) == 0
    assert state(localizer) == before
    assert localizer.update_markers([MarkerObservation(0.0, 10, seen, Q)]) == 1
    assert np.abs(pose_error(localizer.estimate.pose, truth)).max() < 0.03


@pytest.mark.parametrize(
    "bad",
    [
        lambda loc: loc.predict(odometry(0.2, x=math.nan)),
        lambda loc: loc.predict(odometry(math.nan)),
        lambda loc: loc.predict(odometry(0.2, v=math.inf)),
        lambda loc: loc.update_scan(replace(SCAN, ranges=np.full(769, np.nan))),
        lambda loc: loc.update_scan(replace(SCAN, range_max=0.01)),
        lambda loc: loc.update_scan(replace(SCAN, ranges=np.zeros(0))),
        lambda loc: loc.update_scan(replace(SCAN, angle_min=math.nan)),
        lambda loc: loc.update_scan(replace(SCAN, stamp=math.nan)),
        lambda loc: loc.update_scan(replace(SCAN, stamp=-5.0)),
        lambda loc: loc.update_scan(replace(SCAN, stamp=5.0)),
        lambda loc: loc.update_markers([MarkerObservation(0.1, 10, Pose2D(math.nan, 0, 0), P0)]),
        lambda loc: loc.estimate_at(9.0),
    ],
)
def test_senseless_input_changes_nothing(corridor, bad):
    localizer = started(corridor, Pose2D(8.0, 5.72, 0.0))
    localizer.predict(odometry(0.0))
    localizer.predict(odometry(0.1, x=0.05, v=0.5))
    before = state(localizer)
    with pytest.raises(SensorDataError):
        bad(localizer)
    assert state(localizer) == before
    localizer.predict(odometry(0.2, x=0.1, v=0.5))
    assert localizer.estimate.pose.x == pytest.approx(8.1)


SCAN = take_scan(Pose2D(8.0, 5.72, 0.0), boxes_of(BOXES), stamp=0.1)


@pytest.mark.parametrize(("later", "word"), [(odometry(-3.0, x=0.4), "back in time"), (odometry(0.2, x=7.0), "jumped")])
def test_after_a_jump_odometry_counts_from_there(corridor, later, word):
    localizer = started(corridor, Pose2D(8.0, 5.72, 0.0))
    localizer.predict(odometry(0.0))
    localizer.predict(odometry(0.1, x=0.05))
    with pytest.raises(SensorDataError, match=word):
        localizer.predict(later)
    assert localizer.estimate.pose.x == pytest.approx(8.05)
    localizer.predict(replace(later, stamp=later.stamp + 0.1, pose=Pose2D(later.pose.x + 0.03, 0.0, 0.0)))
    assert localizer.estimate.pose.x == pytest.approx(8.08)


def test_a_gap_in_the_odometry_is_bridged_with_more_noise(corridor):
    short, long = started(corridor, Pose2D(8.0, 5.72, 0.0)), started(corridor, Pose2D(8.0, 5.72, 0.0))
    for localizer, stamps in ((short, [0.0, 0.1]), (long, [0.0, 1.4])):
        for stamp in stamps:
            localizer.predict(odometry(stamp, x=0.5 * stamp, theta=0.2 * stamp))
    assert long.estimate.pose.x == pytest.approx(8.7, abs=0.02)
    assert np.linalg.det(long.estimate.covariance) > np.linalg.det(short.estimate.covariance)


def test_a_pose_known_a_moment_ago_is_carried_on(corridor):
    localizer = EkfLocalizer(corridor, [], LocalizerParameters(), LASER)
    with pytest.raises(RuntimeError):
        _ = localizer.estimate
    for k in range(11):
        localizer.predict(odometry(0.1 * k, x=0.05 * k, v=0.5))
    localizer.initialise(PoseEstimate(0.5, Pose2D(8.0, 5.72, math.pi / 2), P0))
    np.testing.assert_allclose(
        pose_error(localizer.estimate.pose, compose(Pose2D(8.0, 5.72, math.pi / 2), Pose2D(0.25, 0.0, 0.0))),
        0.0,
        atol=1e-9,
    )
    assert localizer.estimate.stamp == pytest.approx(1.0)
    with pytest.raises(ValueError, match="covariance"):
        localizer.initialise(PoseEstimate(1.0, Pose2D(), np.diag([1.0, 1.0, -1.0])))


def test_scans_before_any_odometry_are_refused(corridor):
    with pytest.raises(SensorDataError, match="no odometry"):
        started(corridor, Pose2D(8.0, 5.72, 0.0)).update_scan(SCAN)


def _drives(t: float) -> Odometry:
    """Round a bend at 0.5 m/s and 0.6 rad/s."""
    twist = Twist2D(0.5, 0.6)
    return Odometry(t, move(Pose2D(3.0, 1.0, 0.4), twist, t), twist)


@pytest.mark.parametrize("told_first", [True, False])
@pytest.mark.parametrize("silent_s", [0.05, 0.3, 1.0])
def test_the_way_between_a_pose_and_the_first_odometry_after_it_counts(corridor, told_first, silent_s):
    """Switched on in a bend at 0.5 m/s, it stayed behind by as much as it had gone since the image: 0.5 m after 1 s."""
    scores, localizer = [], EkfLocalizer(corridor, [], LocalizerParameters(), LASER)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = Pose2D(8.0, 5.72, 0.5)
        error = rng.multivariate_normal(np.zeros(3), P0)
        given = PoseEstimate(0.0, Pose2D(truth.x + error[0], truth.y + error[1], truth.theta + error[2]), P0)
        localizer.restart()
        if told_first:
            localizer.initialise(given)
        for k in range(3):
            localizer.predict(_drives(silent_s + 0.05 * k))
        if not told_first:
            localizer.initialise(given)
        now = localizer.estimate
        there = compose(truth, between(_drives(0.0).pose, _drives(now.stamp).pose))
        scores.append(mahalanobis_squared(pose_error(now.pose, there), now.covariance))
    assert np.mean(scores) < 4.0


def test_what_a_robot_did_in_an_unknown_time_is_not_made_up(corridor):
    localizer = started(corridor, Pose2D(8.0, 5.72, 0.0))
    localizer.predict(odometry(50.0, x=3.0, v=0.5))
    assert localizer.estimate.pose == Pose2D(8.0, 5.72, 0.0)


def test_a_robot_that_stands_is_where_it_was(corridor):
    localizer = started(corridor, Pose2D(8.0, 5.72, 0.0))
    localizer.predict(odometry(1.0, x=3.0))
    assert localizer.estimate.pose == Pose2D(8.0, 5.72, 0.0)
    np.testing.assert_allclose(localizer.estimate.covariance, P0)
