"""The last metre: on a smooth curve to the goal's pose, then turning to its heading, then standing."""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.control.leg import Decision, Leg, Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.pose_approach import CURVES, PERIOD_S, roll_out_approach
from hitchhike_ros.control.safe_motion import SafeMotion
from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import between

# Where the robot is at its goal, as shares of the tolerance: coming along a path, along a curve, and once it is there.
_PATH_ENDS, _CURVE_ENDS, _LEAVES = 0.3, 0.8, 1.0
# A goal that it has come past is not gone back to from within this share of the tolerance (and so many m ahead).
_PASSED, _PASSED_M = 0.8, 0.02
# A curve is planned to end within this share of where it counts as ended.
_CURVE_AIMS = 0.9
# Turned to the heading within the first share of the tolerance it settles, beyond the second it turns again.
_SETTLES, _UNSETTLES = 0.4, 0.9
# It has arrived once it is slower than this (m/s, rad/s).
_STANDS_MPS, _STANDS_RPS = 0.05, 0.1


class GoalApproach:
    """Takes over from the path near the goal of a leg."""

    def __init__(self, params: LocalPlannerParameters, motion: SafeMotion) -> None:
        self._params, self._motion = params, motion

    def step(self, scene: Scene, leg: Leg) -> Decision | None:
        """The next motion to the goal; None where the path leads on: far from the goal, or without a free curve."""
        p, goal = self._params, between(scene.pose, leg.goal)
        left_m = math.hypot(goal.x, goal.y)
        there = _LEAVES if leg.aligning else _CURVE_ENDS if leg.curve else _PATH_ENDS
        passed = left_m <= _PASSED * leg.tolerance_m and goal.x < _PASSED_M
        leg.aligning = left_m <= there * leg.tolerance_m or passed
        if leg.aligning:
            return self._align(scene, leg, goal.theta)
        # A rider would lose a marker that goes back or turns away; it also needs no heading where the ride ends.
        if left_m > p.approach_m or leg.tolerance_rad >= math.pi or scene.gentle:
            return None
        target = self._along_curve(scene, leg, goal)
        if target is None:
            return None
        leg.progress.watch(scene, True, p.no_progress_m, p.no_progress_s)
        return Decision(self._motion.towards(scene, target), "driving")

    def _along_curve(self, scene: Scene, leg: Leg, goal: Pose2D) -> Twist2D | None:
        """The next velocities on a free curve to ``goal`` (in the robot's frame); None where there is none.

        The curve that the leg is on is kept while it is free.
        """
        p, twist, underway = self._params, scene.twist, self._motion.underway(scene)
        # The base is one command late.
        soon = between(Pose2D(twist.v * PERIOD_S, 0.0, twist.omega * PERIOD_S), goal)
        near_m = _CURVE_AIMS * _CURVE_ENDS * leg.tolerance_m
        for curves in ((leg.curve,) if leg.curve else (), CURVES):
            if not curves:
                continue
            plan = roll_out_approach(soon, underway, curves, scene.limits, p.approach_backwards_mps, near_m)
            free = self._motion.clears(scene, plan.poses).min(axis=1) >= self._motion.floor_m(scene)
            usable = free & (plan.backwards_m <= p.approach_backwards_m)
            seconds = np.where(usable, plan.seconds, np.inf)
            best = int(np.argmin(seconds))
            if math.isfinite(seconds[best]):
                leg.curve = curves[best]
                return Twist2D(float(plan.velocities[best, 0]), float(plan.velocities[best, 1]))
        leg.curve = None
        return None

    def _align(self, scene: Scene, leg: Leg, error: float) -> Decision:
        """Turn to the goal's heading, ``error`` rad away, and arrive standing."""
        p, twist = self._params, scene.twist
        leg.settled = abs(error) <= (_UNSETTLES if leg.settled else _SETTLES) * leg.tolerance_rad
        if leg.settled:
            leg.arrived = abs(twist.v) < _STANDS_MPS and abs(twist.omega) < _STANDS_RPS
            return Decision(Twist2D(), "arrived" if leg.arrived else "driving")
        target = self._motion.turn(scene, error)
        waited = leg.progress.watch(scene, target is not None, p.no_progress_m, p.no_progress_s)
        if target is not None:
            return Decision(self._motion.towards(scene, target), "driving")
        return Decision(Twist2D(), "blocked" if waited >= p.blocked_after_s else "driving", "no room to turn")
