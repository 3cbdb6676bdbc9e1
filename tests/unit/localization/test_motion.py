"""The velocity motion model: Jacobians, continuity at omega = 0, noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import move, wrap_angle
from hitchhike_ros.localization.motion import MotionNoise, jacobians

POSES = st.builds(Pose2D, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
RATES = st.one_of(st.floats(-3, 3), st.floats(-1e-7, 1e-7), st.just(0.0), st.sampled_from([0.0999, 0.1001, -0.1]))
TWISTS = st.builds(Twist2D, st.floats(-1.5, 1.5), RATES)
STEPS = st.floats(0.01, 0.5)


def as_array(pose: Pose2D) -> np.ndarray:
    return np.array([pose.x, pose.y, pose.theta])


def difference(a: Pose2D, b: Pose2D) -> np.ndarray:
    d = as_array(a) - as_array(b)
    d[2] = wrap_angle(d[2])
    return d


@given(POSES, TWISTS, STEPS)
def test_jacobians_equal_numerical_ones(pose, twist, dt):
    G, V = jacobians(pose.theta, twist, dt)
    h = 1e-6
    for column, step in enumerate(np.eye(3) * h):
        plus, minus = Pose2D(*(as_array(pose) + step)), Pose2D(*(as_array(pose) - step))
        numerical = difference(move(plus, twist, dt), move(minus, twist, dt)) / (2 * h)
        np.testing.assert_allclose(G[:, column], numerical, atol=1e-7)
    for column, (dv, dw) in enumerate(np.eye(2) * h):
        plus, minus = Twist2D(twist.v + dv, twist.omega + dw), Twist2D(twist.v - dv, twist.omega - dw)
        numerical = difference(move(pose, plus, dt), move(pose, minus, dt)) / (2 * h)
        np.testing.assert_allclose(V[:, column], numerical, atol=1e-7)


@pytest.mark.parametrize("edge", [0.0, 0.1, -0.1])
def test_continuous_where_the_series_takes_over(edge):
    pose, dt = Pose2D(1.0, 2.0, 0.7), 0.1
    below, above = Twist2D(0.8, edge - 1e-10), Twist2D(0.8, edge + 1e-10)
    np.testing.assert_allclose(difference(move(pose, above, dt), move(pose, below, dt)), 0.0, atol=1e-10)
    for a, b in zip(jacobians(pose.theta, above, dt), jacobians(pose.theta, below, dt), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_noise_is_the_papers_and_does_not_depend_on_the_rate():
    noise = MotionNoise(alpha_1=0.1, alpha_2=0.2, alpha_3=0.3, alpha_4=0.4, period_s=0.1)
    twist = Twist2D(0.5, -2.0)
    np.testing.assert_allclose(
        noise.covariance(twist, 0.1), np.diag([0.1 * 0.25 + 0.2 * 4, 0.3 * 0.25 + 0.4 * 4]), rtol=1e-12
    )
    # Ten steps of 0.02 s spread the distance driven as two of 0.1 s do.
    np.testing.assert_allclose(10 * noise.covariance(twist, 0.02) * 0.02**2, 2 * noise.covariance(twist, 0.1) * 0.1**2)
