"""Plain values that the layers exchange: frozen, validated where they enter, free of ROS.

Metres, radians and seconds throughout. A ``stamp`` is seconds on the clock of the node that stamped it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import msgspec
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]
# A place in m or an angle in rad, neither infinite nor beyond any map.
Coordinate = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Variance = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
Seed = Annotated[int, msgspec.Meta(ge=0)]
UnitInterval = Annotated[float, msgspec.Meta(ge=0, le=1)]
Side = Literal["left", "right"]
# What a human may do to a robot by teleoperation: free is straight to the base; guided passes through obstacle
# avoidance, which keeps what the protocol asks of a driver; off leaves only stopping.
TeleopMode = Literal["free", "guided", "off"]


# Without slots msgspec leaves out of a pose, and so of messages that it is told in, what the file did not say.
@dataclass(frozen=True, slots=True)
class Pose2D:
    """A planar pose; ``theta`` is kept as given, wrap it with :func:`hitchhike_ros.core.geometry.wrap_angle`."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def is_finite(self) -> bool:
        return math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.theta)


@dataclass(frozen=True)
class Twist2D:
    """Forward speed in m/s and yaw rate in rad/s of a differential drive, in its base frame."""

    v: float = 0.0
    omega: float = 0.0

    def is_finite(self) -> bool:
        return math.isfinite(self.v) and math.isfinite(self.omega)


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """A pose in ``map`` with its 3 x 3 covariance in (x, y, theta)."""

    stamp: float
    pose: Pose2D
    covariance: FloatArray


@dataclass(frozen=True)
class Odometry:
    """Pose in the robot's ``odom`` frame and twist in its base frame, from the wheels.

    ``frame_id`` is what the driver calls that frame; empty: as the robot does.
    """

    stamp: float
    pose: Pose2D
    twist: Twist2D
    frame_id: str = ""


@dataclass(frozen=True, eq=False)
class LaserScan:
    """One planar scan in the laser's frame.

    ``ranges`` is (N,); beam i points to ``angle_min + i * angle_increment``, counter-clockwise: beams that come the
    other way round are turned about. Whatever a driver sends for them, a reading is one of four (REP 117):

    - within the sensor's limits: something is there;
    - +inf: no return, as is what lies beyond ``range_max``;
    - -inf: something is too close to be measured;
    - NaN: left out. It says neither that something is there nor that nothing is. So are numbers below ``range_min``,
      the zeros and error codes of many drivers.

    All numbers but the stamp have the precision of sensor_msgs/LaserScan, so that a scan is the same whether or not it
    has been a message.
    """

    stamp: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: npt.NDArray[np.float32]

    def __post_init__(self) -> None:
        for name in ("angle_min", "angle_increment", "range_min", "range_max"):
            object.__setattr__(self, name, float(np.float32(getattr(self, name))))
        ranges = np.asarray(self.ranges, np.float32)
        if self.angle_increment < 0.0:
            last = float(np.float32(self.angle_min + self.angle_increment * (ranges.size - 1)))
            object.__setattr__(self, "angle_min", last)
            object.__setattr__(self, "angle_increment", -self.angle_increment)
            ranges = ranges[::-1]
        with np.errstate(invalid="ignore"):
            below = (ranges < self.range_min) & (ranges != -np.inf)
            beyond = (ranges > self.range_max) & (ranges != np.inf)
        if below.any() or beyond.any():
            ranges = np.where(below, np.float32(np.nan), np.where(beyond, np.float32(np.inf), ranges))
        object.__setattr__(self, "ranges", ranges)

    def mirrored(self) -> LaserScan:
        """As a laser that is turned over sees it: every bearing with the other sign."""
        return replace(self, angle_min=-self.angle_min, angle_increment=-self.angle_increment)

    def bad_share(self) -> float:
        """Share of the beams that are left out; of a scan without beams all are."""
        return float(np.isnan(self.ranges).mean()) if self.ranges.size else 1.0

    def angles(self) -> FloatArray:
        """Bearing of each beam, (N,) rad."""
        return self.angle_min + self.angle_increment * np.arange(self.ranges.size)

    def valid(self) -> npt.NDArray[np.bool_]:
        """Mask (N,) of the beams that hit something within the sensor's limits."""
        with np.errstate(invalid="ignore"):
            return np.isfinite(self.ranges) & (self.ranges >= self.range_min) & (self.ranges <= self.range_max)


@dataclass(frozen=True, eq=False)
class CameraInfo:
    """Pinhole calibration: image size in pixels, K (3, 3), plumb_bob D (5,)."""

    width: int
    height: int
    K: FloatArray
    D: FloatArray = field(default_factory=lambda: np.zeros(5))


@dataclass(frozen=True)
class Obstacle:
    """A new static box in ``map``: corner with the smallest coordinates, width along x, breadth along y."""

    id: str
    x: float
    y: float
    w: NonNegative
    b: NonNegative


@dataclass(frozen=True)
class Marker:
    """A marker at a known place in ``map``; ``yaw`` is the direction of its outward normal."""

    id: int
    x: float
    y: float
    z: float
    yaw: float
    size_m: Positive = 0.16
    family: str = "36h11"


@dataclass(frozen=True, eq=False)
class MarkerObservation:
    """A marker seen by the camera, in the robot's ``base_footprint``.

    ``pose.theta`` is the direction of the marker's outward normal, so a marker seen square-on straight ahead has
    theta = pi. ``covariance`` is 3 x 3 in (x, y, theta).
    """

    stamp: float
    marker_id: int
    pose: Pose2D
    covariance: FloatArray


@dataclass(frozen=True)
class HitchhikingPoint:
    """A place reserved for coupling (P17 §3): ``area`` is a polygon in ``map``, the driver stops at ``aligning_pose``
    in front of ``marker`` and the hitchhiker stands at ``waiting_pose``, parallel to the wall on that side if one is
    named."""

    name: str
    area: tuple[tuple[float, float], ...]
    aligning_pose: Pose2D
    waiting_pose: Pose2D
    marker: int | None = None
    wall: Side | None = None


@dataclass(frozen=True)
class Contact:
    """A robot began to touch something at (x, y) in ``map``: ``other`` is ``walls``, a box, a person or a robot."""

    stamp: float
    robot: str
    other: str
    x: float
    y: float

    def __str__(self) -> str:
        return f"{self.robot} and {self.other} at {self.stamp:.1f} s"
