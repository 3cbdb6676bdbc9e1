"""path_planning: plans through the robot's own map to where hitchhike_comm wants the robot (module PP).

Plans anew for a new goal, on a changed map, while obstacle avoidance finds the way blocked, and after a failure.

Subscribed (the latter three only while the module is on):
    hhike_msg/status (std_msgs/String): whether the module is on, and the goal
    map (nav_msgs/OccupancyGrid), amcl_pose (geometry_msgs/PoseWithCovarianceStamped)
    navigation/status (std_msgs/String): whether the way is blocked
Published:
    plan (nav_msgs/Path, latched): in ``map``, from the robot to the goal with its heading; empty when there is none
    path_planning/status (std_msgs/String, latched): JSON ``{"goal_id", "state", "reason"}``, state one of idle,
        waiting (for map or pose), planned, failed; published before the plan that it tells of
    /diagnostics (diagnostic_msgs/DiagnosticArray): ERROR and the reason when there is no path
Services:
    make_plan (nav_msgs/GetPlan): as of move_base: an empty path when there is none; start without a frame means from
        the robot; a goal that is occupied is moved by up to ``tolerance``. Refused while the module is off.
Parameters:
    ~config (path), sections ``global_planner`` (planning.global_planner.GlobalPlannerParameters), ``path_planning``
        (planning.replanner.ReplannerParameters) and ``robot``
    ~always_on (bool, false): on without anyone's status, for make_plan alone
    ~rate (Hz, 10): how often what arrived is looked at
TF: none.
"""

from __future__ import annotations

import math
import threading

import msgspec
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan, GetPlanRequest, GetPlanResponse
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.errors import OutsideMapError, PlanningError
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.planning.replanner import Order, Plan, Replanner, ReplannerParameters
from hitchhike_ros.protocol.machine import NavigationReport
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.conversions import estimate_from_msg, grid_from_msg, path_to_msg, pose_from_msg
from hitchhike_ros.ros_io.node import ERROR, OK, WARN, Diagnostics, StatusListener, Switch, run
from hitchhike_ros.ros_io.parameters import node_parameters
from hitchhike_ros.ros_io.timer import Timer

_LEVEL = {"idle": OK, "waiting": WARN, "planned": OK, "failed": ERROR}


class PathPlanning:
    """Stores what arrives; one timer, alive while the module is on, steps the replanner and publishes."""

    def __init__(self) -> None:
        limits = node_parameters(RobotLimits, "robot")
        self._planner = GlobalPlanner(node_parameters(GlobalPlannerParameters, "global_planner"), limits)
        self._replanner_params = node_parameters(ReplannerParameters, "path_planning")
        self._period_s = 1.0 / float(rospy.get_param("~rate", 10.0))
        self._lock = threading.RLock()
        self._forget()
        self._plan = Plan()
        self._timer: Timer | None = None
        self._diagnostics = Diagnostics("path_planning")
        self._plans = rospy.Publisher("plan", Path, queue_size=1, latch=True, tcp_nodelay=True)
        self._states = rospy.Publisher("path_planning/status", String, queue_size=10, latch=True, tcp_nodelay=True)
        self._switch = Switch(
            [
                ("map", OccupancyGridMsg, self._on_map),
                ("amcl_pose", PoseWithCovarianceStamped, self._on_estimate),
                ("navigation/status", String, self._on_navigation),
            ]
        )
        self._publish(self._plan)
        self._service = rospy.Service("make_plan", GetPlan, self._on_make_plan)
        if rospy.get_param("~always_on", False):
            self._turn(True)
        else:
            self._diagnostics.set(OK, "off")
            self._listener = StatusListener(self._on_status, self._diagnostics)

    def _forget(self) -> None:
        """What was known before the module was off may have changed meanwhile."""
        self._replanner = Replanner(self._planner, self._replanner_params)
        self._order: Order | None = None
        self._grid: OccupancyGrid | None = None
        self._estimate: PoseEstimate | None = None
        self._report: NavigationReport | None = None

    def _turn(self, on: bool) -> None:
        with self._lock:
            if not self._switch.set(on):
                return
            if on:
                self._timer = Timer(self._period_s, self._step)
                return
            if self._timer is not None:
                self._timer.shutdown()
            self._forget()
            self._publish(Plan())
            self._diagnostics.set(OK, "off")

    # Callbacks store.

    def _on_status(self, status: Status) -> None:
        with self._lock:
            self._turn(status.modules.PP)
            goal = status.goal if status.modules.PP else None
            # A turn along a wall needs no path.
            self._order = None if goal is None or goal.along_wall else Order(goal.id, goal.pose)

    def _on_map(self, msg: OccupancyGridMsg) -> None:
        grid = grid_from_msg(msg)
        with self._lock:
            known = self._grid
            same = (
                known is not None
                and (known.resolution, known.origin) == (grid.resolution, grid.origin)
                and np.array_equal(known.data, grid.data)
            )
            if not same:
                self._grid = grid

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        estimate = estimate_from_msg(msg)
        if not estimate.pose.is_finite():
            self._diagnostics.count("bad_poses")
            return
        with self._lock:
            self._estimate = estimate

    def _on_navigation(self, msg: String) -> None:
        try:
            report = msgspec.json.decode(msg.data, type=NavigationReport)
        except msgspec.MsgspecError as exc:
            self._diagnostics.count("bad_navigation_status")
            rospy.logwarn_throttle(10.0, "navigation/status: %s", exc)
            return
        with self._lock:
            self._report = report

    # The one place that steps the replanner.

    def _step(self) -> None:
        with self._lock:
            order, grid, estimate, report = self._order, self._grid, self._estimate, self._report
            replanner = self._replanner
        blocked = report is not None and order is not None and (report.goal_id, report.state) == (order.id, "blocked")
        plan = replanner.step(rospy.Time.now().to_sec(), order, grid, estimate, blocked)
        with self._lock:
            if not self._switch.on:  # it was turned off during the search
                return
            if plan is not self._plan:
                self._publish(plan)
            length = {"length_m": round(path_length(plan.path), 2)} if plan.state == "planned" else {"length_m": ""}
            self._diagnostics.set(_LEVEL[plan.state], plan.reason or plan.state, **length)

    def _publish(self, plan: Plan) -> None:
        if plan.state == "failed" and plan.order is not None:
            rospy.logwarn("no path for goal %s: %s", plan.order.id, plan.reason)
        self._plan = plan
        goal_id = plan.order.id if plan.order is not None else ""
        report = {"goal_id": goal_id, "state": plan.state, "reason": plan.reason}
        self._states.publish(String(msgspec.json.encode(report).decode()))
        self._plans.publish(self._message(plan))

    @staticmethod
    def _message(plan: Plan) -> Path:
        now = rospy.Time.now()
        if plan.state != "planned" or plan.order is None:
            empty = Path()
            empty.header.stamp, empty.header.frame_id = now, "map"
            return empty
        return path_to_msg(plan.path, plan.order.goal, now.to_sec())

    # make_plan, which leaves the replanner alone.

    def _on_make_plan(self, request: GetPlanRequest) -> GetPlanResponse:
        with self._lock:
            on, grid, estimate = self._switch.on, self._grid, self._estimate
        if not on:
            raise rospy.ServiceException("path planning is off")
        if grid is None:
            raise rospy.ServiceException("no map received")
        try:
            if request.start.header.frame_id:
                start = self._pose("start", request.start)
            elif estimate is not None:
                start = estimate.pose
            else:
                raise rospy.ServiceException("start has no frame and the robot's pose is not known")
            goal = self._pose("goal", request.goal)
            if request.tolerance > 0.0 and math.isfinite(request.tolerance):
                goal = self._planner.relax(grid, goal, request.tolerance)
            plan = Plan("planned", Order("make_plan", goal), path=self._planner.plan(grid, start, goal))
        except PlanningError as exc:
            rospy.loginfo("make_plan: %s", exc)
            plan = Plan("failed", reason=str(exc))
        return GetPlanResponse(plan=self._message(plan))

    @staticmethod
    def _pose(name: str, msg: PoseStamped) -> Pose2D:
        if msg.header.frame_id.strip("/") not in ("map", ""):
            raise OutsideMapError(f"{name} is in frame {msg.header.frame_id!r}, expected 'map'")
        return pose_from_msg(msg.pose)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros path_planning``."""
    run("path_planning", PathPlanning, dozes=True)
