"""Follows a path around what the map does not know: a dynamic-window controller with the robot's footprint.

One step: the scan becomes obstacle points (:mod:`obstacle_memory`) and a field of distances (:mod:`clearance`); the
path is shifted around them (:mod:`detour`); motions that the robot can make (:mod:`dynamic_window`) are refused when it
could not brake before contact, and scored along the shifted path. Near the goal a smooth curve to its pose is planned
(:mod:`pose_approach`). Where all that leads nowhere, the steps of :mod:`recovery` follow one another, and the state is
``blocked`` until there is a way again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from hitchhike_ros.control.clearance import ClearanceField, Footprint
from hitchhike_ros.control.detour import Detour, DetourPlanner
from hitchhike_ros.control.dynamic_window import brake, roll_out, window
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.obstacle_memory import ObstacleMemory, scan_points
from hitchhike_ros.control.pose_approach import CURVES, PERIOD_S, Curve, roll_out_approach
from hitchhike_ros.control.recovery import Recovery, RecoveryStep
from hitchhike_ros.control.trail import Trail
from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D, Twist2D
from hitchhike_ros.core.errors import PlanningError, SensorDataError
from hitchhike_ros.core.geometry import between, distance
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.core.robot_model import RobotLimits

State = Literal["driving", "arrived", "blocked"]
# A robot's outline as points no farther apart than the field's cells.
_OUTLINE_POINTS = 48
# An approach ends within this share of the goal's tolerance; what is left of the heading is then turned standing.
_CURVE_ENDS = 0.8
# Backing up: the place to steer for, so far along the way back, and what is tried beside that arc, rad/s.
_BACK_AHEAD_M = 0.4
_BACK_YAW_RATES = np.array([0.0, 0.1, -0.1, 0.2, -0.2, 0.4, -0.4])
# Shares of the speed that a human asks for, of which the largest that is safe is driven.
_BY_HAND_SHARES = np.array([1.0, 0.8, 0.6, 0.4, 0.2, 0.0])
# On the spot with a rider behind: so slowly that its marker stays in view (rad/s).
_GENTLE_TURN_RPS = 0.1


@dataclass(frozen=True)
class Decision:
    """What to do now, and why when it is not simply driving."""

    twist: Twist2D
    state: State
    reason: str = ""


@dataclass
class _Leg:
    """One path on the way to its goal, and how far the robot has come."""

    path: Polyline
    goal: Pose2D
    tolerance_m: float
    tolerance_rad: float
    s: float | None = None  # arc length of the robot's foot on the path
    detour: Detour | None = None
    curve: Curve | None = None  # on which the goal is approached
    turning: bool = False
    aligning: bool = False
    settled: bool = False
    arrived: bool = False
    about: Pose2D | None = None  # where it has been busy since it last progressed
    progressed_at: float = math.inf
    moved_at: float = math.inf
    stuck: bool = False

    def watch(self, now: float, moving: bool, pose: Pose2D, params: LocalPlannerParameters) -> float:
        """Seconds without motion. ``stuck`` tells of motion that leads nowhere; who waits is not stuck."""
        if moving or now < self.moved_at:
            self.moved_at = now
        away = self.about is None or distance(self.about, pose) > params.no_progress_m
        if away or not moving or now < self.progressed_at:
            self.about, self.progressed_at = pose, now
        self.stuck |= now - self.progressed_at >= params.no_progress_s
        return now - self.moved_at


class LocalPlanner:
    """Drives one robot along one path at a time. Call :meth:`step` with each scan."""

    def __init__(self, limits: RobotLimits, params: LocalPlannerParameters) -> None:
        self._params, self._limits = params, limits
        self._rider_limits = replace(
            limits,
            max_speed_mps=min(limits.max_speed_mps, params.rider_speed_mps),
            max_yaw_rate_rps=min(limits.max_yaw_rate_rps, params.rider_yaw_rate_rps),
            max_acceleration_mps2=min(limits.max_acceleration_mps2, params.rider_acceleration_mps2),
            max_yaw_acceleration_rps2=min(limits.max_yaw_acceleration_rps2, params.rider_yaw_acceleration_rps2),
        )
        self._footprint = Footprint(limits)
        self._detour_planner = DetourPlanner(limits.radius_m or limits.half_width_m, params.margin_m, params.comfort_m)
        self._memory = ObstacleMemory(params.memory_s, params.near_memory_s, self._footprint)
        self._times = params.rollout_step_s * np.arange(1, math.ceil(params.horizon_s / params.rollout_step_s) + 1)
        table = (
            RecoveryStep("wait", params.recovery_wait_s, "waiting"),
            RecoveryStep("clear", params.recovery_clear_s, "forgetting obstacles out of view"),
            RecoveryStep("turn", params.recovery_turn_s, "turning to look"),
            RecoveryStep("replan", params.recovery_replan_s, "waiting for another plan"),
            RecoveryStep("withdraw", params.recovery_withdraw_s, "making room"),
        )
        self._recovery = Recovery(table, params.recovery_calm_s)
        self._command, self._commanded_at = Twist2D(), -math.inf
        self._leg: _Leg | None = None
        self._trail = Trail(params.recovery_withdraw_m)
        self._withdrawal: _Leg | None = None
        self._withdrew_at: Pose2D | None = None

    def clear(self) -> None:
        """Forget path and goal; what is known of obstacles stays."""
        self._leg = None
        self._start_over()

    def set_path(
        self, path: FloatArray, goal: Pose2D, tolerance_m: float | None = None, tolerance_rad: float | None = None
    ) -> None:
        """Drive along ``path`` (N, 2) to ``goal``, both in ``map``; the tolerances default to the parameters'.

        Another path to the same goal does not make a robot that is blocked an unblocked one until it moves.

        Raises:
            PlanningError: the path is not finite points, or does not end at the goal.
        """
        points = np.asarray(path, dtype=float)
        reference = Polyline(points)
        if not goal.is_finite():
            raise PlanningError(f"goal {goal} is not finite")
        gap = math.hypot(points[-1, 0] - goal.x, points[-1, 1] - goal.y)
        tolerance_m = self._params.goal_tolerance_m if tolerance_m is None else tolerance_m
        tolerance_rad = self._params.goal_tolerance_rad if tolerance_rad is None else tolerance_rad
        if gap > max(0.2, tolerance_m):
            raise PlanningError(f"path ends {gap:.2f} m from the goal")
        if gap > 0.0:
            reference = Polyline(np.vstack([points, (goal.x, goal.y)]))
        before, self._leg = self._leg, _Leg(reference, goal, tolerance_m, tolerance_rad)
        if before is not None and before.goal == goal:
            self._leg.moved_at = before.moved_at
            if not before.stuck:  # after that another path is another chance
                self._leg.about, self._leg.progressed_at = before.about, before.progressed_at
        else:
            self._start_over()

    def step(
        self,
        now: float,
        pose: Pose2D,
        twist: Twist2D,
        scan: LaserScan,
        T_base_laser: Pose2D,
        speed_limit: float,
        gentle: bool = False,
        others: Sequence[tuple[Pose2D, float]] = (),
        teleop: Twist2D | None = None,
    ) -> Decision:
        """The command for the next scan period.

        ``pose`` (in ``map``) and ``twist`` are those at the scan's stamp; ``speed_limit`` in m/s; ``gentle`` while a
        hitchhiker follows. ``others`` are robots that say where in ``map`` they are, with the radius of each: a laser
        sees of a robot only what is at its own height. ``teleop`` is what a human who drives wants, a stand too; None
        where nobody does. It is followed in place of the path, as fast as that is safe; near the goal the robot parks
        by itself for as long as the human wants it to move. Inputs that are not finite, too old or empty give a stand
        with state ``blocked``.
        """
        try:
            points = self._usable_points(now, pose, twist, scan, speed_limit)
        except SensorDataError as exc:
            return self._stand("blocked", str(exc))
        points = self._memory.update(scan, points, pose, T_base_laser)
        leg = self._leg
        if leg is None:
            return self._stand("blocked", "no path")
        if leg.arrived:
            return self._stand("arrived")
        if speed_limit == 0.0:
            leg.moved_at = leg.progressed_at = now
            return self._stand("driving", "speed limit is zero")
        limits = self._rider_limits if gentle else self._limits
        limits = replace(limits, max_speed_mps=min(limits.max_speed_mps, speed_limit))
        field = ClearanceField(np.vstack([points, *(self._outline(pose, *other) for other in others)]))
        near = distance(pose, leg.goal) <= self._params.guided_ends_m
        if teleop is not None and (not near or teleop == Twist2D()):
            return self._drive_guided(leg, now, pose, twist, field, limits, gentle, teleop)
        before = self._command
        decision = self._drive(leg, now, pose, twist, field, limits, gentle)
        # Whoever makes room does not come back at the first gap.
        recovery = self._recovery.step(now, decision.state == "blocked" or self._withdrawal is not None)
        if recovery is None or recovery.action != "withdraw":
            self._withdrawal = None
            self._trail.add(pose)
        else:  # what it gives up is no lack of progress
            leg.about, leg.progressed_at = pose, now
        if recovery is None or (recovery.action != "withdraw" and decision.state != "blocked"):
            return decision
        reason = f"{decision.reason}; {recovery.says}"
        if recovery.action == "clear":
            self._memory.forget_far(pose)
            leg.detour = None
        motion = None
        if recovery.action in ("turn", "withdraw") and not gentle:  # whoever follows behind would lose the marker
            self._command = before
            act = self._look_around if recovery.action == "turn" else self._withdraw
            motion = act(now, pose, twist, field, limits)
        return self._stand("blocked", reason) if motion is None else Decision(motion, "blocked", reason)

    def _usable_points(
        self, now: float, pose: Pose2D, twist: Twist2D, scan: LaserScan, speed_limit: float
    ) -> FloatArray:
        """The scan's points (N, 2) in the laser's frame.

        Raises:
            SensorDataError: something is not finite, too old or empty.
        """
        if not (math.isfinite(now) and pose.is_finite() and twist.is_finite()):
            raise SensorDataError("pose or twist is not finite")
        if not speed_limit >= 0.0:
            raise SensorDataError(f"speed limit is {speed_limit}")
        if not abs(now - scan.stamp) <= self._params.max_age_s:
            raise SensorDataError(f"scan is {now - scan.stamp:.2f} s old")
        return scan_points(scan, self._params.max_nan_fraction)

    def _outline(self, pose: Pose2D, other: Pose2D, radius_m: float) -> FloatArray:
        """Points (N, 2) around another robot, in the own frame; of one that is too near only what leaves room to go."""
        seen = between(pose, other)
        radius = min(radius_m, math.hypot(seen.x, seen.y) - self._limits.circumscribed_m - self._params.margin_m)
        if radius <= 0.0:
            return np.empty((0, 2))
        angles = np.linspace(0.0, 2.0 * math.pi, _OUTLINE_POINTS, endpoint=False)
        return np.array([seen.x, seen.y]) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def _start_over(self) -> None:
        self._recovery.reset()
        self._withdrawal = self._withdrew_at = None

    def _withdraw(
        self, now: float, pose: Pose2D, twist: Twist2D, field: ClearanceField, limits: RobotLimits
    ) -> Twist2D | None:
        """Back along the way that it came, once from one place: who stands in the way may be waiting for the robot."""
        p = self._params
        if self._withdrawal is None:
            if self._withdrew_at is not None and distance(pose, self._withdrew_at) < p.recovery_withdraw_m:
                return None
            way = self._trail.back(pose)
            end, self._withdrew_at = Pose2D(float(way[-1, 0]), float(way[-1, 1])), pose
            self._withdrawal = _Leg(Polyline(way), end, p.goal_tolerance_m, math.tau)
        way_back = self._withdrawal.path
        gone_m, _ = way_back.project(pose.x, pose.y)
        back = between(pose, Pose2D(*way_back.point(gone_m + _BACK_AHEAD_M)))
        if back.x < -abs(back.y):  # where there is no room to turn round there is room to go back
            done = way_back.end_m - gone_m <= p.goal_tolerance_m
            return None if done else self._back_up(now, back, twist, field, limits)
        decision = self._drive(self._withdrawal, now, pose, twist, field, limits, False)
        return decision.twist if decision.state == "driving" else None

    def _back_up(
        self, now: float, back: Pose2D, twist: Twist2D, field: ClearanceField, limits: RobotLimits
    ) -> Twist2D | None:
        """Backwards on the free arc that is nearest to the one to the place ``back`` (robot's frame); None without."""
        p = self._params
        clearance = float(field.clearance(self._footprint, np.zeros(3)))
        speed = min(p.recovery_backwards_mps, limits.max_speed_mps)
        wanted = -speed * 2.0 * back.y / (back.x**2 + back.y**2)
        omega = np.clip(wanted + _BACK_YAW_RATES, -limits.max_yaw_rate_rps, limits.max_yaw_rate_rps)
        targets = np.stack([np.full_like(omega, -speed), omega], axis=1)
        free = self._can_stop(twist, targets, field, self._floor(clearance), limits)
        if not free.any():
            return None
        v, w = targets[int(np.argmax(free))]
        return self._ramp(now, twist, Twist2D(float(v), float(w)), limits)

    def _look_around(
        self, now: float, _pose: Pose2D, twist: Twist2D, field: ClearanceField, limits: RobotLimits
    ) -> Twist2D | None:
        """A slow turn on the spot; None without room for one."""
        clearance = float(field.clearance(self._footprint, np.zeros(3)))
        if clearance <= 0.02:
            return None
        limits = replace(limits, max_yaw_rate_rps=min(limits.max_yaw_rate_rps, self._params.recovery_yaw_rate_rps))
        target = self._turn(1.0, twist, field, min(self._params.margin_m, clearance - 0.005), limits)
        return None if target is None else self._ramp(now, twist, target, limits)

    def _drive(
        self,
        leg: _Leg,
        now: float,
        pose: Pose2D,
        twist: Twist2D,
        field: ClearanceField,
        limits: RobotLimits,
        gentle: bool,
    ) -> Decision:
        p = self._params
        clearance = float(field.clearance(self._footprint, np.zeros(3)))
        if clearance < -0.02:  # more than the discs' overhang and the grid explain
            return self._stand("blocked", "an obstacle touches the footprint")
        floor = self._floor(clearance)
        if leg.stuck:
            return self._stand("blocked", f"no progress for {p.no_progress_s:.0f} s")

        goal = between(pose, leg.goal)
        left_m = math.hypot(goal.x, goal.y)
        near_m = 1.0 if leg.aligning else _CURVE_ENDS if leg.curve else 0.3
        at_goal = left_m <= near_m * leg.tolerance_m
        leg.aligning = at_goal or (left_m <= 0.8 * leg.tolerance_m and goal.x < 0.02)
        if leg.aligning:
            return self._align(leg, now, pose, goal.theta, twist, field, floor, limits)
        # A rider would lose a marker that goes back or turns away; it also needs no heading where the ride ends.
        near = left_m <= p.approach_m and leg.tolerance_rad < math.pi and not gentle
        approach = self._approach(leg, goal, twist, field, floor, limits) if near else None
        if approach is not None:
            leg.watch(now, True, pose, p)
            return Decision(self._ramp(now, twist, approach, limits), "driving")

        stretch = (0.0, math.inf) if leg.s is None else (leg.s - 0.5, leg.s + 2.0)
        leg.s, off_path = leg.path.project(pose.x, pose.y, *stretch)
        if off_path > p.max_off_path_m:
            return self._stand("blocked", f"{off_path:.2f} m off the path")
        leg.detour = self._detour_planner.plan(leg.path, leg.s, pose, field, leg.detour)
        way = self._way(leg.detour)
        stop_after = math.inf
        if leg.detour.blocked:
            stop_after = way.end_m - p.stand_off_m
        elif leg.detour.stations[-1] >= leg.path.end_m:
            stop_after = way.end_m
        speed = math.sqrt(1.2 * limits.max_acceleration_mps2 * max(stop_after, 0.0))
        limits = replace(limits, max_speed_mps=max(min(limits.max_speed_mps, speed), 1e-3))

        target: Twist2D | None = Twist2D()
        if stop_after > 0.0:
            ahead = way.point(0.5)
            heading, reach = math.atan2(ahead[1], ahead[0]), math.hypot(*ahead)
            threshold = p.turn_stop_rad if leg.turning else p.turn_start_rad
            leg.turning = abs(heading) > threshold and reach > 0.5 * leg.tolerance_m
            target = self._turn(heading, twist, field, floor, limits) if leg.turning else None
            target = target or self._best(twist, way, field, floor, limits, gentle)
        standing = target is None or (abs(target.v) < 0.01 and abs(target.omega) < 0.02)
        waited = leg.watch(now, not standing, pose, p)
        if waited >= p.blocked_after_s:
            gap = way.end_m + self._limits.front_m
            why = f"no way past an obstacle {gap:.1f} m ahead" if leg.detour.blocked else "no motion is safe"
            return self._stand("blocked", why)
        if target is None:  # brake as hard as the base can
            return self._stand("driving", "no motion is safe")
        return Decision(self._ramp(now, twist, target, limits), "driving", "waiting for a way" if standing else "")

    def _drive_guided(
        self,
        leg: _Leg,
        now: float,
        pose: Pose2D,
        twist: Twist2D,
        field: ClearanceField,
        limits: RobotLimits,
        gentle: bool,
        wanted: Twist2D,
    ) -> Decision:
        """What the human wants, slower where the robot could not brake before contact; blocked is only the path."""
        p = self._params
        leg.moved_at = leg.progressed_at = now  # it goes where and when the human wants
        leg.about, leg.stuck, leg.detour, leg.turning = pose, False, None, False
        self._start_over()
        self._trail.add(pose)
        clearance = float(field.clearance(self._footprint, np.zeros(3)))
        if clearance < -0.02:
            return self._stand("blocked", "an obstacle touches the footprint")
        # Not backwards: what is behind was seen a while ago, if ever, and the human does not see it either.
        v = min(max(wanted.v, 0.0), limits.max_speed_mps) * _BY_HAND_SHARES
        omega = np.clip(np.full_like(v, wanted.omega), -limits.max_yaw_rate_rps, limits.max_yaw_rate_rps)
        if gentle:
            in_view = p.rider_curvature_per_m * v + _GENTLE_TURN_RPS
            omega = np.clip(omega, -in_view, in_view)
        targets = np.vstack([np.stack([v, omega], axis=1), np.zeros(2)])
        safe = self._can_stop(twist, targets, field, self._floor(clearance), limits)
        chosen = int(np.argmax(safe)) if safe.any() else -1
        command = self._ramp(now, twist, Twist2D(*(float(x) for x in targets[chosen])), limits)
        if not safe.any():
            self._command = command = Twist2D()  # brake as hard as the base can
        leg.s, off_path = leg.path.project(pose.x, pose.y)
        if off_path > p.max_off_path_m:  # path_planning plans anew
            return Decision(command, "blocked", f"driven by hand, {off_path:.2f} m off the path")
        held = bool(chosen) and wanted != Twist2D()
        return Decision(command, "driving", "driven by hand" + (", held back by an obstacle" if held else ""))

    def _floor(self, clearance: float) -> float:
        """How near to an obstacle it may come: the margin, or the ``clearance`` of now where someone has stepped up."""
        return min(self._params.margin_m, clearance - 0.005 if clearance > 0.02 else clearance)

    def _approach(
        self,
        leg: _Leg,
        goal: Pose2D,
        twist: Twist2D,
        field: ClearanceField,
        floor: float,
        limits: RobotLimits,
    ) -> Twist2D | None:
        """The next velocities on a free curve to ``goal`` (in the robot's frame); None where there is none."""
        p = self._params
        underway = self._underway(twist, limits)
        # The base is one command late.
        soon = between(Pose2D(twist.v * PERIOD_S, 0.0, twist.omega * PERIOD_S), goal)
        near_m = 0.9 * _CURVE_ENDS * leg.tolerance_m
        for curves in ((leg.curve,) if leg.curve else (), CURVES):
            if not curves:
                continue
            plan = roll_out_approach(soon, underway, curves, limits, p.approach_backwards_mps, near_m)
            free = field.clearance(self._footprint, plan.poses).min(axis=1) >= floor
            usable = free & (plan.backwards_m <= p.approach_backwards_m)
            seconds = np.where(usable, plan.seconds, np.inf)
            best = int(np.argmin(seconds))
            if math.isfinite(seconds[best]):
                leg.curve = curves[best]
                return Twist2D(float(plan.velocities[best, 0]), float(plan.velocities[best, 1]))
        leg.curve = None
        return None

    def _align(
        self,
        leg: _Leg,
        now: float,
        pose: Pose2D,
        error: float,
        twist: Twist2D,
        field: ClearanceField,
        floor: float,
        limits: RobotLimits,
    ) -> Decision:
        """Turn to the goal's heading, ``error`` rad away, and arrive standing."""
        leg.settled = abs(error) <= (0.9 if leg.settled else 0.4) * leg.tolerance_rad
        if leg.settled:
            leg.arrived = abs(twist.v) < 0.05 and abs(twist.omega) < 0.1
            return self._stand("arrived" if leg.arrived else "driving")
        target = self._turn(error, twist, field, floor, limits)
        waited = leg.watch(now, target is not None, pose, self._params)
        if target is not None:
            return Decision(self._ramp(now, twist, target, limits), "driving")
        return self._stand("blocked" if waited >= self._params.blocked_after_s else "driving", "no room to turn")

    def _turn(
        self, error: float, twist: Twist2D, field: ClearanceField, floor: float, limits: RobotLimits
    ) -> Twist2D | None:
        """A standing turn by ``error`` rad, the other way round where an obstacle forbids it; None without room."""
        if abs(twist.v) > 0.05:
            return Twist2D()
        other = error - math.copysign(2.0 * math.pi, error)
        keep_sense = abs(error) > 2.5 and error * self._command.omega < 0.0
        for angle in (other, error) if keep_sense else (error, other):
            sweep = np.zeros((max(3, math.ceil(abs(angle) / 0.1)), 3))
            sweep[:, 2] = np.linspace(0.0, angle, len(sweep))
            if field.clearance(self._footprint, sweep).min() >= floor:
                rate = min(math.sqrt(1.2 * limits.max_yaw_acceleration_rps2 * abs(angle)), 2.5 * abs(angle))
                return Twist2D(0.0, math.copysign(min(rate, limits.max_yaw_rate_rps), angle))
        return None

    def _best(
        self, twist: Twist2D, way: Polyline, field: ClearanceField, floor: float, limits: RobotLimits, gentle: bool
    ) -> Twist2D | None:
        """The velocities to head for; None when the robot could not brake before contact with any of them."""
        p = self._params
        targets = window(twist, limits, p.window_s, limits.max_speed_mps, p.speed_samples, p.yaw_rate_samples)
        if gentle:
            in_view = np.abs(targets[:, 1]) <= p.rider_curvature_per_m * targets[:, 0] + _GENTLE_TURN_RPS
            targets = targets[in_view] if in_view.any() else targets
        safe = self._can_stop(twist, targets, field, floor, limits)
        if not safe.any():
            return None
        targets = targets[safe]
        poses, velocities = roll_out(twist, targets, limits, self._times)
        best = int(np.argmin(self._costs(targets, poses, velocities, way, field, floor, limits)))
        return Twist2D(float(targets[best, 0]), float(targets[best, 1]))

    def _can_stop(
        self, twist: Twist2D, targets: FloatArray, field: ClearanceField, floor: float, limits: RobotLimits
    ) -> npt.NDArray[np.bool_]:
        """Mask (K,) of the target velocities (K, 2) that leave room to brake after the reaction."""
        reaction = np.array([0.5, 1.0]) * self._params.reaction_s
        committed, velocities = roll_out(twist, targets, limits, reaction)
        stopping = np.concatenate([committed, brake(committed[:, -1], velocities[:, -1], limits, 6)], axis=1)
        return np.asarray(field.clearance(self._footprint, stopping).min(axis=1) >= floor)

    def _costs(
        self,
        targets: FloatArray,
        poses: FloatArray,
        velocities: FloatArray,
        way: Polyline,
        field: ClearanceField,
        floor: float,
        limits: RobotLimits,
    ) -> FloatArray:
        """Cost (K,) of heading for ``targets`` (K, 2): ``poses`` (K, P, 3) judged until contact or the way ends."""
        p, (count, length) = self._params, poses.shape[:2]
        every = np.arange(count)
        travelled = np.cumsum(velocities[..., 0], axis=1) * p.rollout_step_s
        clearance = field.clearance(self._footprint, poses)
        free = np.logical_and.accumulate(clearance >= floor, axis=1).sum(axis=1)
        before_end = (travelled < way.end_m).sum(axis=1) + 1
        last = np.clip(np.minimum(free, before_end) - 1, 0, length - 1)
        contact = np.where(free < np.minimum(before_end, length), 1.0 - free / length, 0.0)

        possible = min(max(limits.max_speed_mps, 0.05) * self._times[-1], way.end_m)
        s = np.arange(0.0, possible + 0.3, 0.06)
        line = way.at(s)
        judged = np.minimum(np.array([length // 3, 2 * length // 3, length - 1]), last[:, None])
        places = poses[every[:, None], judged]
        squared = (places[..., 0, None] - line[:, 0]) ** 2 + (places[..., 1, None] - line[:, 1]) ** 2
        nearest = squared.argmin(axis=-1)
        lateral = np.minimum(squared.min(axis=-1) / 0.3**2, 4.0).mean(axis=1)
        reached = s[nearest[:, -1]]
        along = way.tangents(reached + 0.2)
        theta = poses[every, last, 2]
        heading = 1.0 - (along[:, 0] * np.cos(theta) + along[:, 1] * np.sin(theta))
        counted = np.arange(length) <= last[:, None]
        closest = np.where(counted, clearance, np.inf).min(axis=1)
        discomfort = np.clip(1.0 - closest / p.comfort_m, 0.0, 1.0)
        swing = (targets[:, 1] - self._command.omega) / limits.max_yaw_rate_rps
        return (
            p.progress_weight * (1.0 - reached / max(possible, 0.05))
            + p.lateral_weight * lateral
            + p.heading_weight * heading
            + p.clearance_weight * discomfort**2
            + p.contact_weight * contact
            + p.smoothness_weight * swing**2
        )

    @staticmethod
    def _way(detour: Detour) -> Polyline:
        """The detour from where the robot stands, in its frame, without the quantised first bit beside it."""
        far = np.hypot(detour.points[:, 0], detour.points[:, 1]) > 0.15
        first = int(np.argmax(far)) if far.any() else len(detour.points) - 1
        return Polyline(np.vstack([(0.0, 0.0), detour.points[first:]]))

    def _ramp(self, now: float, twist: Twist2D, target: Twist2D, limits: RobotLimits) -> Twist2D:
        """The last command moved towards ``target`` by what the acceleration limits allow since then."""
        dt = now - self._commanded_at
        dt = dt if 0.0 < dt < 0.2 else 0.1
        start = self._underway(twist, limits)
        pairs = (
            (start.v, target.v, limits.max_acceleration_mps2 * dt),
            (start.omega, target.omega, limits.max_yaw_acceleration_rps2 * dt),
        )
        self._command = Twist2D(*(was + min(max(wanted - was, -step), step) for was, wanted, step in pairs))
        self._commanded_at = now
        return self._command

    def _underway(self, twist: Twist2D, limits: RobotLimits) -> Twist2D:
        """What the base is about to do: the last command; one that lags by more than 0.4 s is not hurried further."""
        dv, dw = 0.4 * limits.max_acceleration_mps2, 0.4 * limits.max_yaw_acceleration_rps2
        last = self._command
        return Twist2D(
            min(max(last.v, twist.v - dv), twist.v + dv), min(max(last.omega, twist.omega - dw), twist.omega + dw)
        )

    def _stand(self, state: State, reason: str = "") -> Decision:
        self._command = Twist2D()
        return Decision(self._command, state, reason)
