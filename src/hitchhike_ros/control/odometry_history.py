"""How the robot has moved lately, to carry a pose from the stamp it is of to the stamp it is wanted at."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from hitchhike_ros.core.datatypes import Odometry, Pose2D, Twist2D
from hitchhike_ros.core.geometry import between, compose, wrap_angle

_KEPT_S = 2.0
_EXTRAPOLATED_S = 0.15  # odometry and scan of one moment may arrive in either order


class OdometryHistory:
    """Readings of the last two seconds."""

    def __init__(self) -> None:
        self._readings: deque[Odometry] = deque()

    def add(self, odometry: Odometry) -> None:
        """Take the newest reading; one that is older than the last starts afresh (a simulation was reset)."""
        if self._readings and odometry.stamp < self._readings[-1].stamp:
            self._readings.clear()
        self._readings.append(odometry)
        while odometry.stamp - self._readings[0].stamp > _KEPT_S:
            self._readings.popleft()

    def clear(self) -> None:
        self._readings.clear()

    @property
    def stamp(self) -> float | None:
        """Of the newest reading, s."""
        return self._readings[-1].stamp if self._readings else None

    @property
    def twist(self) -> Twist2D:
        """Of the newest reading."""
        return self._readings[-1].twist if self._readings else Twist2D()

    def motion(self, since: float, until: float) -> Pose2D | None:
        """The pose at ``until`` in the base frame at ``since``; None where the readings do not reach."""
        start, end = self.at(since), self.at(until)
        return None if start is None or end is None else between(start, end)

    def at(self, stamp: float) -> Pose2D | None:
        """Pose in ``odom`` at ``stamp``; None where the readings do not reach."""
        if not self._readings or not self._readings[0].stamp <= stamp <= self._readings[-1].stamp + _EXTRAPOLATED_S:
            return None
        last = self._readings[-1]
        if stamp >= last.stamp:
            dt = stamp - last.stamp
            middle = compose(last.pose, Pose2D(theta=0.5 * last.twist.omega * dt))
            moved = compose(middle, Pose2D(last.twist.v * dt))
            return Pose2D(moved.x, moved.y, wrap_angle(last.pose.theta + last.twist.omega * dt))
        after = bisect_left(self._readings, stamp, key=lambda r: r.stamp)
        a, b = self._readings[max(after - 1, 0)], self._readings[after]
        u = (stamp - a.stamp) / (b.stamp - a.stamp) if b.stamp > a.stamp else 0.0
        turn = wrap_angle(b.pose.theta - a.pose.theta)
        return Pose2D(
            a.pose.x + u * (b.pose.x - a.pose.x),
            a.pose.y + u * (b.pose.y - a.pose.y),
            wrap_angle(a.pose.theta + u * turn),
        )
