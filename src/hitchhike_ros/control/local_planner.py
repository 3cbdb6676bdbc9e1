"""Follows a path around what the map does not know: a dynamic-window controller with the robot's footprint.

One step: the scan becomes obstacle points (:mod:`obstacle_memory`) and a field of distances (:mod:`clearance`). Then
one part acts, and proposes only motions that the robot can brake from before contact (:mod:`safe_motion`):

- :mod:`guided_driving`, while a human drives;
- :mod:`goal_approach`, near the goal, on a curve to its pose;
- :mod:`path_following`, else, along the path shifted around the obstacles (:mod:`detour`);
- the steps of :mod:`recovery`, :mod:`withdrawal` the last of them, where all that leads nowhere. The state is
  ``blocked`` until there is a way again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchhike_ros.control.clearance import ClearanceField
from hitchhike_ros.control.contact import Contact
from hitchhike_ros.control.goal_approach import GoalApproach
from hitchhike_ros.control.guided_driving import GuidedDriving
from hitchhike_ros.control.leg import Decision, Leg, ProgressCheck, Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.obstacle_memory import ObstacleMemory, scan_points
from hitchhike_ros.control.path_following import PathFollowing
from hitchhike_ros.control.recovery import Recovery, RecoveryStep, recovery_steps
from hitchhike_ros.control.safe_motion import SafeMotion
from hitchhike_ros.control.withdrawal import Withdrawal, look_around
from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D, Twist2D
from hitchhike_ros.core.errors import PlanningError, SensorDataError
from hitchhike_ros.core.geometry import between, distance
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.laser import ScanParameters

# A robot's outline as points no farther apart than the field's cells.
_OUTLINE_POINTS = 48
# A path ends at its goal when it ends no farther from it than this, or than the goal's tolerance (m).
_PATH_END_M = 0.2


class LocalPlanner:
    """Drives one robot along one path at a time. Call :meth:`step` with each scan."""

    def __init__(
        self, limits: RobotLimits, params: LocalPlannerParameters, scan_params: ScanParameters | None = None
    ) -> None:
        self._params, self._limits = params, limits
        self._scan_params = scan_params or ScanParameters()
        self._rider_limits = replace(
            limits,
            max_speed_mps=min(limits.max_speed_mps, params.rider_speed_mps),
            max_yaw_rate_rps=min(limits.max_yaw_rate_rps, params.rider_yaw_rate_rps),
            max_acceleration_mps2=min(limits.max_acceleration_mps2, params.rider_acceleration_mps2),
            max_yaw_acceleration_rps2=min(limits.max_yaw_acceleration_rps2, params.rider_yaw_acceleration_rps2),
        )
        self._motion = SafeMotion(params, limits)
        self._memory = ObstacleMemory(params.memory_s, params.near_memory_s, self._motion.footprint)
        self._path_following = PathFollowing(limits, params, self._motion)
        self._goal_approach = GoalApproach(params, self._motion)
        self._guided_driving = GuidedDriving(params, self._motion)
        self._recovery = Recovery(recovery_steps(params), params.recovery_calm_s)
        self._withdrawal = Withdrawal(params, self._motion, self._drive)
        self._contact = Contact(self._motion.footprint)
        self._leg: Leg | None = None

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
        line = Polyline(path)
        if not goal.is_finite():
            raise PlanningError(f"goal {goal} is not finite")
        end_x, end_y = line.point(line.end_m)
        gap = math.hypot(end_x - goal.x, end_y - goal.y)
        tolerance_m = self._params.goal_tolerance_m if tolerance_m is None else tolerance_m
        tolerance_rad = self._params.goal_tolerance_rad if tolerance_rad is None else tolerance_rad
        if gap > max(_PATH_END_M, tolerance_m):
            raise PlanningError(f"path ends {gap:.2f} m from the goal")
        line.extend(goal.x, goal.y)
        before, self._leg = self._leg, Leg(line, goal, tolerance_m, tolerance_rad)
        if before is None or before.goal != goal:
            self._start_over()
        elif before.progress.stuck:  # another path is another chance
            self._leg.progress = ProgressCheck(before.progress.moved_at)
        else:
            self._leg.progress = before.progress

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

        Args:
            now: in s, on the clock of the stamps.
            pose, twist: of the robot at the scan's stamp, the pose in ``map``.
            scan: the newest one.
            T_base_laser: the laser's mount.
            speed_limit: in m/s; 0 is a pause.
            gentle: whether a hitchhiker follows.
            others: robots that say where in ``map`` they are, with the radius of each: a laser sees of a robot only
                what is at its own height.
            teleop: what a human who drives wants, a stand too; None where nobody does. It is followed in place of the
                path, as fast as that is safe. Near the goal the robot parks by itself for as long as the human wants
                it to move.

        Returns:
            A stand with state ``blocked`` where inputs are not finite, too old or empty.
        """
        try:
            points = self._usable_points(now, pose, twist, scan, speed_limit)
        except SensorDataError as exc:
            decision = Decision(Twist2D(), "blocked", str(exc))
        else:
            seen = self._memory.update(scan, points, pose, T_base_laser)
            outlines = [self._outline(pose, *other) for other in others]
            sources = [("scan", len(points)), ("earlier scans", len(seen) - len(points))]
            sources += [("the place that another robot tells", len(outline)) for outline in outlines]
            points = np.vstack([seen, *outlines])
            decision = self._decide(now, pose, twist, points, sources, speed_limit, gentle, teleop)
        self._motion.command(decision.twist, now)
        return decision

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
        return scan_points(scan, self._scan_params.max_bad_share)

    def _outline(self, pose: Pose2D, other: Pose2D, radius_m: float) -> FloatArray:
        """Points (N, 2) around another robot, in the own frame; of one that is too near only what leaves room to go."""
        seen = between(pose, other)
        radius = min(radius_m, math.hypot(seen.x, seen.y) - self._limits.circumscribed_m - self._params.margin_m)
        if radius <= 0.0:
            return np.empty((0, 2))
        angles = np.linspace(0.0, 2.0 * math.pi, _OUTLINE_POINTS, endpoint=False)
        return np.array([seen.x, seen.y]) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def _decide(
        self,
        now: float,
        pose: Pose2D,
        twist: Twist2D,
        points: FloatArray,
        sources: Sequence[tuple[str, int]],
        speed_limit: float,
        gentle: bool,
        teleop: Twist2D | None,
    ) -> Decision:
        """Which part acts, with obstacle points (N, 2) in the robot's frame.

        ``sources`` says, in their order, where how many of them come from.
        """
        leg = self._leg
        if leg is None:
            return Decision(Twist2D(), "blocked", "no path")
        if leg.arrived:
            return Decision(Twist2D(), "arrived")
        if speed_limit == 0.0:
            leg.progress.moved_at = leg.progress.came_on_at = now
            return Decision(Twist2D(), "driving", "speed limit is zero")
        limits = self._rider_limits if gentle else self._limits
        limits = replace(limits, max_speed_mps=min(limits.max_speed_mps, speed_limit))
        field = ClearanceField(points)
        clearance_m = self._motion.clearance_m(field)
        scene = Scene(now, pose, twist, field, limits, gentle, clearance_m)
        if self._motion.touches(scene):
            scene = replace(scene, touched=self._contact.describe(points, sources))
        else:
            self._contact.clear()
        near = distance(pose, leg.goal) <= self._params.guided_ends_m
        if teleop is not None and (not near or teleop == Twist2D()):
            self._start_over()
            self._withdrawal.end(pose)
            return self._guided_driving.step(scene, leg, teleop)
        decision = self._drive(scene, leg)
        # Whoever makes room does not come back at the first gap.
        recovery = self._recovery.step(now, decision.state == "blocked" or self._withdrawal.underway)
        if recovery is None or recovery.action != "withdraw":
            self._withdrawal.end(pose)
            if recovery is None or decision.state != "blocked":
                return decision
        return self._recover(scene, leg, recovery, decision.reason)

    def _drive(self, scene: Scene, leg: Leg) -> Decision:
        """Along a leg, its goal included."""
        if self._motion.touches(scene):
            return Decision(Twist2D(), "blocked", scene.touched)
        if leg.progress.stuck:
            return Decision(Twist2D(), "blocked", f"no progress for {self._params.no_progress_s:.0f} s")
        return self._goal_approach.step(scene, leg) or self._path_following.step(scene, leg)

    def _recover(self, scene: Scene, leg: Leg, step: RecoveryStep, why: str) -> Decision:
        """What a step of recovery does about a blocked way; it stands where a rider would lose the marker."""
        motion: Twist2D | None = None
        if step.action == "clear":
            self._memory.forget_far(scene.pose)
            leg.detour = None
        elif step.action == "turn" and not scene.gentle:
            motion = look_around(scene, self._params, self._motion)
        elif step.action == "withdraw":
            # What it gives up is no lack of progress.
            leg.progress.about, leg.progress.came_on_at = scene.pose, scene.now
            motion = None if scene.gentle else self._withdrawal.step(scene)
        return Decision(motion or Twist2D(), "blocked", f"{why}; {step.says}")

    def _start_over(self) -> None:
        """The next block is a new one."""
        self._recovery.reset()
        self._withdrawal.forget()
