"""What messages are made of: the envelope, and fields with their bounds.

Metres and radians in ``map``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import NonNegative, Pose2D, Positive

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
# The way to a goal, x and y in m in ``map``, simplified to so many points at most.
MOST_PATH_POINTS = 64
PathPoints = Annotated[tuple[tuple[float, float], ...], msgspec.Meta(max_length=MOST_PATH_POINTS)]
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

    def aged(self, waited_s: float) -> Self:
        """The message as it reads ``waited_s`` after it came: what it says of a time is of a time longer ago."""
        return self


@dataclass(frozen=True, kw_only=True)
class RearMarker:
    """The marker on a robot's back; its pose is in the robot's ``base_footprint``."""

    marker_id: int
    marker_size_m: Positive
    marker_pose: Pose2D


@dataclass(frozen=True, kw_only=True)
class PoseFields:
    """Where the sender is, or in some messages of a convoy the rider ahead of whom they are for."""

    x: float
    y: float
    theta: float

    @property
    def pose(self) -> Pose2D:
        return Pose2D(self.x, self.y, self.theta)


def covariance_rows(covariance: npt.ArrayLike) -> Covariance:
    """A 3 x 3 array as the nested tuple that messages carry."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(covariance, dtype=float).tolist()
    return (a, b, c), (d, e, f), (g, h, i)
