"""The simulated laser: batched rays, the paper's accuracy, REP 117 values."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pybullet as p

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, NonNegative, Positive


@dataclass(frozen=True)
class LaserParameters:
    """Section ``simulated_laser``: Hokuyo UHG-08LX.

    P18 §8.3 gives bounds: ± 30 mm to 1 m, 3 % of the range to 8 m. They are read as three standard deviations, and no
    reading is outside them.
    """

    beams: int = 769
    angle_increment_rad: Positive = 2.0 * math.pi / 1024.0
    range_min_m: NonNegative = 0.02
    range_max_m: Positive = 8.0
    near_bound_m: NonNegative = 0.03
    far_bound: NonNegative = 0.03

    @property
    def angle_min_rad(self) -> float:
        """Bearing of the first beam; the middle one looks straight ahead."""
        return -self.angle_increment_rad * (self.beams - 1) / 2.0


class Laser:
    """One robot's laser, with its own noise stream."""

    def __init__(self, params: LaserParameters, rng: np.random.Generator) -> None:
        self._params, self._rng = params, rng
        angles = params.angle_min_rad + params.angle_increment_rad * np.arange(params.beams)
        self._directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
        # Rays reach beyond the sensor's range, so that noise can bring a reading from either side of it.
        self._reach_m = params.range_max_m * (1.0 + params.far_bound)

    def distances(self, client: int, T_world_laser: FloatArray, threads: int) -> FloatArray:
        """True distances (N,) in m along all beams from T_world_laser (4, 4) in the world of pybullet's ``client``."""
        start = T_world_laser[:3, 3]
        ends = start + self._reach_m * self._directions @ T_world_laser[:3, :3].T
        hits = p.rayTestBatch([start.tolist()] * len(ends), ends.tolist(), numThreads=threads, physicsClientId=client)
        return np.array([hit[2] if hit[0] >= 0 else np.inf for hit in hits]) * self._reach_m

    def scan(self, client: int, T_world_laser: FloatArray, stamp: float, threads: int) -> LaserScan:
        """What the laser measures of the world of pybullet's ``client`` at T_world_laser (4, 4)."""
        return as_scan(self.distances(client, T_world_laser, threads), stamp, self._params, self._rng)


def as_scan(true: FloatArray, stamp: float, params: LaserParameters, rng: np.random.Generator) -> LaserScan:
    """The scan of true distances (N,) in m."""
    ranges = measure(true, params, rng).astype(np.float32)
    return LaserScan(
        stamp, params.angle_min_rad, params.angle_increment_rad, params.range_min_m, params.range_max_m, ranges
    )


def measure(true: FloatArray, params: LaserParameters, rng: np.random.Generator) -> FloatArray:
    """Readings (N,) of true distances (N,) in m, inf for none: noise within the bounds, then REP 117's infinities."""
    noise = np.clip(rng.standard_normal(true.shape) / 3.0, -1.0, 1.0)
    hit = np.isfinite(true)
    bound = np.maximum(params.near_bound_m, params.far_bound * np.where(hit, true, 0.0))
    ranges = np.where(hit, true + bound * noise, np.inf)
    ranges[ranges > params.range_max_m] = np.inf
    ranges[ranges < params.range_min_m] = -np.inf
    return ranges
