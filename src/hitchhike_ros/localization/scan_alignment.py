"""Walls as landmarks: a scan aligned to the distance field of the map, as a measurement with its information.

The papers measure point landmarks (P18 Eqs. 13-19). Along a corridor, or in a map of a real building, corners are rare
or ragged while walls are everywhere, so each end point is also taken as a measurement of its distance to the nearest
wall: it should be zero. Along a bare corridor those measurements say nothing about the way along it; their information
matrix is then singular in that direction, and the filter keeps what it had from odometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from hitchhike_ros.datatypes import FloatArray, NonNegative, Pose2D, Positive, UnitInterval
from hitchhike_ros.geometry import transform_points
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise

Count = Annotated[int, msgspec.Meta(ge=1)]


@dataclass(frozen=True)
class AlignmentParameters:
    """How a scan is aligned."""

    max_beams: Count = 150
    max_gap_m: Positive = 0.2  # end points further apart count as this far when beams are spread over the walls
    wall_sigma_m: Positive = 0.003  # roughness of walls
    face_error: NonNegative = 0.6  # standard deviation by the greatest error of the field at a face
    face_bias: NonNegative = 0.5  # of that, averaged over the beams, as an error of the position that they share
    map_sigma: NonNegative = 0.02  # error of the position, in cells, that all beams of a scan share
    gate_sigmas: Positive = 3.5
    max_gate_m: Positive = 0.6
    min_explained: UnitInterval = 0.2
    min_beams: Count = 15
    iterations: Count = 6
    annealing: UnitInterval = 0.2  # how fast the error expected of the prior shrinks from step to step


@dataclass(frozen=True, eq=False)
class Alignment:
    """A scan's measurement of the pose, about the prior mean.

    ``information`` (3, 3) is its inverse covariance A in (x, y, theta), ``vector`` (3,) = A (measured - mean).
    ``explained`` is the share of the beams that lie on walls of the map.
    """

    information: FloatArray
    vector: FloatArray
    explained: float


def spread(ends: EndPoints, max_beams: int, max_gap_m: float) -> EndPoints:
    """At most ``max_beams`` of the beams, spread evenly along the walls instead of evenly over the angles."""
    if len(ends.points) <= max_beams:
        return ends
    steps = np.minimum(np.hypot(*np.diff(ends.points, axis=0, append=ends.points[-1:]).T), max_gap_m)
    # Smoothed, or noisy beams, which are far from their neighbours, would be chosen more often than others.
    along = np.cumsum(np.convolve(steps, np.full(15, 1.0 / 15.0), mode="same"))
    chosen = np.unique(np.searchsorted(along, np.linspace(along[0], along[-1], max_beams)))
    return EndPoints(ends.points[chosen], ends.ranges[chosen], ends.beams[chosen])


class ScanAlignment:
    """Aligns end points to the walls of one map."""

    def __init__(
        self, field: DistanceField, resolution: float, noise: LaserNoise, parameters: AlignmentParameters
    ) -> None:
        self._field, self._noise, self._parameters = field, noise, parameters
        self._resolution = resolution

    def align(self, ends: EndPoints, origin: FloatArray, mean: Pose2D, covariance: FloatArray) -> Alignment | None:
        """The measurement that a scan makes of the pose, given the prior.

        Gauss-Newton from the prior mean on the distances of the end points to the walls, with the prior as one more
        measurement so that a direction that the walls do not show stays put. Points further from a wall than prior and
        noise explain (boxes, other robots, people) do not count, those near that limit count less.

        Args:
            ends: end points in ``base_footprint``.
            origin: the laser's position (2,) in ``base_footprint``.
            mean: prior pose in ``map``.
            covariance: prior covariance (3, 3).

        Returns:
            The measurement, or None where too few beams lie on walls of the map.
        """
        p = self._parameters
        ends = spread(ends, p.max_beams, p.max_gap_m)
        if len(ends.points) < p.min_beams:
            return None
        range_variance = self._noise.sigma(ends.ranges) ** 2
        rays = (ends.points - origin) / ends.ranges[:, None]
        delta = np.zeros(3)
        inlier = np.ones(len(ends.points), dtype=bool)
        for iteration in range(p.iterations):
            pose = Pose2D(mean.x + delta[0], mean.y + delta[1], mean.theta + delta[2])
            points = transform_points(pose, ends.points)
            distance, gradient, valid = self._field.lookup(points)
            turn = gradient[:, 1] * (points[:, 0] - pose.x) - gradient[:, 0] * (points[:, 1] - pose.y)
            J = np.column_stack([gradient, turn])
            towards = np.einsum("ni,ni->n", gradient, transform_points(Pose2D(theta=pose.theta), rays))
            face_error = self._field.face_error(points)
            wall_variance = p.wall_sigma_m**2 + (p.face_error * face_error) ** 2
            variance = range_variance * towards**2 + wall_variance
            if iteration == 0:
                spread_of_prior = np.einsum("ni,ij,nj->n", J, covariance, J)
                gate = np.minimum(p.gate_sigmas * np.sqrt(variance + spread_of_prior), p.max_gate_m)
            # At first the whole error of the prior is expected at an end point, later only the noise.
            scale = variance + spread_of_prior * p.annealing**iteration
            # A beam that leaves the wall at its end point went through it: that is the wall's back.
            inlier = valid & (np.abs(distance) < gate) & (towards < 0.2)
            robust = np.where(inlier, 1.0 / (1.0 + distance**2 / (4.0 * scale)) ** 2, 0.0)
            weighted = (self._independence(points, wall_variance / variance) * robust / variance)[:, None] * J
            A = weighted.T @ J
            b = A @ delta - weighted.T @ np.where(inlier, distance, 0.0)
            step = np.linalg.solve(np.eye(3) + covariance @ A, covariance @ b) - delta
            delta = delta + step
            if abs(step[0]) + abs(step[1]) < 1e-4 and abs(step[2]) < 1e-4:
                break
        explained = float(inlier.mean())
        if inlier.sum() < p.min_beams or explained < p.min_explained:
            return None
        # The errors that the beams share add to the covariance: (A^-1 + B)^-1 = A (I + B A)^-1, A perhaps singular.
        sigma = np.hypot(p.map_sigma * self._resolution, p.face_bias * float(face_error[inlier].mean()))
        shared = np.linalg.inv(np.eye(3) + A @ np.diag([sigma**2, sigma**2, 0.0]))
        return Alignment(shared @ A, shared @ b, explained)

    def _independence(self, points: FloatArray, shared: FloatArray) -> FloatArray:
        """What each of the end points (N, 2) counts: those on one cell share the error of its face.

        ``shared`` (N,) is the part of their variance that is the wall's.
        """
        cells = np.floor(points / self._resolution).astype(np.int64)
        cells -= cells.min(axis=0)
        _, at, count = np.unique(
            cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True, return_counts=True
        )
        return 1.0 / (1.0 + (count[at] - 1) * shared)
