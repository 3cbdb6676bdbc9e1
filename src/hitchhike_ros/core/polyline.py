"""A path by its arc length: where a place is along it, what lies ahead, and how it goes on."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.errors import PlanningError

# Tangents are taken over this length to both sides, so that the stairs of a grid path do not shake them.
_TANGENT_REACH_M = 0.2
# A corner of a path that is nearer to the one before is left out: what is shorter has no direction.
_SAME_M = 1e-3


class Polyline:
    """Straight pieces through points (N, 2) in m, N >= 1, by arc length s in m.

    Points nearer than 1 mm to the one before are left out. The first point is at s = ``start_m``. Arc lengths keep what
    they say while the path grows at its end and is forgotten at its beginning. Beyond the ends everything is as at the
    end that is nearer. Questions about one place use plain numbers, which for few points is ten times as fast as
    arrays; those about many places use arrays.

    Raises:
        PlanningError: the points are not a finite (N, 2) array with N >= 1.

    >>> path = Polyline([(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)])
    >>> path.length_m
    7.0
    >>> path.project(5.0, 1.0)  # is 2 m beside the path, after 4 m of it
    (4.0, 2.0)
    >>> path.pose(1.0)
    Pose2D(x=1.0, y=0.0, theta=0.0)
    >>> path.ahead(5.0).points.tolist()
    [[3.0, 2.0], [3.0, 4.0]]
    >>> path.extend(0.0, 4.0)
    >>> path.forget_before(3.0)
    >>> (path.start_m, path.end_m, path.point(8.5))
    (3.0, 10.0, (1.5, 4.0))
    """

    def __init__(self, points: FloatArray | Sequence[tuple[float, float]], start_m: float = 0.0) -> None:
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0 or not np.isfinite(points).all():
            raise PlanningError(f"a path must be finite points (N, 2), got an array of shape {points.shape}")
        rows = points.tolist()
        self._xs, self._ys, self._arcs = [rows[0][0]], [rows[0][1]], [start_m]
        self._arrays: tuple[FloatArray, FloatArray] | None = None
        for x, y in rows[1:]:
            if math.hypot(x - self._xs[-1], y - self._ys[-1]) > _SAME_M:
                self.extend(x, y)

    @property
    def start_m(self) -> float:
        """Arc length of the first point."""
        return self._arcs[0]

    @property
    def end_m(self) -> float:
        """Arc length of the last point."""
        return self._arcs[-1]

    @property
    def length_m(self) -> float:
        """From the first point to the last along the path."""
        return self._arcs[-1] - self._arcs[0]

    @property
    def points(self) -> FloatArray:
        """The corners (N, 2), ends included."""
        return self._as_arrays()[1]

    @property
    def arcs(self) -> FloatArray:
        """Arc length (N,) of each of :attr:`points`, strictly increasing."""
        return self._as_arrays()[0]

    # One place.

    def point(self, s: float) -> tuple[float, float]:
        """The place (x, y) at arc length ``s``."""
        arcs, xs, ys = self._arcs, self._xs, self._ys
        if s <= arcs[0]:
            return xs[0], ys[0]
        if s >= arcs[-1]:
            return xs[-1], ys[-1]
        k = bisect_right(arcs, s)
        share = (s - arcs[k - 1]) / (arcs[k] - arcs[k - 1])
        return xs[k - 1] + share * (xs[k] - xs[k - 1]), ys[k - 1] + share * (ys[k] - ys[k - 1])

    def pose(self, s: float) -> Pose2D:
        """The place at ``s``, looking along the piece on which it is; at a corner along the next one.

        A path of one point looks along x.
        """
        x, y = self.point(s)
        if len(self._arcs) == 1:
            return Pose2D(x, y)
        k = min(max(bisect_right(self._arcs, s), 1), len(self._arcs) - 1)
        return Pose2D(x, y, math.atan2(self._ys[k] - self._ys[k - 1], self._xs[k] - self._xs[k - 1]))

    def project(self, x: float, y: float, first: float = -math.inf, last: float = math.inf) -> tuple[float, float]:
        """Arc length of the place of the path that is nearest to (x, y), and its distance in m.

        Args:
            x, y: the place sought.
            first, last: arc lengths between which the path is searched. Of places as near as each other the first
                counts. A corner less than 1 mm beyond ``first`` is passed over, as in :meth:`ahead`.
        """
        start, end = self._arcs[0], self._arcs[-1]
        first = min(max(first, start), end)
        last = max(min(last, end), first)
        ax, ay = self.point(first)
        if last - first <= _SAME_M:
            return first, math.hypot(x - ax, y - ay)
        arc, nearest, distance = first, first, math.inf
        k = bisect_right(self._arcs, first + _SAME_M)
        while arc < last:
            to = min(self._arcs[k], last)
            bx, by = (self._xs[k], self._ys[k]) if to == self._arcs[k] else self.point(last)
            dx, dy = bx - ax, by - ay
            squared = dx * dx + dy * dy
            share = ((x - ax) * dx + (y - ay) * dy) / squared if squared > 0.0 else 0.0
            share = min(max(share, 0.0), 1.0)
            away = math.hypot(x - ax - share * dx, y - ay - share * dy)
            if away < distance:
                nearest, distance = arc + share * (to - arc), away
            ax, ay, arc, k = bx, by, to, k + 1
        return nearest, distance

    def passes(self, x: float, y: float, within_m: float, first: float = -math.inf) -> list[float]:
        """Arc lengths from ``first`` on at which the path passes (x, y), in their order.

        That is where it comes nearest each time that it comes within ``within_m``.
        """
        found, arc = list[tuple[float, float]](), max(first, self.start_m)
        pieces = [*(s for s, _, _ in self.corners(arc, self.end_m)), self.end_m]
        leaves_m = -math.inf  # until there it has been within reach since it came nearest
        for end in pieces:
            nearest, away = self.project(x, y, arc, end)
            if away <= within_m:
                if found and leaves_m >= arc:
                    if away < found[-1][1]:
                        found[-1] = nearest, away
                else:
                    found.append((nearest, away))
                if math.dist(self.point(end), (x, y)) <= within_m:
                    leaves_m = end
            arc = end
        return [nearest for nearest, _ in found]

    # Many places at once.

    def at(self, s: FloatArray) -> FloatArray:
        """Places (K, 2) at arc lengths (K,)."""
        arcs, points = self._as_arrays()
        return np.stack([np.interp(s, arcs, points[:, axis]) for axis in (0, 1)], axis=-1)

    def tangents(self, s: FloatArray, reach_m: float = _TANGENT_REACH_M) -> FloatArray:
        """Unit directions (K, 2) of travel at arc lengths (K,), each along the chord over ``reach_m`` to both sides.

        Where the path comes back to where it was within that, the direction is x.
        """
        s = np.clip(s, self.start_m, self.end_m)
        chord = self.at(s + reach_m) - self.at(s - reach_m)
        norm = np.linalg.norm(chord, axis=1, keepdims=True)
        return np.where(norm > 1e-9, chord / np.maximum(norm, 1e-9), (1.0, 0.0))

    def project_all(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As :meth:`project` of the whole path, for all ``places`` (K, 2): arc lengths (K,) and distances (K,)."""
        arcs, points = self._as_arrays()
        along = np.diff(points, axis=0)
        if not len(along):
            return np.full(len(places), arcs[0]), np.hypot(*(places - points[0]).T)
        offset = places[:, None] - points[:-1]  # (K, pieces, 2)
        share = np.clip((offset * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        away = np.hypot(*np.moveaxis(offset - share[:, :, None] * along, 2, 0))
        each, nearest = np.arange(len(places)), away.argmin(axis=1)
        return arcs[nearest] + share[each, nearest] * np.diff(arcs)[nearest], away[each, nearest]

    # Other paths, and this one as it goes on.

    def ahead(self, first: float, last: float = math.inf) -> Polyline:
        """The part between two arc lengths, which keep what they say; without corners less than 1 mm from its ends."""
        first = min(max(first, self.start_m), self.end_m)
        part = Polyline([self.point(first)], first)
        last = max(min(last, self.end_m), first)
        begin, end = bisect_right(self._arcs, first + _SAME_M), bisect_left(self._arcs, last - _SAME_M)
        part._arcs += self._arcs[begin:end]
        part._xs += self._xs[begin:end]
        part._ys += self._ys[begin:end]
        if last > part.end_m + _SAME_M:
            part._append(last, *self.point(last))
        return part

    def corners(self, first: float, last: float) -> list[tuple[float, float, float]]:
        """The places where it bends, strictly between two arc lengths: (s, x, y) of each."""
        inner = slice(bisect_right(self._arcs, first), bisect_left(self._arcs, last))
        return list(zip(self._arcs[inner], self._xs[inner], self._ys[inner], strict=True))

    def extend(self, x: float, y: float, s: float | None = None) -> None:
        """It goes straight on to (x, y), however near that is; where it ends already nothing changes.

        ``s`` is the arc length there where the caller counts it, as an odometer does.
        """
        if s is None:
            s = self._arcs[-1] + math.hypot(x - self._xs[-1], y - self._ys[-1])
        if s > self._arcs[-1]:
            self._append(s, x, y)

    def forget_after(self, s: float) -> None:
        """It ends at arc length ``s``."""
        if s < self.end_m:
            end = self.point(s)
            keep = max(bisect_left(self._arcs, s), 1)
            for knots in (self._arcs, self._xs, self._ys):
                del knots[keep:]
            if s > self._arcs[-1]:
                self._append(s, *end)
            self._arrays = None

    def forget_before(self, s: float) -> None:
        """Drop corners that are not needed from arc length ``s`` on; the path begins at the last corner before it."""
        drop = min(max(bisect_right(self._arcs, s) - 1, 0), len(self._arcs) - 1)
        for knots in (self._arcs, self._xs, self._ys):
            del knots[:drop]
        self._arrays = None

    def _append(self, arc: float, x: float, y: float) -> None:
        self._arcs.append(arc)
        self._xs.append(x)
        self._ys.append(y)
        self._arrays = None

    def _as_arrays(self) -> tuple[FloatArray, FloatArray]:
        if self._arrays is None:
            self._arrays = np.array(self._arcs), np.column_stack([self._xs, self._ys])
        return self._arrays
