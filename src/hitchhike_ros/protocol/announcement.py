"""The path that a robot announces: simplified, with times, and what others make of it (P18 §4).

Clocks differ, so times are told as durations from the message on.
"""

from __future__ import annotations

import bisect
import math

import cv2
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
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
        # For so few points loops are ten times as fast as arrays, and every robot looks several times a second.
        self._xy: list[list[float]] = self.points.tolist()
        self._arcs: list[float] = self.arcs.tolist()
        self.come_m = 0.0

    @property
    def length_m(self) -> float:
        return self._arcs[-1]

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
        best_away, best_arc, arc = math.inf, 0.0, min(from_m, self.length_m)
        here = self.at(from_m)
        ax, ay = here.x, here.y
        for (bx, by), to in zip(self._xy, self._arcs, strict=True):
            if to <= from_m + _STEP_M:
                continue
            dx, dy = bx - ax, by - ay
            share = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, _STEP_M**2)
            share = min(max(share, 0.0), 1.0)
            away = math.hypot(x - ax - share * dx, y - ay - share * dy)
            if away < best_away:
                best_away, best_arc = away, arc + share * (to - arc)
            ax, ay, arc = bx, by, to
        if best_away == math.inf:  # there is nothing ahead
            return math.hypot(x - ax, y - ay), arc
        return best_away, best_arc

    def all_nearest(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As :meth:`nearest` of the whole path, for all ``places`` (K, 2) at once: distances (K,) and arcs (K,)."""
        begin, along = self.points[:-1], np.diff(self.points, axis=0)
        if not len(along):
            return np.hypot(*(places - self.points[0]).T), np.zeros(len(places))
        offset = places[:, None] - begin  # (K, segments, 2)
        share = np.clip((offset * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), _STEP_M**2), 0.0, 1.0)
        away = np.hypot(*np.moveaxis(offset - share[:, :, None] * along, 2, 0))
        each, best = np.arange(len(places)), away.argmin(axis=1)
        return away[each, best], self.arcs[best] + share[each, best] * np.diff(self.arcs)[best]

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
        if len(self._xy) == 1:
            return Pose2D(*self._xy[0])
        k = min(max(bisect.bisect_right(self._arcs, arc_m) - 1, 0), len(self._xy) - 2)
        (x, y), (to_x, to_y) = self._xy[k], self._xy[k + 1]
        part = (min(arc_m, self.length_m) - self._arcs[k]) / (self._arcs[k + 1] - self._arcs[k])
        dx, dy = to_x - x, to_y - y
        return Pose2D(x + part * dx, y + part * dy, math.atan2(dy, dx))

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
