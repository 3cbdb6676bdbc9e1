"""A path by its arc length: where the robot is on it, and what lies ahead."""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.errors import PlanningError

_TANGENT_REACH_M = 0.2  # tangents are taken over this length to both sides, so a grid path's stairs do not shake them


class ReferencePath:
    """A polyline (N, 2) in metres, parametrised by arc length from its first point.

    Raises:
        PlanningError: the points are not a finite (N, 2) array with N >= 1.
    """

    def __init__(self, points: FloatArray) -> None:
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0 or not np.isfinite(points).all():
            raise PlanningError(f"a path must be finite points (N, 2), got an array of shape {points.shape}")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate(([True], steps > 1e-6))
        self._points = points[keep]
        self._s = np.concatenate(([0.0], np.cumsum(steps[steps > 1e-6])))

    @property
    def length(self) -> float:
        """Arc length in m."""
        return float(self._s[-1])

    def at(self, s: FloatArray) -> FloatArray:
        """Points (N, 2) at arc lengths (N,); before the start and past the end, the ends."""
        return np.stack([np.interp(s, self._s, self._points[:, k]) for k in (0, 1)], axis=-1)

    def tangents(self, s: FloatArray) -> FloatArray:
        """Unit directions (N, 2) of travel at arc lengths (N,)."""
        s = np.clip(s, 0.0, self.length)
        chord = self.at(s + _TANGENT_REACH_M) - self.at(s - _TANGENT_REACH_M)
        norm = np.linalg.norm(chord, axis=1, keepdims=True)
        return np.where(norm > 1e-9, chord / np.maximum(norm, 1e-9), (1.0, 0.0))

    def project(self, x: float, y: float, first: float = 0.0, last: float = math.inf) -> tuple[float, float]:
        """Arc length of the point of the path nearest to (x, y) between two arc lengths, and its distance in m."""
        first, last = max(first, 0.0), min(last, self.length)
        inner = self._s[(self._s > first) & (self._s < last)]
        s = np.concatenate(([first], inner, [last]))
        points = self.at(s)
        legs = np.diff(points, axis=0)
        lengths = np.maximum((legs**2).sum(axis=1), 1e-12)
        fraction = np.clip(((np.array([x, y]) - points[:-1]) * legs).sum(axis=1) / lengths, 0.0, 1.0)
        feet = points[:-1] + fraction[:, None] * legs
        distances = np.hypot(feet[:, 0] - x, feet[:, 1] - y)
        nearest = int(np.argmin(distances))
        return float(s[nearest] + fraction[nearest] * (s[nearest + 1] - s[nearest])), float(distances[nearest])
