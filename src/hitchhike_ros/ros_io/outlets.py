"""The outputs of each module: for each one row with its topic, its message type and its conversion.

Topics are relative to the robot's namespace; ``~name`` is the topic that the node's private parameter ``name`` names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec
import rospy
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseArray,
    PoseStamped,
    PoseWithCovarianceStamped,
    Transform,
    TransformStamped,
    Twist,
    Vector3,
)
from nav_msgs.msg import MapMetaData, Path
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Int8, String, UInt8MultiArray
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.octree import read_voxels
from hitchhike_ros.modules.inputs import (
    FoundObstacles,
    HandedOverObstacles,
    InitialPose,
    PlannedPath,
)
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.map_transfer import Transfer
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import encode_observations
from hitchhike_ros.protocol.status import encode_status
from hitchhike_ros.ros_io.conversions import (
    estimate_to_msg,
    grid_to_msg,
    header,
    map_info,
    path_to_msg,
    pose_to_msg,
    quaternion_from_rotation,
    quaternion_from_yaw,
    twist_to_msg,
)
from hitchhike_ros.ros_io.images import image_to_msg
from hitchhike_ros.ros_io.markers import voxel_markers
from hitchhike_ros.ros_io.parameters import frame

if TYPE_CHECKING:  # a node imports its own module and no other
    from hitchhike_ros.modules.slam import SlamOutputs
    from hitchhike_ros.modules.visual_servoing import Look, View


@dataclass(frozen=True, eq=False)
class Outlet:
    """``convert`` turns a field of the outputs (``""``: all of them) into messages.

    A new subscriber of a topic that is latched or ``on_demand`` gets the last output. On demand it is converted for
    that subscriber, so that it costs nothing while nobody subscribes.
    """

    field: str
    topic: str
    cls: Any
    convert: Callable[[Any], Iterable[Any]]
    latch: bool = False
    queue_size: int = 1
    on_demand: bool = False


def _json(value: object) -> Iterable[String]:
    yield String(msgspec.json.encode(value, enc_hook=float).decode())


def _twists(twist: Twist2D) -> Iterable[Twist]:
    yield twist_to_msg(twist)


def _texts(texts: Iterable[str]) -> Iterable[String]:
    return map(String, texts)


def _boxes(boxes: FoundObstacles | HandedOverObstacles) -> Iterable[String]:
    return _json(NewObstacles(obstacles=boxes.obstacles))


def _awards(awards: Iterable[Award]) -> Iterable[String]:
    return (text for award in awards for text in _json(award))


def _initial_pose(start: InitialPose) -> Iterable[PoseWithCovarianceStamped]:
    yield estimate_to_msg(start.estimate)


def _transfers(transfers: Iterable[Transfer]) -> Iterable[String]:
    return (text for transfer in transfers for text in _json(transfer))


def _voxels(view: Callable[[], bytes]) -> Iterable[MarkerArray]:
    yield voxel_markers(read_voxels(view()), rospy.get_time())


def path_of(path: PlannedPath) -> Path:
    """A path as a message in ``map``, stamped now; it has no poses where there is no path."""
    now = rospy.get_time()
    return Path(header=header(now, "map")) if path.end is None else path_to_msg(path.points, path.end, now)


def _states(view: View) -> Iterable[Int8]:
    yield Int8(int(view))


def _codes(look: Look) -> Iterable[String]:
    return () if look.target is None else _texts([look.target.code.message])


def _marker_poses(look: Look, camera_frame: str) -> Iterable[PoseWithCovarianceStamped]:
    if look.target is None:
        return
    T = look.target.T_camera_marker
    msg = PoseWithCovarianceStamped(header=header(look.image.stamp, look.image.frame_id or camera_frame))
    msg.pose.pose = Pose(Point(*T[:3, 3].tolist()), quaternion_from_rotation(T[:3, :3]))
    msg.pose.covariance = look.target.covariance.ravel().tolist()
    yield msg


def _annotated(look: Look) -> Iterable[Image]:
    from hitchhike_ros.servoing.annotation import annotated  # noqa: PLC0415  (loads ViSP)

    picture = annotated(look.image.rgb(), look.target, look.markers, carried=look.carried)
    yield image_to_msg(picture, look.image.stamp, look.image.frame_id, "rgb8")


def visual_servoing_outlets(camera_frame: str) -> tuple[Outlet, ...]:
    """The outputs of visual_servoing; ``camera_frame`` is the frame of images that name none."""

    def poses(look: Look) -> Iterable[PoseStamped]:
        return (PoseStamped(msg.header, msg.pose.pose) for msg in _marker_poses(look, camera_frame))

    own = "visual_servoing/"
    return (
        Outlet("command", "cmd_vel/servoing", Twist, lambda command: _twists(command.twist)),
        Outlet("observations", own + "observations", String, lambda said: _texts([encode_observations(said)])),
        Outlet("look", own + "object_position", PoseStamped, poses),
        Outlet(
            "look",
            own + "object_position_covariance",
            PoseWithCovarianceStamped,
            lambda look: _marker_poses(look, camera_frame),
        ),
        Outlet("view", own + "status", Int8, _states),
        Outlet("look", own + "code_message", String, _codes),
        Outlet("look", own + "image_annotated", Image, _annotated),
    )


def _grids(grid: OccupancyGrid) -> Iterable[OccupancyGridMsg]:
    yield grid_to_msg(grid, rospy.get_time())


def _metadata(grid: OccupancyGrid) -> Iterable[MapMetaData]:
    yield map_info(grid, rospy.get_time())


def _clouds(outputs: SlamOutputs) -> Iterable[PoseArray]:
    if outputs.particles is not None and outputs.pose is not None:
        poses = [pose_to_msg(Pose2D(x, y, theta)) for x, y, theta in outputs.particles.tolist()]
        yield PoseArray(header(outputs.pose.stamp, "map"), poses)


def slam_outlets(odom_frame: str) -> tuple[Outlet, ...]:
    """The outputs of slam; ``odom_frame`` is the robot's frame ``odom`` where its odometry names none."""

    def transforms(outputs: SlamOutputs) -> Iterable[TFMessage]:
        if outputs.T_map_odom is not None:
            stamp, pose = outputs.T_map_odom
            transform = Transform(Vector3(pose.x, pose.y, 0.0), quaternion_from_yaw(pose.theta))
            child = outputs.odom_frame or odom_frame
            yield TFMessage([TransformStamped(header(stamp, "map"), child, transform)])

    return (
        Outlet("", "/tf", TFMessage, transforms, queue_size=100),
        Outlet("pose", "amcl_pose", PoseWithCovarianceStamped, lambda estimate: (estimate_to_msg(estimate),)),
        Outlet("", "particlecloud", PoseArray, _clouds),
        Outlet("boxes", "new_obstacles", String, _boxes, latch=True),
        Outlet("grid", "map", OccupancyGridMsg, _grids, latch=True),
        Outlet("grid", "map_metadata", MapMetaData, _metadata, latch=True),
    )


VELOCITY_MUX = (Outlet("twist", "cmd_vel", Twist, _twists),)
HITCHHIKE_COMM = (
    Outlet("messages", "~network_out", String, _texts, queue_size=50),
    Outlet("initial_pose", "initialpose", PoseWithCovarianceStamped, _initial_pose, queue_size=10),
    Outlet("handed_over", "hhike_msg/new_obstacles", String, _boxes, queue_size=10),
    Outlet("awards", "hhike_msg/award", String, _awards, latch=True, queue_size=10),
    Outlet("status", "hhike_msg/status", String, lambda status: _texts([encode_status(status)]), True, 10),
)
PATH_PLANNING = (
    Outlet("report", "path_planning/status", String, _json, latch=True, queue_size=10),  # before what it tells of
    Outlet("plan", "plan", Path, lambda plan: (path_of(plan),), latch=True),
)
OBSTACLE_AVOIDANCE = (
    Outlet("command", "cmd_vel/navigation", Twist, lambda command: _twists(command.twist)),
    Outlet("report", "navigation/status", String, _json, latch=True, queue_size=10),
)
TELEOP = (
    Outlet("command", "cmd_vel/teleop", Twist, lambda command: _twists(command.twist), queue_size=10),
    Outlet("active", "teleop/active", Bool, lambda said: (Bool(said.active),), queue_size=10),
)
MAPPING_3D = (
    Outlet("messages", "~network_out", String, _texts, queue_size=200),
    Outlet("file", "octomap_binary", UInt8MultiArray, lambda file: (UInt8MultiArray(data=file),), latch=True),
    Outlet("view", "occupied_cells_vis_array", MarkerArray, _voxels, on_demand=True),
    Outlet("transfers", "map_3d/transfer", String, _transfers, latch=True, queue_size=10),
)


def outlets(name: str) -> tuple[Outlet, ...]:
    """The outputs of the module ``name``; frames have the prefix that the node's parameters say."""
    match name:
        case "slam":
            return slam_outlets(frame("odom"))
        case "visual_servoing":
            return visual_servoing_outlets(frame("camera_optical"))
    return _OF_MODULE[name]


_OF_MODULE = {
    "path_planning": PATH_PLANNING,
    "obstacle_avoidance": OBSTACLE_AVOIDANCE,
    "hitchhike_comm": HITCHHIKE_COMM,
    "velocity_mux": VELOCITY_MUX,
    "mapping_3d": MAPPING_3D,
    "teleop": TELEOP,
}
