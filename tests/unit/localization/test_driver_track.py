"""The own heading from a track that is seen in ``odom`` and told in ``map``."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D
from hitchhike_ros.core.geometry import compose, wrap_angle
from hitchhike_ros.localization.driver_track import DriverTrack, with_heading

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
    seen = MarkerObservation(1.0, 0, Pose2D(1.0, 0.0, math.pi - 0.08), covariance)
    better = with_heading(seen, marker_heading=math.pi + 0.3, heading=0.3, variance=1e-8)
    assert wrap_angle(better.pose.theta - math.pi) == pytest.approx(0.0, abs=1e-4)
    assert better.pose.y == pytest.approx(0.08 * 2e-4 / 1.6e-3, rel=1e-3)
    assert better.covariance[2, 2] == pytest.approx(1e-8, rel=1e-3)
    assert np.linalg.eigvalsh(better.covariance).min() > 0.0
    unknown = with_heading(seen, math.pi + 0.3, 0.0, variance=1e9)
    assert unknown.pose.theta == pytest.approx(seen.pose.theta)


def test_the_seam_of_the_circle_is_no_error() -> None:
    seen = MarkerObservation(1.0, 0, Pose2D(1.0, 0.0, -math.pi + 0.01), np.eye(3) * 1e-3)
    better = with_heading(seen, marker_heading=math.pi, heading=0.0, variance=1e-3)
    assert abs(wrap_angle(better.pose.theta - math.pi)) == pytest.approx(0.005, abs=1e-6)
