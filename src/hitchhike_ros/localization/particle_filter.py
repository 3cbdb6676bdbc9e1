"""Particles over the planar pose of one robot: sampling of the motion, weights, and resampling to a size set by KLD.

Fox, Adapting the sample size in particle filters through KLD-sampling, IJRR 22(12), 2003. Nothing here knows of
sensors: a scan comes in as a log likelihood of each particle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive, Twist2D, UnitInterval
from hitchhike_ros.core.geometry import wrap_angles
from hitchhike_ros.localization.motion import MotionNoise

Count = Annotated[int, msgspec.Meta(ge=2)]


@dataclass(frozen=True)
class ParticleParameters:
    """Size of the cloud, its sensor model and its recovery. Values are those of amcl where it has them, else chosen."""

    min_particles: Count = 400
    max_particles: Count = 4000
    kld_error: Positive = 0.05
    kld_quantile: Positive = 2.33  # of the normal distribution, at 99 %
    bin_m: Positive = 0.5
    bin_rad: Positive = 0.1745
    resample_share: UnitInterval = 0.5  # of the particles that must be effective
    kernel: UnitInterval = 0.2  # width of the kernel about each resampled particle, as a share of the cloud's
    moving_kernel: UnitInterval = 0.5  # while the cloud converges
    beams: Count = 80
    outlier_share: Positive = 0.05  # likelihood of a beam that hits what is not in the map, relative to a perfect beam
    effective_share: UnitInterval = 0.4  # of the particles that one observation may leave effective
    tolerance_m: Positive = 0.15  # of end points, while there are several hypotheses
    right_share: UnitInterval = 0.05  # replaces effective_share while there are several hypotheses
    converging_power: UnitInterval = 0.1  # a likelihood tempered below it: the cloud has yet to converge
    # A cloud counts as one hypothesis while it is narrower than this.
    one_cluster_m: Positive = 0.3
    one_cluster_rad: Positive = 0.3
    alpha_slow: UnitInterval = 0.005  # w_slow and w_fast of the augmented filter, per scan
    alpha_fast: UnitInterval = 0.2
    lost_ratio: UnitInterval = 0.95  # w_fast by w_slow below which other poses are tried
    poor_fit: UnitInterval = 0.75  # w_fast below which they are tried as well
    near_m: Positive = 4.0  # half of the candidates lie within this, as robots are seldom carried far ...
    near_rad: Positive = 0.1
    look_every: Annotated[int, msgspec.Meta(ge=1)] = 10  # every so many scans, while nothing is wrong
    candidates: Count = 600  # random poses that are tried
    aligned: Annotated[int, msgspec.Meta(ge=1)] = 1  # how many of the likeliest of each half are aligned
    better_fit: UnitInterval = 0.03  # share of the beams by which such a pose must fit better
    random_share: UnitInterval = 0.2  # of the particles that go there
    seed: int = 0


class ParticleFilter:
    """A weighted cloud of poses in ``map``."""

    def __init__(self, motion: MotionNoise, parameters: ParticleParameters, rng: np.random.Generator) -> None:
        self._motion, self._parameters, self._rng = motion, parameters, rng
        self.poses: FloatArray = np.zeros((0, 3))
        self.weights: FloatArray = np.zeros(0)
        self._converging = False

    def seed(self, mean: Pose2D, covariance: FloatArray) -> None:
        """Particles about ``mean``, spread along the eigenvectors of ``covariance`` (3, 3) (P17 §6.2, P18 Eq. 22)."""
        values, vectors = np.linalg.eigh(covariance)
        p = self._parameters
        wide = math.sqrt(max(float(covariance[0, 0] + covariance[1, 1]), 0.0)) > p.one_cluster_m
        spread = self._rng.standard_normal((p.max_particles if wide else p.min_particles, 3))
        self.replace(np.array([mean.x, mean.y, mean.theta]) + spread * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)

    def replace(self, poses: FloatArray) -> None:
        """A new cloud (N, 3) of equal weights."""
        self.poses = np.array(poses)
        self.poses[:, 2] = wrap_angles(self.poses[:, 2])
        self.weights = np.full(len(poses), 1.0 / len(poses))

    def predict(self, twist: Twist2D, dt_s: float) -> None:
        """Each particle moves by a twist of its own, drawn about the measured one (P18 Eqs. 10 and 11)."""
        sigma = np.sqrt(np.diag(self._motion.covariance(twist, dt_s)))
        v, omega = np.array([[twist.v], [twist.omega]]) + sigma[:, None] * self._rng.standard_normal(
            (2, len(self.poses))
        )
        half = 0.5 * omega * dt_s
        chord, heading = v * dt_s * np.sinc(half / np.pi), self.poses[:, 2] + half
        self.poses[:, 0] += chord * np.cos(heading)
        self.poses[:, 1] += chord * np.sin(heading)
        self.poses[:, 2] = wrap_angles(heading + half)

    def weigh(self, log_likelihood: FloatArray) -> None:
        """Multiply the weights by the likelihood (N,) of an observation.

        A likelihood that is so much narrower than the cloud that few particles would be left is tempered until
        ``effective_share`` of them stay effective. The next observations do the rest.
        """
        log_weights = np.log(np.maximum(self.weights, 1e-300))
        log_likelihood = log_likelihood - log_likelihood.max()
        # Of several hypotheses most are wrong, and must be allowed to vanish.
        share = self._parameters.effective_share if self.is_one_cluster else self._parameters.right_share
        # Powers are halved on a logarithmic scale; the smallest leaves all as it was.
        low, high, power = 1e-9, 1.0, 1.0
        for _ in range(12):
            weights = np.exp(log_weights + power * log_likelihood)
            enough = weights.sum() ** 2 >= share * len(weights) * (weights**2).sum()
            if enough and power == high:
                break
            low, high = (power, high) if enough else (low, power)
            power = math.sqrt(low * high)
        if power != high:
            power, weights = low, np.exp(log_weights + low * log_likelihood)
        self._converging = power < self._parameters.converging_power
        self.weights = weights / weights.sum()

    def inject(self, poses: FloatArray) -> None:
        """Put poses (K, 3) in the place of K particles drawn at random; they get the average weight."""
        taken = self._rng.choice(len(self.poses), min(len(poses), len(self.poses)), replace=False)
        self.poses[taken] = poses[: len(taken)]
        self.weights[taken] = 1.0 / len(self.poses)
        self.weights /= self.weights.sum()

    def spread(self) -> tuple[float, float]:
        """Standard deviation of the whole cloud in position (m) and heading (rad)."""
        _, covariance = moments(self.poses, self.weights)
        return math.sqrt(covariance[0, 0] + covariance[1, 1]), math.sqrt(covariance[2, 2])

    @property
    def is_one_cluster(self) -> bool:
        """Whether the cloud is one hypothesis."""
        position, heading = self.spread()
        return position < self._parameters.one_cluster_m and heading < self._parameters.one_cluster_rad

    def estimate(self) -> tuple[Pose2D, FloatArray]:
        """Mean of the heaviest cluster, and the second moment (3, 3) of the whole cloud about it.

        So the covariance says when there are other hypotheses.
        """
        members = np.ones(len(self.poses), dtype=bool)
        if not self.is_one_cluster:
            p = self._parameters
            bins, _ = self._bins(self.poses)
            heaviest = int(np.argmax(np.bincount(bins, self.weights)))
            centre, _ = moments(self.poses[bins == heaviest], self.weights[bins == heaviest])
            away = self.poses - centre
            near = np.hypot(away[:, 0], away[:, 1]) < p.bin_m
            members = near & (np.abs(wrap_angles(away[:, 2])) < 2.0 * p.bin_rad)
        mean, _ = moments(self.poses[members], self.weights[members])
        away = self.poses - mean
        away[:, 2] = wrap_angles(away[:, 2])
        return Pose2D(*mean.tolist()), (self.weights[:, None] * away).T @ away

    def resample(self) -> None:
        """Low-variance resampling where too few particles are effective, to the number that their spread needs."""
        p, n = self._parameters, len(self.poses)
        few = 1.0 / float((self.weights**2).sum()) < p.resample_share * n
        if not (few or self._converging or n > 2 * p.min_particles):
            return
        drawn = self.poses[_low_variance(self.weights, n, self._rng)]
        _, occupied = self._bins(drawn)
        wanted = min(max(kld_size(occupied, p.kld_error, p.kld_quantile), p.min_particles), p.max_particles)
        if wanted != n:
            drawn = self.poses[_low_variance(self.weights, wanted, self._rng)]
        # A kernel moves each particle, so that no two stay alike. The particles are drawn in by as much, which
        # keeps mean and covariance. A cloud that has yet to converge may spread, to move to where its tails were thin.
        if self.is_one_cluster:
            mean, covariance = moments(self.poses, self.weights)
            values, vectors = np.linalg.eigh(covariance)
            away = drawn - mean
            away[:, 2] = wrap_angles(away[:, 2])
            noise = self._rng.standard_normal(drawn.shape) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
            width = p.moving_kernel if self._converging else p.kernel
            drawn = mean + (1.0 if self._converging else math.sqrt(1.0 - width**2)) * away + width * noise
        else:
            drawn = drawn + self._rng.standard_normal(drawn.shape) * [0.04, 0.04, 0.03]
        self.replace(drawn)

    def _bins(self, poses: FloatArray) -> tuple[npt.NDArray[np.int64], int]:
        """Bin (N,) of each pose, numbered from 0, and how many there are."""
        p = self._parameters
        cells = np.floor(poses / [p.bin_m, p.bin_m, p.bin_rad]).astype(np.int64)
        cells -= cells.min(axis=0)
        size = cells.max(axis=0) + 1
        keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
        found, bins = np.unique(keys, return_inverse=True)
        return bins, len(found)


def kld_size(bins: int, error: float, quantile: float) -> int:
    """How many samples keep the Kullback-Leibler distance below ``error`` where ``bins`` are occupied (Fox, Eq. 7)."""
    if bins < 2:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3)


def moments(poses: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (3,), its heading on the circle, and covariance (3, 3) of weighted poses (N, 3)."""
    w = weights / weights.sum()
    mean = w @ poses
    mean[2] = math.atan2(w @ np.sin(poses[:, 2]), w @ np.cos(poses[:, 2]))
    away = poses - mean
    away[:, 2] = wrap_angles(away[:, 2])
    return mean, (w[:, None] * away).T @ away


def _low_variance(weights: FloatArray, size: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Indices (size,) drawn with one random number, in proportion to the weights (Thrun et al., Table 4.4)."""
    picks = (np.arange(size) + rng.random()) / size
    return np.minimum(np.searchsorted(np.cumsum(weights), picks), len(weights) - 1)
