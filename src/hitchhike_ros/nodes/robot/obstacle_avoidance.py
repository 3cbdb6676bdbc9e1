"""obstacle_avoidance: drives along the plan to the goal, around what the map does not know (module OBS).

One decision for each scan, once the pose of the scan's stamp is there; a later pose is awaited for a moment, then the
last one is carried on by odometry. The robot stands, with the reason in navigation/status and /diagnostics, when a
scan, odometry or a pose is missing, old or senseless, and while there is no plan to its goal.

A human who drives (teleop) is followed in place of the plan, within the speed limit, gently with a rider behind and
never into an obstacle; the robot stands while the human wants nothing. Where a driver aligns it drives by itself, where
it waits for its rider it has no goal and stands.

Subscribed (all but the first only while the module is on):
    hhike_msg/status (std_msgs/String): whether the module is on, the goal, the speed limit, whether somebody rides
    plan (nav_msgs/Path, in ``map``): followed when it ends at the goal; a goal that is only to stand parallel to a wall
        needs none
    amcl_pose (geometry_msgs/PoseWithCovarianceStamped), odom (nav_msgs/Odometry), scan (sensor_msgs/LaserScan)
    cmd_vel/teleop (geometry_msgs/Twist): what the human wants
    teleop/active (std_msgs/Bool): repeated while a human has the robot in hand, so that it does not drive by itself
Published:
    cmd_vel/navigation (geometry_msgs/Twist): for each scan while there is a goal; one stand when that ends
    navigation/status (std_msgs/String, latched): JSON ``{"goal_id", "state", "reason"}``, state one of idle, driving,
        arrived, blocked (the reason ends with the step of recovery); when it changes
    lockstep/answer (std_msgs/Header): the stamp of each scan that has been worked on, when /lockstep is true
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Parameters:
    ~config (path), sections ``obstacle_avoidance`` (control.local_planner_parameters.LocalPlannerParameters),
        ``wall_alignment`` (control.wall_alignment.WallAlignmentParameters) and ``robot``
    ~urdf (path): mount of the laser
    section ``teleop_authority`` of ~config (control.teleop_authority.TeleopAuthorityParameters): how old a human's word
        may be
    ~pose_wait_s (s of wall time, 0.1; 0.4 in lock-step, where time stands still meanwhile): how long the pose of a scan
        is awaited
TF: none.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import msgspec
import numpy as np
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry as OdometryMsg
from nav_msgs.msg import Path
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Bool, String

from hitchhike_ros.control.local_planner import LocalPlanner
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.teleop_authority import TeleopAuthority, TeleopAuthorityParameters
from hitchhike_ros.control.wall_alignment import WallAlignmentParameters, in_line
from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D, PoseEstimate, Positive, Side, Twist2D
from hitchhike_ros.core.errors import PlanningError, SensorDataError, TeleopError
from hitchhike_ros.core.geometry import compose, distance, pose_from_matrix, wrap_angle
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import RobotLimits, mount
from hitchhike_ros.protocol.events import NavigationReport
from hitchhike_ros.protocol.status import GoalCommand, Status
from hitchhike_ros.ros_io.conversions import (
    LaserScanArrayMsg,
    estimate_from_msg,
    odometry_from_msg,
    path_from_msg,
    pose_from_msg,
    scan_from_msg,
    twist_from_msg,
    twist_to_msg,
)
from hitchhike_ros.ros_io.node import ERROR, OK, WARN, Diagnostics, LockstepAnswer, StatusListener, Switch, run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer

# A plan whose last pose is farther than this from the goal, in m and rad, is to another one.
_SAME_PLACE_M, _SAME_HEADING_RAD = 0.2, 0.02
_STAMP_TOLERANCE_S = 1e-4
_WATCH_PERIOD_S = 0.05


@dataclass(frozen=True, eq=False)
class _Plan:
    """A path (N, 2) in ``map`` and the pose at its end."""

    points: FloatArray
    end: Pose2D

    def leads_to(self, goal: GoalCommand) -> bool:
        turned = abs(wrap_angle(self.end.theta - goal.theta))
        return distance(self.end, goal.pose) <= _SAME_PLACE_M and turned <= _SAME_HEADING_RAD


class ObstacleAvoidanceNode:
    """Callbacks store under one lock; a scan, or its absence, leads to a decision."""

    def __init__(self) -> None:
        self._params = node_parameters(LocalPlannerParameters, "obstacle_avoidance")
        self._wall_params = node_parameters(WallAlignmentParameters, "wall_alignment")
        self._limits = node_parameters(RobotLimits, "robot")
        self._teleop_authority = TeleopAuthority(node_parameters(TeleopAuthorityParameters, "teleop_authority"))
        self._T_base_laser = pose_from_matrix(mount(path_parameter("urdf"), "laser"))
        self._pose_wait_s = convert(
            rospy.get_param("~pose_wait_s", 0.4 if rospy.get_param("/lockstep", False) else 0.1),
            Positive,
            rospy.get_name(),
            "~pose_wait_s",
        )
        self._local_planner = LocalPlanner(self._limits, self._params)
        self._changed = threading.Condition()  # guards everything below
        self._status: Status | None = None
        self._timer: Timer | None = None
        self._report = NavigationReport("", "idle")
        self._forget()

        self._diagnostics = Diagnostics("obstacle_avoidance")
        self._diagnostics.set(OK, "off")
        self._commands = rospy.Publisher("cmd_vel/navigation", Twist, queue_size=1, tcp_nodelay=True)
        self._reports = rospy.Publisher("navigation/status", String, queue_size=10, latch=True, tcp_nodelay=True)
        self._answer = LockstepAnswer("obstacle_avoidance")
        self._publish_report(self._report)
        self._switch = Switch(
            [
                ("plan", Path, self._on_plan),
                ("amcl_pose", PoseWithCovarianceStamped, self._on_estimate),
                ("odom", OdometryMsg, self._on_odometry),
                ("scan", LaserScanArrayMsg, self._on_scan),
                ("cmd_vel/teleop", Twist, self._on_teleop),
                ("teleop/active", Bool, self._on_active),
            ]
        )
        self._listener = StatusListener(self._on_status, self._diagnostics)

    @property
    def _goal(self) -> GoalCommand | None:
        return self._status.goal if self._status is not None and self._status.modules.OBS else None

    def _forget(self) -> None:
        """What was seen before the module was off says nothing about now."""
        self._plan: _Plan | None = None
        self._followed: tuple[str, _Plan] | None = None
        self._turns_for = ""  # the order for which it turns along a wall
        self._estimate: PoseEstimate | None = None
        self._odometry = PoseBuffer()
        self._odometry_problem = ""
        self._decided_at = rospy.get_time()

    # Switching.

    def _on_status(self, status: Status) -> None:
        with self._changed:
            before, self._status = self._goal, status
            self._teleop_authority.hear_status()
            goal = self._goal
            if self._switch.set(status.modules.OBS):
                if status.modules.OBS:
                    self._timer = Timer(_WATCH_PERIOD_S, self._watch)
                elif self._timer is not None:
                    self._timer.shutdown()
                    self._timer = None
                self._forget()
            if goal is None:
                self._local_planner.clear()
                self._followed, self._turns_for = None, ""
                if before is not None:
                    self._commands.publish(twist_to_msg(Twist2D()))
                self._tell(NavigationReport("", "idle"), OK if status.modules.OBS else None)
            elif before is None or before.id != goal.id:
                self._decided_at = rospy.get_time()
            self._changed.notify_all()

    # Sensors.

    def _on_plan(self, msg: Path) -> None:
        with self._changed:
            self._plan = _Plan(path_from_msg(msg), pose_from_msg(msg.poses[-1].pose)) if msg.poses else None

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        with self._changed:
            self._estimate = estimate_from_msg(msg)
            self._changed.notify_all()

    def _on_odometry(self, msg: OdometryMsg) -> None:
        with self._changed:
            try:
                self._odometry.add(odometry_from_msg(msg))
                self._odometry_problem = ""
            except SensorDataError as exc:
                self._odometry.clear()
                self._odometry_problem = str(exc)
                self._diagnostics.count("bad_odometry")
                self._stand(str(exc))

    def _on_teleop(self, msg: Twist) -> None:
        with self._changed:
            if not self._teleop_authority.command(twist_from_msg(msg), rospy.get_time()):
                self._diagnostics.count("bad_teleop")
                rospy.logwarn_throttle(10.0, "cmd_vel/teleop is not finite: refused")

    def _on_active(self, msg: Bool) -> None:
        with self._changed:
            self._teleop_authority.take(msg.data, rospy.get_time())

    def _on_scan(self, msg: LaserScanMsg) -> None:
        stamp = msg.header.stamp.to_sec()
        with self._changed:
            self._decided_at = rospy.get_time()
            if self._goal is not None:
                self._work(msg, stamp)
        self._answer(stamp)

    def _work(self, msg: LaserScanMsg, stamp: float) -> None:
        try:
            scan = scan_from_msg(msg)
        except SensorDataError as exc:
            self._diagnostics.count("bad_scans")
            self._stand(str(exc))
            return
        self._changed.wait_for(lambda: self._goal is None or self._located(stamp), self._pose_wait_s)
        self._decide(scan)

    def _located(self, stamp: float) -> bool:
        return self._estimate is not None and self._estimate.stamp >= stamp - _STAMP_TOLERANCE_S

    def _watch(self) -> None:
        """Scans that stay away must not leave the robot driving."""
        with self._changed:
            silent = rospy.get_time() - self._decided_at
            if silent < 0.0:
                self._decided_at = rospy.get_time()  # time jumped back
            elif silent > self._params.max_age_s:
                self._stand(f"no scan for {self._params.max_age_s} s")

    # The one place that steps the controller.

    def _decide(self, scan: LaserScan) -> None:
        goal, status = self._goal, self._status
        self._decided_at = rospy.get_time()
        if goal is None or status is None:
            return
        if self._arrived(goal):
            self._act(goal, self._report, Twist2D(), OK)
            return
        try:
            pose = self._pose_at(scan.stamp)
            followed = self._line_up(goal, goal.along_wall, pose, scan) if goal.along_wall else self._follow(goal)
        except (SensorDataError, PlanningError) as exc:
            self._stand(str(exc))
            return
        if not followed:
            self._act(goal, NavigationReport(goal.id, "idle", "no plan to the goal"), Twist2D(), WARN)
            return
        limit = self._limits.max_speed_mps if status.speed_limit_mps is None else status.speed_limit_mps
        others = [(Pose2D(r.x, r.y), r.radius_m) for r in status.robots]
        gentle = status.carries_rider
        try:
            hand = (
                self._teleop_authority.wanted(pose, gentle, self._decided_at)
                if status.teleop_mode == "guided"
                else None
            )
        except TeleopError as exc:
            self._stand(str(exc))
            return
        decision = self._local_planner.step(
            self._decided_at, pose, self._odometry.newest.twist, scan, self._T_base_laser, limit, gentle, others, hand
        )
        level = ERROR if decision.state == "blocked" else OK
        self._act(goal, NavigationReport(goal.id, decision.state, decision.reason), decision.twist, level)

    def _follow(self, goal: GoalCommand) -> bool:
        """Take a new plan to the goal; whether there is one.

        Raises:
            PlanningError: the plan cannot be used.
        """
        plan = self._plan
        if plan is None or not plan.leads_to(goal):
            self._local_planner.clear()
            self._followed = None
            return False
        if self._followed != (goal.id, plan):
            self._local_planner.set_path(plan.points, goal.pose, goal.tolerance_m, goal.tolerance_rad)
            self._followed = (goal.id, plan)
        return True

    def _line_up(self, goal: GoalCommand, side: Side, pose: Pose2D, scan: LaserScan) -> bool:
        """Take up the order to turn parallel to a wall, by the wall in the first scan after it.

        Raises:
            PlanningError: there is no such wall.
        """
        if self._turns_for != goal.id:
            line = in_line(pose, goal.theta, side, scan, self._T_base_laser, self._wall_params)
            self._local_planner.set_path(np.array([(line.x, line.y)]), line, goal.tolerance_m, goal.tolerance_rad)
            self._turns_for = goal.id
        return True

    def _pose_at(self, stamp: float) -> Pose2D:
        """The pose in ``map`` at a scan's stamp.

        Raises:
            SensorDataError: pose or odometry is missing, old or senseless.
        """
        estimate, max_age_s = self._estimate, self._params.max_age_s
        if self._odometry_problem:
            raise SensorDataError(self._odometry_problem)
        if not self._odometry:
            raise SensorDataError("no odometry")
        if not abs(stamp - self._odometry.newest.stamp) <= max_age_s:
            raise SensorDataError(f"odometry is more than {max_age_s} s off the scan")
        if estimate is None:
            raise SensorDataError("no pose")
        if not estimate.pose.is_finite():
            raise SensorDataError("pose is not finite")
        if not abs(stamp - estimate.stamp) <= max_age_s:
            raise SensorDataError(f"pose is more than {max_age_s} s off the scan")
        if abs(stamp - estimate.stamp) <= _STAMP_TOLERANCE_S:
            return estimate.pose
        return compose(estimate.pose, self._odometry.motion(estimate.stamp, stamp, "pose or scan"))

    # Output.

    def _stand(self, reason: str) -> None:
        """Stand where there is a goal to drive to, because of something that is not as it should be."""
        goal = self._goal
        if goal is not None and not self._arrived(goal):
            self._act(goal, NavigationReport(goal.id, "blocked", reason), Twist2D(), ERROR)

    def _arrived(self, goal: GoalCommand) -> bool:
        return (self._report.goal_id, self._report.state) == (goal.id, "arrived")

    def _act(self, goal: GoalCommand, report: NavigationReport, twist: Twist2D, level: int) -> None:
        self._commands.publish(twist_to_msg(twist))
        self._tell(report, level)

    def _tell(self, report: NavigationReport, level: int | None) -> None:
        """Publish what is new; level None: the module is off."""
        if level is None:
            self._diagnostics.set(OK, "off")
        else:
            self._diagnostics.set(level, f"{report.state}: {report.reason}" if report.reason else report.state)
        if report != self._report:
            self._report = report
            self._publish_report(report)

    def _publish_report(self, report: NavigationReport) -> None:
        self._reports.publish(String(msgspec.json.encode(report).decode()))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros obstacle_avoidance``."""
    run("obstacle_avoidance", ObstacleAvoidanceNode, dozes=True)
