"""The last poses of a robot by their stamps: where it was when a scan or an image was taken."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec

from hitchhike_ros.core.datatypes import Odometry, Pose2D, Positive, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, distance, interpolate, move, twist_between


@dataclass(frozen=True)
class PoseBufferParameters:
    """Which readings are believed, and how far they reach (chosen)."""

    history_s: Positive = 2.0  # how old a scan or an image may be
    max_extrapolation_s: Positive = 0.2  # odometry and scan of one moment may arrive in either order
    max_speed_mps: Positive = 3.0  # a pose that moves faster has jumped
    max_yaw_rate_rps: Positive = 10.0
    still_mps: Positive = 0.02  # a pose that is no faster than this,
    still_rps: Positive = 0.02  # and turns no faster, stands
    twistless_readings: Annotated[int, msgspec.Meta(ge=1)] = 3
    """After so many readings on end without a speed, of a pose that moves, the speed is taken from the poses."""


class _MissingSpeed:
    """Whether a driver leaves one component of the twist at 0 while the pose moves; some fill in the pose alone."""

    def __init__(self, still: float, readings: int) -> None:
        self._still, self._readings, self._count = still, readings, 0

    @property
    def known(self) -> bool:
        """Whether it is so."""
        return self._count >= self._readings

    def of(self, told: float, moved: float) -> float:
        """The speed to believe of a reading that tells ``told``, where the pose has moved at ``moved``."""
        if told != 0.0:
            self._count = 0
        elif not self.known:
            self._count = self._count + 1 if abs(moved) > self._still else 0
        return moved if self.known else told


class PoseBuffer:
    """Checks readings as they come, keeps those of the last moments and tells the pose between and just beyond them.

    Between two readings the pose moves at a constant velocity in the robot's frame (:func:`core.geometry.interpolate`);
    beyond the newest it moves on at that one's twist. All readings are in one frame, ``odom`` as a rule. Where a driver
    tells no twist, readings are kept with that of their poses.

    >>> buffer = PoseBuffer()
    >>> buffer.add(Odometry(1.0, Pose2D(0.0), Twist2D(0.5)))
    >>> buffer.add(Odometry(1.25, Pose2D(0.125), Twist2D(0.5)))
    (Twist2D(v=0.5, omega=0.0), 0.25)
    >>> buffer.at(1.125)
    Pose2D(x=0.0625, y=0.0, theta=0.0)
    >>> buffer.motion(1.125, 1.375)
    Pose2D(x=0.125, y=0.0, theta=0.0)
    >>> buffer.covers(1.5)
    False
    """

    def __init__(self, parameters: PoseBufferParameters | None = None) -> None:
        self._parameters = parameters or PoseBufferParameters()
        self._readings: deque[Odometry] = deque()
        p = self._parameters
        self._missing = tuple(_MissingSpeed(still, p.twistless_readings) for still in (p.still_mps, p.still_rps))

    def __bool__(self) -> bool:
        """Whether there is any reading."""
        return bool(self._readings)

    @property
    def oldest(self) -> Odometry:
        """The reading that has been kept the longest; IndexError where there is none."""
        return self._readings[0]

    @property
    def newest(self) -> Odometry:
        """The last reading; IndexError where there is none."""
        return self._readings[-1]

    @property
    def twistless(self) -> bool:
        """Whether the driver leaves out the speed or the yaw rate, so that it is derived from the poses."""
        return any(missing.known for missing in self._missing)

    def clear(self) -> None:
        """Forget all readings."""
        self._readings.clear()

    def add(self, reading: Odometry) -> tuple[Twist2D, float] | None:
        """Take a reading.

        Returns:
            The twist since the reading before and for how many seconds; None for the first reading, and for one with
            the stamp of the one before, which is left out.

        Raises:
            SensorDataError: the reading is not finite, which changes nothing; or it runs back in time or has jumped:
                then the next one counts from this one, and what was before is forgotten.
        """
        if not (math.isfinite(reading.stamp) and reading.pose.is_finite() and reading.twist.is_finite()):
            raise SensorDataError(f"odometry at {reading.stamp:.2f} s is not finite")
        before, p = self._readings[-1] if self._readings else None, self._parameters
        if before is not None and reading.stamp == before.stamp:
            return None
        problem = None if before is None else self._jump(before, reading)
        if problem is not None:
            self._readings.clear()
        if before is None or problem is not None:
            moved = None
        else:
            dt_s = reading.stamp - before.stamp
            moved = twist_between(before.pose, reading.pose, dt_s), dt_s
            reading = replace(reading, twist=self._believed(reading.twist, moved[0]))
        self._readings.append(reading)
        while self._readings[0].stamp < reading.stamp - p.history_s:
            self._readings.popleft()
        if problem is not None:
            raise SensorDataError(problem)
        return moved

    def covers(self, stamp: float) -> bool:
        """Whether :meth:`at` knows the pose at ``stamp``."""
        reach = self._parameters.max_extrapolation_s
        # A comparison that a NaN fails as well.
        return bool(self) and self.oldest.stamp - reach <= stamp <= self.newest.stamp + reach

    def at(self, stamp: float, what: str = "time asked for") -> Pose2D:
        """The pose at ``stamp``.

        Raises:
            SensorDataError: ``what`` was at that time is too old or too new for the readings, or there are none.
        """
        if not self._readings:
            raise SensorDataError(f"no odometry yet for the {what} at {stamp:.2f} s")
        if not self.covers(stamp):
            reach = f"from {self.oldest.stamp:.2f} s to {self.newest.stamp:.2f} s"
            raise SensorDataError(f"{what} at {stamp:.2f} s, but odometry {reach}")
        after: Odometry | None = None
        for reading in reversed(self._readings):  # most questions are about the last moment
            if reading.stamp <= stamp:
                if after is None:
                    return move(reading.pose, reading.twist, stamp - reading.stamp)
                share = (stamp - reading.stamp) / (after.stamp - reading.stamp)
                return interpolate(reading.pose, after.pose, share)
            after = reading
        return move(self.oldest.pose, self.oldest.twist, stamp - self.oldest.stamp)

    def get(self, stamp: float) -> Pose2D | None:
        """The pose at ``stamp``, None where the readings do not reach."""
        return self.at(stamp) if self.covers(stamp) else None

    def motion(self, since: float, until: float, what: str = "time asked for") -> Pose2D:
        """T_since_until: the pose at ``until`` seen from the pose at ``since``; raises as :meth:`at`."""
        return between(self.at(since, what), self.at(until, what))

    def _believed(self, told: Twist2D, moved: Twist2D) -> Twist2D:
        v, omega = self._missing
        return Twist2D(v.of(told.v, moved.v), omega.of(told.omega, moved.omega))

    def _jump(self, before: Odometry, reading: Odometry) -> str | None:
        """What is wrong with a reading after the one ``before``; None where it follows from it."""
        dt_s, p = reading.stamp - before.stamp, self._parameters
        if dt_s < 0.0:
            return f"odometry went back in time from {before.stamp:.2f} s to {reading.stamp:.2f} s"
        turned = abs(between(before.pose, reading.pose).theta)
        if distance(before.pose, reading.pose) > p.max_speed_mps * dt_s or turned > p.max_yaw_rate_rps * dt_s:
            pose = reading.pose
            return f"odometry jumped to ({pose.x:.2f}, {pose.y:.2f}, {pose.theta:.2f}) within {dt_s:.2f} s"
        return None
