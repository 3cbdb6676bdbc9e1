"""Where the driver's axle has been, as far as its follower still has to drive."""

from __future__ import annotations

import math

from hitchhike_ros.core.polyline import Polyline

# The follower's place on the trail is sought this far ahead of the last one, so that a loop is not cut short (chosen).
REACH_M = 1.0
# So much of the trail behind the follower is kept (chosen).
_BEHIND_M = 0.5


class DriverTrail:
    """The driver's track in ``odom`` by arc length, and how far along it the follower is.

    >>> trail = DriverTrail((0.0, 0.0), (1.0, 0.0))
    >>> trail.extend((1.0, 0.5), math.pi / 2, step=0.1)
    >>> trail.advance(0.4, 0.1)
    0.4
    >>> trail.at(2.0)  # 0.5 m past the driver
    (1.0, 1.0)
    """

    def __init__(self, *points: tuple[float, float]) -> None:
        self._line = Polyline(points)
        self._own = 0.0

    def extend(self, point: tuple[float, float], heading: float, step: float) -> None:
        """The driver is at ``point``: taken when it is ``step`` metres on, and in the direction that it looks to."""
        x, y = self._line.point(self._line.end_m)
        dx, dy = point[0] - x, point[1] - y
        if math.hypot(dx, dy) >= step and dx * math.cos(heading) + dy * math.sin(heading) > 0.0:
            self._line.extend(*point)

    def advance(self, x: float, y: float) -> float:
        """Arc length of the follower at (x, y): of the nearest point at most ``REACH_M`` ahead of where it was."""
        self._own, _ = self._line.project(x, y, self._own, self._own + REACH_M)
        self._line.forget_before(self._own - _BEHIND_M)
        return self._own

    @property
    def length(self) -> float:
        """Arc length of the driver's end."""
        return self._line.end_m

    def at(self, s: float) -> tuple[float, float]:
        """The point at arc length ``s``; past the driver, straight on."""
        past = s - self._line.end_m
        if past <= 0.0 or self._line.length_m == 0.0:
            return self._line.point(s)
        end = self._line.pose(self._line.end_m)
        return end.x + past * math.cos(end.theta), end.y + past * math.sin(end.theta)
