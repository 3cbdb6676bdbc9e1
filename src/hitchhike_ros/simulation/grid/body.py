"""Where a robot of the grid simulator is: between events it moves by formula, along a path or behind another robot."""

from __future__ import annotations

import math

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.core.polyline import Polyline

# A robot that drives looks along the chord of its path from so far behind it to so far ahead: it rounds corners.
_CHORD_M = 0.5
# A robot remembers so much of its own trail, for those that follow it.
_TRAIL_M = 12.0
_TINY_M = 1e-6


class Body:
    """A point with a heading. Turning costs no time, and so does changing speed; bodies pass through each other.

    ``odometer_m`` is the way driven in all. ``speed_mps`` is the speed now. Every question is about ``time``, the
    time of the last :meth:`advance`.
    """

    def __init__(self, pose: Pose2D, time: float) -> None:
        self.x, self.y, self.time = pose.x, pose.y, time
        self.odometer_m = 0.0
        self._theta: float | None = pose.theta
        # What it has driven and what lies before it, by odometer: the trail behind, then the path ahead.
        self._line = Polyline([(pose.x, pose.y)])
        self._leg_began = 0.0
        self._speed = 0.0
        self._end_theta: float | None = None
        self._leader: Body | None = None
        self._lag_m = self._joined_m = self._follow_began = self._leader_began = self._seen_m = self._top_speed = 0.0
        self._sees = False

    @property
    def moves(self) -> bool:
        """Whether it may be elsewhere a moment later."""
        return self._leader is not None or (self._speed > 0.0 and self.odometer_m < self._line.end_m)

    @property
    def speed_mps(self) -> float:
        if self._leader is not None:
            if self.odometer_m < self._target_m() - _TINY_M:
                return self._top_speed
            return self._leader.speed_mps if self._sees else 0.0
        return self._speed if self.odometer_m < self._line.end_m - _TINY_M else 0.0

    @property
    def remaining_m(self) -> float:
        """How much of its path is left."""
        return self._line.end_m - self.odometer_m

    @property
    def leader(self) -> Body | None:
        """The body whose trail it follows."""
        return self._leader

    @property
    def sees(self) -> bool:
        """Whether it saw its leader when it last looked."""
        return self._sees

    @property
    def arrives(self) -> float:
        """When it comes to the end of its path; inf while it stands or follows."""
        if self._leader is not None or self._speed <= 0.0 or self.remaining_m <= _TINY_M:
            return math.inf
        return self.time + self.remaining_m / self._speed

    @property
    def path(self) -> list[tuple[float, float]]:
        """The points of the path ahead, from where it is."""
        return [(self.x, self.y), *((x, y) for _, x, y in self._line.corners(self.odometer_m, math.inf))]

    @property
    def pose(self) -> Pose2D:
        return Pose2D(self.x, self.y, self.theta)

    @property
    def theta(self) -> float:
        if self._theta is None:
            self._theta = self._heading()
        return self._theta

    def advance(self, time: float) -> None:
        """Move on to ``time``, which is not before that of the last call."""
        passed, self.time = time - self.time, max(time, self.time)
        if passed <= 0.0:
            return
        if self._leader is not None:
            self._leader.advance(time)
            if self._sees:
                self._seen_m = self._leader.odometer_m
            self._creep(min(self._target_m(), self.odometer_m + self._top_speed * passed))
        elif self._speed > 0.0 and self.odometer_m < self._line.end_m:
            self._go_to(min(self.odometer_m + self._speed * passed, self._line.end_m))

    def drive(self, path: FloatArray, speed_mps: float, end_theta: float | None) -> None:
        """Drive along ``path`` (N, 2), which begins here; at its end turn to ``end_theta``, unless that is None."""
        self._forget_future()
        for x, y in path[1:].tolist():
            x0, y0 = self._line.point(self._line.end_m)
            if math.hypot(x - x0, y - y0) > _TINY_M:
                self._line.extend(x, y)
        self._leg_began, self._speed, self._end_theta = self.odometer_m, speed_mps, end_theta
        if self.remaining_m <= _TINY_M:
            self._theta = self.theta if end_theta is None else end_theta
        else:
            self._theta = None

    def set_speed(self, speed_mps: float) -> None:
        """Drive at this speed from now on."""
        self._speed = speed_mps

    def stop(self) -> None:
        """Stand here."""
        theta = self.theta
        self._forget_future()
        self._theta, self._speed = theta, 0.0

    def turn(self, theta: float) -> None:
        """Stand here and turn to ``theta``."""
        self.stop()
        self._theta = theta

    def follow(self, leader: Body, lag_m: float, top_speed_mps: float) -> None:
        """Follow ``leader`` at ``lag_m``: straight to where it is now, and from there along its trail."""
        self.stop()
        self._leader, self._lag_m, self._top_speed = leader, lag_m, top_speed_mps
        self._joined_m = math.hypot(leader.x - self.x, leader.y - self.y)
        self._follow_began, self._leader_began, self._seen_m = self.odometer_m, leader.odometer_m, leader.odometer_m
        self._leg_began = self.odometer_m
        self._straight = (self.x, self.y), (leader.x, leader.y)

    def look(self, sees: bool) -> None:
        """Take whether it sees its leader now. Where it does not, it goes as far as it has seen the leader go."""
        self._sees = sees
        leader = self._leader
        if sees and leader is not None:
            self._seen_m = leader.odometer_m
            if math.hypot(leader.x - self.x, leader.y - self.y) > _TINY_M:
                self._theta = math.atan2(leader.y - self.y, leader.x - self.x)

    def point(self, s: float) -> tuple[float, float]:
        """The place where its odometer says ``s``, as far as it remembers."""
        return self._line.point(s)

    def _target_m(self) -> float:
        """How far it may go behind its leader, on its own odometer."""
        gone = self._seen_m - self._leader_began
        return max(self._follow_began + self._joined_m + gone - self._lag_m, self.odometer_m)

    def _creep(self, s: float) -> None:
        """Go on along the leader's trail, and leave the same trail."""
        leader, began = self._leader, self._follow_began
        assert leader is not None
        if s <= self.odometer_m:
            return
        straight = began + self._joined_m
        if self.odometer_m < straight:
            (x0, y0), (x1, y1) = self._straight
            part = min(s, straight) - began
            f = part / self._joined_m if self._joined_m else 1.0
            self._line.extend(x0 + f * (x1 - x0), y0 + f * (y1 - y0), min(s, straight))
        if s > straight:
            offset = self._leader_began - straight
            for arc, x, y in leader._line.corners(max(self.odometer_m, straight) + offset, s + offset):
                self._line.extend(x, y, arc - offset)
            self._line.extend(*leader.point(s + offset), s)
        self.odometer_m, self._theta = s, None
        self.x, self.y = self._line.point(self._line.end_m)
        self._prune()

    def _go_to(self, s: float) -> None:
        if s > self._line.end_m - _TINY_M:
            s = self._line.end_m
        self.odometer_m = s
        self.x, self.y = self.point(s)
        self._theta = None
        if s >= self._line.end_m:
            self._theta = self._end_theta
        self._prune()

    def _forget_future(self) -> None:
        """Forget what lies ahead: from here on the path is another one."""
        self._line.forget_after(self.odometer_m)
        self._leader, self._sees = None, False

    def _prune(self) -> None:
        """Forget what is farther back than anybody follows, but not at every step."""
        if self.odometer_m - self._line.start_m > 2.0 * _TRAIL_M:
            self._line.forget_before(self.odometer_m - _TRAIL_M)

    def _heading(self) -> float:
        """The direction of the chord of its path around here."""
        back, ahead = max(self.odometer_m - _CHORD_M, self._leg_began), self.odometer_m + _CHORD_M
        (x0, y0), (x1, y1) = self.point(back), self.point(ahead)
        if math.hypot(x1 - x0, y1 - y0) < _TINY_M:
            (x0, y0), (x1, y1) = self.point(self.odometer_m - 0.01), self.point(self.odometer_m + 0.01)
        return wrap_angle(math.atan2(y1 - y0, x1 - x0))
