"""The path that a robot announces: simplified, with times, and what others make of it (P18 §4).

Clocks differ, so times are told as durations from the message on.
"""

from __future__ import annotations

import cv2
import numpy as np

from hitchhike_ros.datatypes import FloatArray, Pose2D
from hitchhike_ros.planning.announced import AnnouncedDriver
from hitchhike_ros.protocol.messages import Waypoint, Waypoints

# A simplified path is nowhere farther from the plan (chosen: less than a place in a corridor matters).
_SIMPLIFY_M = 0.15
# Farther from its plan a robot is on another way (chosen).
_ASTRAY_M = 1.5
# A ride may end at nodes of the path, which are no farther apart (chosen).
NODES_M = 2.5
# Steps that are shorter are none (m).
_STEP_M = 1e-3


class OwnPath:
    """A plan, and how far along it the robot has come."""

    def __init__(self, path: FloatArray) -> None:
        """``path`` (N, 2) in m in ``map``, N >= 1."""
        points = np.asarray(path, dtype=float)
        kept = cv2.approxPolyDP(points.astype(np.float32)[:, None], _SIMPLIFY_M, False)[:, 0].astype(float)
        kept[0], kept[-1] = points[0], points[-1]
        self.points = kept[np.concatenate([[True], np.hypot(*np.diff(kept, axis=0).T) > _STEP_M])]
        self.arcs = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.points, axis=0).T))])
        self.come_m = 0.0

    @property
    def length_m(self) -> float:
        return float(self.arcs[-1])

    @property
    def left_m(self) -> float:
        """Metres of the path that are still ahead."""
        return self.length_m - self.come_m

    def advance(self, pose: Pose2D) -> bool:
        """The robot is at ``pose``; False where that is not on the path."""
        away, arc = self.nearest(pose.x, pose.y, self.come_m)
        if away > _ASTRAY_M:
            return False
        self.come_m = arc
        return True

    def nearest(self, x: float, y: float, from_m: float = 0.0) -> tuple[float, float]:
        """Distance in m of (x, y) from the path beyond ``from_m``, and where along it that is, in m."""
        points, arcs = self.ahead(from_m)
        if len(points) == 1:
            return float(np.hypot(x - points[0, 0], y - points[0, 1])), float(arcs[0])
        along, offset = np.diff(points, axis=0), np.array([x, y]) - points[:-1]
        share = np.clip((offset * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), _STEP_M**2), 0.0, 1.0)
        away = np.hypot(*(offset - share[:, None] * along).T)
        k = int(away.argmin())
        return float(away[k]), float(arcs[k] + share[k] * (arcs[k + 1] - arcs[k]))

    def ahead(self, from_m: float) -> tuple[FloatArray, FloatArray]:
        """Points (M, 2) and arcs (M,) from ``from_m`` on, M >= 1."""
        later = self.arcs > from_m + _STEP_M
        here = self.at(from_m)
        return (
            np.vstack([[here.x, here.y], self.points[later]]),
            np.concatenate([[min(from_m, self.length_m)], self.arcs[later]]),
        )

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Points (K, 2) all along the path, and their arcs (K,), no farther apart than where a ride may end."""
        arcs = np.linspace(0.0, self.length_m, max(2, int(np.ceil(self.length_m / NODES_M)) + 1))
        return np.column_stack([np.interp(arcs, self.arcs, axis) for axis in self.points.T]), arcs

    def at(self, arc_m: float) -> Pose2D:
        """The pose on the path after so many metres, looking along it; before its beginning it goes straight on."""
        if len(self.points) == 1:
            return Pose2D(float(self.points[0, 0]), float(self.points[0, 1]))
        k = int(np.clip(np.searchsorted(self.arcs, arc_m, side="right") - 1, 0, len(self.points) - 2))
        (x, y), step = self.points[k], self.points[k + 1] - self.points[k]
        length = self.arcs[k + 1] - self.arcs[k]
        part = (min(arc_m, self.length_m) - self.arcs[k]) / length
        return Pose2D(float(x + part * step[0]), float(y + part * step[1]), float(np.arctan2(step[1], step[0])))

    def waypoints(self, speed_mps: float, in_s: float = 0.0) -> tuple[Waypoint, ...]:
        """What is still ahead, at ``speed_mps`` from ``in_s`` on; nothing where it has come to the end."""
        points, arcs = self.ahead(self.come_m)
        if len(points) < 2:
            return ()
        times = in_s + (arcs - arcs[0]) / speed_mps
        return tuple(zip(points[:, 0].tolist(), points[:, 1].tolist(), times.tolist(), strict=True))


def announced_driver(
    robot_id: str, waypoints: Waypoints, heard_at: float, free_places: int, safe_speed_mps: float
) -> AnnouncedDriver:
    """A path that was announced at ``heard_at``, on the own clock, with nodes where one may leave along the way."""
    columns = np.array(waypoints, dtype=float)
    metres = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(columns[:, :2], axis=0).T))])
    pieces = np.maximum(np.ceil(np.diff(metres) / NODES_M), 1).astype(int)
    knots = np.concatenate([k + np.arange(n) / n for k, n in enumerate(pieces)] + [[len(pieces)]])
    x, y, in_s = (np.interp(knots, np.arange(len(columns)), column) for column in columns.T)
    return AnnouncedDriver(robot_id, np.column_stack([x, y]), heard_at + in_s, free_places, safe_speed_mps)
