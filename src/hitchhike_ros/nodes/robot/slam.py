"""slam: localizes the robot in its map (module LZN) and keeps that map up to date (module MAP), each switched alone.

Subscribed:
    hhike_msg/status (std_msgs/String): which modules are on, and where other robots say that they are
    initialpose (geometry_msgs/PoseWithCovarianceStamped): where the robot is
    hhike_msg/new_obstacles (std_msgs/String): boxes that a driver handed over
    odom (nav_msgs/Odometry), scan (sensor_msgs/LaserScan), visual_servoing/observations (std_msgs/String): markers that
        the camera sees; only while the module LZN is on
Published:
    amcl_pose (geometry_msgs/PoseWithCovarianceStamped): for each scan, with its stamp; none while it is not known. Of a
        robot that stands, has no goal and knows its pose, once in ~rest_pose_period_s
    particlecloud (geometry_msgs/PoseArray): for each pose, with the method ``particle`` and a subscriber
    map (nav_msgs/OccupancyGrid, latched), map_metadata (nav_msgs/MapMetaData, latched): the robot's own copy with the
        new boxes, when they have changed
    new_obstacles (std_msgs/String, latched): JSON ``{"obstacles": [{"id", "x", "y", "w", "b"}]}``
    lockstep/answer (std_msgs/Header): the stamp of each scan that has been taken, when /lockstep is true
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Services:
    global_localization (std_srvs/Empty): the robot may be anywhere; only with the method ``particle``
Services used:
    static_map (nav_msgs/GetMap): the map to start from
Parameters:
    ~config (path), sections ``slam`` (modules.slam.SlamParameters), ``localization``
        (localization.localizer.LocalizerParameters) and ``mapping`` (mapping.new_obstacles.MappingParameters); a
        private parameter with the name of one of theirs replaces it
    ~method (``ekf`` or ``particle``, ekf): how to localize
    ~urdf (path): mount of the laser
    ~world (path): markers at known places
    ~initial_pose_x, ~initial_pose_y (m), ~initial_pose_a (rad): start, all three or none
    ~initial_cov_xx, ~initial_cov_yy (m², 0.25), ~initial_cov_aa (rad², 0.0685): its covariance, as of amcl
    ~always_on (bool, false): both modules on without anyone's status
    ~map_timeout_s (s of wall time, 60): how long static_map is awaited
TF: map -> odom, for each scan, valid for ~transform_tolerance_s (s, 0.1) after it as of amcl. While localization is off
    the last one is repeated, valid until it is repeated again: who looks on sees the robot go on by its wheels.
"""

from __future__ import annotations

import math
from typing import cast, get_args

import numpy as np
import rospy
from std_srvs.srv import Empty, EmptyRequest, EmptyResponse

from hitchhike_ros.core.datatypes import Coordinate, Pose2D, PoseEstimate, Variance
from hitchhike_ros.core.errors import HitchhikeError, ParameterError
from hitchhike_ros.localization.methods import Method
from hitchhike_ros.modules.inputs import InitialPose
from hitchhike_ros.modules.slam import Slam
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets
from hitchhike_ros.ros_io.parameters import given, is_given, parameter


def build() -> ModuleHost:
    """The node's host."""
    slam = Slam.build(NodeFiles(), method=localization_method(), alone=parameter("always_on", bool, False))
    start_from_parameters(slam)
    host = ModuleHost(Single(slam), {slam.name: outlets(slam.name)})
    serve_global_localization(host, slam)
    return host


def localization_method() -> Method:
    """Of parameter ``method``.

    Raises:
        ParameterError: it is none.
    """
    method = given("method", "ekf")
    if method not in get_args(Method):
        raise ParameterError(rospy.get_name(), "~method", method, f"one of {', '.join(get_args(Method))}")
    return cast(Method, method)


def start_from_parameters(slam: Slam) -> None:
    """Tell the module where the robot is, if the parameters do.

    Raises:
        ParameterError: they are of no use.
    """
    start = _initial_pose()
    if start is not None:
        slam.sense(InitialPose(start), rospy.get_time())


def serve_global_localization(host: ModuleHost, slam: Slam) -> None:
    """Offer the service of amcl, if the module can look for the robot anywhere."""

    def globalize(_request: EmptyRequest) -> EmptyResponse:
        try:
            host.call(slam.globalize)
        except HitchhikeError as exc:
            raise rospy.ServiceException(str(exc)) from exc
        return EmptyResponse()

    if slam.can_globalize:
        rospy.Service("global_localization", Empty, globalize)


def _initial_pose() -> PoseEstimate | None:
    """The start of the parameters, as amcl reads it; None where they name none.

    Raises:
        ParameterError: one of them is no number, or only some of the three are given.
    """
    names = ("initial_pose_x", "initial_pose_y", "initial_pose_a")
    named = [name for name in names if is_given(name)]
    if not named:
        return None
    if len(named) < len(names):
        missing = next(name for name in names if name not in named)
        raise ParameterError(rospy.get_name(), f"~{missing}", None, "a number, as the other two are given")
    x, y, a = (parameter(name, Coordinate, None) for name in names)
    defaults = {"xx": 0.25, "yy": 0.25, "aa": (math.pi / 12.0) ** 2}
    variances = [parameter(f"initial_cov_{k}", Variance, v) for k, v in defaults.items()]
    return PoseEstimate(rospy.get_time(), Pose2D(x, y, a), np.diag(variances))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros slam``."""
    run("slam", build)
