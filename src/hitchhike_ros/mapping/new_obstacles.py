"""New static boxes: what the laser sees where the static map has nothing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hitchhike_ros.datatypes import LaserScan, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.mapping.grid import OccupancyGrid


@dataclass(frozen=True)
class NewObstaclesParameters:
    """Parameters of :class:`NewObstacleMapper` (section ``new_obstacles``)."""


class NewObstacleMapper:
    """Boxes that stand where the static map is free."""

    def __init__(self, grid: OccupancyGrid, params: NewObstaclesParameters) -> None:
        self._grid, self._params = grid, params
        self._obstacles: tuple[Obstacle, ...] = ()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The boxes known now, oldest first, in ``map``; the same tuple while nothing changed beyond noise."""
        return self._obstacles

    def update(
        self,
        scan: LaserScan,
        estimate: PoseEstimate,
        T_base_laser: Pose2D,
        others: Iterable[tuple[Pose2D, float]] = (),
    ) -> None:
        """Take in one scan from the estimated pose; ``others`` are known robots as (pose in ``map``, radius in m)."""

    def add(self, obstacles: Iterable[Obstacle]) -> None:
        """Boxes handed over by a driver: kept as measured until beams pass through them."""
        self._obstacles += tuple(obstacles)
