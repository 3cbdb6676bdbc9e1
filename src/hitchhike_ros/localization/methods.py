"""The ways to localize, by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from hitchhike_ros.core.datatypes import Marker, Pose2D
from hitchhike_ros.localization.ekf_localizer import EkfLocalizer
from hitchhike_ros.localization.localizer import Localizer, LocalizerParameters
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.mapping.grid import OccupancyGrid

Method = Literal["ekf", "particle"]


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
