"""Motions from which the robot can brake before contact, and the command that the base got last."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hitchhike_ros.control.clearance import ClearanceField, Footprint
from hitchhike_ros.control.dynamic_window import brake, roll_out
from hitchhike_ros.control.leg import Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.core.datatypes import FloatArray, Twist2D
from hitchhike_ros.core.robot_model import RobotLimits

# Deeper in contact than the discs of the footprint stand out, and the grid is coarse (m).
_TOUCHES_M = -0.02
# Where somebody has stepped up to it, the robot may come nearer by this than it is (m), but not from less than that.
_NEARER_M, _LEAST_M = 0.005, 0.02
# The base lags behind its commands by no more than this; it is not hurried further ahead (s).
_LAG_S = 0.4
# A command older than this is not what the base does; then a period of the laser counts (s).
_OLD_S, _PERIOD_S = 0.2, 0.1
# To turn standing, the robot stands first (m/s).
_ROLLS_MPS = 0.05
# Turning half round, either way is as good: beyond this angle it keeps the sense in which it turns (rad).
_HALF_ROUND_RAD = 2.5
# Speeds towards a stop: sqrt(_BRAKING a d) brakes with 60 % of the deceleration a; turns also end by proportion (1/s).
_BRAKING, _TURN_GAIN = 1.2, 2.5
_SWEEP_RAD = 0.1  # between the headings at which the room to turn is looked at


def stopping_speed(left: float, deceleration: float) -> float:
    """The speed from which it can stop in what is ``left``, in m and m/s or rad and rad/s, without braking hard."""
    return math.sqrt(_BRAKING * deceleration * max(left, 0.0))


class SafeMotion:
    """Knows the last command; whoever proposes the next one asks here what is safe."""

    def __init__(self, params: LocalPlannerParameters, limits: RobotLimits) -> None:
        self._params = params
        self.footprint = Footprint(limits)
        self._last, self._commanded_at = Twist2D(), -math.inf

    @property
    def last(self) -> Twist2D:
        """The command that the base got last."""
        return self._last

    def command(self, twist: Twist2D, now: float) -> None:
        """``twist`` goes to the base."""
        self._last, self._commanded_at = twist, now

    def clearance_m(self, field: ClearanceField) -> float:
        """Distance in m of the footprint where the robot is to the nearest obstacle; negative in contact."""
        return float(field.clearance(self.footprint, np.zeros(3)))

    def touches(self, scene: Scene) -> bool:
        """Whether an obstacle is within the footprint."""
        return scene.clearance_m < _TOUCHES_M

    def floor_m(self, scene: Scene) -> float:
        """How near to an obstacle it may come: the margin, or about as near as it is where someone has stepped up."""
        clearance = scene.clearance_m
        return min(self._params.margin_m, clearance - _NEARER_M if clearance > _LEAST_M else clearance)

    def can_stop(self, scene: Scene, targets: FloatArray) -> npt.NDArray[np.bool_]:
        """Mask (K,) of the target velocities (K, 2) that leave room to brake after the reaction."""
        reaction = np.array([0.5, 1.0]) * self._params.reaction_s
        committed, velocities = roll_out(scene.twist, targets, scene.limits, reaction)
        stopping = np.concatenate([committed, brake(committed[:, -1], velocities[:, -1], scene.limits, 6)], axis=1)
        return np.asarray(self.clears(scene, stopping).min(axis=1) >= self.floor_m(scene))

    def clears(self, scene: Scene, poses: FloatArray) -> FloatArray:
        """Clearance (...) in m of the footprint at each of ``poses`` (..., 3) in the robot's frame."""
        return scene.field.clearance(self.footprint, poses)

    def turn(self, scene: Scene, error: float) -> Twist2D | None:
        """A standing turn by ``error`` rad, the other way round where an obstacle forbids it; None without room."""
        if abs(scene.twist.v) > _ROLLS_MPS:
            return Twist2D()
        other = error - math.copysign(2.0 * math.pi, error)
        keep_sense = abs(error) > _HALF_ROUND_RAD and error * self._last.omega < 0.0
        for angle in (other, error) if keep_sense else (error, other):
            sweep = np.zeros((max(3, math.ceil(abs(angle) / _SWEEP_RAD)), 3))
            sweep[:, 2] = np.linspace(0.0, angle, len(sweep))
            if self.clears(scene, sweep).min() >= self.floor_m(scene):
                fastest = stopping_speed(abs(angle), scene.limits.max_yaw_acceleration_rps2)
                rate = min(fastest, _TURN_GAIN * abs(angle), scene.limits.max_yaw_rate_rps)
                return Twist2D(0.0, math.copysign(rate, angle))
        return None

    def underway(self, scene: Scene) -> Twist2D:
        """What the base is about to do: the last command, as far as it lies ahead of what the base does."""
        dv = _LAG_S * scene.limits.max_acceleration_mps2
        dw = _LAG_S * scene.limits.max_yaw_acceleration_rps2
        last, twist = self._last, scene.twist
        return Twist2D(
            min(max(last.v, twist.v - dv), twist.v + dv), min(max(last.omega, twist.omega - dw), twist.omega + dw)
        )

    def towards(self, scene: Scene, target: Twist2D) -> Twist2D:
        """The last command moved towards ``target`` by what the acceleration limits allow since then."""
        dt = scene.now - self._commanded_at
        dt = dt if 0.0 < dt < _OLD_S else _PERIOD_S
        start = self.underway(scene)
        pairs = (
            (start.v, target.v, scene.limits.max_acceleration_mps2 * dt),
            (start.omega, target.omega, scene.limits.max_yaw_acceleration_rps2 * dt),
        )
        return Twist2D(*(was + min(max(wanted - was, -step), step) for was, wanted, step in pairs))
