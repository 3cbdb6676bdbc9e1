"""What a laser scan means in space: its noise and its end points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D, Positive, UnitInterval
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import transform_points


@dataclass(frozen=True)
class ScanParameters:
    """Section ``scan``: which scans all modules of a robot use."""

    max_bad_share: UnitInterval = 0.9
    """Of a scan with a greater share of bad beams (NaN or below ``range_min``) nothing is used: the robot stands.
    Drivers that send NaN or 0.0 for "no return" leave more than half of the beams out in a large room (chosen)."""


@dataclass(frozen=True)
class LaserNoise:
    """Standard deviation of a range: constant near by, then a share of the range.

    The laser of the papers is within 30 mm up to 1 m and within 3 % to 8 m (P17 §7.1); those bounds are read as three
    standard deviations (chosen).
    """

    near_sigma_m: Positive = 0.01
    sigma_ratio: Positive = 0.01

    def sigma(self, ranges: FloatArray) -> FloatArray:
        """Standard deviation (N,) in m of ranges (N,) in m."""
        return np.maximum(self.near_sigma_m, self.sigma_ratio * ranges)


@dataclass(frozen=True, eq=False)
class EndPoints:
    """The beams of a scan that hit something.

    ``points`` (N, 2) in ``base_footprint``, ``ranges`` (N,) in m, ``beams`` (N,) their indices in the scan.
    """

    points: FloatArray
    ranges: FloatArray
    beams: npt.NDArray[np.int64]


def check_scan(scan: LaserScan, max_bad_share: float = 1.0) -> None:
    """Raises SensorDataError where a scan has senseless angles or limits, or more bad beams than ``max_bad_share``, or
    nothing else."""
    if scan.ranges.size == 0:
        raise SensorDataError("scan is empty, expected ranges")
    angles = (scan.stamp, scan.angle_min, scan.angle_increment)
    if not (all(map(math.isfinite, angles)) and scan.angle_increment > 0.0):
        raise SensorDataError(f"scan has senseless stamp or angles {angles}, expected finite ones and an increment")
    if not (0.0 <= scan.range_min < scan.range_max):
        raise SensorDataError(
            f"scan has senseless range limits {scan.range_min}, {scan.range_max}, expected 0 <= range_min < range_max"
        )
    share = scan.bad_share()
    if share > max_bad_share or share == 1.0:
        raise SensorDataError(
            f"scan: {int(np.isnan(scan.ranges).sum())} of {scan.ranges.size} beams are NaN or below range_min "
            f"{scan.range_min:.2f} m, expected at most {max_bad_share:.0%} (scan/max_bad_share)"
        )


def end_points(scan: LaserScan, T_base_laser: Pose2D, max_range_m: float = np.inf) -> EndPoints:
    """End points of the valid beams up to ``max_range_m``, in ``base_footprint``."""
    beams = np.flatnonzero(scan.valid() & (scan.ranges <= max_range_m))
    ranges, angles = scan.ranges[beams].astype(float), scan.angle_min + scan.angle_increment * beams
    points = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    return EndPoints(transform_points(T_base_laser, points), ranges, beams)


def beam_towards(scan: LaserScan, bearings: FloatArray) -> npt.NDArray[np.int64]:
    """The beams (N,) nearest to ``bearings`` (N,) in the laser's frame, in rad; ``ranges.size`` or more without one."""
    turns = np.mod(bearings - scan.angle_min + 0.5 * scan.angle_increment, 2 * math.pi)
    return np.floor(turns / scan.angle_increment).astype(np.int64)


def passed_through(
    scan: LaserScan, T_map_laser: Pose2D, points: FloatArray, noise: LaserNoise, clearance_m: float
) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Which points the beam in their direction surely went through.

    Args:
        scan: the scan.
        T_map_laser: the laser's pose.
        points: (N, 2) in ``map``, in m.
        noise: of the ranges; a beam has to end three standard deviations behind a point.
        clearance_m: and at least so far behind it.

    Returns:
        Mask (N,), and the points' distance (N,) from the laser in m.
    """
    offset = points - (T_map_laser.x, T_map_laser.y)
    range_m = np.hypot(offset[:, 0], offset[:, 1])
    beam = beam_towards(scan, np.arctan2(offset[:, 1], offset[:, 0]) - T_map_laser.theta)
    seen = (beam < scan.ranges.size) & (range_m > scan.range_min)
    measured = scan.ranges[np.where(seen, beam, 0)]
    return seen & (measured > range_m + np.maximum(clearance_m, 3.0 * noise.sigma(range_m))), range_m
