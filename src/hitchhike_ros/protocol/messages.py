"""The messages between robots: one JSON object each on ``/hhike_msg/network`` (P17 Listing 1, made valid).

Metres and radians in ``map``. Numbers given as strings are read, unknown keys are ignored, unknown types and versions
are refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import NonNegative, Obstacle, Pose2D, Positive
from hitchhike_ros.core.errors import MessageError

VERSION = 1
EVERYBODY = "*"

RobotId = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
Profile = Annotated[float, msgspec.Meta(ge=0, le=100)]
Priority = Annotated[int, msgspec.Meta(ge=0, le=20)]
Row = tuple[float, float, float]
# x, y in m in ``map``, and in how many s after the message the sender is there: clocks differ.
Waypoint = tuple[float, float, NonNegative]
# More of them in one message are no simplified path (chosen).
_MOST_WAYPOINTS = 500
Waypoints = Annotated[tuple[Waypoint, ...], msgspec.Meta(max_length=_MOST_WAYPOINTS)]
Covariance = tuple[Row, Row, Row]
Place = Annotated[int, msgspec.Meta(ge=1)]  # in a convoy, 1 behind the driver


@dataclass(frozen=True, kw_only=True)
class Message:
    """What every message carries. ``seq`` grows from message to message of one robot."""

    type: ClassVar[str]

    robot_id: RobotId
    to: RobotId = EVERYBODY
    ride_id: str = ""
    seq: Annotated[int, msgspec.Meta(ge=0)] = 0
    time_stamp: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RearMarker:
    """The marker on a robot's back; its pose is in the robot's ``base_footprint``."""

    marker_id: int
    marker_size_m: Positive
    marker_pose: Pose2D


@dataclass(frozen=True, kw_only=True)
class PoseFields:
    """Where the sender is."""

    x: float
    y: float
    theta: float

    @property
    def pose(self) -> Pose2D:
        return Pose2D(self.x, self.y, self.theta)


@dataclass(frozen=True, kw_only=True)
class Beacon(Message):
    """``status``: who is there, where, what for, and along which path (P18 §4).

    A rider that does not localize has no pose of its own. Towards a hitchhiker the robot may go up to
    ``safe_speed_mps``.
    """

    type = "status"

    state: str
    profile: Profile
    priority: Priority
    radius_m: Positive = 0.3
    pose: Pose2D | None = None
    goal: Pose2D | None = None
    path: Waypoints = ()
    free_places: Annotated[int, msgspec.Meta(ge=0)] = 0
    safe_speed_mps: Positive = 0.6


@dataclass(frozen=True, kw_only=True)
class Request(PoseFields, Message):
    """A hitchhiker asks for a ride: {R_h, G_h, P_h} and where it stands (P17 §2.2, P18 §4), or will, in ``in_s``."""

    type = "request"

    goal: Pose2D
    profile: Profile
    priority: Priority = 10
    in_s: NonNegative = 0.0
    rear_marker: RearMarker | None = None  # for whoever comes behind it in a convoy


@dataclass(frozen=True, kw_only=True)
class Accept(PoseFields, Message):
    """A driver offers the ride: how long it is, where it ends, and its rear marker.

    In a network the hitchhiker chooses among the rides that the driver's ``path`` allows (P18 §4).
    """

    type = "accept"

    profile: Profile
    ride_m: NonNegative
    decouple_point: tuple[float, float]
    marker_id: int
    marker_size_m: Positive
    marker_pose: Pose2D  # in the driver's base_footprint
    path: Waypoints = ()
    safe_speed_mps: Positive = 0.6

    @property
    def rear_marker(self) -> RearMarker:
        return RearMarker(marker_id=self.marker_id, marker_size_m=self.marker_size_m, marker_pose=self.marker_pose)


@dataclass(frozen=True, kw_only=True)
class Deny(Message):
    """A driver refuses, with the paper's text where it has one."""

    type = "deny"

    reason: str


@dataclass(frozen=True, kw_only=True)
class Lock(Message):
    """The hitchhiker takes the offer.

    In a network it says where: the driver stops at ``aligning``, the hitchhiker is at ``waiting`` in ``in_s``, and
    the ride ends at ``leave``. It says so again as it comes nearer.
    """

    type = "lock"

    aligning: Pose2D | None = None
    waiting: Pose2D | None = None
    leave: tuple[float, float] | None = None
    in_s: NonNegative = 0.0
    rear_marker: RearMarker | None = None


@dataclass(frozen=True, kw_only=True)
class RequestCancel(Message):
    """The hitchhiker no longer needs a ride from this driver."""

    type = "request_cancel"


@dataclass(frozen=True, kw_only=True)
class Aligned(PoseFields, Message):
    """*Aligned: ready to couple*, with dloc (P17 Alg. 1, line 18), and in a convoy whom to couple to."""

    type = "aligned"

    decouple_point: tuple[float, float]
    place: Place = 1
    ahead: RearMarker | None = None


@dataclass(frozen=True, kw_only=True)
class Coupled(Message):
    """*Coupling successful* (P17 Alg. 2, line 9)."""

    type = "coupled"

    gap_m: float


@dataclass(frozen=True, kw_only=True)
class NewObstacles:
    """Ω of the papers."""

    obstacles: tuple[Obstacle, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Driver(PoseFields, Message):
    """The driver's message of every δ seconds: pose, Σ, Ω (P17 §4, Listing 1), and its speed.

    In a convoy, pose and Σ are of the robot ahead of the rider, the one with the rear marker ``ahead``.
    """

    type = "driver"

    sigma: Covariance
    new_obstacles: NewObstacles = NewObstacles()
    v: float = 0.0
    ridden_m: NonNegative = 0.0
    place: Place = 1
    ahead: RearMarker | None = None


@dataclass(frozen=True, kw_only=True)
class Ack(Message):
    """Message ``acknowledges`` of type ``of`` has arrived; a rider adds how it follows.

    A driver that confirms a lock adds the place, and in how many seconds it will be aligned.

    ``seen`` is the marker ahead in its ``base_footprint`` with covariance ``seen_sigma``: it tells where the rider is.
    """

    type = "ack"

    of: str
    acknowledges: int
    place: Place = 1
    in_s: NonNegative = 0.0
    following: bool = True
    gap_m: float | None = None
    seen: Pose2D | None = None
    seen_sigma: Covariance | None = None


@dataclass(frozen=True, kw_only=True)
class Decouple(PoseFields, Message):
    """The driver stands at dloc and hands over pose, Σ and Ω (P17 Alg. 1, line 31), as in its messages before."""

    type = "decouple"

    sigma: Covariance
    new_obstacles: NewObstacles = NewObstacles()
    ridden_m: NonNegative = 0.0
    place: Place = 1
    ahead: RearMarker | None = None


@dataclass(frozen=True, kw_only=True)
class Terminate(Message):
    """Either robot ends the ride, with the reason."""

    type = "terminate"

    reason: str


# Of the transfer of a 3D map (chosen): bytes of a piece before base64, pieces asked for at a time, and bytes of the
# whole, compressed and not.
LEAST_PIECE, LARGEST_PIECE, MOST_ASKED = 1 << 10, 1 << 15, 64
LARGEST_PACKED, LARGEST_MAP = 1 << 24, 1 << 26
_MOST_PIECES = LARGEST_PACKED // LEAST_PIECE
MapId = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
PieceIndex = Annotated[int, msgspec.Meta(ge=0, lt=_MOST_PIECES)]


@dataclass(frozen=True, kw_only=True)
class MapMessage(Message):
    """What two nodes mapping_3d say to each other (P17 §7.4); the machines of the ride do not hear it.

    ``ride_id`` is that of the ride on which the map was made. A map's id is the SHA-256 of its .bt file.
    """


@dataclass(frozen=True, kw_only=True)
class MapRequest(MapMessage):
    """The hitchhiker asks which map there is, or, with the ``map_id`` of an offer, for pieces of that one."""

    type = "map_request"

    map_id: Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{64})?$")] = ""
    pieces: Annotated[tuple[PieceIndex, ...], msgspec.Meta(max_length=MOST_ASKED)] = ()


@dataclass(frozen=True, kw_only=True)
class MapOffer(MapMessage):
    """The driver has a map of ``map_bytes``, in zlib's format ``packed_bytes``, in pieces of ``piece_bytes``."""

    type = "map_offer"

    map_id: MapId
    map_bytes: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_MAP)]
    packed_bytes: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_PACKED)]
    piece_bytes: Annotated[int, msgspec.Meta(ge=LEAST_PIECE, le=LARGEST_PIECE)]

    @property
    def pieces(self) -> int:
        """How many there are; the last may be shorter than the others."""
        return -(-self.packed_bytes // self.piece_bytes)


@dataclass(frozen=True, kw_only=True)
class MapPiece(MapMessage):
    """Bytes of a packed map from ``index`` times its ``piece_bytes`` on, base64 in JSON, and their CRC-32."""

    type = "map_piece"

    map_id: MapId
    index: PieceIndex
    crc32: Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]
    data: Annotated[bytes, msgspec.Meta(min_length=1, max_length=LARGEST_PIECE)]


@dataclass(frozen=True, kw_only=True)
class MapAck(MapMessage):
    """The hitchhiker has the map, whole; or it does not want it, or no longer, with the reason."""

    type = "map_ack"

    map_id: MapId
    arrived: bool
    reason: str = ""


MESSAGE_TYPES: dict[str, type[Message]] = {
    cls.type: cls
    for cls in (
        Beacon,
        Request,
        Accept,
        Deny,
        Lock,
        RequestCancel,
        Aligned,
        Coupled,
        Driver,
        Ack,
        Decouple,
        Terminate,
    )
}
MAP_MESSAGES: dict[str, type[MapMessage]] = {cls.type: cls for cls in (MapRequest, MapOffer, MapPiece, MapAck)}
_ALL_TYPES: dict[str, type[Message]] = {**MESSAGE_TYPES, **MAP_MESSAGES}


# msgspec crashes when two threads are the first to use a type, and some types are in several messages: all are made
# ready now.
for _cls in _ALL_TYPES.values():
    msgspec.json.Decoder(_cls)


def encode(message: Message) -> str:
    """``message`` as JSON."""
    content = msgspec.to_builtins(message, enc_hook=float)  # NumPy's scalars are no floats to msgspec
    return msgspec.json.encode({"version": VERSION, "type": message.type, **content}).decode()


def decode(text: str) -> Message:
    """The message in a JSON text.

    Raises:
        MessageError: no JSON object, another version, an unknown type, or a field that is missing or out of bounds;
            it names the field and what was expected.
    """
    try:
        content = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as exc:
        raise MessageError(f"not JSON: {exc}") from exc
    if not isinstance(content, dict):
        raise MessageError(f"not a JSON object but {type(content).__name__}")
    if str(content.get("version")) != str(VERSION):
        raise MessageError(f"version {content.get('version')!r}, expected {VERSION}")
    kind = content.get("type")
    cls = _ALL_TYPES.get(kind) if isinstance(kind, str) else None
    if cls is None:
        raise MessageError(f"type {kind!r}, expected one of {', '.join(_ALL_TYPES)}")
    try:
        message = msgspec.convert(content, cls, strict=False)
    except msgspec.ValidationError as exc:
        raise MessageError(f"{kind}: {exc}") from exc
    for name, pose in _poses(message, content):  # elsewhere "nowhere in particular", here all or nothing
        if len(pose) < 3 or not {"x", "y", "theta"} <= set(pose):
            raise MessageError(f"{kind}: {name} is {pose}, expected x, y and theta")
    if not _finite(message):
        name, value = next((name, value) for name, value in _floats(message) if not math.isfinite(value))
        raise MessageError(f"{kind}: {name} is {value}, expected a finite number")
    for name in ("sigma", "seen_sigma"):
        sigma = getattr(message, name, None)
        if sigma is not None and not _is_covariance(sigma):
            raise MessageError(f"{kind}: {name} is {sigma}, expected symmetric and positive semidefinite")
    path = getattr(message, "path", ())
    if len(path) == 1 or any(after[2] <= before[2] for before, after in pairwise(path)):
        raise MessageError(f"{kind}: path is {path}, expected two points or more, each later than the one before")
    return message


def covariance_rows(covariance: npt.ArrayLike) -> Covariance:
    """A 3 x 3 array as the nested tuple that messages carry."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(covariance, dtype=float).tolist()
    return (a, b, c), (d, e, f), (g, h, i)


def _is_covariance(sigma: Covariance) -> bool:
    """Zero is one (P17 §6.1 starts with it); rounding in the last digits is let through."""
    matrix = np.array(sigma)
    scaled = matrix / (np.abs(matrix).max() or 1.0)
    return bool(np.abs(scaled - scaled.T).max() <= 1e-9 and np.linalg.eigvalsh(scaled)[0] >= -1e-9)


@cache
def _names(cls: type[Any]) -> tuple[str, ...]:
    return tuple(f.name for f in fields(cls))


# Of each class, the fields that may hold a pose, or a rear marker with one.
_FIELDS_OF_POSES = {
    cls: tuple(f.name for f in fields(cls) if "Pose2D" in str(f.type) or "RearMarker" in str(f.type))
    for cls in (*_ALL_TYPES.values(), RearMarker)
}


def _poses(value: object, content: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every pose in a message as it came, with the name of its field."""
    if isinstance(value, Pose2D):
        yield name, content
    elif isinstance(value, Message | RearMarker):
        for field in _FIELDS_OF_POSES[type(value)]:
            if (inner := getattr(value, field)) is not None:
                yield from _poses(inner, content[field], f"{name}.{field}" if name else field)


def _finite(value: object) -> bool:
    """Whether every number in a message is."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, tuple):
        return all(map(_finite, value))
    if is_dataclass(value) and not isinstance(value, type):
        return all(_finite(getattr(value, name)) for name in _names(type(value)))
    return True


def _floats(value: object, name: str = "") -> Iterator[tuple[str, float]]:
    """Every float in a message with the name of its field."""
    if isinstance(value, float):
        yield name, value
    elif isinstance(value, tuple):
        for item in value:
            yield from _floats(item, name)
    elif is_dataclass(value):
        for f in fields(value):
            yield from _floats(getattr(value, f.name), f"{name}.{f.name}" if name else f.name)
