"""Along a path: around what stands on it, turning first where it leads elsewhere, slower towards its end."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchhike_ros.control.detour import Detour, DetourPlanner
from hitchhike_ros.control.dynamic_window import roll_out, window
from hitchhike_ros.control.leg import Decision, Leg, Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.safe_motion import SafeMotion, stopping_speed
from hitchhike_ros.control.trajectory_critics import costs, judge
from hitchhike_ros.core.datatypes import Twist2D
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.core.robot_model import RobotLimits

# The robot's foot is sought on the path so far behind and ahead of the last one (m): no loop of it is left out.
_BACK_M, _ON_M = 0.5, 2.0
# Whether to turn standing is decided by where the way leads within this (m).
_LOOK_AHEAD_M = 0.5
# Slower than this is standing (m/s, rad/s).
_STANDS_MPS, _STANDS_RPS = 0.01, 0.02
# The first stations of a detour are beside the robot by rounding to lanes (m).
_BESIDE_M = 0.15
_LEAST_SPEED_MPS = 1e-3
_NOT_SAFE = "no motion is safe"


class PathFollowing:
    """A dynamic-window controller along the detour of a leg's path."""

    def __init__(self, limits: RobotLimits, params: LocalPlannerParameters, motion: SafeMotion) -> None:
        self._params, self._motion, self._front_m = params, motion, limits.front_m
        self._detours = DetourPlanner(limits.radius_m or limits.half_width_m, params.margin_m, params.comfort_m)
        self._times = params.rollout_step_s * np.arange(1, math.ceil(params.horizon_s / params.rollout_step_s) + 1)

    def step(self, scene: Scene, leg: Leg) -> Decision:
        """On along the path; blocked when it is too far off, or has stood too long without a way."""
        p = self._params
        stretch = (-math.inf, math.inf) if leg.s is None else (leg.s - _BACK_M, leg.s + _ON_M)
        leg.s, off_path = leg.path.project(scene.pose.x, scene.pose.y, *stretch)
        if off_path > p.max_off_path_m:
            return Decision(Twist2D(), "blocked", f"{off_path:.2f} m off the path")
        leg.detour = self._detours.plan(leg.path, leg.s, scene.pose, scene.field, leg.detour)
        way = way_along(leg.detour)
        target = self._target(scene, leg, leg.detour, way)
        standing = target is None or (abs(target.v) < _STANDS_MPS and abs(target.omega) < _STANDS_RPS)
        waited = leg.progress.watch(scene, not standing, p.no_progress_m, p.no_progress_s)
        if waited >= p.blocked_after_s:
            gap = way.end_m + self._front_m
            why = f"no way past an obstacle {gap:.1f} m ahead" if leg.detour.blocked else _NOT_SAFE
            return Decision(Twist2D(), "blocked", why)
        if target is None:  # brake as hard as the base can
            return Decision(Twist2D(), "driving", _NOT_SAFE)
        return Decision(self._motion.towards(scene, target), "driving", "waiting for a way" if standing else "")

    def _target(self, scene: Scene, leg: Leg, detour: Detour, way: Polyline) -> Twist2D | None:
        """The velocities to head for: none at the end of the way; None where no motion is safe."""
        p = self._params
        stop_after = math.inf
        if detour.blocked:
            stop_after = way.end_m - p.stand_off_m
        elif detour.stations[-1] >= leg.path.end_m:
            stop_after = way.end_m
        if stop_after <= 0.0:
            return Twist2D()
        speed = stopping_speed(stop_after, scene.limits.max_acceleration_mps2)
        speed = max(min(scene.limits.max_speed_mps, speed), _LEAST_SPEED_MPS)
        scene = replace(scene, limits=replace(scene.limits, max_speed_mps=speed))
        ahead = way.point(_LOOK_AHEAD_M)
        heading, reach = math.atan2(ahead[1], ahead[0]), math.hypot(*ahead)
        threshold = p.turn_stop_rad if leg.turning else p.turn_start_rad
        leg.turning = abs(heading) > threshold and reach > 0.5 * leg.tolerance_m
        turn = self._motion.turn(scene, heading) if leg.turning else None
        return turn or self._best(scene, way)

    def _best(self, scene: Scene, way: Polyline) -> Twist2D | None:
        """The cheapest velocities; None when the robot could not brake before contact with any of them."""
        p, limits = self._params, scene.limits
        targets = window(scene.twist, limits, p.window_s, limits.max_speed_mps, p.speed_samples, p.yaw_rate_samples)
        if scene.gentle:
            in_view = np.abs(targets[:, 1]) <= p.in_view_rps(targets[:, 0])
            targets = targets[in_view] if in_view.any() else targets
        safe = self._motion.can_stop(scene, targets)
        if not safe.any():
            return None
        targets = targets[safe]
        poses, velocities = roll_out(scene.twist, targets, limits, self._times)
        motions = judge(
            *(targets, self._motion.last, poses, velocities, p.rollout_step_s, self._motion.clears(scene, poses)),
            *(self._motion.floor_m(scene), way, limits.max_speed_mps),
        )
        best = int(np.argmin(costs(motions, limits, p)))
        return Twist2D(float(targets[best, 0]), float(targets[best, 1]))


def way_along(detour: Detour) -> Polyline:
    """The detour from where the robot stands, in its frame, without the first bit beside it."""
    far = np.hypot(detour.points[:, 0], detour.points[:, 1]) > _BESIDE_M
    first = int(np.argmax(far)) if far.any() else len(detour.points) - 1
    return Polyline(np.vstack([(0.0, 0.0), detour.points[first:]]))
