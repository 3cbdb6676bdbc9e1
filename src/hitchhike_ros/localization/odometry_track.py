"""The last readings of the wheels: what each adds, and where the robot was when a scan was taken."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import Odometry, Pose2D, Positive, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, move, twist_between


@dataclass(frozen=True)
class OdometryTrackParameters:
    """Which readings are believed, and how far they reach (chosen)."""

    history_s: Positive = 2.0  # how old a scan or an image may be
    max_extrapolation_s: Positive = 0.2  # how much newer than the odometry
    max_speed_mps: Positive = 3.0  # odometry that moves faster has jumped
    max_yaw_rate_rps: Positive = 10.0


class OdometryTrack:
    """Checks readings and keeps those of the last moments."""

    def __init__(self, parameters: OdometryTrackParameters) -> None:
        self._parameters = parameters
        self._history: deque[Odometry] = deque()

    def __bool__(self) -> bool:
        """Whether there is any reading."""
        return bool(self._history)

    @property
    def oldest(self) -> Odometry:
        """Reading that is kept the longest."""
        return self._history[0]

    @property
    def newest(self) -> Odometry:
        """Last reading."""
        return self._history[-1]

    def clear(self) -> None:
        """Forget all."""
        self._history.clear()

    def add(self, odometry: Odometry) -> tuple[Twist2D, float] | None:
        """Take a reading; the twist since the one before and for how long, None where no time has passed.

        Raises:
            SensorDataError: the reading is not finite, runs back in time or has jumped; after a jump, in time or in
                space, the next one counts from this one.
        """
        if not (np.isfinite(odometry.stamp) and odometry.pose.is_finite() and odometry.twist.is_finite()):
            raise SensorDataError(f"odometry at {odometry.stamp:.2f} s is not finite")
        motion = self._motion_to(odometry) if self._history else None
        self._history.append(odometry)
        while self._history[0].stamp < odometry.stamp - self._parameters.history_s:
            self._history.popleft()
        return motion

    def at(self, stamp: float, what: str = "time asked for") -> Pose2D:
        """Pose in the robot's ``odom`` frame at ``stamp``.

        Raises:
            SensorDataError: ``what`` was at that time is too old or too new for the odometry.
        """
        if not self._history:
            raise SensorDataError(f"no odometry yet for the {what} at {stamp:.2f} s")
        oldest, newest, p = self._history[0].stamp, self._history[-1].stamp, self._parameters
        # A comparison that a NaN fails as well.
        if not oldest - p.max_extrapolation_s <= stamp <= newest + p.max_extrapolation_s:
            raise SensorDataError(f"{what} at {stamp:.2f} s, but odometry from {oldest:.2f} s to {newest:.2f} s")
        after = self._history[-1]
        if stamp >= newest:
            return move(after.pose, after.twist, stamp - newest)
        for before in reversed(self._history):
            if before.stamp <= stamp:
                dt = after.stamp - before.stamp
                return move(before.pose, twist_between(before.pose, after.pose, dt), stamp - before.stamp)
            after = before
        return move(after.pose, after.twist, stamp - after.stamp)

    def seen_from_now(self, stamp: float, what: str = "time asked for") -> Pose2D:
        """T_now_then: where the robot was at ``stamp``, seen from where it is at the newest reading; raises as `at`."""
        then = self.at(stamp, what)
        return between(self._history[-1].pose, then)

    def _motion_to(self, odometry: Odometry) -> tuple[Twist2D, float] | None:
        before, p = self._history[-1], self._parameters
        dt = odometry.stamp - before.stamp
        if dt == 0.0:
            self._history.pop()
            return None
        if dt < 0.0:
            self._history = deque([odometry])
            raise SensorDataError(f"odometry went back in time from {before.stamp:.2f} s to {odometry.stamp:.2f} s")
        twist = twist_between(before.pose, odometry.pose, dt)
        if abs(twist.v) > p.max_speed_mps or abs(twist.omega) > p.max_yaw_rate_rps:
            self._history = deque([odometry])
            raise SensorDataError(
                f"odometry jumped to ({odometry.pose.x:.2f}, {odometry.pose.y:.2f}, {odometry.pose.theta:.2f}) "
                f"within {dt:.2f} s"
            )
        return twist, dt
