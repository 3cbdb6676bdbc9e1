"""The beams of one scan in ``map``, and where they meet axis-aligned boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray, LaserScan, Pose2D, PoseEstimate
from hitchhike_ros.geometry import compose
from hitchhike_ros.mapping.laser import LaserNoise, check_scan

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Beams:
    """N beams that tell something.

    ``origin`` (2,) and ``directions`` (N, 2) of length 1 in ``map``; ``ranges`` (N,) in m, infinite where the beam
    returned nothing; ``sigma`` (N,) in m, the standard deviation of an end point from range noise and pose.
    """

    origin: FloatArray
    directions: FloatArray
    ranges: FloatArray
    sigma: FloatArray

    def points(self) -> FloatArray:
        """End points (N, 2) in ``map``; not finite where nothing was hit."""
        return self.origin + self.ranges[:, None] * self.directions

    def crossing(self, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (N,) in m at which each beam's line enters and leaves a box (4,): least x, y, greatest x, y.

        The beam misses the box where it would leave before it enters, or leaves behind the laser.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            low = (bounds[:2] - self.origin) / self.directions
            high = (bounds[2:] - self.origin) / self.directions
        return np.fmin(low, high).max(axis=1), np.fmax(low, high).min(axis=1)


def beams_in_map(
    scan: LaserScan, estimate: PoseEstimate, T_base_laser: Pose2D, noise: LaserNoise
) -> tuple[Beams, npt.NDArray[np.int64]]:
    """The beams of a scan that are good or returned nothing, and their indices (N,) in the scan.

    Raises:
        SensorDataError: the scan is empty, has senseless angles or NaN ranges.
    """
    check_scan(scan)
    T_map_laser = compose(estimate.pose, T_base_laser)
    told = scan.valid() | np.isposinf(scan.ranges)
    indices = np.flatnonzero(told)
    angles = T_map_laser.theta + scan.angle_min + scan.angle_increment * indices
    ranges = scan.ranges[indices]
    reach = np.minimum(ranges, scan.range_max)
    cov = estimate.covariance
    # Each beam is uncertain along both axes of the position; a turn moves its end across it.
    sigma = np.sqrt(noise.sigma(reach) ** 2 + (cov[0, 0] + cov[1, 1]) / 2.0 + cov[2, 2] * reach**2)
    origin = np.array([T_map_laser.x, T_map_laser.y])
    return Beams(origin, np.column_stack([np.cos(angles), np.sin(angles)]), ranges, sigma), indices
