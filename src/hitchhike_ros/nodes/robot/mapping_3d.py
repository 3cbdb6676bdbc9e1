"""mapping_3d: the driver's OctoMap of a ride, and its way to the hitchhiker (P17 §7.4).

While the robot drives with a hitchhiker behind it, its depth camera fills an OctoMap. When the hitchhiker has left, it
asks for that map and gets it in checked pieces over the network, while both drive on. It arrives bit for bit, or not at
all. A robot without a depth camera only asks. Off, the node listens to hhike_msg/status and nothing else.

Subscribed:
    hhike_msg/status (std_msgs/String): whether the robot carries a rider, or rides
    camera/depth/image_raw (sensor_msgs/Image: 32FC1 in m or 16UC1 in mm, rectified), camera/depth/camera_info
        (sensor_msgs/CameraInfo), amcl_pose (geometry_msgs/PoseWithCovarianceStamped): only while it carries one
    /hhike_msg/network (std_msgs/String), or ~network_in: only from the end of a ride until it
        is known that the map has arrived, or that it does not
Published:
    /hhike_msg/network (std_msgs/String), or ~network_out: map_request, map_offer, map_piece, map_ack
    octomap_binary (std_msgs/UInt8MultiArray, latched): the newest map as a .bt file: of its own ride as a driver when
        that ends, or the one that has arrived
    occupied_cells_vis_array (visualization_msgs/MarkerArray): its occupied voxels, in map; for subscribers only
    map_3d/transfer (std_msgs/String, latched): JSON, protocol.map_transfer.Transfer, when it begins and how it ended
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Parameters:
    ~config (path), sections ``mapping_3d`` (Mapping3DParameters here), ``octree`` (mapping.octree.OctreeParameters)
        and ``map_transfer`` (protocol.map_transfer.TransferParameters)
    ~period_s (s, 1): between images that are taken into the map
    ~resolution_m (m, 0.05), ~max_range_m (m, 4), ~stride (pixels, 4): of the map and its images
    ~piece_bytes (4096), ~window (pieces, 16), ~retry_s (s, 1), ~patience_s (s, 60), ~largest_packed (bytes, 2^24),
        ~largest_map (bytes, 2^26): of the transfer
    ~urdf (path): where the depth camera is (link ``depth_camera_optical``), if there is one
    ~robot_id (string, default: the namespace)
    ~network_in, ~network_out (string, /hhike_msg/network): topics where it hears the others and speaks to them
TF: none; the camera is where amcl_pose and ~urdf say that it is.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import rospy
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Vector3
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import Image
from std_msgs.msg import ColorRGBA, String, UInt8MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, Odometry, Positive, Twist2D
from hitchhike_ros.core.errors import MapFileError, MessageError, SensorDataError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import fixed_transforms
from hitchhike_ros.mapping.octree import OccupancyOctree, OctreeParameters, Voxels, read_voxels
from hitchhike_ros.protocol.map_transfer import MapReceiver, MapSender, Transfer, TransferParameters
from hitchhike_ros.protocol.messages import MapMessage, decode, encode
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.conversions import (
    camera_info_from_msg,
    depth_from_msg,
    estimate_from_msg,
    header,
)
from hitchhike_ros.ros_io.node import ERROR, OK, WARN, Diagnostics, StatusListener, Switch, run
from hitchhike_ros.ros_io.parameters import given, network_topic, node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer

# The core is stepped so often while it maps or a map is under way (s).
_STEP_S = 0.1
# Without an image or a pose for so many periods, the diagnosis says so (chosen).
_SILENT_PERIODS = 3.0
# Colours of voxels from the floor to this height (m), and more of them in one marker are hard on a viewer (chosen).
_COLOUR_M = 2.0


@dataclass(frozen=True)
class Mapping3DParameters:
    """Section ``mapping_3d``."""

    period_s: Positive = 1.0


class Mapping3D:
    """Callbacks store under a lock; one timer, which runs only while there is something to do, does it."""

    def __init__(self) -> None:
        self._params = node_parameters(Mapping3DParameters, "mapping_3d")
        self._tree_params = node_parameters(OctreeParameters, "octree")
        self._transfer_params = node_parameters(TransferParameters, "map_transfer")
        self._robot_id = str(given("robot_id", rospy.get_namespace().strip("/")))
        # None without a depth camera.
        self._T_base_camera = fixed_transforms(path_parameter("urdf")).get("depth_camera_optical")
        self._outbox = Outbox(int(rospy.Time.now().to_sec() * 1000))
        self._lock = threading.RLock()
        self._diagnostics = Diagnostics("mapping_3d")

        self._status: Status | None = None
        self._carried: dict[str, str] = {}  # who rides, and the id of the ride where it is known
        self._tree: OccupancyOctree | None = None
        self._depth: Image | None = None
        self._info: CameraInfo | None = None
        self._poses = PoseBuffer()
        self._taken_at = self._began_at = -math.inf
        self._riding_with: tuple[str, str] | None = None  # driver and ride
        self._senders: dict[str, MapSender] = {}
        self._receiver: MapReceiver | None = None
        self._delivered: MapReceiver | None = None
        self._finished_at = -math.inf
        self._heard: list[MapMessage] = []
        self._announced: dict[str, Transfer] = {}
        self._newest: bytes | None = None
        self._timer: Timer | None = None

        self._network = rospy.Publisher(network_topic("network_out"), String, queue_size=200, tcp_nodelay=True)
        self._files = rospy.Publisher("octomap_binary", UInt8MultiArray, queue_size=1, latch=True)
        self._transfers = rospy.Publisher("map_3d/transfer", String, queue_size=10, latch=True)
        self._cells = rospy.Publisher(
            "occupied_cells_vis_array", MarkerArray, queue_size=1, subscriber_listener=_NewPeer(self._show_to)
        )
        self._camera = Switch(
            [
                ("camera/depth/image_raw", Image, self._on_depth),
                ("camera/depth/camera_info", CameraInfoMsg, self._on_info),
                ("amcl_pose", PoseWithCovarianceStamped, self._on_pose),
            ]
        )
        self._ear = Switch([(network_topic("network_in"), String, self._on_network)], queue_size=200)
        self._diagnostics.set(OK, "off")
        self._listener = StatusListener(self._on_status, self._diagnostics)

    # Callbacks store; the status switches.

    def _on_status(self, status: Status) -> None:
        with self._lock:
            self._status = status
            self._as_driver(status)
            self._as_hitchhiker(status)
            self._switch()

    def _as_driver(self, status: Status) -> None:
        if self._T_base_camera is None:
            return
        carries = status.carries_rider
        if carries and self._tree is None:
            self._tree, self._began_at = OccupancyOctree(self._tree_params), rospy.get_time()
            self._taken_at = -math.inf
        carried = {name: self._carried.get(name, "") for name in (status.convoy if carries else ())}
        if status.ride is not None and status.ride.hitchhiker in carried:
            carried[status.ride.hitchhiker] = status.ride.ride_id
        left = {name: ride_id for name, ride_id in self._carried.items() if name not in carried}
        self._carried = carried
        if left:
            self._make_ready(left)
        if not status.convoy:
            self._tree = None

    def _make_ready(self, riders: dict[str, str]) -> None:
        """Keep the map as it is now for those who have left."""
        if self._tree is None or not len(self._tree):
            return
        content, now = self._tree.file(), rospy.get_time()
        for name, ride_id in riders.items():
            self._senders[name] = MapSender(self._transfer_params, self._robot_id, name, ride_id, content, now)
        self._publish_map(content)

    def _as_hitchhiker(self, status: Status) -> None:
        if status.rides and status.ride is not None:
            self._riding_with = status.ride.driver, status.ride.ride_id
        elif self._riding_with is not None:
            driver, ride_id = self._riding_with
            self._riding_with = None
            self._receiver = MapReceiver(
                self._transfer_params, self._robot_id, driver, ride_id, rospy.get_time(), _problem
            )

    def _switch(self) -> None:
        """Sensors, network and timer are on while they are needed."""
        carries = self._tree is not None and self._status is not None and self._status.carries_rider
        if self._camera.set(carries):
            self._depth = None
            self._poses.clear()
        sharing = bool(self._senders) or self._receiver is not None
        self._ear.set(sharing)
        if (carries or sharing) == (self._timer is not None):
            return
        if self._timer is None:
            self._timer = Timer(_STEP_S, self._step)
        else:
            self._timer.shutdown()
            self._timer = None
            self._diagnostics.set(OK, "off")

    def _on_depth(self, msg: Image) -> None:
        with self._lock:
            # Kept until its pose has come; the next one that is due takes its place only then.
            if self._depth is None and msg.header.stamp.to_sec() - self._taken_at >= self._params.period_s:
                self._depth = msg

    def _on_info(self, msg: CameraInfoMsg) -> None:
        with self._lock:
            self._info = camera_info_from_msg(msg)

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        estimate = estimate_from_msg(msg)
        if estimate.pose.is_finite():
            with self._lock:
                try:
                    self._poses.add(Odometry(estimate.stamp, estimate.pose, Twist2D()))
                except SensorDataError:
                    self._diagnostics.count("pose_jumps")

    def _on_network(self, msg: String) -> None:
        if '"map_' not in msg.data:  # the machines' messages are many
            return
        try:
            message = decode(msg.data)
        except MessageError as exc:
            self._diagnostics.count("dropped")
            rospy.logwarn_throttle(10.0, "network message dropped: %s", exc)
            return
        if isinstance(message, MapMessage) and message.to == self._robot_id:
            with self._lock:
                self._heard.append(message)

    # The one place that maps and transfers.

    def _step(self) -> None:
        with self._lock:
            now = rospy.get_time()
            if self._camera.on:
                self._map(now)
            heard, self._heard = self._heard, []
            for side in (*self._senders.values(), self._receiver):
                if side is None:
                    continue
                for message in heard:
                    self._send(side.hear(message, now), now)
                self._send(side.step(now), now)
            self._finish(now)
            self._switch()

    def _map(self, now: float) -> None:
        """Take the image that waits, once the pose at its stamp is known."""
        period_s = self._params.period_s
        if now - max(self._taken_at, self._began_at) > _SILENT_PERIODS * period_s:
            what = "no depth image" if self._depth is None or self._info is None else "no pose at the image's stamp"
            self._diagnostics.set(ERROR, f"{what} for {now - max(self._taken_at, self._began_at):.1f} s")
        msg = self._depth
        if msg is None or self._info is None or self._tree is None or self._T_base_camera is None:
            return
        stamp = msg.header.stamp.to_sec()
        if not self._poses or self._poses.newest.stamp < stamp:
            if now - stamp > period_s:
                self._depth = None  # localization is behind; a newer image will do
            return
        self._depth = None
        if stamp < self._poses.oldest.stamp:
            return
        pose = self._poses.at(stamp)
        self._taken_at = stamp
        T_map_base = matrix_from_xyz_rpy((pose.x, pose.y, 0.0), (0.0, 0.0, pose.theta))
        try:
            points = self._tree.insert(depth_from_msg(msg), self._info, T_map_base @ self._T_base_camera)
        except SensorDataError as exc:
            self._diagnostics.count("bad_images")
            self._diagnostics.set(ERROR, str(exc))
            return
        images = self._diagnostics.count("images")
        self._diagnostics.set(OK if points else WARN, "mapping", points=points, nodes=len(self._tree))
        if self._cells.get_num_connections():
            self._show(self._tree.file())
        rospy.logdebug("image %d: %d points", images, points)

    def _send(self, messages: Iterable[MapMessage], now: float) -> None:
        for message in messages:
            self._network.publish(String(encode(self._outbox.stamp(message, now))))

    def _finish(self, now: float) -> None:
        """Announce what has begun or ended, and forget what is over."""
        receiver = self._receiver
        for side in (*self._senders.values(), *([] if receiver is None else [receiver])):
            self._announce(side.transfer)
        self._senders = {name: sender for name, sender in self._senders.items() if not sender.transfer.over}
        if receiver is None or not receiver.transfer.over:
            self._finished_at = now
        elif receiver is not self._delivered:
            self._delivered = receiver
            if receiver.content is not None:
                self._publish_map(receiver.content)
        # The driver may ask again how it went: it is answered for as long as it might.
        elif not 0.0 <= now - self._finished_at < self._transfer_params.patience_s:
            self._receiver = None
        if not self._camera.on:
            self._diagnostics.set(OK, "transferring a map")

    def _announce(self, transfer: Transfer) -> None:
        key = f"{transfer.side} {transfer.other}"
        last = self._announced.get(key)
        if transfer.state == "waiting" or (
            last is not None
            and (last.state, last.ride_id, last.map_id) == (transfer.state, transfer.ride_id, transfer.map_id)
        ):
            return
        self._announced[key] = transfer
        self._transfers.publish(String(msgspec.json.encode(transfer).decode()))
        self._diagnostics.set(
            OK,
            "transferring a map",
            **{
                f"{transfer.side}_{name}": getattr(transfer, name)
                for name in ("state", "other", "map_id", "map_bytes", "packed_bytes", "pieces", "messages", "bad")
            },
        )
        if transfer.over:
            rospy.loginfo(
                "map of the ride with %s %s%s: %d bytes, %d compressed, %d pieces in %d messages, %.1f s",
                transfer.other,
                transfer.state,
                f" ({transfer.reason})" if transfer.reason else "",
                transfer.map_bytes,
                transfer.packed_bytes,
                transfer.pieces,
                transfer.messages,
                transfer.seconds,
            )

    # Output.

    def _publish_map(self, content: bytes) -> None:
        self._newest = content
        self._files.publish(UInt8MultiArray(data=content))
        if self._cells.get_num_connections():
            self._show(content)

    def _show(self, content: bytes) -> None:
        self._cells.publish(_markers(read_voxels(content), rospy.get_time()))

    def _show_to(self, publish: Any) -> None:
        """A viewer that comes late sees the newest map."""
        with self._lock:
            content = self._newest
        if content is not None:
            publish(_markers(read_voxels(content), rospy.get_time()))


class _NewPeer(rospy.SubscribeListener):
    """Calls back with what publishes to one new subscriber alone."""

    def __init__(self, callback: Any) -> None:
        super().__init__()
        self._callback = callback

    def peer_subscribe(self, _topic: str, _publish: Any, peer_publish: Any) -> None:
        self._callback(peer_publish)


def _problem(content: bytes) -> str:
    """What is wrong with a map that has arrived, if anything."""
    try:
        read_voxels(content, "the map")
    except MapFileError as exc:
        return str(exc)
    return ""


def _markers(voxels: Voxels, stamp: float) -> MarkerArray:
    """As octomap_server's: a list of cubes for each size of voxel, from red on the floor to blue above."""
    sides = voxels.resolution_m * 2.0 ** np.arange(16)
    markers = []
    for number, side in enumerate(sides):
        marker = Marker(header=header(stamp, "map"), ns="map", id=number, type=Marker.CUBE_LIST)
        centres = voxels.centres[np.isclose(voxels.sides, side, rtol=0.1)]
        marker.action = Marker.ADD if len(centres) else Marker.DELETE
        marker.pose.orientation.w = 1.0
        marker.scale = Vector3(side, side, side)
        marker.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
        marker.points = [Point(*centre) for centre in centres.tolist()]
        marker.colors = _colours(centres[:, 2])
        markers.append(marker)
    return MarkerArray(markers)


def _colours(heights: FloatArray) -> list[ColorRGBA]:
    """A colour for each height (N,) in m."""
    u = np.clip(heights / _COLOUR_M, 0.0, 1.0)
    rgb = np.column_stack((1.0 - u, 1.0 - np.abs(2.0 * u - 1.0), u))
    return [ColorRGBA(r, g, b, 1.0) for r, g, b in rgb.tolist()]


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros mapping_3d``."""
    run("mapping_3d", Mapping3D, dozes=True)
