"""One robot's localization in a known map: odometry, corners, walls and known markers in one filter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from hitchhike_ros.datatypes import (
    LaserScan,
    Marker,
    MarkerObservation,
    Odometry,
    Pose2D,
    PoseEstimate,
    UnitInterval,
)
from hitchhike_ros.errors import SensorDataError
from hitchhike_ros.geometry import compose, compose_jacobians, inverse, transform_points
from hitchhike_ros.localization.ekf import Ekf, EkfParameters, LandmarkObservation
from hitchhike_ros.localization.landmarks import CornerParameters, map_corners, scan_corners
from hitchhike_ros.localization.odometry_track import OdometryTrack, OdometryTrackParameters
from hitchhike_ros.localization.particle_filter import ParticleParameters
from hitchhike_ros.localization.scan_alignment import AlignmentParameters, ScanAlignment
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import LaserNoise, check_scan, end_points


@dataclass(frozen=True)
class LocalizerParameters:
    """Section ``localization`` of a robot's parameter file."""

    ekf: EkfParameters = field(default_factory=EkfParameters)
    laser: LaserNoise = field(default_factory=LaserNoise)
    corners: CornerParameters = field(default_factory=CornerParameters)
    alignment: AlignmentParameters = field(default_factory=AlignmentParameters)
    corner_share: UnitInterval = 0.2  # of a scan's information that its corners carry; the walls carry the rest
    odometry: OdometryTrackParameters = field(default_factory=OdometryTrackParameters)
    particles: ParticleParameters = field(default_factory=ParticleParameters)


class EkfLocalizer:
    """The papers' filter fed by one robot's sensors (P18 §8.2).

    The state is kept at the time of the newest odometry. A scan or an image that was taken earlier is carried to that
    time by the odometry in between, so the order in which messages arrive does not matter.
    """

    def __init__(
        self, grid: OccupancyGrid, markers: Iterable[Marker], parameters: LocalizerParameters, T_base_laser: Pose2D
    ) -> None:
        self._parameters, self._T_base_laser = parameters, T_base_laser
        self._markers = {m.id: Pose2D(m.x, m.y, m.yaw) for m in markers}
        self._landmarks = map_corners(grid, parameters.corners)
        self._alignment = ScanAlignment(DistanceField(grid), grid.resolution, parameters.laser, parameters.alignment)
        self._ekf: Ekf | None = None
        self._stamp = 0.0
        self._odometry = OdometryTrack(parameters.odometry)
        self._explained: float | None = None

    def restart(self) -> None:
        """Forget estimate and odometry, such as after a pause in which the robot was moved; the map stays."""
        self._odometry.clear()
        self._ekf, self._explained, self._stamp = None, None, 0.0

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return self._ekf is not None

    @property
    def estimate(self) -> PoseEstimate:
        """Pose in ``map`` at the time of the newest odometry.

        Raises:
            RuntimeError: before :meth:`initialise`.
        """
        return self._filter().estimate(self._stamp)

    @property
    def explained(self) -> float | None:
        """Share of the last scan's beams that lie on walls of the map; None where the scan could not be used."""
        return self._explained

    def initialise(self, estimate: PoseEstimate) -> None:
        """Start, or start again, from a pose known otherwise.

        Raises:
            ValueError: the pose is not finite or the covariance is none.
        """
        ekf = Ekf(estimate.pose, estimate.covariance, self._parameters.ekf)
        if self._odometry and estimate.stamp >= self._odometry.oldest.stamp:
            # A pose taken a moment ago: the robot has moved on since.
            step = inverse(self._odometry.seen_from_now(min(estimate.stamp, self._stamp)))
            J, _ = compose_jacobians(estimate.pose, step)
            ekf = Ekf(compose(estimate.pose, step), J @ ekf.covariance @ J.T, self._parameters.ekf)
        elif not self._odometry:
            self._stamp = estimate.stamp
        self._ekf, self._explained = ekf, None

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
        if motion is not None and self._ekf is not None:
            self._ekf.predict(*motion)

    def update_scan(self, scan: LaserScan) -> bool:
        """Correct by the corners and walls in a scan; False where it shows too little of the map.

        Raises:
            SensorDataError: the scan is senseless, or too old or too new for the odometry. Nothing has changed then.
            RuntimeError: before :meth:`initialise`.
        """
        ekf, p = self._filter(), self._parameters
        check_scan(scan)
        T_now_then = self._odometry.seen_from_now(scan.stamp, "scan")
        ends = end_points(scan, compose(T_now_then, self._T_base_laser))
        origin = transform_points(T_now_then, np.array([[self._T_base_laser.x, self._T_base_laser.y]]))[0]
        alignment = self._alignment.align(ends, origin, ekf.pose, ekf.covariance)
        self._explained = alignment.explained if alignment else None
        if alignment is None:
            return False
        ekf.update_information(
            (1.0 - p.corner_share) * alignment.information, (1.0 - p.corner_share) * alignment.vector
        )
        if p.corner_share > 0.0:
            # After the walls, because corners of boxes that are not in the map are then outside the gate.
            for corner in scan_corners(ends, origin, p.laser, p.corners):
                ekf.update_landmark(_weakened(corner, p.corner_share), self._landmarks)
        return True

    def update_markers(self, observations: Iterable[MarkerObservation]) -> int:
        """Correct by markers; those that are not in the map are ignored. Returns how many were used.

        Raises:
            SensorDataError: an observation is not finite, or too old or too new for the odometry.
            RuntimeError: before :meth:`initialise`.
        """
        ekf, used = self._filter(), 0
        for seen in observations:
            if seen.marker_id not in self._markers:
                continue
            if not (seen.pose.is_finite() and np.isfinite(seen.covariance).all()):
                raise SensorDataError(f"marker {seen.marker_id} at {seen.stamp:.2f} s is not finite")
            T_now_then = self._odometry.seen_from_now(seen.stamp, "image")
            _, J = compose_jacobians(T_now_then, seen.pose)
            now = MarkerObservation(
                self._stamp, seen.marker_id, compose(T_now_then, seen.pose), J @ seen.covariance @ J.T
            )
            used += ekf.update_marker(now, self._markers[seen.marker_id])
        return used

    def estimate_at(self, stamp: float) -> PoseEstimate:
        """The estimate carried by odometry to another time, such as that of a scan.

        Raises:
            SensorDataError: the time is too old or too new for the odometry.
            RuntimeError: before :meth:`initialise`.
        """
        ekf = self._filter()
        T_now_then = self._odometry.seen_from_now(stamp)
        J, _ = compose_jacobians(ekf.pose, T_now_then)
        return PoseEstimate(stamp, compose(ekf.pose, T_now_then), J @ ekf.covariance @ J.T)

    def odometry_at(self, stamp: float) -> Pose2D:
        """Pose in the robot's ``odom`` frame at ``stamp``; raises as :meth:`estimate_at`."""
        return self._odometry.at(stamp)

    def _filter(self) -> Ekf:
        if self._ekf is None:
            raise RuntimeError("the localizer has no estimate before initialise()")
        return self._ekf


def _weakened(observation: LandmarkObservation, share: float) -> LandmarkObservation:
    """The observation with only a share of its information, because its beams are used once more."""
    scale = 1.0 / np.sqrt(share)
    return LandmarkObservation(
        observation.range_m,
        observation.bearing_rad,
        observation.signature,
        observation.range_sigma_m * scale,
        observation.bearing_sigma_rad * scale,
        observation.signature_sigma,
    )
