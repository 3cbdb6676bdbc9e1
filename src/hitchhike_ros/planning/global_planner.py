"""Paths through the map for one robot: inflated grid, a search that is repaired as boxes come and go, smoothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.errors import GoalBlockedError, OutsideMapError, StartBlockedError, UnreachableError
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import CellArray, OccupancyGrid
from hitchhike_ros.planning.astar import Cell, CostArray
from hitchhike_ros.planning.costmap import Costmap, CostmapParameters, build_costmap, label_regions
from hitchhike_ros.planning.dstar_lite import RepairedSearch


@dataclass(frozen=True)
class GlobalPlannerParameters(CostmapParameters):
    """Section ``global_planner``, inflation included; all values are chosen."""

    # Bends shorter than about its square root, in cells, are rounded off.
    smoothing_rounds: Annotated[int, msgspec.Meta(ge=0, le=1000)] = 12


class GlobalPlanner:
    """Plans on one grid after another and keeps the inflation of the last one, and the search for the last goal."""

    def __init__(self, params: GlobalPlannerParameters, limits: RobotLimits) -> None:
        self._params, self._limits = params, limits
        self._costmap: Costmap | None = None
        self._search = RepairedSearch()

    def costmap(self, grid: OccupancyGrid) -> Costmap:
        """The inflated ``grid``; computed once for the same grid object."""
        costmap = self._costmap  # read once: another thread may plan on another grid
        if costmap is None or costmap.grid is not grid:
            costmap = self._costmap = build_costmap(grid, self._limits, self._params)
        return costmap

    def relax(self, grid: OccupancyGrid, goal: Pose2D, tolerance_m: float) -> Pose2D:
        """``goal``, or the nearest place where the robot may stand, if ``goal`` is none and one is within tolerance.

        Raises:
            OutsideMapError: the goal is not on the map (or not finite).
        """
        cost, cell = self.costmap(grid).cost, _cell(grid, "goal", goal)
        if np.isfinite(cost[cell]):
            return goal
        reach = int(min(tolerance_m / grid.resolution, max(cost.shape))) + 1
        low = np.maximum(np.array(cell) - reach, 0)
        window = cost[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1]
        places = grid.cell_to_world(np.argwhere(np.isfinite(window)) + low)
        away = np.hypot(*(places - [goal.x, goal.y]).T)
        if not len(away) or away.min() > tolerance_m:
            return goal
        x, y = places[away.argmin()]
        return Pose2D(float(x), float(y), goal.theta)

    def plan(self, grid: OccupancyGrid, start: Pose2D, goal: Pose2D) -> FloatArray:
        """The path (N, 2) in m in ``map``, N >= 2, from exactly ``start`` to exactly ``goal``, about a cell a step.

        A robot that stands closer to an obstacle than it may drive (pushed there, or a box has appeared beside it) may
        leave that strip by the shortest way; a goal there is refused.

        Raises:
            OutsideMapError: start or goal is not on the map (or not finite).
            StartBlockedError: the start is in an obstacle, or in a strip that cannot be left.
            GoalBlockedError: the goal is in an obstacle or its inflation.
            UnreachableError: no path joins the two.
        """
        costmap = self.costmap(grid)
        start_cell, goal_cell = _cell(grid, "start", start), _cell(grid, "goal", goal)
        cost, regions = costmap.cost, None
        if not np.isfinite(cost[goal_cell]):
            raise GoalBlockedError(
                f"goal ({goal.x:.2f}, {goal.y:.2f}) has {max(costmap.clearance[goal_cell], 0.0):.2f} m to the nearest "
                f"obstacle, expected at least {costmap.lethal_m:.2f} m"
            )
        if not np.isfinite(cost[start_cell]):
            cost = _open_way_out(costmap, start_cell)
            if not np.isfinite(cost[start_cell]):
                raise StartBlockedError(f"start ({start.x:.2f}, {start.y:.2f}) is inside an obstacle")
            regions = label_regions(cost)
            if not np.isfinite(costmap.cost[regions == regions[start_cell]]).any():
                raise StartBlockedError(f"start ({start.x:.2f}, {start.y:.2f}) is closed in by obstacles")
        regions = costmap.regions if regions is None else regions
        if regions[start_cell] != regions[goal_cell]:
            raise UnreachableError(
                f"no way from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f}) "
                f"that is {2 * costmap.lethal_m:.2f} m wide"
            )
        ends = np.array([(start.x, start.y), (goal.x, goal.y)])
        path = _smooth(self._search(cost, start_cell, goal_cell).cells, costmap, self._params)
        return np.vstack([ends[:1], grid.cell_to_world(path[1:-1]), ends[1:]])


def _cell(grid: OccupancyGrid, name: str, pose: Pose2D) -> Cell:
    if pose.is_finite():
        cell = grid.world_to_cell([pose.x, pose.y])
        if grid.in_bounds(cell)[0]:
            return int(cell[0, 0]), int(cell[0, 1])
    raise OutsideMapError(f"{name} ({pose.x:.2f}, {pose.y:.2f}) is outside the map")


def _open_way_out(costmap: Costmap, start: Cell) -> CostArray:
    """Costs with the inflation about ``start`` passable, dearer than any free cell, so that it is left at once."""
    reach = int(np.ceil(costmap.lethal_m / costmap.grid.resolution)) + 1
    window = tuple(slice(max(0, index - reach), index + reach + 1) for index in start)
    cost = costmap.cost.copy()
    strip = ~np.isfinite(cost[window]) & (costmap.clearance[window] > 0)
    free = cost[np.isfinite(cost)]
    cost[window][strip] = 10.0 * (float(free.max()) if free.size else 1.0)
    return cost


def _smooth(cells: CellArray, costmap: Costmap, params: GlobalPlannerParameters) -> FloatArray:
    """The path (N, 2) through ``cells`` (N, 2), in fractions of cells, with its bends rounded off.

    Each point moves towards the middle of its neighbours as long as it stays in a passable cell and loses no more than
    a cell's width of clearance, of which more than the inflation radius counts for nothing. The ends stay.
    """
    own = costmap.clearance[tuple(cells.T)][1:-1]
    least = np.minimum(own - costmap.grid.resolution, params.inflation_m)
    least = np.maximum(least, np.minimum(own, costmap.lethal_m))
    path = cells.astype(float)
    for _ in range(params.smoothing_rounds if len(cells) > 2 else 0):
        moved = (path[:-2] + 2.0 * path[1:-1] + path[2:]) / 4.0
        keeps_clear = costmap.clearance[tuple(np.rint(moved).astype(int).T)] >= least
        path[1:-1][keeps_clear] = moved[keeps_clear]
    return path
