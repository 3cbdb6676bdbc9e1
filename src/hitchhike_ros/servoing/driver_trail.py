"""Where the driver's axle has been, as far as its follower still has to drive."""

from __future__ import annotations

import math

import numpy as np

# The follower's place on the trail is sought this far ahead of the last one, so that a loop is not cut short (chosen).
REACH_M = 1.0


class Trail:
    """The driver's track, a polyline by arc length, and how far along it the follower is."""

    def __init__(self, *points: tuple[float, float]) -> None:
        self._points = [np.array(point, dtype=float) for point in points]
        self._s = [0.0]
        for a, b in zip(self._points, self._points[1:], strict=False):
            self._s.append(self._s[-1] + float(np.linalg.norm(b - a)))
        self._own = 0.0

    def extend(self, point: tuple[float, float], heading: float, step: float) -> None:
        """The driver is at ``point``: taken when it is ``step`` metres on, and in the direction that it looks to."""
        leg = np.array(point) - self._points[-1]
        length = float(np.linalg.norm(leg))
        if length >= step and leg[0] * math.cos(heading) + leg[1] * math.sin(heading) > 0.0:
            self._points.append(np.array(point))
            self._s.append(self._s[-1] + length)

    def advance(self, x: float, y: float) -> float:
        """Arc length of the follower at (x, y): of the nearest point at most ``REACH_M`` ahead of where it was."""
        p = np.array([x, y])
        best, best_distance = self._own, math.inf
        for a, b, s in zip(self._points, self._points[1:], self._s, strict=False):
            leg = b - a
            length = float(np.linalg.norm(leg))
            if length == 0.0 or s + length < self._own or s > self._own + REACH_M:
                continue
            f = min(max(float((p - a) @ leg) / length**2, 0.0), 1.0)
            d = float(np.linalg.norm(a + f * leg - p))
            if d < best_distance:
                best, best_distance = s + f * length, d
        self._own = max(self._own, best)
        while len(self._points) > 2 and self._s[1] < self._own - 0.5:
            self._points.pop(0)
            self._s.pop(0)
        return self._own

    @property
    def length(self) -> float:
        """Arc length of the driver's end."""
        return self._s[-1]

    def at(self, s: float) -> tuple[float, float]:
        """The point at arc length ``s``; past the driver, straight on."""
        if s >= self._s[-1]:
            leg = self._points[-1] - self._points[-2]
            ahead = self._points[-1] + leg * (s - self._s[-1]) / max(float(np.linalg.norm(leg)), 1e-9)
            return float(ahead[0]), float(ahead[1])
        points = np.array(self._points)
        return float(np.interp(s, self._s, points[:, 0])), float(np.interp(s, self._s, points[:, 1]))
