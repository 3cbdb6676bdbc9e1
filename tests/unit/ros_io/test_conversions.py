"""Messages of what the nodes know."""

from __future__ import annotations

import numpy as np
import pytest
import rospy

from hitchhike_ros.core.geometry import matrix_from_xyz_rpy
from hitchhike_ros.ros_io.conversions import header, to_stamp, transform_from_matrix


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
