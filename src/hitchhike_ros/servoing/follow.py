"""Riding behind a marker: the follower drives the driver's track at a constant gap (P17 §3, step 3).

Position-based law for a unicycle. What the camera sees is joined with the own wheel odometry (no localization: that is
off during a ride) to a short trail of where the driver's axle has been. Steering is pure pursuit along that trail, so
boxes that the driver went around are gone around, not cut; the speed holds the gap and feeds the driver's own speed
forward. The law reads no clock; all coordinates are in the follower's ``odom`` frame unless said otherwise.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hitchhike_ros.datatypes import FloatArray, MarkerObservation, Odometry, Pose2D, Positive, Twist2D
from hitchhike_ros.errors import SensorDataError
from hitchhike_ros.geometry import compose, wrap_angle
from hitchhike_ros.robot_model import RobotLimits

# Noise that the own wheels add to a measured step of the driver (chosen).
ODOMETRY_SIGMA_M = 0.003
# An estimated speed below this is none (chosen).
STANDING_MPS = 0.05
# The follower's place on the trail is sought this far ahead of the last one, so that a loop is not cut short (chosen).
REACH_M = 1.0
# A follower farther than this from the trail of a driver that it lost does not go back to it (chosen).
STRAY_M = 0.5

State = Literal["searching", "following", "lost", "stopped"]


@dataclass(frozen=True)
class FollowParameters:
    """Section ``follow``; all values are chosen."""

    gap_gain: Positive = 1.2
    """Closing speed for each metre of gap error, 1/s."""
    lookahead_m: Positive = 0.5
    """Pure pursuit aims at the point of the trail this far ahead."""
    max_bearing_rad: Positive = 0.35
    """The heading keeps the marker's bearing within this; half the field of view is 0.52, half a plate at 0.8 m 0.1."""
    view_gain: Positive = 3.0
    """How fast the bearing may approach that limit, 1/s."""
    max_yaw_rate_rps: Positive = 1.2
    lost_timeout_s: Positive = 0.5
    """Without an observation for longer than this the driver is lost: stop."""
    odometry_timeout_s: Positive = 0.4
    marker_offset_m: Positive = 0.30
    """How far the marker is behind the driver's axle."""
    trail_step_m: Positive = 0.03
    """Distance of the trail's points."""
    driver_acceleration_mps2: Positive = 1.2
    """Standard deviation of the driver's acceleration, for the estimate of its speed."""
    driver_yaw_rate_rps: Positive = 0.5
    """Standard deviation of the driver's yaw rate, for the estimate of its heading."""
    feed_forward_sigma_mps: Positive = 0.3
    """Trust in the speed that the driver tells; it is older than what the camera sees."""


@dataclass(frozen=True)
class Decision:
    """What to do now, and why when it is not following; gap and bearing of the marker as predicted for now."""

    twist: Twist2D
    state: State
    reason: str = ""
    gap_m: float | None = None
    bearing_rad: float | None = None


class FollowLaw:
    """Follows one marker.

    ``camera_x_m`` is how far the camera is ahead of the own axle. The gap is the horizontal distance from camera to
    marker.
    """

    def __init__(self, params: FollowParameters, limits: RobotLimits, camera_x_m: float) -> None:
        self._params, self._limits, self._camera_x = params, limits, camera_x_m
        self._odometry: deque[Odometry] = deque()
        self.reset()

    def reset(self) -> None:
        """Forget the driver; odometry is kept."""
        self._driver: DriverEstimate | None = None
        self._trail = Trail()

    def add_odometry(self, odometry: Odometry) -> None:
        """The newest reading of the wheels.

        Raises:
            SensorDataError: it is not finite.
        """
        if not (math.isfinite(odometry.stamp) and odometry.pose.is_finite() and odometry.twist.is_finite()):
            raise SensorDataError(f"odometry at {odometry.stamp:.2f} s is not finite")
        if self._odometry and odometry.stamp < self._odometry[-1].stamp:  # the clock was reset
            self._odometry.clear()
            self.reset()
        if self._odometry and odometry.stamp == self._odometry[-1].stamp:
            self._odometry.pop()
        self._odometry.append(odometry)
        while odometry.stamp - self._odometry[0].stamp > 1.0:
            self._odometry.popleft()

    def step(
        self,
        now: float,
        observation: MarkerObservation | None,
        odometry: Odometry | None,
        gap_m: float,
        feed_forward_mps: float = 0.0,
    ) -> Decision:
        """The command at time ``now``.

        Args:
            now: in s, on the clock of the stamps.
            observation: of the driver's marker in the newest image, which may be older than ``now``; None when it is
                not in it, or there is no new image.
            odometry: the newest reading; None when :meth:`add_odometry` has it.
            gap_m: the gap to keep.
            feed_forward_mps: the speed that the driver tells, 0 when it tells none.

        Raises:
            SensorDataError: as :meth:`add_odometry`.
        """
        p = self._params
        if odometry is not None:
            self.add_odometry(odometry)
        if observation is not None:
            self._see(observation, feed_forward_mps)
        age = now - self._odometry[-1].stamp if self._odometry else math.inf
        if not age <= p.odometry_timeout_s:
            return Decision(Twist2D(), "stopped", "no odometry" if math.isinf(age) else f"odometry is {age:.2f} s old")
        driver = self._driver
        if driver is None:
            return Decision(Twist2D(), "searching", "marker not seen yet")
        unseen = now - driver.stamp
        if unseen > p.lost_timeout_s:
            return Decision(Twist2D(), "lost", f"marker not seen for {unseen:.2f} s")
        own = self._odometry[-1].pose
        camera, marker = compose(own, Pose2D(self._camera_x)), driver.marker_at(now)
        dx, dy = marker[0] - camera.x, marker[1] - camera.y
        gap, bearing = math.hypot(dx, dy), wrap_angle(math.atan2(dy, dx) - own.theta)
        v = max(0.0, driver.speed + self._closing_speed(gap - gap_m))
        # Bearing's rate is drift - omega.
        across = wrap_angle(driver.heading - own.theta) - bearing
        drift = (driver.speed * math.sin(across) + v * math.sin(bearing)) / max(gap, 0.1)
        omega = self._keep_in_view(v * self._curvature(own), bearing, drift)
        return Decision(self._saturate(v, omega), "following", "", gap, bearing)

    def _see(self, observation: MarkerObservation, feed_forward_mps: float) -> None:
        own = self._pose_at(observation.stamp)
        if own is None or not observation.pose.is_finite() or not np.isfinite(observation.covariance).all():
            return
        p = self._params
        marker = compose(own, observation.pose)
        if self._driver is None:
            self._driver = DriverEstimate(p, observation.stamp, marker, observation.covariance)
            self._trail = Trail((own.x, own.y), self._driver.axle)
        elif observation.stamp > self._driver.stamp:
            if observation.stamp - self._driver.stamp > p.lost_timeout_s:
                # What it did meanwhile was not seen: its speed is unknown again, the way to it is taken as straight.
                self._driver = DriverEstimate(p, observation.stamp, marker, observation.covariance)
                place = self._trail.at(self._trail.advance(own.x, own.y))
                if math.hypot(place[0] - own.x, place[1] - own.y) > STRAY_M:  # it went its own way meanwhile
                    self._trail = Trail((own.x, own.y), self._driver.axle)
            else:
                self._driver.update(observation.stamp, marker, observation.covariance)
            self._trail.extend(self._driver.axle, self._driver.heading, p.trail_step_m)
        if feed_forward_mps > 0.0:
            self._driver.tell_speed(feed_forward_mps)

    def _closing_speed(self, error: float) -> float:
        """What closes a gap error; no faster than half the own acceleration brakes, as the driver may brake too."""
        closing = self._params.gap_gain * error
        return min(closing, math.sqrt(self._limits.max_acceleration_mps2 * error)) if error > 0.0 else closing

    def _curvature(self, own: Pose2D) -> float:
        """Pure pursuit of the trail."""
        s = self._trail.advance(own.x, own.y)
        target = self._trail.at(s + self._params.lookahead_m)
        dx, dy = target[0] - own.x, target[1] - own.y
        lateral = -math.sin(own.theta) * dx + math.cos(own.theta) * dy
        return 2.0 * lateral / max(dx * dx + dy * dy, 0.04)

    def _keep_in_view(self, omega: float, bearing: float, drift: float) -> float:
        """The yaw rate nearest to ``omega`` with which the bearing nears its limit no faster than exponentially.

        ``drift`` is the bearing's rate without turning.
        """
        gain, limit = self._params.view_gain, self._params.max_bearing_rad
        return max(drift - gain * (limit - bearing), min(drift + gain * (limit + bearing), omega))

    def _saturate(self, v: float, omega: float) -> Twist2D:
        """Both scaled together, so that the curvature is kept."""
        max_omega = min(self._params.max_yaw_rate_rps, self._limits.max_yaw_rate_rps)
        scale = max(1.0, v / self._limits.max_speed_mps, abs(omega) / max_omega)
        return Twist2D(v / scale, omega / scale)

    def _pose_at(self, stamp: float) -> Pose2D | None:
        """Own pose when the image was taken, between two readings of the odometry; None outside of what is known."""
        if not self._odometry or not self._odometry[0].stamp - 0.05 <= stamp:
            return None
        after = next((o for o in self._odometry if o.stamp >= stamp), None)
        if after is None:  # the image is newer than the wheels: carry the last reading on
            last = self._odometry[-1]
            dt = stamp - last.stamp
            if dt > self._params.odometry_timeout_s:
                return None
            return compose(last.pose, Pose2D(last.twist.v * dt, 0.0, last.twist.omega * dt))
        before = max((o for o in self._odometry if o.stamp <= stamp), key=lambda o: o.stamp, default=after)
        span = after.stamp - before.stamp
        f = (stamp - before.stamp) / span if span > 0.0 else 0.0
        a, b = before.pose, after.pose
        turn = wrap_angle(b.theta - a.theta)
        return Pose2D(a.x + f * (b.x - a.x), a.y + f * (b.y - a.y), a.theta + f * turn)


class DriverEstimate:
    """Heading and speed of the driver by two small Kalman filters; its position is taken as seen.

    ``marker``, ``axle`` and ``heading`` are in the follower's odometry frame at ``stamp``.
    """

    def __init__(self, params: FollowParameters, stamp: float, marker: Pose2D, covariance: FloatArray) -> None:
        self._params = params
        self.stamp = stamp
        self.heading = wrap_angle(marker.theta + math.pi)
        self._heading_variance = float(covariance[2, 2])
        self.marker = (marker.x, marker.y)
        self._measured = 0.0
        # Distance along its way since it was first seen, and speed; how fast it is at first nobody knows.
        self._state = np.zeros(2)
        self._P = np.diag([float(covariance[0, 0]), 0.5**2])

    @property
    def speed(self) -> float:
        """Speed of the driver in m/s; what is less than its noise is a stand, or the follower would creep up."""
        speed = float(self._state[1])
        return speed if abs(speed) > STANDING_MPS else 0.0

    @property
    def axle(self) -> tuple[float, float]:
        """Where the middle of the driver's axle is."""
        offset = self._params.marker_offset_m
        return self.marker[0] + offset * math.cos(self.heading), self.marker[1] + offset * math.sin(self.heading)

    def marker_at(self, now: float) -> tuple[float, float]:
        """The marker's position carried on to ``now``."""
        ahead = self.speed * max(0.0, now - self.stamp)
        return self.marker[0] + ahead * math.cos(self.heading), self.marker[1] + ahead * math.sin(self.heading)

    def update(self, stamp: float, marker: Pose2D, covariance: FloatArray) -> None:
        """A newer observation: the marker's pose in ``odom``, its covariance in the own base frame."""
        p, dt = self._params, stamp - self.stamp
        predicted = self._heading_variance + (p.driver_yaw_rate_rps * dt) ** 2
        gain = predicted / (predicted + float(covariance[2, 2]))
        self.heading = wrap_angle(self.heading + gain * wrap_angle(marker.theta + math.pi - self.heading))
        self._heading_variance = (1.0 - gain) * predicted
        dx, dy = marker.x - self.marker[0], marker.y - self.marker[1]
        self._measured += dx * math.cos(self.heading) + dy * math.sin(self.heading)
        F = np.array([[1.0, dt], [0.0, 1.0]])
        G = np.array([0.5 * dt * dt, dt]) * p.driver_acceleration_mps2
        self._state = F @ self._state
        self._P = F @ self._P @ F.T + np.outer(G, G)
        self._correct(np.array([1.0, 0.0]), self._measured, float(covariance[0, 0]) + ODOMETRY_SIGMA_M**2)
        self.marker, self.stamp = (marker.x, marker.y), stamp

    def tell_speed(self, speed_mps: float) -> None:
        """The speed from the driver's message."""
        self._correct(np.array([0.0, 1.0]), speed_mps, self._params.feed_forward_sigma_mps**2)

    def _correct(self, H: FloatArray, measured: float, variance: float) -> None:
        K = self._P @ H / (H @ self._P @ H + variance)
        self._state = self._state + K * (measured - H @ self._state)
        self._P = self._P - np.outer(K, H @ self._P)


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

    def at(self, s: float) -> tuple[float, float]:
        """The point at arc length ``s``; past the driver, straight on."""
        if s >= self._s[-1]:
            leg = self._points[-1] - self._points[-2]
            ahead = self._points[-1] + leg * (s - self._s[-1]) / max(float(np.linalg.norm(leg)), 1e-9)
            return float(ahead[0]), float(ahead[1])
        points = np.array(self._points)
        return float(np.interp(s, self._s, points[:, 0])), float(np.interp(s, self._s, points[:, 1]))
