"""A person at the keys, as a rule: watches where the robot is on the map and its route, and holds keys (P18 §8.3.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive
from hitchhike_ros.core.geometry import between
from hitchhike_ros.core.polyline import Polyline


@dataclass(frozen=True)
class HumanParameters:
    """Section ``human``; chosen."""

    look_ahead_m: Positive = 1.2  # on the route, what the person steers for
    correct_rad: Positive = 0.1  # off by more than this, the person steers
    turn_rad: Positive = 0.8  # off by more than this, the person stops and turns on the spot
    turned_rad: Positive = 0.25
    park_m: Positive = 1.0  # nearer to the end than this the robot parks while the person says go
    repeat_s: Positive = 0.1  # a key that is held


class ScriptedHuman:
    """The keys for one robot along one route after another."""

    def __init__(self, params: HumanParameters) -> None:
        self._params = params
        self._turning = False
        self._due_at = 0.0

    def keys(self, pose: Pose2D, route: FloatArray, now: float) -> str:
        """What is typed at ``now``, often nothing; ``pose`` and ``route`` (N, 2) in ``map``."""
        repeat_s = self._params.repeat_s
        if 0.0 < self._due_at - now <= repeat_s:
            return ""
        on_time = 0.0 <= now - self._due_at < repeat_s
        self._due_at = (self._due_at if on_time else now) + repeat_s
        path = Polyline(route)
        s, _ = path.project(pose.x, pose.y)
        if path.end_m - s < self._params.park_m:
            return "w"
        ahead = between(pose, Pose2D(*path.point(s + self._params.look_ahead_m)))
        off = math.atan2(ahead.y, ahead.x)
        side = "a" if off > 0.0 else "d"
        if abs(off) > (self._params.turned_rad if self._turning else self._params.turn_rad):
            stop = "" if self._turning else " "
            self._turning = True
            return stop + side
        self._turning = False
        return side if abs(off) > self._params.correct_rad else "w"
