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
    ~config (path), sections ``obstacle_avoidance`` (modules.obstacle_avoidance.ObstacleAvoidanceParameters),
        ``wall_alignment`` (control.wall_alignment.WallAlignmentParameters), ``teleop_authority``
        (control.teleop_authority.TeleopAuthorityParameters: how old a human's word may be) and ``robot``. A private
        parameter with the name of one of theirs replaces it, e.g. ~pose_wait_s (s, 0.1: how long the pose of a scan is
        awaited)
    ~urdf (path): mount of the laser
TF: none.
"""

from __future__ import annotations

from hitchhike_ros.modules.obstacle_avoidance import ObstacleAvoidance
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets


def build() -> ModuleHost:
    """The node's host."""
    module = ObstacleAvoidance.build(NodeFiles())
    return ModuleHost(Single(module), {module.name: outlets(module.name)})


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros obstacle_avoidance``."""
    run("obstacle_avoidance", build)
