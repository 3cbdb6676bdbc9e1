"""Heading and speed of the driver, from its marker as seen and the speed that it tells."""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.servoing.follow_parameters import FollowParameters

# Noise that the own wheels add to a measured step of the driver (chosen).
ODOMETRY_SIGMA_M = 0.003
# An estimated speed below this counts as a stand (chosen).
STANDING_MPS = 0.05


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
        # Distance along its way since it was first seen, and speed. The speed is unknown at first.
        self._state = np.zeros(2)
        self._P = np.diag([float(covariance[0, 0]), 0.5**2])

    @property
    def speed(self) -> float:
        """Speed of the driver in m/s; 0 when it is below its noise, or the follower would creep up."""
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
