"""Messages of what the nodes know."""

from __future__ import annotations

import math
from io import BytesIO

import numpy as np
import pytest
import rospy
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Header

from hitchhike_ros.core.datatypes import LaserScan, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import SensorDataError
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


def scan_msg(count: int = 181, **changes: object) -> LaserScanMsg:
    """Of 180 degrees, as most drivers send it, with some fields changed."""
    good = {
        "angle_min": -np.pi / 2,
        "angle_max": np.pi / 2,
        "angle_increment": np.pi / 180,
        "range_min": 0.02,
        "range_max": 8.0,
        "ranges": np.linspace(1.0, 2.0, count, dtype=np.float32),
    }
    return LaserScanMsg(**{**good, **changes})


@pytest.mark.parametrize(
    "msg",
    [
        scan_msg(),
        scan_msg(ranges=[math.nan, *np.ones(180)]),
        scan_msg(ranges=np.full(181, math.nan)),  # how many are too many, the modules know
        scan_msg(ranges=np.zeros(181)),
        scan_msg(180),  # a beam less, or some more, than the header says
        scan_msg(185),
        scan_msg(175),
        scan_msg(angle_max=0.0),  # not given
        scan_msg(angle_max=math.nan),
        scan_msg(angle_min=np.pi / 2, angle_max=-np.pi / 2, angle_increment=-np.pi / 180),
        scan_msg(271, angle_min=-2.356, angle_max=2.356),
        scan_msg(360, angle_min=0.0, angle_max=2 * np.pi),  # hls_lfcd
        scan_msg(361, angle_min=-np.pi, angle_max=np.pi),
        scan_msg(360, angle_min=0.0, angle_max=-np.pi / 180),  # the last one, within (-pi, pi]
        scan_msg(range_max=math.inf),
        scan_msg(range_min=-0.1),
        scan_msg(range_min=0.0),
        scan_msg(1, angle_min=0.1, angle_max=0.1),
    ],
)
def test_what_drivers_send_is_a_scan(msg: LaserScanMsg) -> None:
    scan = scan_from_msg(msg)
    assert scan.ranges.size == len(msg.ranges)
    check = LaserScan(0.0, msg.angle_min, msg.angle_increment, max(msg.range_min, 0.0), msg.range_max, msg.ranges)
    np.testing.assert_array_equal(scan.ranges, check.ranges)
    np.testing.assert_allclose(scan.angles(), check.angles())
    assert scan.angle_increment > 0.0


@pytest.mark.parametrize(
    ("msg", "reason"),
    [
        (scan_msg(ranges=[]), "scan: ranges is empty, expected beams"),
        (scan_msg(angle_min=math.nan), "scan: angle_min is nan, expected radians"),
        (scan_msg(angle_min=-90.0, angle_max=90.0, angle_increment=1.0), "scan: angle_min is -90, expected radians"),
        (scan_msg(angle_increment=0.0), "scan: angle_increment is 0 with 181 ranges, expected radians"),
        (scan_msg(angle_increment=math.inf), "scan: angle_increment is inf"),
        (scan_msg(angle_increment=math.nan), "scan: angle_increment is nan"),
        (scan_msg(angle_increment=1.0), "scan: angle_increment is 1 with 181 ranges, expected radians"),
        (scan_msg(91), "scan: angle_max is 1.5708, expected 0: angle_min and 90 increments"),
        (scan_msg(angle_increment=-np.pi / 180), "scan: angle_max is 1.5708, expected -4.71239"),
        (scan_msg(range_max=math.nan), "scan: range_min is 0.02 and range_max nan, expected range_min < range_max"),
        (scan_msg(range_min=math.nan), "scan: range_min is nan and range_max 8"),
        (scan_msg(range_min=9.0), "scan: range_min is 9 and range_max 8"),
        (scan_msg(range_max=0.0, range_min=0.0), "scan: range_min is 0 and range_max 0"),
    ],
)
def test_a_scan_whose_beams_point_nowhere_is_refused_by_its_value(msg: LaserScanMsg, reason: str) -> None:
    with pytest.raises(SensorDataError) as caught:
        scan_from_msg(msg)
    assert str(caught.value).startswith(reason)


_ANY = st.floats(width=32) | st.sampled_from([0.0, math.nan, math.inf, -math.inf, 1e-45, 3.4e38])


@given(_ANY, _ANY, _ANY, _ANY, _ANY, st.lists(_ANY, max_size=400))
def test_whatever_comes_is_a_scan_or_refused(
    first: float, last: float, step: float, low: float, high: float, ranges: list[float]
) -> None:
    try:
        scan = scan_from_msg(LaserScanMsg(Header(), first, last, step, 0.0, 0.0, low, high, ranges, []))
    except SensorDataError:
        return
    assert scan.angle_increment > 0.0
    assert 0.0 <= scan.range_min < scan.range_max
    measured = scan.ranges[np.isfinite(scan.ranges)]
    assert ((measured >= np.float32(scan.range_min)) & (measured <= np.float32(scan.range_max))).all()


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
