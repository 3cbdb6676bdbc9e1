"""Localization by the papers' filter: odometry, corners, walls and known markers in one Gaussian."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Marker, MarkerObservation, Pose2D, Twist2D
from hitchhike_ros.localization.ekf import Ekf, LandmarkObservation
from hitchhike_ros.localization.landmarks import map_corners, scan_corners
from hitchhike_ros.localization.localizer import Localizer, LocalizerParameters
from hitchhike_ros.localization.scan_alignment import Alignment, ScanAlignment
from hitchhike_ros.mapping.distance_field import DistanceField
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import EndPoints


class EkfLocalizer(Localizer):
    """The papers' filter fed by one robot's sensors (P18 §8.2)."""

    def __init__(
        self, grid: OccupancyGrid, markers: Iterable[Marker], parameters: LocalizerParameters, T_base_laser: Pose2D
    ) -> None:
        super().__init__(markers, parameters, T_base_laser)
        self._landmarks = map_corners(grid, parameters.corners)
        self._alignment = ScanAlignment(DistanceField(grid), grid.resolution, parameters.laser, parameters.alignment)
        self._ekf: Ekf | None = None
        self._scans = 0

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""
        return self._ekf is not None

    def _gaussian(self) -> tuple[Pose2D, FloatArray]:
        ekf = self._filter()
        return ekf.pose, ekf.covariance

    def _forget(self) -> None:
        self._ekf, self._scans = None, 0

    def _begin(self, pose: Pose2D, covariance: FloatArray) -> None:
        self._ekf = Ekf(pose, covariance, self._parameters.ekf)

    def _move(self, twist: Twist2D, dt_s: float) -> None:
        self._filter().predict(twist, dt_s)

    def _correct_by_scan(self, ends: EndPoints, origin: FloatArray) -> Alignment | None:
        ekf, p = self._filter(), self._parameters
        alignment = self._alignment.align(ends, origin, ekf.pose, ekf.covariance)
        if alignment is None:
            return None
        self._scans += 1
        share = 0.0 if self._scans % p.corners_every else p.corner_share
        ekf.update_information((1.0 - share) * alignment.information, (1.0 - share) * alignment.vector)
        if share > 0.0:
            # After the walls, because corners of boxes that are not in the map are then outside the gate.
            for corner in scan_corners(ends, origin, p.laser, p.corners):
                ekf.update_landmark(_weakened(corner, share), self._landmarks)
        return alignment

    def _correct_by_marker(self, seen: MarkerObservation, T_map_marker: Pose2D) -> bool:
        return self._filter().update_marker(seen, T_map_marker)

    def _filter(self) -> Ekf:
        assert self._ekf is not None, "Localizer asks only after it has checked"
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
