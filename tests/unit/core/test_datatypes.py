import dataclasses
import math

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import CameraInfo, LaserScan, Pose2D, Twist2D


def test_finite_means_every_number() -> None:
    for value in (math.nan, math.inf, -math.inf):
        assert not Pose2D(x=value).is_finite()
        assert not Pose2D(y=value).is_finite()
        assert not Pose2D(theta=value).is_finite()
        assert not Twist2D(v=value).is_finite()
        assert not Twist2D(omega=value).is_finite()
    assert Pose2D(1, 2, 3).is_finite()
    assert Twist2D(1, 2).is_finite()


def test_values_are_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Pose2D().x = 1.0  # type: ignore[misc]


def test_scan_of_rep_117() -> None:
    """+inf is no return, -inf is too close, NaN is broken, and a range outside the sensor's limits is no hit."""
    ranges = np.array([0.5, np.inf, -np.inf, np.nan, 0.01, 9.0, 8.0])
    scan = LaserScan(0.0, -1.0, 0.25, range_min=0.02, range_max=8.0, ranges=ranges)
    np.testing.assert_array_equal(scan.valid(), [True, False, False, False, False, False, True])
    np.testing.assert_allclose(scan.angles(), [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5])


def test_a_beam_says_something_or_is_left_out() -> None:
    """Nothing is measured below range_min: zeros and codes say nothing, as NaN."""
    ranges = [0.5, 0.0, -0.0, -1.0, 0.019, 0.02, 8.0, 8.001, 65.533, np.inf, -np.inf, np.nan]
    scan = LaserScan(0.0, -1.0, 0.25, range_min=0.02, range_max=8.0, ranges=np.array(ranges))
    nan, inf = np.nan, np.inf
    expected = np.array([0.5, nan, nan, nan, nan, 0.02, 8.0, inf, inf, inf, -inf, nan], np.float32)
    np.testing.assert_array_equal(scan.ranges, expected)
    assert scan.bad_share() == pytest.approx(5 / 12)
    np.testing.assert_array_equal(scan.valid(), np.isfinite(expected))
    assert LaserScan(0.0, 0.0, 0.1, 0.02, 8.0, np.empty(0)).bad_share() == 1.0


def test_without_a_greatest_range_everything_beyond_the_smallest_counts() -> None:
    scan = LaserScan(0.0, 0.0, 0.1, 0.0, np.inf, np.array([0.0, 1000.0, np.inf]))
    np.testing.assert_array_equal(scan.valid(), [True, True, False])


def test_beams_that_come_clockwise_are_turned_about() -> None:
    scan = LaserScan(0.0, 1.0, -0.5, 0.02, 8.0, np.array([1.0, 2.0, 3.0, np.nan]))
    np.testing.assert_allclose(scan.angles(), [-0.5, 0.0, 0.5, 1.0])
    np.testing.assert_array_equal(scan.ranges, np.array([np.nan, 3.0, 2.0, 1.0], np.float32))


def test_a_scan_has_the_precision_of_its_message() -> None:
    scan = LaserScan(0.1, -0.1, 0.1, 0.02, 8.0, np.array([0.1, 1.0 / 3.0, np.inf]))
    assert scan.ranges.dtype == np.float32
    np.testing.assert_array_equal(scan.ranges, np.array([0.1, 1.0 / 3.0, np.inf], np.float32))
    assert (scan.angle_min, scan.angle_increment) == (-float(np.float32(0.1)), float(np.float32(0.1)))
    assert scan.stamp == 0.1


def test_cameras_do_not_share_their_distortion() -> None:
    a, b = (CameraInfo(640, 480, np.eye(3)) for _ in range(2))
    a.D[0] = 1.0
    assert b.D[0] == 0.0
