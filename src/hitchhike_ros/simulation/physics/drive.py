"""A differential drive's base: velocity controller with watchdog, and odometry from imperfect wheel encoders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, NonNegative, Odometry, Pose2D, Positive, Twist2D
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.core.robot_model import RobotLimits


@dataclass(frozen=True)
class DriveParameters:
    """Section ``simulated_drive``: the base's own controller. Its accelerations are above what velocity_mux asks for,
    so that the base follows; all values are chosen."""

    max_acceleration_mps2: Positive = 1.0
    max_yaw_acceleration_rps2: Positive = 4.0
    max_wheel_torque_nm: Positive = 5.0
    watchdog_s: Positive = 0.5


@dataclass(frozen=True)
class OdometryParameters:
    """Section ``simulated_odometry``: the encoders' imperfection; all values but the ticks are chosen.

    Each wheel's radius differs from the nominal one by a factor drawn once a run, and each stretch of d metres has slip
    noise of standard deviation ``slip_m * sqrt(d)``.
    """

    ticks_per_turn: Positive = 2578.0
    radius_error_sigma: NonNegative = 0.0005
    slip_m: NonNegative = 0.001


class BaseController:
    """Turns commands into a ramped twist; stops when none came for ``watchdog_s``."""

    def __init__(self, limits: RobotLimits, params: DriveParameters) -> None:
        self._limits, self._params = limits, params
        self._target, self._deadline = Twist2D(), -math.inf
        self.twist = Twist2D()

    def command(self, twist: Twist2D, now: float) -> None:
        """Drive ``twist`` from now on, within the robot's limits; one that is not finite stops the robot."""
        limits = self._limits
        if not twist.is_finite():
            twist = Twist2D()
        self._target = Twist2D(_clamp(twist.v, limits.max_speed_mps), _clamp(twist.omega, limits.max_yaw_rate_rps))
        self._deadline = now + self._params.watchdog_s

    def step(self, now: float, dt: float) -> Twist2D:
        """The twist to drive for the next ``dt`` seconds."""
        target = self._target if now <= self._deadline else Twist2D()
        if target != self.twist:
            dv = _clamp(target.v - self.twist.v, self._params.max_acceleration_mps2 * dt)
            dw = _clamp(target.omega - self.twist.omega, self._params.max_yaw_acceleration_rps2 * dt)
            self.twist = Twist2D(self.twist.v + dv, self.twist.omega + dw)
        return self.twist

    def wheel_speeds(self) -> tuple[float, float]:
        """Speeds of the left and the right wheel in rad/s for the present twist."""
        half = self.twist.omega * self._limits.wheel_separation_m / 2.0
        radius = self._limits.wheel_radius_m
        return (self.twist.v - half) / radius, (self.twist.v + half) / radius


class WheelOdometry:
    """Dead reckoning from the angles of both wheels (P18 Eqs. 1–6)."""

    def __init__(
        self, limits: RobotLimits, params: OdometryParameters, rng: np.random.Generator, start_s: float = 0.0
    ) -> None:
        self._limits, self._params, self._rng = limits, params, rng
        self._scale = 1.0 + params.radius_error_sigma * rng.standard_normal(2)
        self._angles = np.zeros(2)  # true
        self._measured = np.zeros(2)  # with slip and radius error, not yet cut into ticks
        self._ticks = np.zeros(2)
        self.odometry = Odometry(start_s, Pose2D(), Twist2D())

    def update(self, stamp: float, angles: FloatArray) -> Odometry:
        """Read the encoders: ``angles`` (2,) in rad have the left and the right wheel turned since the start."""
        params, radius = self._params, self._limits.wheel_radius_m
        turned = angles - self._angles
        slip = params.slip_m * np.sqrt(np.abs(turned) * radius) / radius * self._rng.standard_normal(2)
        self._measured += turned * self._scale + slip
        self._angles = np.array(angles)
        ticks = np.floor(self._measured * params.ticks_per_turn / (2.0 * math.pi))
        left, right = ((ticks - self._ticks) * 2.0 * math.pi / params.ticks_per_turn * radius).tolist()
        self._ticks = ticks
        dt = stamp - self.odometry.stamp
        pose = integrate_wheels(self.odometry.pose, left, right, self._limits.wheel_separation_m)
        beta = (right - left) / self._limits.wheel_separation_m
        twist = Twist2D((left + right) / 2.0 / dt, beta / dt) if dt > 0.0 else self.odometry.twist
        self.odometry = Odometry(stamp, pose, twist)
        return self.odometry


def integrate_wheels(pose: Pose2D, left: float, right: float, separation: float) -> Pose2D:
    """The pose after the wheels ran ``left`` and ``right`` metres (P18 Eqs. 1–6, with the sign of Eq. 5 mended).

    β = (r - l) / W, R = l / β, C = P - (R + W/2)(sin θ, -cos θ), P' = C + (R + W/2)(sin θ', -cos θ'); straight when
    r = l. Written by the chord, which is the same and has no pole at β = 0.
    """
    beta, length = (right - left) / separation, (left + right) / 2.0
    half = beta / 2.0
    chord = length * (math.sin(half) / half if abs(half) > 1e-6 else 1.0 - half * half / 6.0)
    heading = pose.theta + half
    return Pose2D(pose.x + chord * math.cos(heading), pose.y + chord * math.sin(heading), wrap_angle(pose.theta + beta))


def _clamp(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
