"""The inputs of the modules: for each one row with its topic, its message type and its conversion.

Topics are relative to the robot's namespace; ``~name`` is the topic that the node's private parameter ``name`` names.
An input has one row, whichever modules take it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import rospy
from geometry_msgs.msg import (
    PoseWithCovarianceStamped,
    Twist,
)
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from nav_msgs.msg import Odometry as OdometryMsg
from nav_msgs.msg import Path
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import CompressedImage, Image, Joy
from std_msgs.msg import Bool, String

from hitchhike_ros.core.datatypes import CameraInfo, LaserScan, Odometry, PoseEstimate
from hitchhike_ros.core.errors import MessageError, ParameterError, SensorDataError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.modules.inputs import (
    CameraImage,
    DepthCameraInfo,
    DepthImage,
    FoundObstacles,
    HandedOverObstacles,
    InitialPose,
    Joystick,
    NavigationCommand,
    NetworkText,
    PlannedPath,
    PlanReport,
    ServoingCommand,
    TeleopActive,
    TeleopCommand,
)
from hitchhike_ros.protocol.events import NavigationReport
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import Observations, decode_observations
from hitchhike_ros.protocol.status import Status, decode_status
from hitchhike_ros.ros_io.conversions import (
    LaserScanArrayMsg,
    estimate_from_msg,
    grid_from_msg,
    odometry_from_msg,
    path_from_msg,
    pose_from_msg,
    scan_from_msg,
    twist_from_msg,
)
from hitchhike_ros.ros_io.images import (
    camera_info_from_msg,
    depth_from_msg,
    gray_from_compressed,
    gray_from_msg,
    rgb_from_compressed,
    rgb_from_msg,
)
from hitchhike_ros.ros_io.parameters import given


@dataclass(frozen=True, eq=False)
class Inlet:
    """``convert`` turns a message into an input of the type ``what``, or raises SensorDataError or MessageError."""

    what: type
    topic: str
    cls: Any
    convert: Callable[[Any], object]
    queue_size: int = 1


def _twist_of(command: type) -> Callable[[Twist], object]:
    return lambda msg: command(twist_from_msg(msg))


def _json_of(cls: type, topic: str) -> Callable[[String], Any]:
    # Made once, as msgspec crashes when two threads make the first decoder of a type.
    decoder: msgspec.json.Decoder[Any] = msgspec.json.Decoder(cls)

    def decode(msg: String) -> Any:
        try:
            return decoder.decode(msg.data)
        except msgspec.MsgspecError as exc:
            raise MessageError(f"{topic}: {exc}") from exc

    return decode


def _estimate(msg: PoseWithCovarianceStamped) -> PoseEstimate:
    estimate = estimate_from_msg(msg)
    if not estimate.pose.is_finite():
        raise SensorDataError(f"pose at {estimate.stamp:.2f} s is not finite")
    return estimate


def _planned_path(msg: Path) -> PlannedPath:
    return PlannedPath(path_from_msg(msg), pose_from_msg(msg.poses[-1].pose) if msg.poses else None)


def _start(msg: PoseWithCovarianceStamped) -> InitialPose:
    if msg.header.frame_id.strip("/") not in ("map", ""):
        raise MessageError(f"frame {msg.header.frame_id!r}, expected 'map'")
    return InitialPose(estimate_from_msg(msg))


def _handed_over(msg: String) -> HandedOverObstacles:
    return HandedOverObstacles(_decode_boxes(msg).obstacles)


_decode_boxes = _json_of(NewObstacles, "new_obstacles")


# Distortion models that OpenCV's coefficients describe; a camera without distortion may name none.
_LENSES = ("plumb_bob", "rational_polynomial", "")


def _camera_info(msg: CameraInfoMsg) -> CameraInfo:
    if msg.distortion_model not in _LENSES:
        raise SensorDataError(f"distortion model {msg.distortion_model!r} in it, expected one of {_LENSES}")
    return camera_info_from_msg(msg)


def _camera_image(msg: Image) -> CameraImage:
    return CameraImage(
        msg.header.stamp.to_sec(), partial(gray_from_msg, msg), partial(rgb_from_msg, msg), msg.header.frame_id
    )


def _compressed_image(msg: CompressedImage) -> CameraImage:
    return CameraImage(
        msg.header.stamp.to_sec(),
        partial(gray_from_compressed, msg),
        partial(rgb_from_compressed, msg),
        msg.header.frame_id,
    )


def _depth_image(msg: Image) -> DepthImage:
    return DepthImage(msg.header.stamp.to_sec(), partial(depth_from_msg, msg))


def _heard(msg: String) -> NetworkText:
    connection = getattr(msg, "_connection_header", None) or {}
    return NetworkText(msg.data, str(connection.get("callerid", "?")))


INLETS: dict[type, Inlet] = {
    inlet.what: inlet
    for inlet in (
        Inlet(Status, "hhike_msg/status", String, lambda msg: decode_status(msg.data), queue_size=10),
        # Sensors. The queue of odometry is long, as filters integrate every reading.
        Inlet(Odometry, "odom", OdometryMsg, odometry_from_msg, queue_size=50),
        Inlet(LaserScan, "scan", LaserScanArrayMsg, scan_from_msg),
        Inlet(CameraImage, "camera/image_raw", Image, _camera_image),
        Inlet(CameraInfo, "camera/camera_info", CameraInfoMsg, _camera_info),
        Inlet(DepthImage, "camera/depth/image_raw", Image, _depth_image),
        Inlet(
            DepthCameraInfo,
            "camera/depth/camera_info",
            CameraInfoMsg,
            lambda msg: DepthCameraInfo(camera_info_from_msg(msg)),
        ),
        # From module to module.
        Inlet(PoseEstimate, "amcl_pose", PoseWithCovarianceStamped, _estimate),
        Inlet(OccupancyGrid, "map", OccupancyGridMsg, grid_from_msg),
        Inlet(PlannedPath, "plan", Path, _planned_path),
        Inlet(FoundObstacles, "new_obstacles", String, lambda msg: FoundObstacles(_decode_boxes(msg).obstacles)),
        Inlet(NavigationReport, "navigation/status", String, _json_of(NavigationReport, "navigation/status"), 10),
        Inlet(PlanReport, "path_planning/status", String, _json_of(PlanReport, "path_planning/status"), 10),
        Inlet(Observations, "visual_servoing/observations", String, lambda msg: decode_observations(msg.data), 10),
        Inlet(TeleopActive, "teleop/active", Bool, lambda msg: TeleopActive(msg.data)),
        Inlet(TeleopCommand, "cmd_vel/teleop", Twist, _twist_of(TeleopCommand)),
        Inlet(ServoingCommand, "cmd_vel/servoing", Twist, _twist_of(ServoingCommand)),
        Inlet(NavigationCommand, "cmd_vel/navigation", Twist, _twist_of(NavigationCommand)),
        # From an operator, and from a driver by hitchhike_comm.
        Inlet(Joystick, "joy", Joy, lambda msg: Joystick(tuple(msg.axes), tuple(msg.buttons))),
        Inlet(InitialPose, "initialpose", PoseWithCovarianceStamped, _start),
        Inlet(HandedOverObstacles, "hhike_msg/new_obstacles", String, _handed_over, queue_size=10),
        # From robot to robot.
        Inlet(NetworkText, "~network_in", String, _heard, queue_size=200),
    )
}


def inlet_of(what: type) -> Inlet:
    """The row of an input; of images the one that ``~image_transport`` names, ``raw`` or ``compressed``.

    Raises:
        ParameterError: there is no such transport.
    """
    inlet = INLETS[what]
    if what is not CameraImage:
        return inlet
    transport = given("image_transport", "raw")
    if transport == "compressed":
        # As image_transport has it: the topic of the images is remapped, and its compressed one lies below it.
        topic = f"{rospy.resolve_name(inlet.topic)}/compressed"
        return Inlet(CameraImage, topic, CompressedImage, _compressed_image)
    if transport != "raw":
        raise ParameterError(rospy.get_name(), "~image_transport", transport, "raw or compressed")
    return inlet
