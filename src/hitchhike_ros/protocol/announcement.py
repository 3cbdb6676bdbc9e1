"""The path that a robot announces: simplified, with times, and what others make of it (P18 §4).

Clocks differ, so times are told as durations from the message on.
"""

from __future__ import annotations

import cv2
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.planning.announced import AnnouncedDriver
from hitchhike_ros.protocol.messages import MOST_PATH_POINTS, PathPoints, Waypoint, Waypoints

# A simplified path is nowhere farther from the plan (chosen: less than a place in a corridor matters).
_SIMPLIFY_M = 0.15
# A hitchhiker's path, which others compare with theirs, is simplified by this at least (chosen: a cell of a map).
_COMPARED_M = 0.05
_DECIMALS = 3  # of a metre: what is told of a path
# So much coarser at a time, until the path has few enough points (chosen).
_COARSER = 1.5
# Farther from its plan a robot is on another way (chosen).
ASTRAY_M = 1.5
# A ride may end at nodes of the path, which are no farther apart (chosen).
NODES_M = 2.5


class OwnPath:
    """A ``plan`` (N, 2), simplified to ``line``, and how far along that the robot has come: ``come_m``."""

    def __init__(self, path: FloatArray) -> None:
        """``path`` (N, 2) in m in ``map``, N >= 1."""
        self.plan = np.asarray(path, dtype=float)
        self.line = Polyline(_simplified(self.plan, _SIMPLIFY_M))
        self.come_m = 0.0

    @property
    def left_m(self) -> float:
        """Metres of the path that are still ahead."""
        return self.line.end_m - self.come_m

    def advance(self, pose: Pose2D) -> bool:
        """The robot is at ``pose``; False where that is not on the path ahead."""
        arc, away = self.line.project(pose.x, pose.y, self.come_m)
        if away > ASTRAY_M:
            return False
        self.come_m = arc
        return True

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Points (K, 2) all along the path, and their arcs (K,), no farther apart than where a ride may end."""
        arcs = np.linspace(0.0, self.line.end_m, max(2, int(np.ceil(self.line.end_m / NODES_M)) + 1))
        return self.line.at(arcs), arcs

    def waypoints(self, speed_mps: float, in_s: float = 0.0) -> tuple[Waypoint, ...]:
        """What is still ahead, at ``speed_mps`` from ``in_s`` on; nothing where it has come to the end."""
        ahead = self.line.ahead(self.come_m)
        if ahead.length_m == 0.0:
            return ()
        times = in_s + (ahead.arcs - ahead.start_m) / speed_mps
        return tuple(zip(*ahead.points.T.tolist(), times.tolist(), strict=True))


def asked_path(plan: FloatArray) -> PathPoints:
    """A ``plan`` (N, 2) as a request tells it: as near to the plan as the number of points allows."""
    tolerance_m = _COMPARED_M
    points = np.asarray(plan, dtype=float)
    kept = _simplified(points, tolerance_m)
    while len(kept) > MOST_PATH_POINTS:
        tolerance_m *= _COARSER
        kept = _simplified(points, tolerance_m)
    return tuple((round(x, _DECIMALS), round(y, _DECIMALS)) for x, y in kept.tolist())


def _simplified(points: FloatArray, tolerance_m: float) -> FloatArray:
    """Those of the points (N, 2) that keep the path within ``tolerance_m``, both ends included (Douglas-Peucker)."""
    origin = points[0]  # single precision is fine near it
    shifted = (points - origin).astype(np.float32)[:, None]
    kept = cv2.approxPolyDP(shifted, tolerance_m, False)[:, 0].astype(float) + origin
    kept[0], kept[-1] = points[0], points[-1]
    return np.asarray(kept)


def announced_driver(
    robot_id: str, waypoints: Waypoints, heard_at: float, free_places: int, safe_speed_mps: float
) -> AnnouncedDriver:
    """A path that was announced at ``heard_at``, on the own clock, with nodes where one may leave along the way."""
    columns = np.array(waypoints, dtype=float)
    pieces = np.maximum(np.ceil(np.hypot(*np.diff(columns[:, :2], axis=0).T) / NODES_M), 1).astype(int)
    knots = np.concatenate([k + np.arange(n) / n for k, n in enumerate(pieces)] + [[len(pieces)]])
    x, y, in_s = (np.interp(knots, np.arange(len(columns)), column) for column in columns.T)
    return AnnouncedDriver(robot_id, np.column_stack([x, y]), heard_at + in_s, free_places, safe_speed_mps)
