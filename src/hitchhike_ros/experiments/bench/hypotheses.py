"""The papers' filter where landmarks look alike: several Gaussians, one for each way to explain what was seen.

Beside each pose it could be seen from, an observation may be of nothing that is in the map. The observations of one
picture are given to landmarks jointly, no landmark twice, and wrong explanations die out when later pictures speak
against them (Reid, 1979; as a sum of Gaussians Alspach and Sorenson, 1972).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive, Twist2D
from hitchhike_ros.core.geometry import compose, compose_jacobians, wrap_angle, wrap_angles
from hitchhike_ros.localization.ekf import Ekf, EkfParameters, LandmarkObservation, check_gaussian, expected_from
from hitchhike_ros.localization.motion import MotionNoise

IndexArray = NDArray[np.intp]

_WITHIN_PICTURE = 4  # times as many are followed within a picture as after it (chosen)
_NOTHING = -1  # the landmark of an observation that is of none


@dataclass(frozen=True)
class HypothesesParameters:
    """What is likely, and how many explanations are followed.

    ``clutter_density`` is the rate of observations of nothing in the map over that of a landmark in view, per picture
    and per m and rad of the field of view.
    """

    motion: MotionNoise = field(default_factory=MotionNoise)
    clutter_density: Positive = 0.05
    gate: Positive = 5.99  # chi-square quantile at 95 % for range and bearing
    most: Annotated[int, msgspec.Meta(ge=1)] = 12
    merge: Positive = 1.0  # squared Mahalanobis distance within which two hypotheses are one


class Hypotheses:
    """Weighted Gaussians of (x, y, theta) in ``map``, the most likely first."""

    def __init__(self, mean: Pose2D, covariance: FloatArray, parameters: HypothesesParameters | None = None) -> None:
        """``covariance`` is (3, 3), symmetric and positive semi-definite.

        Raises:
            ValueError: the mean is not finite or the covariance is none.
        """
        self._parameters = parameters or HypothesesParameters()
        self._poses = np.array([[mean.x, mean.y, wrap_angle(mean.theta)]])
        self._P = check_gaussian(mean, covariance)[None]
        self._log_weights = np.zeros(1)
        self._moved = self._standing()

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def pose(self) -> Pose2D:
        """Mean of the most likely hypothesis."""
        return compose(Pose2D(*self._poses[0].tolist()), self._moved.pose)

    @property
    def covariance(self) -> FloatArray:
        """Sigma (3, 3) of the most likely hypothesis."""
        return self._after_motion(Pose2D(*self._poses[0].tolist()), self._P[0])

    @property
    def weights(self) -> FloatArray:
        """Probabilities (N,), falling; they add up to 1."""
        weights: FloatArray = np.exp(self._log_weights)
        return weights

    def predict(self, twist: Twist2D, dt_s: float) -> None:
        """The robot held ``twist`` for ``dt_s`` > 0."""
        self._moved.predict(twist, dt_s)

    def correct(
        self, picture: Sequence[LandmarkObservation], positions: FloatArray, share: float = 1.0
    ) -> tuple[int | None, ...]:
        """Correct by what was seen at one moment, by range and bearing alone.

        Args:
            picture: what was seen, no landmark twice.
            positions: the landmarks (N, 2) in ``map`` in m.
            share: of the observations' information, above 0 and up to 1, that earlier pictures have not told already.
                Their likelihoods are taken to this power.

        Returns:
            For each observation the landmark that the most likely hypothesis gives it to.
        """
        self._move()
        given = np.full((len(self), 0), _NOTHING)
        for observation in picture:
            given = self._branch(observation, positions, share, given)
        best = self._merge()
        return tuple(None if index == _NOTHING else int(index) for index in given[best])

    def _branch(
        self, observation: LandmarkObservation, positions: FloatArray, share: float, given: IndexArray
    ) -> IndexArray:
        """Each hypothesis with each landmark left to it, or with none; ``given`` (N, earlier observations), one more.

        A likelihood N(z; h, R) to the power s is N(z; h, R / s) times a factor that is the same for all landmarks and
        matters beside clutter.
        """
        p = self._parameters
        expected, H = expected_from(self._poses, positions)
        innovation = np.array([observation.range_m, observation.bearing_rad]) - expected
        innovation[..., 1] = wrap_angles(innovation[..., 1])
        R = observation.covariance[:2, :2]
        HPH = H @ self._P[:, None] @ H.swapaxes(-1, -2)
        squared, _ = _mahalanobis_squared(innovation, HPH + R)
        weak, det = _mahalanobis_squared(innovation, HPH + R / share)
        peak = math.sqrt(float(np.linalg.det(R)))
        over_clutter = -share * math.log(2.0 * math.pi * peak * p.clutter_density)
        gain = over_clutter - 0.5 * (weak + np.log(det * (share / peak) ** 2))
        free = ~(given[:, :, None] == np.arange(len(positions))).any(axis=1)
        gain = np.where(free & (squared <= p.gate), gain, -np.inf)

        scores = self._log_weights[:, None] + np.column_stack([gain, np.zeros(len(self))])
        kept = np.argsort(-scores, axis=None, kind="stable")[: _WITHIN_PICTURE * p.most]
        kept = kept[scores.flat[kept] > -np.inf]
        parent, index = np.divmod(kept, len(positions) + 1)
        self._log_weights, self._poses, self._P = scores.flat[kept], self._poses[parent], self._P[parent]
        seen = np.flatnonzero(index < len(positions))
        of = parent[seen], index[seen]
        self._update(seen, innovation[of], H[of], R / share)
        return np.column_stack([given[parent], np.where(index < len(positions), index, _NOTHING)])

    def _update(self, which: IndexArray, innovation: FloatArray, H: FloatArray, R: FloatArray) -> None:
        """As the papers' filter (P18 Eq. 19, in Joseph form), for hypotheses ``which`` (K,) of their innovations."""
        P = self._P[which]
        PH = P @ H.swapaxes(1, 2)
        K = PH @ np.linalg.inv(H @ PH + R)
        self._poses[which] += (K @ innovation[:, :, None])[:, :, 0]
        self._poses[which, 2] = wrap_angles(self._poses[which, 2])
        A = np.eye(3) - K @ H
        self._P[which] = A @ P @ A.swapaxes(1, 2) + K @ R @ K.swapaxes(1, 2)

    def _merge(self) -> int:
        """Make hypotheses near a more likely one one with it, keep the most likely; index of the first one before."""
        order = np.argsort(-self._log_weights, kind="stable")
        best = int(order[0])
        merged: list[tuple[float, FloatArray, FloatArray]] = []
        while len(order) and len(merged) < self._parameters.most:
            centre = order[0]
            away = self._poses[order] - self._poses[centre]
            away[:, 2] = wrap_angles(away[:, 2])
            # A little is added because a pose that is known exactly has a covariance without inverse.
            information = np.linalg.inv(self._P[centre] + 1e-12 * np.eye(3))
            near = np.einsum("ni,ij,nj->n", away, information, away) <= self._parameters.merge
            merged.append(self._moments(order[near], away[near]))
            order = order[~near]
        merged.sort(key=lambda hypothesis: -hypothesis[0])
        log_weights = np.array([hypothesis[0] for hypothesis in merged])
        self._log_weights = log_weights - np.logaddexp.reduce(log_weights)
        self._poses = np.array([hypothesis[1] for hypothesis in merged])
        self._P = np.array([hypothesis[2] for hypothesis in merged])
        return best

    def _moments(self, which: IndexArray, away: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Log weight, mean and covariance of hypotheses that lie ``away`` (K, 3) from the first of them."""
        log_weight = float(np.logaddexp.reduce(self._log_weights[which]))
        weights = np.exp(self._log_weights[which] - log_weight)
        shift = weights @ away
        spread = away - shift
        pose = self._poses[which[0]] + shift
        pose[2] = wrap_angle(float(pose[2]))
        P = np.einsum("n,nij->ij", weights, self._P[which]) + (spread.T * weights) @ spread
        return log_weight, pose, (P + P.T) / 2

    def _move(self) -> None:
        poses = [Pose2D(*pose) for pose in self._poses.tolist()]
        self._P = np.array([self._after_motion(pose, P) for pose, P in zip(poses, self._P, strict=True)])
        moved = [compose(pose, self._moved.pose) for pose in poses]
        self._poses = np.array([[pose.x, pose.y, pose.theta] for pose in moved])
        self._moved = self._standing()

    def _after_motion(self, pose: Pose2D, P: FloatArray) -> FloatArray:
        J_pose, J_moved = compose_jacobians(pose, self._moved.pose)
        after: FloatArray = J_pose @ P @ J_pose.T + J_moved @ self._moved.covariance @ J_moved.T
        return after

    def _standing(self) -> Ekf:
        """The motion since the last picture, the same for all hypotheses in the frame of the robot at that moment."""
        return Ekf(Pose2D(), np.zeros((3, 3)), EkfParameters(self._parameters.motion))


def _mahalanobis_squared(innovation: FloatArray, S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared distances of innovations (..., 2) and determinants of their covariances (..., 2, 2)."""
    a, b = innovation[..., 0], innovation[..., 1]
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    return (a * a * S[..., 1, 1] - 2.0 * a * b * S[..., 0, 1] + b * b * S[..., 0, 0]) / det, det
