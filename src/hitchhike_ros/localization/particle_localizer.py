"""Localization by particles: a likelihood field of the map, recovery by poses drawn where the scan fits."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Marker, MarkerObservation, Pose2D, Twist2D
from hitchhike_ros.core.geometry import wrap_angles
from hitchhike_ros.localization.localizer import Localizer, LocalizerParameters
from hitchhike_ros.localization.particle_filter import ParticleFilter
from hitchhike_ros.localization.scan_alignment import ScanAlignment, Sight, spread
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import FREE, OccupancyGrid
from hitchhike_ros.mapping.laser import EndPoints

# Beams by which random poses are tried first. Standard deviations of such a pose before and after it has been aligned.
# An end point that is so near to a wall lies on it. All are chosen.
_SCOUTING_BEAMS = 30
_CANDIDATE: FloatArray = np.diag(np.square([0.3, 0.3, 0.2]))
_FOUND_SIGMA = np.array([0.03, 0.03, 0.02])
_FIT_M = 0.08


class ParticleLocalizer(Localizer):
    """A cloud of poses; the estimate is its heaviest cluster, with the covariance of the whole cloud about it.

    A scan is weighed by its end points' distances to the walls (likelihood field; Thrun, Burgard, Fox, Probabilistic
    Robotics, Table 6.3). When scans fit worse than they used to (w_fast below w_slow, Table 8.3), random poses in free
    space are tried, and some particles move to the one that the scan fits best.
    """

    def __init__(
        self, grid: OccupancyGrid, markers: Iterable[Marker], parameters: LocalizerParameters, T_base_laser: Pose2D
    ) -> None:
        super().__init__(markers, parameters, T_base_laser)
        self._field = DistanceField(grid)
        self._alignment = ScanAlignment(self._field, grid.resolution, parameters.laser, parameters.alignment)
        self._free = grid.cell_to_world(np.argwhere(grid.data == FREE))
        self._grid = grid
        self._rng = np.random.default_rng(parameters.particles.seed)
        self._cloud = ParticleFilter(parameters.ekf.motion, parameters.particles, self._rng)
        self._slow = self._fast = 0.0  # w_slow and w_fast: how well scans have fitted in the long run and lately
        self._scans = 0

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return len(self._cloud.poses) > 0

    @property
    def particles(self) -> FloatArray:
        """The cloud (N, 3) in ``map``."""
        return self._cloud.poses.copy()

    def globalize(self) -> None:
        """Forget where the robot is: it may be anywhere in the free space of the map."""
        self._cloud.replace(self._random_poses(self._parameters.particles.max_particles))
        self._start_anew()
        self._slow = self._fast = 0.0

    def _gaussian(self) -> tuple[Pose2D, FloatArray]:
        return self._cloud.estimate()

    def _forget(self) -> None:
        self._cloud.poses, self._cloud.weights = np.zeros((0, 3)), np.zeros(0)
        self._slow = self._fast = 0.0
        self._scans = 0

    def _begin(self, pose: Pose2D, covariance: FloatArray) -> None:
        self._cloud.seed(pose, covariance)
        self._slow = self._fast = 0.0

    def _move(self, twist: Twist2D, dt_s: float) -> None:
        self._cloud.predict(twist, dt_s)

    def _correct_by_scan(self, ends: EndPoints, origin: FloatArray) -> Sight | None:
        p, align = self._parameters.particles, self._parameters.alignment
        ends = spread(ends, p.beams, align.max_gap_m)
        if len(ends.points) < align.min_beams:
            return None
        self._recover(ends, origin)
        pose, covariance = self._cloud.estimate()
        at = self._alignment.incidence(ends, origin, pose)
        variance, counts = np.full(len(ends.points), p.tolerance_m**2), np.ones(len(ends.points))
        if self._cloud.is_one_cluster:
            # It includes the width of the cloud, or walls would be outliers to a cloud that has yet to converge.
            cloud = 0.5 * (covariance[0, 0] + covariance[1, 1]) + 0.5 * covariance[2, 2] * ends.ranges**2
            variance, counts = (
                np.where(at.valid, at.variance, self._parameters.laser.sigma(ends.ranges) ** 2) + cloud,
                at.independence,
            )
        log_likelihood, fit = self._log_likelihood(self._cloud.poses, ends.points, variance, counts)
        self._cloud.weigh(log_likelihood)
        explained = float(self._cloud.weights @ fit)
        self._slow += (p.alpha_slow if self._slow else 1.0) * (explained - self._slow)
        self._fast += (p.alpha_fast if self._fast else 1.0) * (explained - self._fast)
        self._cloud.resample()
        on_walls = at.valid & (np.abs(at.distance) < _FIT_M)
        return at.sight(np.where(on_walls, at.independence / at.variance, 0.0), on_walls)

    def _correct_by_marker(self, seen: MarkerObservation, T_map_marker: Pose2D) -> bool:
        poses, marker = self._cloud.poses, T_map_marker
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        dx, dy = marker.x - poses[:, 0], marker.y - poses[:, 1]
        innovation = np.column_stack(
            [
                seen.pose.x - (c * dx + s * dy),
                seen.pose.y - (c * dy - s * dx),
                wrap_angles(seen.pose.theta - marker.theta + poses[:, 2]),
            ]
        )
        squared = np.einsum("ni,ij,nj->n", innovation, np.linalg.inv(seen.covariance), innovation)
        _, covariance = self._cloud.estimate()
        reach = 9.0 * float(np.trace(covariance) / max(np.trace(seen.covariance), 1e-9))
        if float(squared.min()) > self._parameters.ekf.gate * (1.0 + reach):
            return False
        self._cloud.weigh(-0.5 * squared)
        self._cloud.resample()
        return True

    def _random_poses(self, size: int) -> FloatArray:
        cells = self._free[self._rng.integers(len(self._free), size=size)]
        within = self._grid.resolution * (self._rng.random((size, 2)) - 0.5)
        return np.column_stack([cells + within, self._rng.uniform(-math.pi, math.pi, size)])

    def _near_poses(self, about: Pose2D, size: int) -> FloatArray:
        """At most ``size`` poses in free space near a pose, with nearly the same heading."""
        p = self._parameters.particles
        points = self._rng.normal((about.x, about.y), p.near_m, (4 * size, 2))
        cells = self._grid.world_to_cell(points)
        inside = self._grid.in_bounds(cells)
        inside[inside] = self._grid.data[tuple(cells[inside].T)] == FREE
        points = points[inside][:size]
        return np.column_stack([points, self._rng.normal(about.theta, p.near_rad, len(points))])

    def _recover(self, ends: EndPoints, origin: FloatArray) -> None:
        """Look for a pose that fits better when the cloud has fitted worse lately or is spread; put particles there.

        The likeliest of random poses in free space are aligned to the walls. The best is taken only if more of the scan
        lies on walls there than at the estimate, so that boxes and people near a robot do not make it jump.
        """
        p = self._parameters.particles
        self._scans += 1
        fits = self._fast >= max(p.lost_ratio * self._slow, p.poor_fit)
        well = fits and self._cloud.is_one_cluster
        # In a bare corridor another place fits as well until the robot has driven on, so look now and then anyway.
        if well and self._scans % p.look_every:
            return
        some = ends.points[np.linspace(0, len(ends.points) - 1, _SCOUTING_BEAMS).astype(int)]
        estimate, _ = self._cloud.estimate()
        candidates = np.vstack([self._random_poses(p.candidates // 2), self._near_poses(estimate, p.candidates // 2)])
        log_likelihood, _ = self._log_likelihood(candidates, some, np.full(len(some), p.tolerance_m**2))
        found: list[FloatArray] = []
        half = p.candidates // 2
        anywhere, near = np.argsort(log_likelihood[:half]), half + np.argsort(log_likelihood[half:])
        head_start = [0.0]
        for k in (*anywhere[-p.aligned :], *near[-p.aligned :]):
            alignment = self._alignment.align(ends, origin, Pose2D(*candidates[k].tolist()), _CANDIDATE)
            if alignment is not None:
                covariance = np.linalg.inv(np.linalg.inv(_CANDIDATE) + alignment.information)
                found.append(candidates[k] + covariance @ alignment.vector)
                head_start.append(p.better_fit if k >= half else 0.0)
        if not found:
            return
        poses = np.array([(estimate.x, estimate.y, estimate.theta), *found])
        _, fit = self._log_likelihood(poses, ends.points, np.ones(len(ends.points)))
        # Among places that fit equally, a near one with the same heading is likelier than the corridor turned round.
        best = int(np.argmax(fit + head_start))
        if best > 0 and fit[best] > fit[0] + p.better_fit:
            size = int(p.random_share * len(self._cloud.poses))
            self._cloud.inject(poses[best] + self._rng.standard_normal((size, 3)) * _FOUND_SIGMA)

    def _log_likelihood(
        self, poses: FloatArray, points: FloatArray, variance: FloatArray, counts: FloatArray | float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """Log likelihood (N,) of end points (B, 2) in ``base_footprint`` at poses (N, 3); their share on walls (N,).

        ``variance`` (B,) is that of their distances to the walls, ``counts`` (B,) is the weight of each.
        """
        distance = self._field.distances(poses, points)
        likelihood = np.exp(-0.5 * distance**2 / variance)
        # The fit is measured with one tolerance, whatever the cloud's is, so that fits compare over time.
        fit = np.mean(np.abs(distance) < _FIT_M, axis=1)
        return (counts * np.log(likelihood + self._parameters.particles.outlier_share)).sum(axis=1), fit
