"""Where a robot stops on the way to a place that others take up: as near to it as it is not in the way.

Bodies count as discs, as robots tell of each other no more than a place and a radius.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.core.polyline import Polyline

# Discs with less room between them than this do not both have their place (chosen: the margin of obstacle avoidance).
_LEAST_ROOM_M = 0.05
# Who stops before another robot leaves so much room: as obstacle avoidance before a blocked way (chosen).
_STAND_OFF_M = 0.3
# Places along the way are tried so far apart.
_STEP_M = 0.05


@dataclass(frozen=True)
class Occupied:
    """A place in ``map`` that the robot ``by`` takes up, or is about to."""

    by: str
    place: Pose2D
    radius_m: float


@dataclass(frozen=True)
class FreePlace:
    """A place on the way: ``pose`` heads along it, ``to_go_m`` is how far it is, ``before_m`` how far from its end."""

    pose: Pose2D
    to_go_m: float
    before_m: float


def taken_by(place: Pose2D, radius_m: float, occupied: Sequence[Occupied]) -> Occupied | None:
    """Who leaves no room at ``place`` for a robot of that radius, the nearest first; None where it is free."""
    near = [
        (distance(place, other.place), other.by, other)
        for other in occupied
        if distance(place, other.place) < radius_m + other.radius_m + _LEAST_ROOM_M
    ]
    return min(near)[2] if near else None


def nearest_free_place(path: FloatArray, radius_m: float, occupied: Sequence[Occupied]) -> FreePlace:
    """The last place of ``path`` (N, 2) in m in ``map`` where a robot stands clear of all others.

    Where there is none that is its beginning: whoever cannot stand anywhere better stays.
    """
    line = Polyline(path)
    arcs = np.append(np.arange(0.0, line.end_m, _STEP_M), line.end_m)
    points = line.at(arcs)
    free = np.ones(len(arcs), dtype=bool)
    for other in occupied:
        away = np.hypot(points[:, 0] - other.place.x, points[:, 1] - other.place.y)
        free &= away >= radius_m + other.radius_m + _STAND_OFF_M
    arc = float(arcs[np.flatnonzero(free)[-1]]) if free.any() else 0.0
    pose = line.pose(arc)
    end_x, end_y = line.point(line.end_m)
    return FreePlace(pose, arc, float(np.hypot(end_x - pose.x, end_y - pose.y)))
