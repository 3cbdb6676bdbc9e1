"""The own heading from a track that is seen in ``odom`` and told in ``map``."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, compose_jacobians, wrap_angle
from hitchhike_ros.localization.driver_track import DriverTrack, with_heading
from hitchhike_ros.localization.ekf import mahalanobis_squared, pose_error

ANGLE = st.floats(-math.pi, math.pi)


def track(length_m: float, bend: float) -> list[Pose2D]:
    """A driver's way in ``map``: a straight one that bends sideways by ``bend``."""
    return [Pose2D(x, bend * math.sin(x), 0.0) for x in np.arange(0.0, length_m, 0.25)]


@given(ANGLE, st.floats(-20.0, 20.0), st.floats(-0.5, 0.5))
def test_exact_places_give_the_turn(theta: float, x: float, bend: float) -> None:
    T_map_odom, T_odom_map = Pose2D(x, -2.0, theta), compose(Pose2D(0, 0, -theta), Pose2D(-x, 2.0))
    heading = DriverTrack()
    for place in track(6.0, bend):
        heading.add(compose(T_odom_map, place), place)
    result = heading.turn()
    assert result is not None
    assert wrap_angle(result[0] - T_map_odom.theta) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("length_m", "stands"), [(0.9, False), (0.25, True)])
def test_a_short_track_says_nothing(length_m: float, stands: bool) -> None:
    heading = DriverTrack()
    places = track(length_m, 0.0) * (20 if stands else 1)
    for place in places:
        heading.add(place, place)
    assert heading.turn() is None


def test_error_is_within_its_variance() -> None:
    rng = np.random.default_rng(4)
    scores = []
    for _ in range(200):
        heading = DriverTrack()
        drift = rng.normal(0.0, 0.015)
        for place in track(5.0, 0.2):
            seen = compose(Pose2D(theta=-drift), place)
            noisy = Pose2D(seen.x + rng.normal(0, 0.01), seen.y + rng.normal(0, 0.01))
            late = Pose2D(place.x - rng.uniform(0.0, 0.05), place.y)  # messages are older than images
            heading.add(noisy, late)
        result = heading.turn()
        assert result is not None
        scores.append(result[0] ** 2 / result[1] if result else math.inf)
    assert 0.6 < np.mean(scores) < 1.4
    assert max(scores) < 16.0


def test_a_rider_finds_itself_after_its_driver_is_lost() -> None:
    T_map_odom, T_odom_map = Pose2D(3.0, -2.0, 0.7), compose(Pose2D(0, 0, -0.7), Pose2D(-3.0, 2.0))
    known = DriverTrack()
    for place in track(5.0, 0.2):
        known.add(compose(T_odom_map, place), place)
    own = Pose2D(4.0, 0.5, -1.2)  # in odom
    located = known.locate(9.0, own)
    assert located is not None
    truth = compose(T_map_odom, own)
    assert (located.pose.x, located.pose.y) == pytest.approx((truth.x, truth.y), abs=1e-6)
    assert wrap_angle(located.pose.theta - truth.theta) == pytest.approx(0.0, abs=1e-6)
    assert located.stamp == 9.0
    assert np.linalg.eigvalsh(located.covariance).min() > 0.0
    assert DriverTrack().locate(9.0, own) is None


def test_a_heading_corrects_the_yaw_and_what_is_correlated_with_it() -> None:
    covariance = np.array([[1e-4, 0.0, 0.0], [0.0, 1e-4, 2e-4], [0.0, 2e-4, 1.6e-3]])
    given = PoseEstimate(1.0, Pose2D(1.0, 0.0, 0.3 - 0.08), covariance)
    better = with_heading(given, heading=0.3, variance=1e-8)
    assert better.pose.theta == pytest.approx(0.3, abs=1e-4)
    assert better.pose.y == pytest.approx(0.08 * 2e-4 / 1.6e-3, rel=1e-3)
    assert better.covariance[2, 2] == pytest.approx(1e-8, rel=1e-3)
    assert np.linalg.eigvalsh(better.covariance).min() > 0.0
    assert better.stamp == 1.0
    assert with_heading(given, 0.3, variance=1e9).pose.theta == pytest.approx(given.pose.theta)


def test_the_seam_of_the_circle_is_no_error() -> None:
    given = PoseEstimate(1.0, Pose2D(1.0, 0.0, -math.pi + 0.01), np.eye(3) * 1e-3)
    better = with_heading(given, heading=math.pi, variance=1e-3)
    assert abs(wrap_angle(better.pose.theta - math.pi)) == pytest.approx(0.005, abs=1e-6)


def filled(seen: np.ndarray, told: np.ndarray) -> DriverTrack:
    """A track of places (N, 2) as seen and as told."""
    known = DriverTrack()
    for s, t in zip(seen, told, strict=True):
        known.add(Pose2D(*s.tolist()), Pose2D(*t.tolist()))
    return known


def straight(*along: float) -> np.ndarray:
    return np.column_stack([along, np.zeros(len(along))])


def elsewhere(seen: np.ndarray) -> np.ndarray:
    """The same places in a map whose origin is far away."""
    return seen + [30.0, 40.0]


def variance_of(seen: np.ndarray, place: float = 0.01**2) -> float:
    """Of the turn, where each place has that variance: by the spread of the places, and by the drift."""
    return place / float(np.sum((seen - seen.mean(axis=0)) ** 2)) + 0.015**2


def test_the_turn_is_that_of_least_squares_and_its_variance_follows_the_residuals() -> None:
    rng = np.random.default_rng(3)
    seen = np.column_stack([np.arange(0.0, 3.9, 0.3), 0.5 * np.sin(np.arange(0.0, 3.9, 0.3))])
    T = rotation(0.4)
    told = seen @ T.T + [2.0, -1.0] + rng.normal(0.0, 0.03, seen.shape)

    def residuals(x: np.ndarray) -> np.ndarray:
        return (seen @ rotation(x[0]).T + x[1:] - told).ravel()

    fit = least_squares(residuals, [0.3, 0.0, 0.0], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    result = filled(seen, told).turn()
    assert result is not None
    assert result[0] == pytest.approx(fit.x[0], abs=1e-6)
    place = float(np.sum(fit.fun**2)) / (2 * len(seen) - 3)
    assert place > 0.01**2
    assert result[1] == pytest.approx(variance_of(seen, place), rel=1e-6)


def rotation(angle: float) -> np.ndarray:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def test_exact_places_are_known_to_a_centimetre() -> None:
    seen = straight(*np.arange(0.0, 2.1, 0.25))
    result = filled(seen, seen).turn()
    assert result is not None
    assert result[1] == pytest.approx(variance_of(seen))


def test_only_the_last_four_metres_count() -> None:
    seen = straight(*np.arange(0.0, 10.1, 0.25))
    told = seen.copy()
    told[seen[:, 0] < 5.99, 1] = 3.0
    result = filled(seen, told).turn()
    assert result is not None
    assert result == pytest.approx((0.0, variance_of(seen[seen[:, 0] > 5.99])))


@pytest.mark.parametrize(
    ("along", "known"),
    [
        ((0.0, 0.25, 0.5, 0.75, 1.0), True),
        ((0.0, 0.25, 0.5, 0.75, 0.99), False),
        ((0.0, 0.4, 0.8, 1.2), False),
        ((0.0, 0.4, 0.8, 1.2, 1.6), True),
    ],
)
def test_it_takes_five_places_over_a_metre(along: tuple[float, ...], known: bool) -> None:
    assert (filled(straight(*along), elsewhere(straight(*along))).turn() is not None) == known


def test_places_within_five_centimetres_of_the_last_count_once() -> None:
    along = np.arange(0.0, 2.1, 0.25)
    near = straight(*np.sort(np.concatenate([along, along + 0.04])))
    far = straight(*np.sort(np.concatenate([along, along + 0.06])))
    for seen, counted in ((near, straight(*along)), (far, far)):
        result = filled(seen, elsewhere(seen)).turn()
        assert result is not None
        assert result[1] == pytest.approx(variance_of(counted))


def test_an_error_of_the_heading_moves_the_robot_about_the_middle_of_the_track() -> None:
    seen = np.column_stack([np.arange(0.0, 3.1, 0.25), 0.2 * np.arange(0.0, 3.1, 0.25)])
    told = seen @ rotation(0.7).T + [3.0, -2.0]
    known, own = filled(seen, told), Pose2D(5.0, 1.5, -1.2)
    located, turn = known.locate(9.0, own), known.turn()
    assert located is not None and turn is not None

    def pose(heading: float) -> np.ndarray:
        way = rotation(heading) @ (np.array([own.x, own.y]) - seen.mean(axis=0))
        return np.array([*(told.mean(axis=0) + way), own.theta + heading])

    lever = (pose(turn[0] + 1e-6) - pose(turn[0] - 1e-6)) / 2e-6
    expected = turn[1] * np.outer(lever, lever) + np.diag([0.1**2, 0.1**2, 1e-6])
    np.testing.assert_allclose(located.covariance, expected, rtol=1e-6, atol=1e-12)


def test_a_heading_is_joined_as_a_measurement_of_the_yaw() -> None:
    """The same as a Kalman update of all three with the yaw measured."""
    rng = np.random.default_rng(1)
    root = rng.normal(0.0, 0.1, (3, 3))
    P, H, variance = root @ root.T, np.array([[0.0, 0.0, 1.0]]), 0.004
    better = with_heading(PoseEstimate(1.0, Pose2D(1.0, 0.2, 2.9), P), heading=2.8, variance=variance)
    K = P @ H.T / (H @ P @ H.T + variance)
    expected = np.array([1.0, 0.2, 2.9]) + K[:, 0] * (2.8 - 2.9)
    assert (better.pose.x, better.pose.y, better.pose.theta) == pytest.approx(tuple(expected))
    np.testing.assert_allclose(better.covariance, (np.eye(3) - K @ H) @ P, atol=1e-12)


@pytest.mark.parametrize("sigma", [(0.03, 0.03, 0.01), (0.3, 0.05, 0.03), (0.2, 0.4, 0.1)])
@pytest.mark.parametrize("length_m", [1.5, 5.0])
def test_who_is_lost_knows_its_place_no_better_than_its_driver_does(
    sigma: tuple[float, float, float], length_m: float
) -> None:
    """With a driver that knows its place to 0.2 by 0.4 m the squared normalised error was 18, not 3 at the most."""
    mount, T_odom_map = Pose2D(-0.3, 0.0, math.pi), compose(Pose2D(0, 0, -0.7), Pose2D(-3.0, 2.0))
    known = np.diag(np.square(sigma))
    scores = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        error = rng.multivariate_normal(np.zeros(3), known)  # of the driver's localization, the whole way
        lost = DriverTrack()
        for place in track(length_m, 0.2):
            told = Pose2D(place.x + error[0], place.y + error[1], place.theta + error[2])
            J, _ = compose_jacobians(told, mount)
            seen = compose(T_odom_map, compose(place, mount))
            noisy = Pose2D(seen.x + rng.normal(0, 0.01), seen.y + rng.normal(0, 0.01))
            lost.add(noisy, compose(told, mount), J @ known @ J.T)
        own = compose(T_odom_map, Pose2D(length_m - 1.2, 0.1, 0.1))
        located = lost.locate(9.0, own)
        assert located is not None
        miss = pose_error(located.pose, Pose2D(length_m - 1.2, 0.1, 0.1))
        scores.append(mahalanobis_squared(miss, located.covariance))
    assert np.mean(scores) < 3.3


def test_a_driver_whose_error_changes_on_the_way_turns_the_track() -> None:
    """From one end of 4 m to the other by 0.15 m: the heading was off by 2.5 of its standard deviations."""
    scores = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        first, last = rng.normal(0.0, 0.15, 2)
        lost = DriverTrack()
        for x in np.arange(0.0, 4.1, 0.25):
            lost.add(Pose2D(x, 0.0), Pose2D(x, first + (last - first) * x / 4.0), np.diag([0.15**2, 0.15**2, 0.01]))
        turn = lost.turn()
        assert turn is not None
        scores.append(turn[0] ** 2 / turn[1])
    assert 0.5 < np.mean(scores) < 1.5
