"""The servo laws: interaction matrices against numerical ones, and what each makes of a marker."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flat_world import TURTLEBOT as LIMITS
from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import between, compose
from hitchhike_ros.servoing.driver_trail import DriverTrail
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.servo_laws import (
    ImageTask,
    LawInput,
    PositionTask,
    Target,
    TaskLaw,
    TrailLaw,
    closing_gain,
    make_law,
    saturate,
)

GAP = 0.8
TASKS = (ImageTask(), PositionTask())
seen = st.builds(
    Target,
    *(st.floats(0.3, 4.0), st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
    *(st.floats(0.0, 0.3), st.floats(-0.3, 0.3)),
)


def moved(target: Target, v: float, omega: float, dt: float, driver: bool = True) -> Target:
    """Where the target is in the camera after the axle drove (v, omega) for ``dt``, by rigid motions alone."""
    camera = Pose2D(target.camera_x, target.camera_y)
    if omega == 0.0:
        step = Pose2D(v * dt)
    else:
        r, turn = v / omega, omega * dt
        step = Pose2D(r * math.sin(turn), r * (1.0 - math.cos(turn)), turn)
    share = 1.0 if driver else 0.0
    marker = compose(camera, Pose2D(target.x + share * target.vx * dt, target.y + share * target.vy * dt))
    now = between(compose(step, camera), marker)
    return replace(target, x=now.x, y=now.y)


@pytest.mark.parametrize("task", TASKS)
@settings(max_examples=40)
@given(target=seen)
def test_interaction_matrix_and_drift_against_numerical_ones(task, target):
    h = 1e-6

    def rate(v, omega, driver):
        ends = [task.error(moved(target, v, omega, dt, driver), GAP) for dt in (h, -h)]
        return (ends[0] - ends[1]) / (2.0 * h)

    J = np.column_stack([rate(1.0, 0.0, False), rate(0.0, 1.0, False)])
    np.testing.assert_allclose(task.jacobian(target), J, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(task.drift(target), rate(0.0, 0.0, True), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("task", TASKS)
@settings(max_examples=40)
@given(target=seen)
def test_the_interaction_matrix_never_becomes_singular(task, target):
    assert abs(np.linalg.det(task.jacobian(target))) > 0.05


@pytest.mark.parametrize("task", TASKS)
@settings(max_examples=40)
@given(target=seen)
def test_the_error_decays_as_the_gains_say(task, target):
    params = FollowParameters()
    law = TaskLaw(task, params, LIMITS)
    v, omega = law.velocities(LawInput(Pose2D(), DriverTrail((0.0, 0.0), (1.0, 0.0)), target, target.speed), GAP)
    rate = task.jacobian(target) @ (v, omega) + task.drift(target)
    gain = closing_gain(params, LIMITS, target.x - GAP)
    if v > 0.0:  # it does not go backwards
        np.testing.assert_allclose(rate, -np.array([params.bearing_gain, gain]) * task.error(target, GAP), atol=1e-6)


@pytest.mark.parametrize("name", ["trail", "image", "position"])
def test_in_place_behind_a_driver_every_law_drives_as_the_driver(name):
    law = make_law(FollowParameters(law=name), LIMITS)
    target = Target(GAP, 0.0, 0.5, 0.0, 0.1)
    v, omega = law.velocities(LawInput(Pose2D(), DriverTrail((0.0, 0.0), (1.2, 0.0)), target, 0.5), GAP)
    assert (v, omega) == (pytest.approx(0.5), pytest.approx(0.0, abs=1e-9))


@pytest.mark.parametrize("name", ["image", "position"])
@pytest.mark.parametrize("start", [(2.0, 0.5), (1.5, -0.6), (0.5, 0.1), (3.0, 0.0)])
def test_a_standing_marker_is_driven_up_to(name, start):
    params = FollowParameters(law=name)
    law, target = make_law(params, LIMITS), Target(*start, camera_x=0.1)
    for _ in range(200):
        v, omega = law.velocities(LawInput(Pose2D(), DriverTrail((0.0, 0.0), (1.0, 0.0)), target, 0.0), GAP)
        twist = saturate(v, omega, LIMITS.max_speed_mps, params.max_yaw_rate_rps)
        target = moved(target, twist.v, twist.omega, 0.05)
        assert target.gap > min(GAP, math.hypot(*start)) - 0.05
    assert target.y == pytest.approx(0.0, abs=0.01)
    assert target.x == pytest.approx(
        min(GAP, start[0]), abs=0.03
    )  # one that is too near stays, for it sees no way back


def test_the_trail_is_followed_where_the_marker_would_be_gone_straight_to():
    trail, target = DriverTrail((0.0, 0.0), (0.6, 0.3), (1.2, 0.0)), Target(0.9, 0.0, 0.0, 0.0, 0.1)
    view = LawInput(Pose2D(), trail, target, 0.3)
    v, omega = TrailLaw(FollowParameters(), LIMITS).velocities(view, GAP)
    straight = make_law(FollowParameters(law="image"), LIMITS).velocities(view, GAP)
    assert omega > 0.1
    assert straight[1] == pytest.approx(0.0, abs=1e-9)
    assert v > 0.3


@given(st.floats(0.0, 3.0), st.floats(-6.0, 6.0))
def test_saturation_keeps_the_direction(v, omega):
    twist = saturate(v, omega, 0.7, 1.2)
    assert twist.v <= 0.7 + 1e-9
    assert abs(twist.omega) <= 1.2 + 1e-9
    assert twist.v * omega == pytest.approx(twist.omega * v, abs=1e-9)
    if v <= 0.7 and abs(omega) <= 1.2:
        assert (twist.v, twist.omega) == (v, omega)


@given(st.floats(0.01, 20.0))
def test_closing_leaves_room_to_brake(error):
    v = closing_gain(FollowParameters(), LIMITS, error) * error
    assert v * v / (2.0 * LIMITS.max_acceleration_mps2) <= 0.5 * error + 1e-9
