"""The messages of a ride between robots (P17 Listing 1, made valid), and the beacon of P18 §4."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Self

import msgspec

from hitchhike_ros.core.datatypes import NonNegative, Obstacle, Pose2D, Positive
from hitchhike_ros.protocol.messages.fields import (
    Covariance,
    Message,
    PathPoints,
    Place,
    PoseFields,
    Priority,
    Profile,
    RearMarker,
    Waypoints,
)


@dataclass(frozen=True, kw_only=True)
class Beacon(Message):
    """``status``: who is there, where, what for, and along which path (P18 §4).

    A rider that does not localize has no pose of its own. Towards a hitchhiker the robot may go up to
    ``safe_speed_mps``. ``goal`` is where it will stand: a place before its goal where another robot has that. Its way
    there is ``left_m`` long, where it knows that; ``driver`` is who has driven it on the way.
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
    left_m: NonNegative | None = None
    driver: str = ""


@dataclass(frozen=True, kw_only=True)
class Request(PoseFields, Message):
    """A hitchhiker asks for a ride: {R_h, G_h, P_h} and where it stands (P17 §2.2, P18 §4), or will, in ``in_s``.

    ``path`` is its way from there to the goal, Q_h (P18 Algorithm 2); without one a driver plans it on its own map.
    """

    type = "request"

    goal: Pose2D
    profile: Profile
    priority: Priority = 10
    in_s: NonNegative = 0.0
    rear_marker: RearMarker | None = None  # for whoever comes behind it in a convoy
    path: PathPoints = ()


@dataclass(frozen=True, kw_only=True)
class Accept(PoseFields, Message):
    """A driver offers the ride: how long it is, where it ends, and its rear marker.

    In a network that is the ride from the first place to the last that both their ways pass, and the hitchhiker chooses
    among all rides that the driver's ``path`` allows (P18 §4).
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
    goal: Pose2D | None = None  # where the driver will stand

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
    the ride ends at ``leave``, ``ride_m`` along the driver's path from where it waits (0: it does not say). It says so
    again as it comes nearer.
    """

    type = "lock"

    aligning: Pose2D | None = None
    waiting: Pose2D | None = None
    leave: tuple[float, float] | None = None
    ride_m: NonNegative = 0.0
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
class DriverFields(PoseFields):
    """What a driver tells its rider: pose, Σ, Ω (P17 §4, Listing 1), and how far they have ridden.

    In a convoy, pose and Σ are of the robot ahead of the rider, the one with the rear marker ``ahead``. They are of
    ``age_s`` before the message: clocks differ, but all count the same seconds.
    """

    sigma: Covariance
    new_obstacles: NewObstacles = NewObstacles()
    ridden_m: NonNegative = 0.0
    place: Place = 1
    ahead: RearMarker | None = None
    age_s: NonNegative = 0.0

    def aged(self, waited_s: float) -> Self:
        """As :meth:`.Message.aged`."""
        return replace(self, age_s=self.age_s + max(0.0, waited_s))


@dataclass(frozen=True, kw_only=True)
class Driver(DriverFields, Message):
    """The driver's message of every δ seconds, with its speed."""

    type = "driver"

    v: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Ack(Message):
    """Message ``acknowledges`` of type ``of`` has arrived; a rider adds how it follows.

    A driver that confirms a lock adds the place, in how many seconds it will be aligned, and how long the ride is from
    there (0: it does not say): so far the two ride together, and that is what is paid for.

    ``seen`` is the marker ahead in its ``base_footprint`` with covariance ``seen_sigma``: it tells where the rider is,
    or was ``seen_age_s`` before the message.
    """

    type = "ack"

    of: str
    acknowledges: int
    place: Place = 1
    in_s: NonNegative = 0.0
    ride_m: NonNegative = 0.0
    following: bool = True
    gap_m: float | None = None
    seen: Pose2D | None = None
    seen_sigma: Covariance | None = None
    seen_age_s: NonNegative = 0.0

    def aged(self, waited_s: float) -> Self:
        """As :meth:`.Message.aged`."""
        return replace(self, seen_age_s=self.seen_age_s + max(0.0, waited_s))


@dataclass(frozen=True, kw_only=True)
class Decouple(DriverFields, Message):
    """The driver stands at dloc and hands over pose, Σ and Ω (P17 Alg. 1, line 31), as in its messages before."""

    type = "decouple"


@dataclass(frozen=True, kw_only=True)
class Terminate(Message):
    """Either robot ends the ride, with the reason."""

    type = "terminate"

    reason: str
