"""The simulated base: ramps, watchdog, and odometry from wheels (P18 Eqs. 1–6)."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.simulation.physics.drive import (
    BaseController,
    DriveParameters,
    OdometryParameters,
    WheelOdometry,
    integrate_wheels,
)

LIMITS = RobotLimits(0.3, 0.1, 0.2, 0.2, 0.2, max_speed_mps=1.0, max_yaw_rate_rps=2.0)
DT = 0.01

wheel = st.floats(-1.0, 1.0)
pose = st.builds(Pose2D, st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3))


def run(base: BaseController, start: float, duration: float) -> Twist2D:
    for i in range(round(duration / DT)):
        base.step(start + i * DT, DT)
    return base.twist


def test_a_command_is_reached_by_a_ramp() -> None:
    base = BaseController(
        LIMITS, DriveParameters(max_acceleration_mps2=1.0, max_yaw_acceleration_rps2=4.0, watchdog_s=9.0)
    )
    base.command(Twist2D(0.5, -1.0), 0.0)
    assert astuple(run(base, 0.0, 0.1)) == pytest.approx((0.1, -0.4))
    assert astuple(run(base, 0.1, 0.5)) == pytest.approx((0.5, -1.0))
    left, right = base.wheel_speeds()
    assert (left * 0.1, right * 0.1) == pytest.approx((0.5 + 0.15, 0.5 - 0.15))


def test_without_commands_the_base_stops() -> None:
    base = BaseController(LIMITS, DriveParameters())
    base.command(Twist2D(0.4, 0.5), 0.0)
    assert run(base, 0.0, 0.5).v == pytest.approx(0.4)
    assert run(base, 0.51, 0.5) == Twist2D(0.0, 0.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_senseless_command_stops_and_limits_hold(bad: float) -> None:
    base = BaseController(LIMITS, DriveParameters(watchdog_s=9.0))
    base.command(Twist2D(99.0, -99.0), 0.0)
    assert astuple(run(base, 0.0, 2.0)) == pytest.approx((1.0, -2.0))
    base.command(Twist2D(bad, 0.5), 2.0)
    assert astuple(run(base, 2.0, 2.0)) == pytest.approx((0.0, 0.0))


@given(pose, wheel, wheel)
def test_wheels_follow_the_circle_of_the_paper(start: Pose2D, left: float, right: float) -> None:
    """Against Eqs. 1–5 as written, with their sign mended."""
    width = 0.3
    end = integrate_wheels(start, left, right, width)
    beta = (right - left) / width
    assert end.theta == pytest.approx(wrap_angle(start.theta + beta), abs=1e-9)
    if abs(beta) < 1e-3:
        length = (left + right) / 2
        straight = start.x + length * math.cos(start.theta), start.y + length * math.sin(start.theta)
        assert (end.x, end.y) == pytest.approx(straight, abs=1e-3)
        return
    radius = left / beta + width / 2
    cx, cy = start.x - radius * math.sin(start.theta), start.y + radius * math.cos(start.theta)
    theta = start.theta + beta
    assert (end.x, end.y) == pytest.approx((cx + radius * math.sin(theta), cy - radius * math.cos(theta)), abs=1e-9)


@given(pose, wheel, wheel)
def test_driving_back_returns(start: Pose2D, left: float, right: float) -> None:
    back = integrate_wheels(integrate_wheels(start, left, right, 0.3), -left, -right, 0.3)
    assert (back.x, back.y) == pytest.approx((start.x, start.y), abs=1e-9)


def drive_straight(params: OdometryParameters, seed: int = 0, metres: float = 10.0) -> WheelOdometry:
    encoders = WheelOdometry(LIMITS, params, np.random.default_rng(seed))
    for i in range(1, 601):
        encoders.update(i / 60, np.full(2, metres * i / 600 / LIMITS.wheel_radius_m))
    return encoders


def test_perfect_encoders_measure_to_a_tick() -> None:
    odometry = drive_straight(OdometryParameters(2000.0, 0.0, 0.0)).odometry
    tick = 2 * math.pi * LIMITS.wheel_radius_m / 2000
    assert (odometry.pose.x, odometry.pose.y) == pytest.approx((10.0, 0.0), abs=1.01 * tick)
    assert odometry.stamp == 10.0
    assert odometry.twist.v == pytest.approx(1.0, abs=60 * tick)


def test_imperfect_encoders_drift_as_much_as_they_should() -> None:
    """Heading after d metres: both wheels' slip and radius errors over the wheel separation."""
    params = OdometryParameters(1e6, 0.001, 0.002)
    headings = [drive_straight(params, seed).odometry.pose.theta for seed in range(40)]
    expected = math.sqrt(2 * (0.001 * 10.0) ** 2 + 2 * 0.002**2 * 10.0) / LIMITS.wheel_separation_m
    assert 0.7 * expected < np.std(headings) < 1.4 * expected
