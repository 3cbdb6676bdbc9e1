"""Heading and speed of the driver, from its marker as seen and the speed that it tells."""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import compose, inverse, wrap_angle
from hitchhike_ros.servoing.follow_parameters import FollowParameters

# Noise that the own wheels add to a measured step of the driver (chosen).
ODOMETRY_SIGMA_M = 0.003
# An estimated speed below this counts as a stand (chosen).
STANDING_MPS = 0.05
# Where the marker is on a driver that does not tell it: that of the P3DX in ``urdf``, in its ``base_footprint``.
USUAL_MARKER = Pose2D(-0.30, 0.0, math.pi)


class DriverEstimate:
    """Heading and speed of the driver by two small Kalman filters; its position is taken as seen.

    ``marker``, ``axle`` and ``heading`` are in the follower's odometry frame at ``stamp``.
    """

    def __init__(
        self,
        params: FollowParameters,
        stamp: float,
        marker: Pose2D,
        covariance: FloatArray,
        T_driver_marker: Pose2D = USUAL_MARKER,
    ) -> None:
        """Begin with one observation.

        Args:
            params: noise of the driver's motion.
            stamp: of the image, s.
            marker: in ``odom``.
            covariance: of the marker's pose (3, 3), in the own base frame.
            T_driver_marker: where the marker is mounted, in the driver's ``base_footprint``.
        """
        self._params, self._T_driver_marker = params, T_driver_marker
        self.stamp = stamp
        self.heading = wrap_angle(marker.theta - T_driver_marker.theta)
        self._heading_variance = float(covariance[2, 2])
        self.marker = (marker.x, marker.y)
        self._measured = 0.0
        # Distance along its way since it was first seen, and speed. The speed is unknown at first.
        self._state = np.zeros(2)
        self._P = np.diag([float(covariance[0, 0]), 0.5**2])
        self._told: tuple[float, float] | None = None  # the speed that was taken last, and when it was told

    @property
    def speed(self) -> float:
        """Speed of the driver in m/s; 0 when it is below its noise, or the follower would creep up."""
        speed = float(self._state[1])
        return speed if abs(speed) > STANDING_MPS else 0.0

    @property
    def axle(self) -> tuple[float, float]:
        """Where the middle of the driver's axle is."""
        mount = self._T_driver_marker
        facing = Pose2D(*self.marker, wrap_angle(self.heading + mount.theta))
        base = compose(facing, inverse(mount))
        return base.x, base.y

    def marker_at(self, now: float) -> tuple[float, float]:
        """The marker's position carried on to ``now``."""
        ahead = self.speed * max(0.0, now - self.stamp)
        return self.marker[0] + ahead * math.cos(self.heading), self.marker[1] + ahead * math.sin(self.heading)

    def update(self, stamp: float, marker: Pose2D, covariance: FloatArray) -> None:
        """A newer observation: the marker's pose in ``odom``, its covariance in the own base frame."""
        p, dt, before = self._params, stamp - self.stamp, self.axle
        predicted = self._heading_variance + (p.driver_yaw_rate_rps * dt) ** 2
        gain = predicted / (predicted + float(covariance[2, 2]))
        self.heading = wrap_angle(
            self.heading + gain * wrap_angle(marker.theta - self._T_driver_marker.theta - self.heading)
        )
        self._heading_variance = (1.0 - gain) * predicted
        # Of the axle: a marker beside it, or far behind, swings out when the driver turns.
        self.marker, self.stamp = (marker.x, marker.y), stamp
        axle = self.axle
        dx, dy = axle[0] - before[0], axle[1] - before[1]
        self._measured += dx * math.cos(self.heading) + dy * math.sin(self.heading)
        F = np.array([[1.0, dt], [0.0, 1.0]])
        G = np.array([0.5 * dt * dt, dt]) * p.driver_acceleration_mps2
        self._state = F @ self._state
        self._P = F @ self._P @ F.T + np.outer(G, G)
        self._correct(np.array([1.0, 0.0]), self._measured, float(covariance[0, 0]) + ODOMETRY_SIGMA_M**2)

    def tell_speed(self, speed_mps: float, told_at: float | None = None) -> None:
        """The speed from the driver's message, which counts once however often it is passed on.

        Args:
            speed_mps: as told.
            told_at: when, on the clock of the stamps. What was told at another time than that of the newest image says
                less, as the driver may have sped up or slowed down since. Without it the same speed again is no news.
        """
        told = (speed_mps, self.stamp if told_at is None else told_at)
        if self._told is not None and (told[0] == self._told[0] if told_at is None else told[1] <= self._told[1]):
            return
        self._told = told
        changed = self._params.driver_acceleration_mps2 * (self.stamp - told[1])
        self._correct(np.array([0.0, 1.0]), speed_mps, self._params.feed_forward_sigma_mps**2 + changed**2)

    def _correct(self, H: FloatArray, measured: float, variance: float) -> None:
        K = self._P @ H / (H @ self._P @ H + variance)
        self._state = self._state + K * (measured - H @ self._state)
        self._P = self._P - np.outer(K, H @ self._P)
