"""The ways to localize, behind one interface."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Protocol

from hitchhike_ros.datatypes import LaserScan, Marker, MarkerObservation, Odometry, Pose2D, PoseEstimate
from hitchhike_ros.localization.localizer import EkfLocalizer, LocalizerParameters
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.mapping.grid import OccupancyGrid

Method = Literal["ekf", "particle"]


class Localizer(Protocol):
    """One robot's localization; the state is kept at the time of the newest odometry."""

    @property
    def initialised(self) -> bool:
        """Whether there is an estimate."""

    @property
    def estimate(self) -> PoseEstimate:
        """Pose in ``map`` at the time of the newest odometry."""

    @property
    def explained(self) -> float | None:
        """Share of the last scan's beams that lie on walls of the map; None where the scan could not be used."""

    def restart(self) -> None:
        """Forget estimate and odometry; what was computed from the map stays."""

    def initialise(self, estimate: PoseEstimate) -> None:
        """Start, or start again, from a pose known otherwise."""

    def predict(self, odometry: Odometry) -> None:
        """Move by the difference to the odometry before."""

    def update_scan(self, scan: LaserScan) -> bool:
        """Correct by a scan; False where it shows too little of the map."""

    def update_markers(self, observations: Iterable[MarkerObservation]) -> int:
        """Correct by markers of the map; how many were used."""

    def estimate_at(self, stamp: float) -> PoseEstimate:
        """The estimate carried by odometry to another time, such as that of a scan."""

    def odometry_at(self, stamp: float) -> Pose2D:
        """Pose in the robot's ``odom`` frame at ``stamp``."""


def make_localizer(
    method: Method,
    grid: OccupancyGrid,
    markers: Iterable[Marker],
    parameters: LocalizerParameters,
    T_base_laser: Pose2D,
) -> Localizer:
    """A localizer in the map ``grid``; it has no estimate yet."""
    kind: type[EkfLocalizer] | type[ParticleLocalizer] = EkfLocalizer if method == "ekf" else ParticleLocalizer
    return kind(grid, markers, parameters, T_base_laser)
