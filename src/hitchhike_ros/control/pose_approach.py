"""The last metre to a pose, planned: smooth curves that end at the goal with its heading, forwards or backwards.

The curves are those of a feedback law for unicycles (Park and Kuipers, "A smooth control law for graceful motion of
differential wheeled mobile robots in 2D environment", ICRA 2011), rolled out with the base's own acceleration limits
from where it is and as fast as it is. A few gains in both directions of travel give a few curves; the controller takes
the quickest that is free and keeps to its gains, so that it follows the curve that it has planned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Twist2D
from hitchhike_ros.core.geometry import inverse, wrap_angles
from hitchhike_ros.core.robot_model import RobotLimits

PERIOD_S = 0.1
_STEPS = 100
# Gains that between them were quickest from random starts (chosen): k1 bends the curve towards the goal's heading, k2
# turns the robot onto the curve.
_GAINS = ((1.0, 1.0), (0.5, 0.7), (1.0, 1.5), (1.5, 0.7))
_SLOWING = 0.02  # in bends, by the square of the curvature
_TURN_FIRST_RAD = 1.4  # with the way this far off the nose, turn standing
_TURN_UNTIL_RAD = 0.8


@dataclass(frozen=True)
class Curve:
    """One way of approaching: forwards (+1) or backwards (-1), and the law's gains."""

    sense: int
    k1: float
    k2: float


CURVES = tuple(Curve(sense, *gains) for sense in (1, -1) for gains in _GAINS)


@dataclass(frozen=True, eq=False)
class Approach:
    """Curves rolled out: poses (K, P, 3) in the robot's frame, first velocities (K, 2), seconds (K,) to arrive.

    A curve that has not arrived within the horizon takes infinitely long. After its arrival a curve stays there.
    ``backwards_m`` (K,) is how far it goes backwards.
    """

    poses: FloatArray
    velocities: FloatArray
    seconds: FloatArray
    backwards_m: FloatArray


def roll_out_approach(
    goal: Pose2D, twist: Twist2D, curves: tuple[Curve, ...], limits: RobotLimits, reverse_mps: float, near_m: float
) -> Approach:
    """Approach ``goal`` (in the robot's frame) from ``twist`` along each of ``curves``, to within ``near_m``.

    What is left of the heading there is turned standing; that time is counted.
    """
    rates = np.array([limits.max_acceleration_mps2, limits.max_yaw_acceleration_rps2])
    gains = np.array([(c.sense, c.k1, c.k2) for c in curves]).T
    start = inverse(goal)  # all is reckoned in the goal's frame
    state = np.tile([start.x, start.y, start.theta], (len(curves), 1))
    speed = np.tile([twist.v, twist.omega], (len(curves), 1))
    poses, first = np.empty((len(curves), _STEPS, 3)), np.zeros((len(curves), 2))
    seconds, backwards = np.full(len(curves), np.inf), np.zeros(len(curves))
    for step in range(_STEPS):
        target = _law(state, gains, limits, reverse_mps)
        arrived = np.hypot(state[:, 0], state[:, 1]) <= near_m
        target[arrived] = 0.0
        change = np.clip(target - speed, -rates * PERIOD_S, rates * PERIOD_S)
        speed = speed + change
        if step == 0:
            first = speed
        turn = speed[:, 1] * PERIOD_S
        middle = state[:, 2] + 0.5 * turn
        along = speed[:, 0] * PERIOD_S
        state = state + np.stack([along * np.cos(middle), along * np.sin(middle), turn], axis=1)
        backwards += np.maximum(0.0, -along)
        poses[:, step] = state
        stands = arrived & (np.abs(speed[:, 0]) < 0.05)
        left = np.abs(wrap_angles(state[:, 2]))
        done = (step + 1) * PERIOD_S + 2.0 * np.sqrt(left / limits.max_yaw_acceleration_rps2)
        seconds = np.where(stands & np.isinf(seconds), done, seconds)
        if np.isfinite(seconds).all():
            poses[:, step + 1 :] = state[:, None]
            break
    return Approach(_in_frame_of(start, poses), first, seconds, backwards)


def _law(state: FloatArray, gains: FloatArray, limits: RobotLimits, reverse_mps: float) -> FloatArray:
    """Velocities (K, 2) wanted at poses (K, 3) in the goal's frame."""
    sense, k1, k2 = gains
    r = np.maximum(np.hypot(state[:, 0], state[:, 1]), 1e-3)
    sight = np.arctan2(-state[:, 1], -state[:, 0])
    back = np.where(sense < 0, np.pi, 0.0)  # going backwards is going forwards with the tail for a nose
    delta = wrap_angles(state[:, 2] + back - sight)
    theta = wrap_angles(back - sight)
    bend = k2 * (delta - np.arctan(-k1 * theta)) + (1.0 + k1 / (1.0 + (k1 * theta) ** 2)) * np.sin(delta)
    curvature = -bend / r
    fastest = np.where(sense < 0, min(reverse_mps, limits.max_speed_mps), limits.max_speed_mps)
    v = np.minimum(fastest / (1.0 + _SLOWING * curvature**2), np.sqrt(limits.max_acceleration_mps2 * r))
    v = v / np.maximum(1.0, np.abs(curvature * v) / limits.max_yaw_rate_rps)
    omega = curvature * v
    off = np.abs(delta)
    spin = np.sqrt(1.2 * limits.max_yaw_acceleration_rps2 * np.maximum(off - _TURN_UNTIL_RAD, 0.05))
    spin = -np.sign(delta) * np.minimum(spin, limits.max_yaw_rate_rps)
    turning = off > _TURN_FIRST_RAD
    return np.stack([np.where(turning, 0.0, sense * v), np.where(turning, spin, omega)], axis=1)


def _in_frame_of(robot: Pose2D, poses: FloatArray) -> FloatArray:
    """Poses (..., 3) of the goal's frame in that of ``robot``, which is given in the goal's."""
    c, s = np.cos(robot.theta), np.sin(robot.theta)
    dx, dy = poses[..., 0] - robot.x, poses[..., 1] - robot.y
    return np.stack([c * dx + s * dy, -s * dx + c * dy, poses[..., 2] - robot.theta], axis=-1)
