"""The beams of one scan in ``map``, and where they meet axis-aligned boxes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray, LaserScan, Pose2D, PoseEstimate
from hitchhike_ros.geometry import compose
from hitchhike_ros.mapping.laser import LaserNoise, check_scan

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Beams:
    """The N beams of a scan that tell something: they hit, or nothing was within reach.

    Beam ``indices[i]`` of all ``size`` beams points to ``bearing`` + ``indices[i] * increment`` in ``map``.
    ``origin`` (2,) and unit ``directions`` (N, 2) in ``map``; ``ranges`` (N,) in m, infinite where nothing was hit;
    ``ends`` (N, 2) in ``map``, at the sensor's reach where nothing was hit. Standard deviations (N,) in m:
    ``range_sigma`` of the ranges, ``pose_sigma`` of the ends along any direction as the pose is uncertain.
    """

    size: int
    bearing: float
    increment: float
    indices: npt.NDArray[np.int64]
    origin: FloatArray
    directions: FloatArray
    ranges: FloatArray
    ends: FloatArray
    range_sigma: FloatArray
    pose_sigma: FloatArray

    def select(self, kept: BoolArray) -> Beams:
        """The beams in a mask (N,)."""
        arrays = ("indices", "directions", "ranges", "ends", "range_sigma", "pose_sigma")
        return replace(self, **{name: getattr(self, name)[kept] for name in arrays})

    def crossing(self, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (N,) in m at which each beam's line enters and leaves a box (4,): least x, y, greatest x, y.

        The beam misses the box where it would leave before it enters, or leaves behind the laser.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            (ax, ay), (bx, by) = (
                (corner - self.origin)[:, None] / self.directions.T for corner in bounds.reshape(2, 2)
            )
        enter = np.fmax(np.fmin(ax, bx), np.fmin(ay, by))
        return enter, np.fmin(np.fmax(ax, bx), np.fmax(ay, by))

    def clear_range(self, bearings: FloatArray) -> FloatArray:
        """Range (K,) in m to which the three beams around each bearing (K,) in ``map`` are all clear, 0 if unknown."""
        ranges = np.zeros(self.size + 2)
        ranges[self.indices + 1] = self.ranges
        clear = np.minimum(np.minimum(ranges[:-2], ranges[1:-1]), ranges[2:])
        beam = np.rint((bearings - self.bearing) % (2.0 * np.pi) / self.increment).astype(np.int64)
        return np.where(beam < self.size, clear[np.minimum(beam, self.size - 1)], 0.0)


def beams_in_map(scan: LaserScan, estimate: PoseEstimate, T_base_laser: Pose2D, noise: LaserNoise) -> Beams:
    """The beams of a scan taken from an estimated pose.

    Raises:
        SensorDataError: the scan is empty, has senseless angles or NaN ranges.
    """
    check_scan(scan)
    T_map_laser = compose(estimate.pose, T_base_laser)
    indices = np.flatnonzero(scan.valid() | np.isposinf(scan.ranges))
    bearing = T_map_laser.theta + scan.angle_min
    angles = bearing + scan.angle_increment * indices
    ranges = scan.ranges[indices]
    reach = np.minimum(ranges, scan.range_max)
    cov = estimate.covariance
    # A turn moves an end across its beam; taken for any direction, as the position's uncertainty is.
    pose_sigma = np.sqrt((cov[0, 0] + cov[1, 1]) / 2.0 + cov[2, 2] * reach**2)
    origin = np.array([T_map_laser.x, T_map_laser.y])
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    return Beams(
        size=scan.ranges.size,
        bearing=bearing,
        increment=scan.angle_increment,
        indices=indices,
        origin=origin,
        directions=directions,
        ranges=ranges,
        ends=origin + reach[:, None] * directions,
        range_sigma=noise.sigma(reach),
        pose_sigma=pose_sigma,
    )
