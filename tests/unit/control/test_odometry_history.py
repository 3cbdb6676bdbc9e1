"""Motion between two moments out of readings at others."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.control.odometry_history import OdometryHistory
from hitchhike_ros.core.datatypes import Odometry, Pose2D, Twist2D

V, OMEGA = 0.5, 0.4


def on_circle(t: float) -> Pose2D:
    """Where a robot at constant twist is at ``t`` s."""
    r = V / OMEGA
    theta = OMEGA * t
    return Pose2D(r * math.sin(theta), r * (1.0 - math.cos(theta)), math.remainder(theta, 2.0 * math.pi))


def history(start: float, end: float) -> OdometryHistory:
    readings = OdometryHistory()
    for i in range(round((end - start) / 0.05) + 1):
        t = start + 0.05 * i
        readings.add(Odometry(t, on_circle(t), Twist2D(V, OMEGA)))
    return readings


@given(st.floats(8.1, 10.1), st.floats(8.1, 10.1))
def test_motion_along_a_circle(since: float, until: float) -> None:
    motion = history(6.0, 10.0).motion(since, until)
    expected = on_circle(until - since)
    assert motion is not None
    assert (motion.x, motion.y, motion.theta) == pytest.approx((expected.x, expected.y, expected.theta), abs=1e-3)


def test_where_readings_do_not_reach_there_is_none() -> None:
    readings = history(6.0, 10.0)
    assert readings.motion(7.0, 10.0) is None
    assert readings.motion(9.0, 10.3) is None
    assert OdometryHistory().motion(0.0, 0.0) is None


def test_time_that_runs_backwards_starts_afresh() -> None:
    readings = history(6.0, 10.0)
    readings.add(Odometry(3.0, Pose2D(), Twist2D()))
    assert readings.stamp == 3.0
    assert readings.motion(9.0, 9.5) is None
    assert readings.motion(3.0, 3.1) == Pose2D()
