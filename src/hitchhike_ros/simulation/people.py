"""People in the simulated world: they walk to and fro along a path of straight pieces.

They are kinematic: they push nobody and nobody pushes them; that they and a robot touch is counted as the robot's
contact. A person stops while a robot is close in front of him, as people do, and walks on when it has gone, or turns
back after a while. He looks no farther than a step, so a robot must still stop for people.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import NonNegative, Pose2D, Positive
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.core.polyline import Polyline

RADIUS_M, HEIGHT_M = 0.25, 1.7
# Somebody stops for a robot whose centre is nearer than this and within this bearing of where he walks, or still nearer
# and anywhere before him (chosen; no robot's corner is farther than 0.4 m from its centre).
_STOP_M, _STOP_RAD, _BESIDE_M = 0.8, math.radians(50.0), 0.7
_PATIENCE_S = 1.0  # then he turns back (chosen)


@dataclass(frozen=True)
class Person:
    """Walks along ``path``, two points (x, y) or more in m in ``map``, and back again, from ``start_s`` on.

    One who is ``hurried`` walks there once and stays, and waits for no robot.
    """

    id: str
    path: tuple[tuple[float, float], ...]
    speed_mps: Positive = 1.0
    start_s: NonNegative = 0.0
    hurried: bool = False


class Walker:
    """A person under way."""

    def __init__(self, person: Person) -> None:
        self.person = person
        self._path = Polyline(person.path)
        self._s, self._sense, self._waited = 0.0, 1.0, 0.0

    @property
    def pose(self) -> Pose2D:
        """Place in ``map`` and the direction in which he walks."""
        there = self._path.pose(self._s)
        return there if self._sense > 0.0 else compose(there, Pose2D(theta=math.pi))

    def step(self, now: float, dt: float, robots: Iterable[Pose2D]) -> bool:
        """Walk for ``dt`` s, or wait for the robot in front; whether he has moved."""
        if now < self.person.start_s:
            return False
        if not self.person.hurried and any(in_front(self.pose, robot) for robot in robots):
            self._waited += dt
            if self._waited > _PATIENCE_S:
                self._sense, self._waited = -self._sense, 0.0
            return False
        self._waited = 0.0
        s, end = self._s + self._sense * self.person.speed_mps * dt, self._path.end_m
        if self.person.hurried:
            s = min(s, end)
        elif not 0.0 <= s <= end:
            s, self._sense = -s if s < 0.0 else 2.0 * end - s, -self._sense
        self._s = s
        return True


def in_front(person: Pose2D, robot: Pose2D) -> bool:
    """Whether a robot is so close in front of a person that he stops for it."""
    x, y = robot.x - person.x, robot.y - person.y
    ahead = x * math.cos(person.theta) + y * math.sin(person.theta)
    away = math.hypot(x, y)
    return (away < _BESIDE_M and ahead > 0.0) or (away < _STOP_M and ahead > math.cos(_STOP_RAD) * away)
