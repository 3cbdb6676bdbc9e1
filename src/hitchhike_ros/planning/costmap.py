"""What a robot pays for standing in a cell: obstacles inflated by its footprint, and a price on being near them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import NonNegative, Positive
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid, distance_to
from hitchhike_ros.planning.astar import CostArray


@dataclass(frozen=True)
class CostmapParameters:
    """Section ``costmap``. The papers name no inflation; all values are chosen."""

    # Free room beyond the inscribed circle of the footprint; cells with less are forbidden.
    margin_m: NonNegative = 0.05
    # An obstacle raises costs up to here: more than half the papers' corridors, so that paths keep to the middle.
    inflation_m: Positive = 1.5
    # Cost, in free cells, that touching an obstacle would add; it decays to 0 at inflation_m, quadratically. Enough to
    # round the corners of the papers' corridors by more than a robot's length, not so much as to weave around pillars.
    clearance_weight: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 0.7
    # Cells of at least this occupancy, in percent, are obstacles (map_server's occupied_thresh).
    occupied_percent: Annotated[int, msgspec.Meta(ge=1, le=100)] = 65
    # Whether paths may cross unknown cells.
    allow_unknown: bool = False


@dataclass(frozen=True, eq=False)
class Costmap:
    """Costs for :mod:`hitchhike_ros.planning.astar` of one robot on one grid, all arrays (H, W).

    ``cost`` is float32, infinite where the robot must not stand; ``clearance`` is the distance in m from a cell's
    centre to the edge of the nearest obstacle, not positive inside one; ``lethal_m`` is the least allowed clearance.
    """

    grid: OccupancyGrid
    cost: CostArray
    clearance: npt.NDArray[np.float32]
    lethal_m: float

    @cached_property
    def regions(self) -> npt.NDArray[np.int32]:
        """Number of the region that each cell belongs to; paths exist within one region only, and 0 is forbidden."""
        return label_regions(self.cost)


def build_costmap(grid: OccupancyGrid, limits: RobotLimits, params: CostmapParameters) -> Costmap:
    """Inflate the obstacles of ``grid`` for a robot.

    With clearance d, a cell is forbidden where d < inscribed radius + margin and else costs
    1 + clearance_weight (1 - d / inflation_m)². The cost beyond the footprint does not depend on the robot, so that
    robots of different sizes that share a corridor also share a line in it.
    """
    obstacles = grid.data >= params.occupied_percent
    if not params.allow_unknown:
        obstacles |= grid.data < 0
    # Distances are between centres, an obstacle begins half a cell before its own.
    clearance = distance_to(obstacles, grid.resolution)
    clearance -= np.float32(grid.resolution / 2)
    lethal_m = limits.inscribed_m + params.margin_m
    cost = clearance / np.float32(-params.inflation_m)  # from here on in place, as maps may have many cells
    cost += np.float32(1)
    np.maximum(cost, 0, out=cost)
    np.square(cost, out=cost)
    cost *= np.float32(params.clearance_weight)
    cost += np.float32(1)
    cost[clearance < lethal_m] = np.inf
    return Costmap(grid, cost, clearance, lethal_m)


def label_regions(cost: CostArray) -> npt.NDArray[np.int32]:
    """Connected regions (H, W) of the passable cells of ``cost`` (H, W), numbered from 1.

    As no path cuts a corner, regions are those of 4-connected cells.
    """
    _, labels = cv2.connectedComponents(np.isfinite(cost).astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return np.asarray(labels, dtype=np.int32)
