"""Messages of what the nodes know."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
import rospy
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import LaserScan, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy
from hitchhike_ros.core.stamps import carried
from hitchhike_ros.ros_io.conversions import (
    LaserScanArrayMsg,
    header,
    odometry_from_msg,
    odometry_to_msg,
    scan_from_msg,
    scan_to_msg,
    to_stamp,
    transform_from_matrix,
)


@pytest.mark.parametrize("rate", [10, 20, 50])
def test_a_clocks_ticks_are_exact(rate: int) -> None:
    for n in range(2000):
        assert to_stamp(n / rate).to_nsec() == n * 10**9 // rate


@pytest.mark.parametrize(
    ("seconds", "stamp"),
    [
        (0.9999999996, rospy.Time(1, 0)),  # not 10**9 nanoseconds
        (1452189953.25, rospy.Time(1452189953, 250_000_000)),
        (0.0, rospy.Time()),
    ],
)
def test_a_stamp_is_the_nearest_nanosecond(seconds: float, stamp: rospy.Time) -> None:
    assert to_stamp(seconds) == stamp
    assert header(seconds, "map").stamp == stamp


def test_a_stamp_tells_the_same_time_back() -> None:
    for seconds in np.random.default_rng(2).uniform(1.4e9, 1.8e9, 2000):  # what a float holds of them is 240 ns apart
        assert to_stamp(seconds).to_sec() == seconds


@given(
    st.integers(0, 10**6).map(lambda steps: carried(steps / 240)),
    st.floats(-3.2, 3.2),
    st.lists(st.floats(width=64, allow_nan=False), min_size=1, max_size=8),
)
def test_a_scan_that_has_been_a_message_is_the_same(stamp: float, angle: float, ranges: list[float]) -> None:
    with np.errstate(over="ignore"):
        scan = LaserScan(stamp, angle, 0.00613592315154, 0.02, 8.0, np.array(ranges))
    buffer = BytesIO()
    scan_to_msg(scan, "laser").serialize(buffer)
    back = scan_from_msg(LaserScanArrayMsg().deserialize(buffer.getvalue()))
    for name in ("stamp", "angle_min", "angle_increment", "range_min", "range_max"):
        assert getattr(back, name) == getattr(scan, name)
    np.testing.assert_array_equal(back.ranges, scan.ranges)
    assert back.ranges.dtype == np.float32


@pytest.mark.parametrize(
    ("rpy", "quaternion"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        ((np.pi / 2, 0.0, 0.0), (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))),
        ((0.0, 0.4, 0.0), (0.0, np.sin(0.2), 0.0, np.cos(0.2))),
        ((0.0, 0.0, -2.0), (0.0, 0.0, -np.sin(1.0), np.cos(1.0))),
        # The optical frame of a camera that looks ahead (REP 103).
        ((-np.pi / 2, 0.0, -np.pi / 2), (-0.5, 0.5, -0.5, 0.5)),
    ],
)
def test_a_matrix_as_a_transform(rpy: tuple[float, float, float], quaternion: tuple[float, ...]) -> None:
    transform = transform_from_matrix(matrix_from_xyz_rpy((0.1, -0.2, 0.3), rpy))
    assert (transform.translation.x, transform.translation.y, transform.translation.z) == (0.1, -0.2, 0.3)
    q = transform.rotation
    found = np.array([q.x, q.y, q.z, q.w])
    assert found * np.sign(found @ quaternion) == pytest.approx(quaternion)  # both signs are one rotation


@pytest.mark.parametrize(("told", "kept"), [("odom", "odom"), ("/p3dx/odom", "p3dx/odom"), ("", "")])
def test_odometry_keeps_the_name_of_its_frame(told: str, kept: str) -> None:
    odometry = Odometry(1.0, Pose2D(1.0, 2.0, 0.5), Twist2D(0.3, 0.1))
    back = odometry_from_msg(odometry_to_msg(odometry, told, "base_link"))
    assert back.frame_id == kept
    assert (back.stamp, back.twist) == (odometry.stamp, odometry.twist)
