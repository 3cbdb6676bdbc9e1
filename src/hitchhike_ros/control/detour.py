"""A way around what stands on the path: the path shifted sideways, station by station, by dynamic programming."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchhike_ros.control.clearance import ClearanceField
from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import inverse, transform_points
from hitchhike_ros.core.polyline import Polyline

_STATION_M = 0.12  # along the path
_LANE_M = 0.08  # across it
_REACH_M = 1.2  # how far a lane may lie beside the path
_AHEAD_M = 3.0
_STEEPEST = 4  # lanes changed from one station to the next
_SMOOTHING = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0

# Costs per station (chosen), offsets in m, clearance relative to what is comfortable.
_OFFSET_COST = 1.0
_CLEARANCE_COST = 2.0
_SHIFT_COST = 1.5
_STEEP_COST = 1.0
_SIDEWAYS_COST = 2.5
_SIDEWAYS_ONCE_COST = 0.1
_CHANGE_COST = 1.5


@dataclass(frozen=True, eq=False)
class Detour:
    """``points`` (N, 2) from the robot on, in its frame, at arc lengths ``stations`` and ``offsets`` to the left of the
    path. ``blocked`` when nothing leads past the last of them."""

    points: FloatArray
    stations: FloatArray
    offsets: FloatArray
    blocked: bool


class DetourPlanner:
    """Cheapest sequence of lateral offsets along the next metres of a path, for a body of a given half width."""

    def __init__(self, half_width_m: float, margin_m: float, comfort_m: float) -> None:
        self._half_width_m, self._margin_m, self._comfort_m = half_width_m, margin_m, comfort_m
        lanes = round(_REACH_M / _LANE_M)
        self._offsets = _LANE_M * np.arange(-lanes, lanes + 1)
        shift = np.abs(self._offsets[:, None] - self._offsets)
        self._sideways = _SIDEWAYS_COST * shift + np.where(shift > 0, _SIDEWAYS_ONCE_COST, 0.0)
        diagonal = _SHIFT_COST * shift + _STEEP_COST * np.maximum(shift - _STATION_M, 0.0)
        self._diagonal = np.where(shift <= (_STEEPEST + 0.5) * _LANE_M, diagonal, np.inf)

    def plan(self, path: Polyline, s: float, pose: Pose2D, field: ClearanceField, before: Detour | None) -> Detour:
        """The way on for a robot at ``pose`` whose foot on ``path`` (both in ``map``) is at arc length ``s``.

        ``field`` is in the robot's frame. ``before`` is the last result: leaving its lane costs, so that two ways as
        good as each other do not take turns.
        """
        end = min(s + _AHEAD_M, path.end_m)
        stations = np.append(np.arange(s, end - 0.5 * _STATION_M, _STATION_M), end)
        tangents = path.tangents(stations)
        normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
        centre = path.at(stations)
        places = centre[:, None] + self._offsets[:, None] * normals[:, None]
        places = transform_points(inverse(pose), places.reshape(-1, 2)).reshape(places.shape)
        clearance = field.distance(places[..., 0], places[..., 1]) - self._half_width_m
        offset = float(normals[0] @ (np.array([pose.x, pose.y]) - centre[0]))
        start = int(np.argmin(np.abs(self._offsets - offset)))
        cost = self._cost(stations, clearance, before)
        if end == path.end_m:
            cost[-1, self._offsets != 0.0] = np.inf  # a goal cannot be shifted
        lanes, blocked = self._search(clearance, start, cost)
        offsets = np.convolve(self._offsets[np.pad(lanes, 2, mode="edge")], _SMOOTHING, "valid")
        offsets[-1] = self._offsets[lanes[-1]]
        stations, centre, normals = (a[: len(lanes)] for a in (stations, centre, normals))
        points = transform_points(inverse(pose), centre + offsets[:, None] * normals)
        return Detour(points, stations, offsets, blocked)

    def _cost(self, stations: FloatArray, clearance: FloatArray, before: Detour | None) -> FloatArray:
        """Cost (M, L) of being in each lane at each station."""
        discomfort = np.maximum(0.0, 1.0 - clearance / self._comfort_m)
        cost = _OFFSET_COST * self._offsets**2 + _CLEARANCE_COST * discomfort**2
        if before is not None:
            change = np.abs(self._offsets - np.interp(stations, before.stations, before.offsets)[:, None])
            cost += _CHANGE_COST * np.minimum(change, 0.5)
        return cost

    def _search(self, clearance: FloatArray, start: int, cost: FloatArray) -> tuple[np.ndarray, bool]:
        """Lanes (M,) of the cheapest way through the first M stations, and whether those are not all of them."""
        closed = clearance < self._margin_m
        # The robot may stand closer than the margin already: near it, what is no worse than now is open.
        closed[:3] = clearance[:3] < min(self._margin_m, clearance[0, start] - 0.01)
        closed[0, start] = False
        cost = np.where(closed, np.inf, cost)
        every = np.arange(closed.shape[1])
        # First straight sideways, through open lanes only.
        barriers = np.cumsum(closed[0])
        total = np.where(barriers == barriers[start], self._sideways[start], np.inf) + cost[0]
        totals, came_from = [total], [every]
        for here in cost[1:]:
            forward = total[:, None] + self._diagonal
            origin = forward.argmin(axis=0)
            total = forward[origin, every] + here
            if total.min() == np.inf:
                break
            totals.append(total)
            came_from.append(origin)
        lane = start if totals[-1].min() == np.inf else int(totals[-1].argmin())
        lanes = np.empty(len(totals), dtype=np.int64)
        for station in range(len(totals) - 1, -1, -1):
            lanes[station] = lane
            lane = int(came_from[station][lane])
        return lanes, len(totals) < len(closed) or totals[-1].min() == np.inf
