"""hitchhike_comm: asks for rides, gives rides, and switches the other modules of its robot (P17 Fig. 8).

Subscribed (in the robot's namespace unless absolute):
    /hhike_msg/network (std_msgs/String), or ~network_in: JSON messages of all robots
    move_base_simple/goal (geometry_msgs/PoseStamped): where the robot is wanted, in ``map``; forwarded to the action
    amcl_pose (geometry_msgs/PoseWithCovarianceStamped), odom (nav_msgs/Odometry), map (nav_msgs/OccupancyGrid)
    new_obstacles (std_msgs/String): boxes that the own slam found
    path_planning/status, navigation/status (std_msgs/String): how the goal fares
    visual_servoing/observations (std_msgs/String)
Published:
    /hhike_msg/network (std_msgs/String), or ~network_out
    hhike_msg/status (std_msgs/String, latched, on change and at 1 Hz): which modules are on, where to
        drive, whom to follow
    hhike_msg/new_obstacles (std_msgs/String): boxes that a driver handed over
    hhike_msg/award (std_msgs/String, latched): the points of the newest ride that this robot drove
    initialpose (geometry_msgs/PoseWithCovarianceStamped): the pose taken over from a driver
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Action:
    move_base (move_base_msgs/MoveBaseAction): drives or rides to a pose in ``map``, with feedback at each new pose; a
        new goal preempts the one before, a cancel stops the robot, and an abort's text says why
Parameters:
    ~config (path), sections ``hitchhiking`` (protocol.parameters.HitchhikingParameters) and ``robot``
    ~urdf (path): mounts of camera and marker
    ~world (path): markers and hitchhiking points; what it says of this robot, and of all, comes before ~config
    ~robot_id (string, default: the namespace)
    ~network_in, ~network_out (string, /hhike_msg/network): topics where it hears the others and speaks to them
    ~awards (path, $ROS_HOME/hitchhike_awards.sqlite): ledger of what this robot earns by driving, which several robots
        may share; ROS_HOME is ~/.ros where it is not set; empty: none is kept
    and every field of HitchhikingParameters, e.g. ~profile (0-100), ~priority (0-20), ~max_wait_s
TF: none.
"""

from __future__ import annotations

import rospy

from hitchhike_ros.modules.hitchhike_comm import HitchhikeComm, HitchhikeCommOutputs
from hitchhike_ros.modules.module import Outputs
from hitchhike_ros.ros_io.awards import AwardKeeper
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.move_base import MoveBaseServer
from hitchhike_ros.ros_io.node import OK, WARN, Diagnostics, DiagnosticsUpdater, run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets


class Surroundings:
    """What hitchhike_comm has beside topics: the action server, the ledger of awards and the log."""

    def __init__(self, robot_id: str, updater: DiagnosticsUpdater) -> None:
        self._awards = AwardKeeper(robot_id)
        self._ledger = Diagnostics("award_ledger", updater)
        self._move_base: MoveBaseServer | None = None
        self._say()

    def serve(self, host: ModuleHost) -> None:
        """Take goals for the robot in ``host`` from now on."""
        self._move_base = MoveBaseServer(host.post, host.order)

    def take(self, _name: str, outputs: Outputs) -> None:
        """What came out of a step."""
        if not isinstance(outputs, HitchhikeCommOutputs):
            return
        for award in outputs.awards:
            self._awards.credit(award)
            rospy.loginfo("%.1f points for %.1f m with %s", award.points, award.ride_m, award.hitchhiker)
        self._awards.step()
        self._say()
        for text in outputs.reports:
            rospy.loginfo("%s", text)
        for text in outputs.warnings:
            rospy.logwarn("%s", text)
        if self._move_base is not None:
            self._move_base.tell(outputs)

    def _say(self) -> None:
        trouble = self._awards.trouble
        text = f"awards are not written down: {trouble}" if trouble else "writing"
        self._ledger.set(WARN if trouble else OK, text, awards_waiting=self._awards.waiting)


def build() -> ModuleHost:
    """The node's host."""
    module = HitchhikeComm.build(NodeFiles())
    updater = DiagnosticsUpdater()
    surroundings = Surroundings(module.robot_id, updater)
    said = {module.name: outlets(module.name)}
    host = ModuleHost(Single(module), said, orders=False, also=surroundings.take, updater=updater)
    surroundings.serve(host)
    return host


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros hitchhike_comm``."""
    run("hitchhike_comm", build)
