"""Localization by particles: a likelihood field of the map, recovery by poses drawn where the scan fits."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from hitchhike_ros.datatypes import FloatArray, LaserScan, Marker, MarkerObservation, Odometry, Pose2D, PoseEstimate
from hitchhike_ros.errors import SensorDataError
from hitchhike_ros.geometry import compose, compose_jacobians, inverse, transform_points, wrap_angles
from hitchhike_ros.localization.ekf import Ekf
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.localization.odometry_track import OdometryTrack
from hitchhike_ros.localization.particle_filter import ParticleFilter
from hitchhike_ros.localization.scan_alignment import ScanAlignment, spread
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import FREE, OccupancyGrid
from hitchhike_ros.mapping.laser import EndPoints, check_scan, end_points

# Beams by which random poses are tried first; how far such a pose is from one that fits; how far it is when it has been
# aligned; and how near to a wall an end point fits (all chosen).
_SCOUTING_BEAMS = 30
_CANDIDATE: FloatArray = np.diag(np.square([0.3, 0.3, 0.2]))
_FOUND_SIGMA = np.array([0.03, 0.03, 0.02])
_FIT_M = 0.08


class ParticleLocalizer:
    """The same inputs and outputs as :class:`hitchhike_ros.localization.localizer.EkfLocalizer`.

    A scan is weighed by its end points' distances to the walls (likelihood field; Thrun, Burgard, Fox, Probabilistic
    Robotics, Table 6.3). When scans fit worse than they used to (w_fast below w_slow, Table 8.3), some particles are
    drawn afresh: of random poses in free space the one that the scan fits best.
    """

    def __init__(
        self, grid: OccupancyGrid, markers: Iterable[Marker], parameters: LocalizerParameters, T_base_laser: Pose2D
    ) -> None:
        self._parameters, self._T_base_laser = parameters, T_base_laser
        self._markers = {m.id: Pose2D(m.x, m.y, m.yaw) for m in markers}
        self._field = DistanceField(grid)
        self._alignment = ScanAlignment(self._field, grid.resolution, parameters.laser, parameters.alignment)
        self._free = grid.cell_to_world(np.argwhere(grid.data == FREE))
        self._resolution = grid.resolution
        self._odometry = OdometryTrack(parameters.odometry)
        self._rng = np.random.default_rng(parameters.particles.seed)
        self._cloud = ParticleFilter(parameters.ekf.motion, parameters.particles, self._rng)
        self.restart()

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return len(self._cloud.poses) > 0

    @property
    def estimate(self) -> PoseEstimate:
        """Pose in ``map`` at the time of the newest odometry; its covariance is that of the whole cloud.

        Raises:
            RuntimeError: before :meth:`initialise`.
        """
        self._check_initialised()
        return PoseEstimate(self._stamp, *self._cloud.estimate())

    @property
    def explained(self) -> float | None:
        """How well the last scan fits, 0 to 1; None where it could not be used."""
        return self._explained

    @property
    def particles(self) -> FloatArray:
        """The cloud (N, 3) in ``map``."""
        return self._cloud.poses.copy()

    def restart(self) -> None:
        """Forget estimate and odometry, such as after a pause in which the robot was moved; the map stays."""
        self._odometry.clear()
        self._cloud.poses, self._cloud.weights = np.zeros((0, 3)), np.zeros(0)
        self._stamp = 0.0
        self._explained: float | None = None
        self._slow = self._fast = 0.0
        self._scans = 0

    def initialise(self, estimate: PoseEstimate) -> None:
        """Start, or start again, from a pose known otherwise.

        Raises:
            ValueError: the pose is not finite or the covariance is none.
        """
        ekf = Ekf(estimate.pose, estimate.covariance)  # checks them
        pose, covariance = ekf.pose, ekf.covariance
        if self._odometry and estimate.stamp >= self._odometry.oldest.stamp:
            # A pose taken a moment ago: the robot has moved on since.
            step = inverse(self._odometry.seen_from_now(min(estimate.stamp, self._stamp)))
            J, _ = compose_jacobians(pose, step)
            pose, covariance = compose(pose, step), J @ covariance @ J.T
        elif not self._odometry:
            self._stamp = estimate.stamp
        self._cloud.seed(pose, covariance)
        self._explained, self._slow, self._fast = None, 0.0, 0.0

    def globalize(self) -> None:
        """Forget where the robot is: it may be anywhere in the free space of the map."""
        self._cloud.replace(self._random_poses(self._parameters.particles.max_particles))
        self._explained, self._slow, self._fast = None, 0.0, 0.0

    def predict(self, odometry: Odometry) -> None:
        """Move by the difference to the odometry before.

        Raises:
            SensorDataError: the odometry is not finite, runs back in time or has jumped. The estimate stays as it was;
                after a jump, in time or in space, the next odometry counts from this one.
        """
        try:
            motion = self._odometry.add(odometry)
        finally:
            if self._odometry:
                self._stamp = self._odometry.newest.stamp
        if motion is not None and self.initialised:
            self._cloud.predict(*motion)

    def update_scan(self, scan: LaserScan) -> bool:
        """Weigh the particles by a scan; False where it has too few end points.

        Raises:
            SensorDataError: the scan is senseless, or too old or too new for the odometry. Nothing has changed then.
            RuntimeError: before :meth:`initialise`.
        """
        self._check_initialised()
        p, align = self._parameters.particles, self._parameters.alignment
        check_scan(scan)
        T_now_then = self._odometry.seen_from_now(scan.stamp, "scan")
        ends = spread(end_points(scan, compose(T_now_then, self._T_base_laser)), p.beams, align.max_gap_m)
        self._explained = None
        if len(ends.points) < align.min_beams:
            return False
        origin = transform_points(T_now_then, np.array([[self._T_base_laser.x, self._T_base_laser.y]]))[0]
        self._recover(ends, origin)
        one = self._cloud.is_one_cluster
        variance = self._variance(ends, T_now_then) if one else np.full(len(ends.points), p.tolerance_m**2)
        log_likelihood, fit = self._log_likelihood(self._cloud.poses, ends.points, variance)
        self._cloud.weigh(log_likelihood)
        explained = self._explained = float(self._cloud.weights @ fit)
        self._slow += (p.alpha_slow if self._slow else 1.0) * (explained - self._slow)
        self._fast += (p.alpha_fast if self._fast else 1.0) * (explained - self._fast)
        self._cloud.resample()
        return True

    def update_markers(self, observations: Iterable[MarkerObservation]) -> int:
        """Weigh by markers; those that are not in the map are ignored. Returns how many were used.

        Raises:
            SensorDataError: an observation is not finite, or too old or too new for the odometry.
            RuntimeError: before :meth:`initialise`.
        """
        self._check_initialised()
        used, poses = 0, self._cloud.poses
        for seen in observations:
            if seen.marker_id not in self._markers:
                continue
            if not (seen.pose.is_finite() and np.isfinite(seen.covariance).all()):
                raise SensorDataError(f"marker {seen.marker_id} at {seen.stamp:.2f} s is not finite")
            T_now_then = self._odometry.seen_from_now(seen.stamp, "image")
            _, J = compose_jacobians(T_now_then, seen.pose)
            now, marker = compose(T_now_then, seen.pose), self._markers[seen.marker_id]
            c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
            dx, dy = marker.x - poses[:, 0], marker.y - poses[:, 1]
            innovation = np.column_stack(
                [
                    now.x - (c * dx + s * dy),
                    now.y - (c * dy - s * dx),
                    wrap_angles(now.theta - marker.theta + poses[:, 2]),
                ]
            )
            precision = np.linalg.inv(J @ seen.covariance @ J.T)
            squared = np.einsum("ni,ij,nj->n", innovation, precision, innovation)
            _, covariance = self._cloud.estimate()
            reach = 9.0 * float(np.trace(covariance) / max(np.trace(J @ seen.covariance @ J.T), 1e-9))
            if float(squared.min()) > self._parameters.ekf.gate * (1.0 + reach):
                continue
            self._cloud.weigh(-0.5 * squared)
            used += 1
        if used:
            self._cloud.resample()
        return used

    def estimate_at(self, stamp: float) -> PoseEstimate:
        """The estimate carried by odometry to another time, such as that of a scan.

        Raises:
            SensorDataError: the time is too old or too new for the odometry.
            RuntimeError: before :meth:`initialise`.
        """
        now = self.estimate
        T_now_then = self._odometry.seen_from_now(stamp)
        J, _ = compose_jacobians(now.pose, T_now_then)
        return PoseEstimate(stamp, compose(now.pose, T_now_then), J @ now.covariance @ J.T)

    def odometry_at(self, stamp: float) -> Pose2D:
        """Pose in the robot's ``odom`` frame at ``stamp``; raises as :meth:`estimate_at`."""
        return self._odometry.at(stamp)

    def _check_initialised(self) -> None:
        if not self.initialised:
            raise RuntimeError("the localizer has no estimate before initialise()")

    def _random_poses(self, size: int) -> FloatArray:
        cells = self._free[self._rng.integers(len(self._free), size=size)]
        within = self._resolution * (self._rng.random((size, 2)) - 0.5)
        return np.column_stack([cells + within, self._rng.uniform(-math.pi, math.pi, size)])

    def _near_poses(self, about: Pose2D, size: int) -> FloatArray:
        """Poses in free space about one, with its heading, more or less."""
        p = self._parameters.particles
        away = np.hypot(*(self._free - (about.x, about.y)).T)
        near = np.exp(-0.5 * (away / p.near_m) ** 2)
        if near.sum() < 1e-6:
            return self._random_poses(size)
        cells = self._free[np.searchsorted(np.cumsum(near) / near.sum(), self._rng.random(size)).clip(0, len(near) - 1)]
        return np.column_stack([cells, about.theta + p.near_rad * self._rng.standard_normal(size)])

    def _recover(self, ends: EndPoints, origin: FloatArray) -> None:
        """Where the cloud fits worse of late, or is spread, look for a pose that fits better and put particles there.

        Of random poses in free space the likeliest are aligned to the walls. The best is taken only if more of the scan
        lies on walls there than at the estimate, so that boxes and people about a robot do not make it jump.
        """
        p = self._parameters.particles
        self._scans += 1
        well = self._fast >= p.lost_ratio * self._slow and self._cloud.is_one_cluster
        # In a bare corridor another place fits as well until the robot has driven on: look now and then all the same.
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
        # Of places that fit as well, a near one with the same heading is likelier than the corridor turned round.
        best = int(np.argmax(fit + head_start))
        if best > 0 and fit[best] > fit[0] + p.better_fit:
            size = int(p.random_share * len(self._cloud.poses))
            self._cloud.inject(poses[best] + self._rng.standard_normal((size, 3)) * _FOUND_SIGMA)

    def _variance(self, ends: EndPoints, T_now_then: Pose2D) -> FloatArray:
        """Of the distances (B,) of end points to the walls: a range that grazes its wall says it well.

        The width of the cloud is part of it, or walls would be outliers to a cloud that has yet to converge.
        """
        align = self._parameters.alignment
        pose, covariance = self._cloud.estimate()
        cloud = 0.5 * (covariance[0, 0] + covariance[1, 1]) + 0.5 * covariance[2, 2] * ends.ranges**2
        laser = compose(pose, compose(T_now_then, self._T_base_laser))
        points = transform_points(pose, ends.points)
        _, gradient, valid = self._field.lookup(points)
        rays = (points - [laser.x, laser.y]) / ends.ranges[:, None]
        across = np.where(valid, np.einsum("ni,ni->n", gradient, rays), 1.0)
        walls = align.wall_sigma_m**2 + (align.face_error * self._field.face_error(points)) ** 2
        return (self._parameters.laser.sigma(ends.ranges) * across) ** 2 + walls + cloud

    def _log_likelihood(
        self, poses: FloatArray, points: FloatArray, variance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Of end points (B, 2) in ``base_footprint`` at poses (N, 3): (N,); and the share of them on walls (N,)."""
        c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        x = poses[:, 0, None] + c * points[:, 0] - s * points[:, 1]
        y = poses[:, 1, None] + s * points[:, 0] + c * points[:, 1]
        distance = self._field.distances(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
        likelihood = np.exp(-0.5 * distance**2 / variance)
        # How well it fits is asked with one tolerance, whatever the cloud's is, so that it compares over time.
        fit = np.mean(np.abs(distance) < _FIT_M, axis=1)
        return np.log(likelihood + self._parameters.particles.outlier_share).sum(axis=1), fit
