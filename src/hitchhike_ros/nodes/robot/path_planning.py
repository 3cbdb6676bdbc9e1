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
        (modules.path_planning.PathPlanningParameters) and ``robot``
    ~always_on (bool, false): on without anyone's status, for make_plan alone
TF: none.
"""

from __future__ import annotations

import math
from dataclasses import replace

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan, GetPlanRequest, GetPlanResponse

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import FrameError, OutsideMapError, PlanningError, StaleInputError
from hitchhike_ros.modules.inputs import NO_PATH, PlannedPath
from hitchhike_ros.modules.path_planning import PathPlanning
from hitchhike_ros.ros_io.frames import pose_in_map
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets, path_of
from hitchhike_ros.ros_io.parameters import parameter


def build() -> ModuleHost:
    """The node's host."""
    always_on = parameter("always_on", bool, False)
    module = PathPlanning.build(NodeFiles(), always_on=always_on)
    host = ModuleHost(Single(module), {module.name: outlets(module.name)}, orders=not always_on)
    serve_make_plan(host, module)
    return host


def serve_make_plan(host: ModuleHost, module: PathPlanning) -> rospy.Service:
    """Offer the service make_plan of the module, which ``host`` steps."""

    def make_plan(request: GetPlanRequest) -> GetPlanResponse:
        try:
            start = _place("start", request.start) if request.start.header.frame_id else None
            goal, now = _place("goal", request.goal), rospy.get_time()
            path = PlannedPath(host.call(lambda: module.make_plan(start, goal, request.tolerance, now)), goal)
        except StaleInputError as exc:
            raise rospy.ServiceException(str(exc)) from exc
        except PlanningError as exc:
            rospy.loginfo("make_plan: %s", exc)
            path = NO_PATH
        return GetPlanResponse(plan=path_of(path))

    return rospy.Service("make_plan", GetPlan, make_plan)


def _place(name: str, msg: PoseStamped) -> Pose2D:
    """In ``map``; a path does not depend on the headings of its ends, which may be left out."""
    try:
        pose = pose_in_map(msg)
    except FrameError as exc:
        raise OutsideMapError(f"{name} is in {exc}") from exc
    return pose if math.isfinite(pose.theta) else replace(pose, theta=0.0)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros path_planning``."""
    run("path_planning", build)
