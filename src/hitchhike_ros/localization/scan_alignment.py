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
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive, UnitInterval
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise

Count = Annotated[int, msgspec.Meta(ge=1)]


@dataclass(frozen=True)
class AlignmentParameters:
    """How a scan is aligned."""

    max_beams: Count = 150
    max_gap_m: Positive = 0.2  # longest distance between neighbours that counts when beams are spread over the walls
    roughness_m: Positive = 0.003  # of walls; unlike the map's errors it differs from beam to beam
    gate_sigmas: Positive = 3.5
    max_gate_m: Positive = 0.6
    min_explained: UnitInterval = 0.2
    min_beams: Count = 15
    iterations: Count = 6
    annealing: UnitInterval = 0.2  # how fast the error expected of the prior shrinks from step to step


@dataclass(frozen=True, eq=False)
class Sight:
    """What a scan shows of the walls.

    ``walls`` (3, 3) is the covariance that the errors of the map have on the pose in (x, y, theta), the same in the
    next scans; ``explained`` the share of the beams that lie on walls.
    """

    walls: FloatArray
    explained: float


@dataclass(frozen=True, eq=False)
class Alignment(Sight):
    """A scan's measurement of the pose, about the prior mean.

    ``information`` (3, 3) is its inverse covariance A in (x, y, theta), ``vector`` (3,) = A (measured - mean).
    """

    information: FloatArray
    vector: FloatArray


@dataclass(frozen=True, eq=False)
class Incidence:
    """End points of a scan at one pose: ``distance`` (N,) to the walls in m, and its Jacobian ``J`` (N, 3) by the pose.

    ``towards`` (N,) is how much of its range each has along the distance's gradient, ``variance`` (N,) that of the
    distance, ``wall`` (N,) the part of it that the map has to answer for, ``count`` (N,) how many end points share
    their cell's face, and ``valid`` (N,) whether there is a wall.
    """

    distance: FloatArray
    J: FloatArray
    towards: FloatArray
    variance: FloatArray
    wall: FloatArray
    count: npt.NDArray[np.int64]
    valid: npt.NDArray[np.bool_]

    @property
    def independence(self) -> FloatArray:
        """Weight (N,) of each end point: those on one cell share the error of its face."""
        return 1.0 / (1.0 + (self.count - 1) * self.wall / self.variance)

    def sight(self, weights: FloatArray, on_walls: npt.NDArray[np.bool_]) -> Sight:
        """What end points with weights (N,) show of the pose; ``on_walls`` (N,) says which lie on walls."""
        A = (weights[:, None] * self.J).T @ self.J
        # The face's share of the variance of the mean over one face; with many end points it is nearly all of it.
        share = self.count * self.independence * self.wall / self.variance
        # Directions that are not measured to a metre or a radian are left to the odometry.
        mean = np.linalg.inv(A + np.eye(3))
        walls = mean @ ((weights * share)[:, None] * self.J).T @ self.J @ mean
        return Sight(walls, float(on_walls.mean()))


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
        delta = np.zeros(3)
        inlier = np.ones(len(ends.points), dtype=bool)
        for iteration in range(p.iterations):
            pose = Pose2D(mean.x + delta[0], mean.y + delta[1], mean.theta + delta[2])
            at = self.incidence(ends, origin, pose)
            if iteration == 0:
                spread_of_prior = np.einsum("ni,ij,nj->n", at.J, covariance, at.J)
                gate = np.minimum(p.gate_sigmas * np.sqrt(at.variance + spread_of_prior), p.max_gate_m)
            # At first the whole error of the prior is expected at an end point, later only the noise.
            scale = at.variance + spread_of_prior * p.annealing**iteration
            # A beam that leaves the wall at its end point went through it: that is the wall's back.
            inlier = at.valid & (np.abs(at.distance) < gate) & (at.towards < 0.2)
            robust = np.where(inlier, 1.0 / (1.0 + at.distance**2 / (4.0 * scale)) ** 2, 0.0)
            weights = at.independence * robust / at.variance
            weighted = weights[:, None] * at.J
            A = weighted.T @ at.J
            b = A @ delta - weighted.T @ np.where(inlier, at.distance, 0.0)
            step = np.linalg.solve(np.eye(3) + covariance @ A, covariance @ b) - delta
            delta = delta + step
            if abs(step[0]) + abs(step[1]) < 1e-4 and abs(step[2]) < 1e-4:
                break
        if inlier.sum() < p.min_beams or inlier.mean() < p.min_explained:
            return None
        sight = at.sight(weights, inlier)
        return Alignment(sight.walls, sight.explained, A, b)

    def incidence(self, ends: EndPoints, origin: FloatArray, pose: Pose2D) -> Incidence:
        """How end points seen from ``origin`` (2,), both in ``base_footprint``, lie on the walls at a pose."""
        points = transform_points(pose, ends.points)
        rays = (points - transform_points(pose, origin[None])) / ends.ranges[:, None]
        distance, gradient, valid = self._field.lookup(points)
        turn = gradient[:, 1] * (points[:, 0] - pose.x) - gradient[:, 0] * (points[:, 1] - pose.y)
        towards = np.einsum("ni,ni->n", gradient, rays)
        wall = self._field.face_variance(points)
        variance = (self._noise.sigma(ends.ranges) * towards) ** 2 + self._parameters.roughness_m**2 + wall
        cells = np.floor(points / self._resolution).astype(np.int64)
        cells -= cells.min(axis=0)
        keys = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
        _, which, count = np.unique(keys, return_inverse=True, return_counts=True)
        J = np.column_stack([gradient, turn])
        return Incidence(distance, J, towards, variance, wall, count[which], valid)
