"""The driver's 3D map of a ride, and its way to the hitchhiker (P17 §7.4).

While the robot drives with a hitchhiker behind it, its depth camera fills an octree. When the hitchhiker has left, it
asks for that map and gets it in checked pieces over the network, while both drive on. It arrives bit for bit, or not at
all. A robot without a depth camera only asks.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, ClassVar

import msgspec

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, Odometry, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import MapFileError, MessageError, SensorDataError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.mapping.octree import OccupancyOctree, OctreeParameters, read_voxels
from hitchhike_ros.modules.inputs import DepthCameraInfo, DepthImage, NetworkText
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Health, Level, Order, Orders, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.protocol.map_transfer import MapReceiver, MapSender, Transfer, TransferParameters
from hitchhike_ros.protocol.messages import MapMessage, decode, encode
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.status import Status

# Without an image or a pose for so many periods, the health says so (chosen).
_SILENT_PERIODS = 3.0
_SENSORS: frozenset[type] = frozenset({DepthImage, DepthCameraInfo, PoseEstimate})
# Of a transfer, in the health.
_TOLD = ("state", "other", "map_id", "map_bytes", "packed_bytes", "pieces", "messages", "bad")


@dataclass(frozen=True)
class Mapping3DParameters:
    """Section ``mapping_3d``."""

    period_s: Annotated[float, msgspec.Meta(ge=0.01)] = 1.0
    """Between images that are taken into the map (chosen)."""


@dataclass(frozen=True, kw_only=True)
class Mapping3DOutputs(Outputs):
    """What goes to the other robot, and what this one has.

    ``messages`` are JSON for the network. ``file`` is a whole map as a .bt file: of the own ride when it has ended for
    somebody, or the one that has arrived. ``view`` gives the map to look at, which may still grow, as a .bt file; it
    is to be called where the module is stepped. ``transfers`` have begun or ended.
    """

    messages: tuple[str, ...] = ()
    file: bytes | None = None
    view: Callable[[], bytes] | None = None
    transfers: tuple[Transfer, ...] = ()


class _RideMap:
    """The map that grows while riders are carried, and the image that waits for its pose."""

    def __init__(
        self,
        params: Mapping3DParameters,
        tree_params: OctreeParameters,
        T_base_camera: FloatArray,
        counts: Counter[str],
    ) -> None:
        self._params, self._T_base_camera, self._counts = params, T_base_camera, counts
        self._tree = OccupancyOctree(tree_params)
        self._info: CameraInfo | None = None
        self._taken_at = -math.inf  # stamp of the newest image in the map
        self.start(0.0)

    def start(self, now: float) -> None:
        """The sensors are heard from now on, for the first time or again."""
        self._depth: DepthImage | None = None
        self._poses = PoseBuffer()
        self._since, self._complain_at = now, now + _SILENT_PERIODS * self._params.period_s
        self.health = Health(reason="mapping")

    def __len__(self) -> int:
        """Nodes of the map."""
        return len(self._tree)

    def file(self) -> bytes:
        """The .bt file of the map as it is now."""
        return self._tree.file()

    def take_image(self, image: DepthImage) -> None:
        """Keep an image that is due; the next one takes its place only when its pose has come, or will not."""
        if self._depth is None and not 0.0 <= image.stamp - self._taken_at < self._params.period_s:
            self._depth = image

    def take_info(self, info: CameraInfo) -> None:
        """Keep the camera's calibration."""
        self._info = info

    def take_pose(self, estimate: PoseEstimate) -> None:
        """Keep where the robot was; poses that jump count anew."""
        try:
            self._poses.add(Odometry(estimate.stamp, estimate.pose, Twist2D()))
        except SensorDataError:
            self._counts["pose_jumps"] += 1

    def next_due(self, now: float) -> float:
        """When an image can be taken, or something has been awaited for too long."""
        return min(self._image_at(now), self._complain_at)

    def step(self, now: float) -> bool:
        """Take the image that waits, once the pose at its stamp is known; whether the map has grown."""
        if now >= self._complain_at:
            self._complain_at = now + self._params.period_s
            what = "no depth image" if self._depth is None or self._info is None else "no pose at the image's stamp"
            self.health = Health(Level.ERROR, f"{what} for {now - self._since:.1f} s")
        image, info, poses = self._depth, self._info, self._poses
        if image is None or now < self._image_at(now):
            return False
        self._depth = None
        if info is None or not poses or not poses.oldest.stamp <= image.stamp <= poses.newest.stamp:
            return False  # localization is behind; a newer image will do
        pose = poses.at(image.stamp)
        self._taken_at, self._since = image.stamp, now
        self._complain_at = now + _SILENT_PERIODS * self._params.period_s
        T_map_base = matrix_from_xyz_rpy((pose.x, pose.y, 0.0), (0.0, 0.0, pose.theta))
        try:
            points = self._tree.insert(image.depth(), info, T_map_base @ self._T_base_camera)
        except SensorDataError as exc:
            self._counts["bad_images"] += 1
            self.health = Health(Level.ERROR, str(exc))
            return False
        self._counts["images"] += 1
        counters = {"points": points, "nodes": len(self._tree)}
        self.health = Health(Level.OK if points else Level.WARN, "mapping", counters)
        return True

    def _image_at(self, now: float) -> float:
        """When the image that waits is taken, or given up."""
        if self._depth is None:
            return math.inf
        located = bool(self._poses) and self._poses.newest.stamp >= self._depth.stamp
        return now if located and self._info is not None else self._depth.stamp + self._params.period_s


class Mapping3D:
    """Maps while it carries somebody, and shares maps after a ride."""

    name: ClassVar[str] = "mapping_3d"
    inputs: ClassVar[frozenset[type]] = _SENSORS | {NetworkText}
    patient: ClassVar[frozenset[type]] = frozenset()

    def __init__(
        self,
        robot_id: str,
        params: Mapping3DParameters,
        tree_params: OctreeParameters,
        transfer_params: TransferParameters,
        T_base_camera: FloatArray | None,
        first_seq: int = 0,
    ) -> None:
        """``T_base_camera`` (4, 4) is the mount of the depth camera's optical frame, None without one; ``first_seq``
        must be greater than any number of an earlier start."""
        self._robot_id, self._params = robot_id, params
        self._tree_params, self._transfer_params = tree_params, transfer_params
        self._T_base_camera = T_base_camera
        self._outbox = Outbox(first_seq)
        self._orders = Orders()
        self._obeys = False  # an order that counted at the last step
        self._statuses: list[Status] = []  # since the last step, as the following two
        self._heard: list[MapMessage] = []
        self._news = True
        self._stepped_at = -math.inf
        self._counts: Counter[str] = Counter()

        self._map: _RideMap | None = None  # of those who ride
        self._carries = False  # a rider, so that the map grows
        self._carried: dict[str, str] = {}  # who rides, and the id of the ride where it is known
        self._riding_with: tuple[str, str] | None = None  # driver and ride

        self._senders: dict[str, MapSender] = {}
        self._receiver: MapReceiver | None = None
        self._received_at: float | None = None  # when that came to its end
        self._announced: dict[str, Transfer] = {}
        # Of this step.
        self._messages: list[str] = []
        self._file: bytes | None = None
        self._view: Callable[[], bytes] | None = None
        self._transfers: list[Transfer] = []

    @classmethod
    def build(cls, files: RobotFiles) -> Mapping3D:
        """That of the robot that ``files`` describe."""
        return cls(
            files.robot_id,
            files.load(Mapping3DParameters, "mapping_3d"),
            files.load(OctreeParameters, "octree"),
            files.load(TransferParameters, "map_transfer"),
            files.mount("depth_camera_optical") if files.has("depth_camera_optical") else None,
            files.first_seq,
        )

    def listens(self) -> frozenset[type]:
        """The sensors while it maps, the network from the end of a ride until the map has arrived or will not."""
        return (_SENSORS if self._carries else frozenset()) | ({NetworkText} if self._sides() else frozenset())

    def sense(self, x: object, now: float) -> None:
        """Store an input; a message about a map wants an answer."""
        match x:
            case NetworkText():
                self._hear(x)
            case DepthImage() if self._map is not None and self._obeys:
                self._map.take_image(x)
            case DepthCameraInfo() if self._map is not None:
                self._map.take_info(x.info)
            case PoseEstimate() if self._map is not None:
                self._map.take_pose(x)
            case Refused():
                self._counts["bad_poses" if x.what is PoseEstimate else "bad_images"] += 1
                self._news = True

    def order(self, order: Order, now: float) -> None:
        """The status says whether the robot carries a rider, or rides."""
        if isinstance(order, Status):
            self._orders.put(order, now)
            self._statuses.append(order)
            self._news = True

    def next_due(self, now: float) -> float:
        """At once on news; when an image can be taken, a transfer goes on, or something is awaited for too long."""
        if self._news or now < self._stepped_at:
            return now
        due = min((side.next_due(now) for side in self._sides()), default=math.inf)
        if self._received_at is not None:
            due = min(due, self._forget_at(self._received_at, now))
        if self._map is not None and self._carries and self._obeys:
            due = min(due, self._orders.expires(), self._map.next_due(now))
        return due

    def step(self, now: float) -> Mapping3DOutputs:
        """Follow the orders, take the image that waits, and hand maps on."""
        if now < self._stepped_at and self._map is not None:
            self._map.start(now)
        self._stepped_at, self._news = now, False
        self._messages, self._file, self._view, self._transfers = [], None, None, []
        statuses, self._statuses = self._statuses, []
        for status in statuses:
            self._as_driver(status, now)
            self._as_hitchhiker(status, now)
        self._obeys = self._orders.get(now) is not None
        if self._map is not None and self._carries and self._obeys and self._map.step(now):
            self._view = self._map.file
        self._share(now)
        return Mapping3DOutputs(
            health=self._health(),
            messages=tuple(self._messages),
            file=self._file,
            view=self._view,
            transfers=tuple(self._transfers),
        )

    # Rides.

    def _as_driver(self, status: Status, now: float) -> None:
        """Map while somebody is carried, and keep the map for those who leave."""
        if self._T_base_camera is None:
            return
        carried_before, self._carries = self._carries, status.carries_rider and bool(status.convoy)
        if self._carries and self._map is None:
            self._map = _RideMap(self._params, self._tree_params, self._T_base_camera, self._counts)
        if self._map is not None and self._carries and not carried_before:
            self._map.start(now)
        carried = {name: self._carried.get(name, "") for name in (status.convoy if self._carries else ())}
        if status.ride is not None and status.ride.hitchhiker in carried:
            carried[status.ride.hitchhiker] = status.ride.ride_id
        left = {name: ride_id for name, ride_id in self._carried.items() if name not in carried}
        self._carried = carried
        if left and self._map is not None and len(self._map):
            content = self._map.file()
            for name, ride_id in left.items():
                self._senders[name] = MapSender(self._transfer_params, self._robot_id, name, ride_id, content, now)
            self._publish(content)
        if not status.convoy:
            self._map = None

    def _as_hitchhiker(self, status: Status, now: float) -> None:
        """Ask for the map when the ride is over."""
        if status.rides and status.ride is not None:
            self._riding_with = status.ride.driver, status.ride.ride_id
        elif self._riding_with is not None:
            self._receiver = MapReceiver(self._transfer_params, self._robot_id, *self._riding_with, now, _problem)
            self._riding_with = self._received_at = None

    # Maps that go from robot to robot.

    def _sides(self) -> list[MapSender | MapReceiver]:
        return [*self._senders.values(), *([] if self._receiver is None else [self._receiver])]

    def _hear(self, heard: NetworkText) -> None:
        if '"map_' not in heard.text:  # the machines' messages are many
            return
        self._news = True
        try:
            message = decode(heard.text)
        except MessageError:
            self._counts["dropped"] += 1
            return
        if isinstance(message, MapMessage) and message.to == self._robot_id:
            self._heard.append(message)

    def _share(self, now: float) -> None:
        """Answer what was heard, go on with what was begun, and forget what is over."""
        heard, self._heard = self._heard, []
        for side in self._sides():
            for message in heard:
                self._send(side.hear(message, now), now)
            self._send(side.step(now), now)
            self._announce(side.transfer)
        self._senders = {name: sender for name, sender in self._senders.items() if not sender.transfer.over}
        receiver = self._receiver
        if receiver is None or not receiver.transfer.over:
            return
        if self._received_at is None:
            self._received_at = now
            if receiver.content is not None:
                self._publish(receiver.content)
        elif self._forget_at(self._received_at, now) <= now:
            self._receiver = self._received_at = None

    def _forget_at(self, received_at: float, now: float) -> float:
        """The driver may ask again how it went: it is answered for as long as it might, unless time jumps back."""
        return received_at + self._transfer_params.patience_s if now >= received_at else now

    def _send(self, messages: Iterable[MapMessage], now: float) -> None:
        self._messages += (encode(self._outbox.stamp(message, now)) for message in messages)

    def _announce(self, transfer: Transfer) -> None:
        """Say that a transfer has begun, or how it ended."""
        key = f"{transfer.side} {transfer.other}"
        last = self._announced.get(key)
        if transfer.state == "waiting" or (
            last is not None
            and (last.state, last.ride_id, last.map_id) == (transfer.state, transfer.ride_id, transfer.map_id)
        ):
            return
        self._announced[key] = transfer
        self._transfers.append(transfer)

    def _publish(self, content: bytes) -> None:
        self._file, self._view = content, lambda: content

    def _health(self) -> Health:
        counters: dict[str, object] = dict(self._counts)
        for transfer in self._announced.values():
            counters.update({f"{transfer.side}_{fact}": getattr(transfer, fact) for fact in _TOLD})
        if self._map is not None and self._carries:
            if not self._obeys:
                return Health(Level.ERROR, f"no status for {ORDER_MAX_AGE_S} s", counters)
            mapping = self._map.health
            return Health(mapping.level, mapping.reason, {**counters, **mapping.counters})
        return Health(Level.OK, "transferring a map" if self._sides() else "off", counters)


def _problem(content: bytes) -> str:
    """What is wrong with a map that has arrived, if anything."""
    try:
        read_voxels(content, "the map")
    except MapFileError as exc:
        return str(exc)
    return ""
