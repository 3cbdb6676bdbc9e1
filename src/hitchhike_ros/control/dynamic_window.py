"""Motions that a differential drive can make in the next seconds, rolled out with its acceleration limits."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Twist2D
from hitchhike_ros.core.robot_model import RobotLimits


def window(
    twist: Twist2D, limits: RobotLimits, reach_s: float, max_speed: float, speeds: int, yaw_rates: int
) -> FloatArray:
    """Target velocities (K, 2) in (v, omega) that can be reached within ``reach_s`` from ``twist``.

    They include the slowest v, standing turns and going straight. ``max_speed`` is kept unless braking to it takes
    longer than ``reach_s``.
    """
    dv, dw = limits.max_acceleration_mps2 * reach_s, limits.max_yaw_acceleration_rps2 * reach_s
    slowest = max(0.0, twist.v - dv)
    v = np.linspace(slowest, max(slowest, min(twist.v + dv, max_speed)), speeds)
    top = limits.max_yaw_rate_rps
    omega = np.linspace(np.clip(twist.omega - dw, -top, top), np.clip(twist.omega + dw, -top, top), yaw_rates)
    omega[np.argmin(np.abs(omega))] = 0.0 if omega[0] <= 0.0 <= omega[-1] else omega[np.argmin(np.abs(omega))]
    return np.stack(np.meshgrid(v, omega, indexing="ij"), axis=-1).reshape(-1, 2)


def roll_out(
    twist: Twist2D, targets: FloatArray, limits: RobotLimits, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Poses (K, P, 3) and velocities (K, P, 2) at ``times`` (P,), from the origin at ``twist`` towards ``targets``."""
    now = np.array([twist.v, twist.omega])
    reach = times[:, None] * (limits.max_acceleration_mps2, limits.max_yaw_acceleration_rps2)
    velocities = now + np.clip(targets[:, None] - now, -reach, reach)
    start = np.broadcast_to(now, (len(targets), 1, 2))
    steps = np.broadcast_to(np.diff(times, prepend=0.0), velocities.shape[:2])
    return _integrate(np.zeros((len(targets), 3)), np.concatenate([start, velocities], axis=1), steps), velocities


def brake(poses: FloatArray, velocities: FloatArray, limits: RobotLimits, samples: int) -> FloatArray:
    """Poses (K, samples, 3) of full braking from ``poses`` (K, 3) at ``velocities`` (K, 2) to a stand."""
    rates = np.array([limits.max_acceleration_mps2, limits.max_yaw_acceleration_rps2])
    duration = (np.abs(velocities) / rates).max(axis=1)
    times = duration[:, None] * np.linspace(0.0, 1.0, samples + 1)
    slower = np.maximum(np.abs(velocities)[:, None] - times[..., None] * rates, 0.0) * np.sign(velocities)[:, None]
    return _integrate(poses, slower, np.diff(times, axis=1))


def _integrate(start: FloatArray, velocities: FloatArray, steps: FloatArray) -> FloatArray:
    """Poses (K, P, 3) after each of the ``steps`` (K, P) in s; ``velocities`` (K, P + 1, 2) are at their ends."""
    mean = 0.5 * (velocities[:, 1:] + velocities[:, :-1])
    turns = mean[..., 1] * steps
    theta = start[:, 2:] + np.cumsum(turns, axis=1)
    middle = theta - 0.5 * turns
    x = start[:, :1] + np.cumsum(mean[..., 0] * steps * np.cos(middle), axis=1)
    y = start[:, 1:2] + np.cumsum(mean[..., 0] * steps * np.sin(middle), axis=1)
    return np.stack([x, y, theta], axis=-1)
