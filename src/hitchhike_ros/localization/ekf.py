"""The papers' extended Kalman filter over the planar pose of one robot (P18 Eqs. 7-19).

Beside the papers' landmarks it takes relative poses of markers and alignments of a scan to the map. Updates are in
Joseph form or in information form, both of which keep the covariance symmetric and positive semi-definite.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, MarkerObservation, Pose2D, PoseEstimate, Positive, Twist2D
from hitchhike_ros.core.geometry import (
    compose,
    compose_jacobians,
    inverse,
    inverse_jacobian,
    move,
    wrap_angle,
    wrap_angles,
)
from hitchhike_ros.localization.motion import MotionNoise, jacobians

# Chi-square quantiles at 99.9 % for 3 degrees of freedom.
GATE_3 = 16.27


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Point landmarks: ``positions`` (N, 2) in ``map`` in m, ``signatures`` (N,)."""

    positions: FloatArray
    signatures: FloatArray

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class LandmarkObservation:
    """Range, bearing and signature of a landmark in ``base_footprint`` (P18 §8.2), with their standard deviations."""

    range_m: float
    bearing_rad: float
    signature: float
    range_sigma_m: Positive
    bearing_sigma_rad: Positive
    signature_sigma: Positive = 0.1

    @property
    def covariance(self) -> FloatArray:
        """Q (3, 3) (P18 Eq. 13)."""
        return np.diag([self.range_sigma_m**2, self.bearing_sigma_rad**2, self.signature_sigma**2])


@dataclass(frozen=True)
class EkfParameters:
    """Noise of the motion and the gate beyond which an observation is taken for something unknown."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    gate: Positive = GATE_3  # squared Mahalanobis distance, 3 degrees of freedom


class Ekf:
    """Mean and covariance of (x, y, theta) in ``map``."""

    def __init__(self, mean: Pose2D, covariance: FloatArray, parameters: EkfParameters | None = None) -> None:
        """``covariance`` is (3, 3), symmetric and positive semi-definite.

        Raises:
            ValueError: the mean is not finite or the covariance is no covariance.
        """
        self._P = check_gaussian(mean, covariance)
        self._parameters = parameters or EkfParameters()
        self._pose = Pose2D(mean.x, mean.y, wrap_angle(mean.theta))

    @property
    def pose(self) -> Pose2D:
        """The mean."""
        return self._pose

    @property
    def covariance(self) -> FloatArray:
        """Sigma (3, 3) in (x, y, theta)."""
        return self._P.copy()

    def estimate(self, stamp: float) -> PoseEstimate:
        """Mean and covariance, stamped."""
        return PoseEstimate(stamp, self._pose, self.covariance)

    def predict(self, twist: Twist2D, dt_s: float) -> None:
        """The robot held ``twist`` for ``dt_s`` > 0 (P18 Eqs. 8-12, with G Sigma G^T)."""
        G, V = jacobians(self._pose.theta, twist, dt_s)
        self._pose = move(self._pose, twist, dt_s)
        self._set(G @ self._P @ G.T + V @ self._parameters.motion.covariance(twist, dt_s) @ V.T)

    def associate(self, observation: LandmarkObservation, landmarks: Landmarks) -> int | None:
        """Index of the most likely landmark (P18 Eqs. 14-18); None when even that one is outside the gate."""
        return self._associate(observation, *_innovations(self._pose, observation, landmarks))

    def update_landmark(
        self, observation: LandmarkObservation, landmarks: Landmarks, index: int | None = None
    ) -> int | None:
        """Correct by one landmark (P18 Eqs. 13-19).

        Args:
            observation: what was seen.
            landmarks: the landmarks of the map.
            index: the landmark seen, where its identity is known; otherwise the most likely one is taken.

        Returns:
            The index of the landmark used, None where none explains the observation.
        """
        innovations, H = _innovations(self._pose, observation, landmarks)
        if index is None:
            index = self._associate(observation, innovations, H)
            if index is None:
                return None
        return index if self._update(innovations[index], H[index], observation.covariance) else None

    def update_marker(self, observation: MarkerObservation, T_map_marker: Pose2D) -> bool:
        """Correct by the relative pose of a known marker; False when it is outside the gate."""
        expected, H = expected_marker(self._pose, T_map_marker)
        seen = observation.pose
        innovation = np.array(
            [seen.x - expected.x, seen.y - expected.y, wrap_angle(seen.theta - expected.theta)], dtype=float
        )
        return self._update(innovation, H, observation.covariance)

    def update_information(self, information: FloatArray, vector: FloatArray) -> None:
        """Correct by a direct measurement z of the pose, which may be known well only in some directions.

        Args:
            information: inverse covariance A (3, 3) of the measurement in (x, y, theta), positive semi-definite.
            vector: A (z - mean), (3,).
        """
        # Sigma (I + A Sigma)^-1 = (Sigma^-1 + A)^-1, but needs the inverse of neither.
        P = np.linalg.solve(np.eye(3) + self._P @ information, self._P)
        self._shift(P @ vector)
        self._set(P)

    def _associate(self, observation: LandmarkObservation, innovations: FloatArray, H: FloatArray) -> int | None:
        if not len(innovations):
            return None
        S = H @ self._P @ H.transpose(0, 2, 1) + observation.covariance
        squared = np.einsum("ni,ni->n", innovations, np.linalg.solve(S, innovations[:, :, None])[:, :, 0])
        best = int(np.argmin(squared + np.log(np.linalg.det(S))))
        return best if squared[best] <= self._parameters.gate else None

    def _update(self, innovation: FloatArray, H: FloatArray, Q: FloatArray) -> bool:
        S = H @ self._P @ H.T + Q
        weighted = np.linalg.solve(S, np.column_stack([innovation, H @ self._P]))
        if float(innovation @ weighted[:, 0]) > self._parameters.gate:
            return False
        K = weighted[:, 1:].T
        self._shift(K @ innovation)
        A = np.eye(3) - K @ H
        self._set(A @ self._P @ A.T + K @ Q @ K.T)
        return True

    def _shift(self, by: FloatArray) -> None:
        p = self._pose
        self._pose = Pose2D(p.x + float(by[0]), p.y + float(by[1]), wrap_angle(p.theta + float(by[2])))

    def _set(self, P: FloatArray) -> None:
        self._P = (P + P.T) / 2


def check_gaussian(mean: Pose2D, covariance: FloatArray) -> FloatArray:
    """The covariance (3, 3) of a pose, exactly symmetric.

    Raises:
        ValueError: the mean is not finite or the covariance is not symmetric and positive semi-definite.
    """
    P = np.array(covariance, dtype=float)
    if not mean.is_finite():
        raise ValueError(f"mean {mean} is not finite")
    if P.shape != (3, 3) or not np.isfinite(P).all():
        raise ValueError(f"covariance {P.tolist()} is not a finite 3 x 3 matrix")
    scale = max(float(np.abs(P).max()), 1e-12)
    if np.abs(P - P.T).max() > 1e-6 * scale or np.linalg.eigvalsh((P + P.T) / 2).min() < -1e-6 * scale:
        raise ValueError(f"covariance {P.tolist()} is not symmetric and positive semi-definite")
    symmetric: FloatArray = (P + P.T) / 2
    return symmetric


def expected_landmarks(pose: Pose2D, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range and bearing (N, 2) of landmarks (N, 2), and H (N, 2, 3) = their Jacobian by the pose (P18 Eqs. 14-16)."""
    expected, H = expected_from(np.array([[pose.x, pose.y, pose.theta]]), positions)
    return expected[0], H[0]


def expected_from(poses: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same as :func:`expected_landmarks` from each of the poses (K, 3): (K, N, 2) and (K, N, 2, 3)."""
    dx, dy = (positions[:, axis] - poses[:, axis, None] for axis in (0, 1))
    q = np.maximum(dx * dx + dy * dy, 1e-12)  # a landmark under the robot has no bearing
    r = np.sqrt(q)
    expected, H = np.empty((*q.shape, 2)), np.zeros((*q.shape, 2, 3))
    expected[..., 0], expected[..., 1] = r, wrap_angles(np.arctan2(dy, dx) - poses[:, 2, None])
    H[..., 0, 0], H[..., 0, 1] = -dx / r, -dy / r
    H[..., 1, 0], H[..., 1, 1], H[..., 1, 2] = dy / q, -dx / q, -1.0
    return expected, H


def expected_marker(pose: Pose2D, T_map_marker: Pose2D) -> tuple[Pose2D, FloatArray]:
    """T_base_marker and its Jacobian (3, 3) by the robot's pose."""
    T_base_map = inverse(pose)
    J, _ = compose_jacobians(T_base_map, T_map_marker)
    return compose(T_base_map, T_map_marker), J @ inverse_jacobian(pose)


def _innovations(pose: Pose2D, observation: LandmarkObservation, landmarks: Landmarks) -> tuple[FloatArray, FloatArray]:
    """Innovations (N, 3) of an observation against each landmark, bearing wrapped, and H (N, 3, 3)."""
    innovations, H = np.empty((len(landmarks), 3)), np.zeros((len(landmarks), 3, 3))
    expected, H[:, :2] = expected_landmarks(pose, landmarks.positions)
    innovations[:, 0] = observation.range_m - expected[:, 0]
    innovations[:, 1] = wrap_angles(observation.bearing_rad - expected[:, 1])
    innovations[:, 2] = observation.signature - landmarks.signatures
    return innovations, H


def mahalanobis_squared(error: FloatArray, covariance: FloatArray) -> float:
    """Squared Mahalanobis distance of a pose error (3,), theta wrapped: the NEES of one estimate."""
    e = np.array([error[0], error[1], wrap_angle(float(error[2]))])
    return float(e @ np.linalg.solve(covariance, e))


def pose_error(estimate: Pose2D, truth: Pose2D) -> FloatArray:
    """Estimate minus truth (3,), theta wrapped."""
    return np.array([estimate.x - truth.x, estimate.y - truth.y, wrap_angle(estimate.theta - truth.theta)])
