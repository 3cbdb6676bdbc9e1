"""Making room: back along the way that the robot came, and a look around, as the last steps of recovery."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hitchhike_ros.control.leg import Decision, Leg, Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.safe_motion import SafeMotion
from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Twist2D
from hitchhike_ros.core.geometry import between, distance
from hitchhike_ros.core.polyline import Polyline

# Places of the way back are so far apart; a pose that is farther on than the second has jumped (m).
_STEP_M, _JUMP_M = 0.1, 0.4
# The place on the way back for which it steers is so far along it (m); beside the arc there it tries these (rad/s).
_AHEAD_M = 0.4
_YAW_RATES = np.array([0.0, 0.1, -0.1, 0.2, -0.2, 0.4, -0.4])
# It turns on the spot with no less room than this (m).
_LEAST_ROOM_M = 0.02


class WayBack:
    """The last bit of the way that a robot came, up to a length; forgotten when its pose jumps."""

    def __init__(self, length_m: float) -> None:
        self._length_m = length_m
        self._came: Polyline | None = None

    def add(self, pose: Pose2D) -> None:
        """The robot is there now (in ``map``)."""
        gone = math.inf if self._came is None else math.dist(self._came.point(self._came.end_m), (pose.x, pose.y))
        if self._came is None or gone > _JUMP_M:
            self._came = Polyline([(pose.x, pose.y)])
        elif gone >= _STEP_M:
            self._came.extend(pose.x, pose.y)
            self._came.forget_before(self._came.end_m - self._length_m)

    def points(self, pose: Pose2D) -> FloatArray:
        """The way back from ``pose``, (N, 2) in ``map``, N >= 1."""
        here = (pose.x, pose.y)
        if self._came is None:
            return np.array([here])
        return np.vstack([here, self._came.ahead(self._came.end_m - self._length_m).points[::-1]])


class Withdrawal:
    """Goes back once from one place: who stands in the way may be waiting for the robot.

    ``drive`` follows a leg forwards, where there is room to turn round.
    """

    def __init__(
        self, params: LocalPlannerParameters, motion: SafeMotion, drive: Callable[[Scene, Leg], Decision]
    ) -> None:
        self._params, self._motion, self._drive = params, motion, drive
        self._way_back = WayBack(params.recovery_withdraw_m)
        self._leg: Leg | None = None
        self._from: Pose2D | None = None

    @property
    def underway(self) -> bool:
        """Whether the robot is going back."""
        return self._leg is not None

    def forget(self) -> None:
        """It may go back from anywhere again."""
        self._leg = self._from = None

    def end(self, pose: Pose2D) -> None:
        """The robot does not go back, and is at ``pose``."""
        self._leg = None
        self._way_back.add(pose)

    def step(self, scene: Scene) -> Twist2D | None:
        """The next command on the way back; None when that is over, or there is no room."""
        p, pose = self._params, scene.pose
        if self._leg is None:
            if self._from is not None and distance(pose, self._from) < p.recovery_withdraw_m:
                return None
            self._from, path = pose, Polyline(self._way_back.points(pose))
            self._leg = Leg(path, Pose2D(*path.point(path.end_m)), p.goal_tolerance_m, math.tau)
        path = self._leg.path
        gone_m, _ = path.project(pose.x, pose.y)
        back = between(pose, Pose2D(*path.point(gone_m + _AHEAD_M)))
        if back.x < -abs(back.y):  # where there is no room to turn round there is room to go back
            return None if path.end_m - gone_m <= p.goal_tolerance_m else self._back_up(scene, back)
        decision = self._drive(scene, self._leg)
        return decision.twist if decision.state == "driving" else None

    def _back_up(self, scene: Scene, back: Pose2D) -> Twist2D | None:
        """Backwards on the free arc that is nearest to the one to the place ``back`` (robot's frame); None without."""
        speed = min(self._params.recovery_backwards_mps, scene.limits.max_speed_mps)
        wanted = -speed * 2.0 * back.y / (back.x**2 + back.y**2)
        omega = np.clip(wanted + _YAW_RATES, -scene.limits.max_yaw_rate_rps, scene.limits.max_yaw_rate_rps)
        targets = np.stack([np.full_like(omega, -speed), omega], axis=1)
        free = self._motion.can_stop(scene, targets)
        if not free.any():
            return None
        v, w = targets[int(np.argmax(free))]
        return self._motion.towards(scene, Twist2D(float(v), float(w)))


def look_around(scene: Scene, params: LocalPlannerParameters, motion: SafeMotion) -> Twist2D | None:
    """The next command of a slow turn on the spot; None without room for one."""
    if scene.clearance_m <= _LEAST_ROOM_M:
        return None
    rate = min(scene.limits.max_yaw_rate_rps, params.recovery_yaw_rate_rps)
    slow = replace(scene, limits=replace(scene.limits, max_yaw_rate_rps=rate))
    target = motion.turn(slow, 1.0)
    return None if target is None else motion.towards(slow, target)
