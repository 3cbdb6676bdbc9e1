"""Noise and Jacobians of the velocity motion model (P18 Eqs. 7-12), and estimates carried from one time to another.

The motion itself is ``core.geometry.move``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, NonNegative, Pose2D, PoseEstimate, Positive, Twist2D
from hitchhike_ros.core.geometry import arc, between, compose, compose_jacobians


@dataclass(frozen=True)
class MotionNoise:
    """Noise in control space (P18 Eq. 10): var(v) = a1 v^2 + a2 w^2, var(w) = a3 v^2 + a4 w^2.

    The papers hold a velocity for one time step. Here a step lasts ``period_s`` and a shorter or longer interval gets
    the variance of the same random walk, so that the rate of the odometry does not matter (chosen).

    The values hold at 0.5 m/s for wheels whose slip is 1 mm in the first metre and grows with the root of the way, and
    whose radii are known to 0.05 %. Over the 5 m within which scans correct the pose, the radii add as much again.
    """

    alpha_1: NonNegative = 0.000025  # 1
    alpha_2: NonNegative = 0.00001  # m^2
    alpha_3: NonNegative = 0.001  # 1/m^2
    alpha_4: NonNegative = 0.0002  # 1
    period_s: Positive = 0.1

    def covariance(self, twist: Twist2D, dt_s: float) -> FloatArray:
        """M (2, 2) in (v, omega) of a velocity held for ``dt_s`` > 0 (P18 Eq. 10)."""
        v2, w2 = twist.v**2, twist.omega**2
        steps = self.period_s / dt_s
        return np.diag(
            [(self.alpha_1 * v2 + self.alpha_2 * w2) * steps, (self.alpha_3 * v2 + self.alpha_4 * w2) * steps]
        )


def jacobians(theta: float, twist: Twist2D, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """G (3, 3) = d move / d pose and V (3, 2) = d move / d (v, omega) (P18 Eqs. 8 and 9)."""
    s, c, ds, dc = arc(twist.omega * dt_s)
    cos, sin = math.cos(theta), math.sin(theta)
    path = twist.v * dt_s
    G = np.array([[1.0, 0.0, path * (-sin * s - cos * c)], [0.0, 1.0, path * (cos * s - sin * c)], [0.0, 0.0, 1.0]])
    V = dt_s * np.array(
        [
            [cos * s - sin * c, path * (cos * ds - sin * dc)],
            [sin * s + cos * c, path * (sin * ds + cos * dc)],
            [0.0, 1.0],
        ]
    )
    return G, V


def carried(estimate: PoseEstimate, T_then_now: Pose2D, now: float) -> PoseEstimate:
    """An estimate after a motion that is known exactly, as of the time ``now``."""
    J, _ = compose_jacobians(estimate.pose, T_then_now)
    return PoseEstimate(now, compose(estimate.pose, T_then_now), J @ estimate.covariance @ J.T)


def carried_on(estimate: PoseEstimate, then: Pose2D | None, odom: Pose2D | None, now: float) -> PoseEstimate:
    """An estimate of the own pose, carried by the wheels to ``now``; as it is where they do not tell.

    ``then`` and ``odom`` are the own poses in ``odom``, at the estimate's time and at ``now``.
    """
    return estimate if then is None or odom is None else carried(estimate, between(then, odom), now)
