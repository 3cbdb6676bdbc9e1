"""Paths on the grid of the grid simulator: D* Lite with the papers' costs, one search for each goal, shared by all.

The search grows from the goal, so that robots under way to one goal share it wherever they are, and a path costs little
more than reading it off (P18 §8.1: D*, a step costs 1, a diagonal one √2). A robot that knows new boxes has searches of
its own, shared by those who know the same boxes.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterable

import numpy as np

from hitchhike_ros.core.datatypes import BoolArray, FloatArray, Obstacle
from hitchhike_ros.core.errors import (
    GoalBlockedError,
    OutsideMapError,
    PlanningError,
    StartBlockedError,
    UnreachableError,
)
from hitchhike_ros.core.geometry import nearest_in_box
from hitchhike_ros.mapping.grid import CellArray, OccupancyGrid, distance_to
from hitchhike_ros.planning.astar import Cell, CostArray
from hitchhike_ros.planning.costmap import CostmapParameters, label_regions
from hitchhike_ros.planning.dstar_lite import DStarLite

Point = tuple[float, float]
# Boxes that a robot knows, by their ids in alphabetical order.
Known = tuple[str, ...]

# A robot that is nearer to an obstacle than it may drive looks so far for a way out (chosen).
_WAY_OUT_M = 1.5
# How many searches are kept; each takes 4 MB on the map of P18 §8.1.
_SEARCHES = 160


class GridPaths:
    """Plans for robots of one size on one map with boxes that not everybody knows.

    ``clearance_m`` is the least distance of a robot's centre to an obstacle's edge. The papers' paths have the least
    length; with a ``weight``, ``clearance_weight`` of :mod:`hitchhike_ros.planning.costmap`, they keep to the middle.
    """

    def __init__(
        self, grid: OccupancyGrid, clearance_m: float, boxes: Iterable[Obstacle] = (), weight: float = 0.0
    ) -> None:
        self._weight = weight
        self.grid, self.clearance_m = grid, clearance_m
        self.boxes = {box.id: box for box in boxes}
        self._obstacles = grid.data != 0
        # From the centre of a cell to the nearest obstacle's, boxes included: so far a line of sight is free.
        solid = grid.with_obstacles(self.boxes.values()).data != 0
        self._solid = solid
        self._free_m = distance_to(solid, grid.resolution)
        self._costs: dict[Known, CostArray] = {}
        self._searches: OrderedDict[tuple[Known, Cell], _Search] = OrderedDict()
        self._origin, self._resolution = (grid.origin.x, grid.origin.y), grid.resolution
        if grid.origin.theta:
            raise ValueError(f"grid is turned by {grid.origin.theta} rad, expected 0")

    def add_box(self, box: Obstacle) -> None:
        """Take in a box that some robot knows; it need not stand anywhere."""
        self.boxes.setdefault(box.id, box)

    def cell(self, x: float, y: float) -> Cell:
        """Row and column of a point; they may be out of bounds."""
        r = self._resolution
        return math.floor((y - self._origin[1]) / r + 1e-9), math.floor((x - self._origin[0]) / r + 1e-9)

    def plan(self, start: Point, goal: Point, known: Known = ()) -> FloatArray:
        """The path (N, 2) in m in ``map``, N >= 2, from exactly ``start`` to exactly ``goal``, a cell a step.

        Raises:
            OutsideMapError: start or goal is not on the map (or not finite).
            StartBlockedError: the start is too near to obstacles, and so is all around it.
            GoalBlockedError: the goal is too near to an obstacle.
            UnreachableError: no path joins the two.
        """
        cells = self._cells(start, goal, known)
        path = np.empty((max(len(cells) - 1, 0) + 2, 2))
        path[0], path[-1] = start, goal
        path[1:-1] = (cells[:-1, ::-1] + 0.5) * self._resolution + self._origin
        return path

    def metres(self, start: Point, goal: Point, known: Known = ()) -> float:
        """Length of the path from cell to cell, to within 3 cells and mostly 1; infinite where there is none."""
        return float(self.all_metres(np.array([start]), np.array([goal]), known)[0, 0])

    def all_metres(self, sources: FloatArray, targets: FloatArray, known: Known = ()) -> FloatArray:
        """As :meth:`metres`, (A, B) from each of the sources (A, 2) to each of the targets (B, 2).

        A path tells how far it is from each of its cells, and nearly from those beside, so most answers are there
        already.
        """
        found = np.full((len(sources), len(targets)), np.inf)
        rows, columns = np.floor((sources - self._origin) / self._resolution + 1e-9).astype(int).T[::-1]
        on_map = (rows >= 0) & (rows < self.grid.height) & (columns >= 0) & (columns < self.grid.width)
        rows, columns = rows[on_map], columns[on_map]
        for j, goal in enumerate(targets.tolist()):
            try:
                search = self._search(goal, known)
            except PlanningError:
                continue
            metres = search.metres[rows, columns]
            for k in np.flatnonzero(np.isnan(metres)).tolist():
                metres[k] = self._metres_from((int(rows[k]), int(columns[k])), search, known)
            found[on_map, j] = metres
        return found

    def free(self, at: Point) -> bool:
        """Whether the map lets a robot be there."""
        row, column = self.cell(*at)
        inside = 0 <= row < self.grid.height and 0 <= column < self.grid.width
        return inside and math.isfinite(self._cost(())[row, column])

    def region(self) -> BoolArray:
        """The largest connected part of the map where a robot may be, boxes or not, as a mask (H, W)."""
        labels = label_regions(self._cost(tuple(sorted(self.boxes))))
        counts = np.bincount(labels[labels > 0]) if labels.any() else np.array([0, 0])
        return np.asarray(labels == counts.argmax())

    def sees(self, a: Point, b: Point) -> bool:
        """Whether the straight line between two points meets no wall and no box."""
        apart = math.dist(a, b)
        row, column = self.cell(*a)
        height, width = self._free_m.shape
        if not (0 <= row < height and 0 <= column < width):
            return False
        if self._free_m[row, column] > apart + self._resolution:
            return True
        steps = max(2, math.ceil(2.0 * apart / self._resolution))
        along = np.linspace(0.0, 1.0, steps + 1)
        points = np.array(a) + along[:, None] * (np.array(b) - np.array(a))
        cells = np.floor((points - self._origin) / self._resolution + 1e-9).astype(int)
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < width) & (cells[:, 1] < height)
        return bool(inside.all()) and not self._solid[cells[:, 1], cells[:, 0]].any()

    def sees_box(self, at: Point, box: Obstacle) -> bool:
        """Whether the nearest edge of the box can be seen; the box hides what is behind that edge."""
        nearest = nearest_in_box(*at, box)
        apart = math.dist(at, nearest)
        before = 1.0 - min(1.0, 1.5 * self._resolution / apart) if apart else 0.0
        return self.sees(at, (at[0] + before * (nearest[0] - at[0]), at[1] + before * (nearest[1] - at[1])))

    def _cells(self, start: Point, goal: Point, known: Known) -> CellArray:
        """The cells (N, 2) of a path behind that of ``start``, up to that of ``goal``; errors as of :meth:`plan`."""
        from_cell, search, cost = self._on_map("start", start), self._search(goal, known), self._cost(known)
        leaves = not math.isfinite(cost[from_cell])
        if leaves:
            from_cell = self._way_out(cost, from_cell, start)
        cells = search.cells(from_cell)
        if not len(cells):
            raise UnreachableError(
                f"no way from ({start[0]:.2f}, {start[1]:.2f}) to ({goal[0]:.2f}, {goal[1]:.2f}) "
                f"that is {2 * self.clearance_m:.2f} m wide"
            )
        return cells if leaves else cells[1:]

    def _metres_from(self, cell: Cell, search: _Search, known: Known) -> float:
        """The length from a cell that is on no path so far; from one where a robot may not be, by the way out."""
        if not math.isnan(told := search.metres[cell]):
            return float(told)  # by the path from a source before this one
        if (beside := search.metres_beside(cell)) is not None:
            return beside
        cost, out = self._cost(known), cell
        if not math.isfinite(cost[cell]):
            try:
                out = self._way_out(cost, cell, self._middle(cell))
            except StartBlockedError:
                return math.inf
        search.cells(out)
        search.metres[cell] = search.metres[out] + math.dist(cell, out) * self._resolution
        return float(search.metres[cell])

    def _search(self, goal: Point, known: Known) -> _Search:
        """The search to ``goal``; raises OutsideMapError and GoalBlockedError as :meth:`plan`."""
        to_cell = self._on_map("goal", goal)
        search = self._searches.get((known, to_cell))
        if search is None:
            cost = self._cost(known)
            if not math.isfinite(cost[to_cell]):
                raise GoalBlockedError(f"goal ({goal[0]:.2f}, {goal[1]:.2f}) is too near to an obstacle")
            search = self._searches[known, to_cell] = _Search(cost, to_cell, self._resolution)
            if len(self._searches) > _SEARCHES:
                self._searches.popitem(last=False)
        else:
            self._searches.move_to_end((known, to_cell))
        return search

    def _middle(self, cell: Cell) -> Point:
        row, column = cell
        return (column + 0.5) * self._resolution + self._origin[0], (row + 0.5) * self._resolution + self._origin[1]

    def _on_map(self, name: str, point: Point) -> Cell:
        if math.isfinite(point[0]) and math.isfinite(point[1]):
            row, column = self.cell(*point)
            if 0 <= row < self.grid.height and 0 <= column < self.grid.width:
                return row, column
        raise OutsideMapError(f"{name} ({point[0]:.2f}, {point[1]:.2f}) is not on the map")

    def _cost(self, known: Known) -> CostArray:
        """Costs of all cells: 1 where a robot may be, inf elsewhere."""
        cost = self._costs.get(known)
        if cost is None:
            blocked = self._obstacles if not known else self._with_boxes(known)
            clearance = distance_to(blocked, self._resolution) - self._resolution / 2
            near = np.maximum(1.0 - clearance / CostmapParameters.inflation_m, 0.0) ** 2
            cost = np.where(clearance < self.clearance_m, np.inf, 1.0 + self._weight * near).astype(np.float32)
            self._costs[known] = cost
        return cost

    def _with_boxes(self, known: Known) -> np.ndarray:
        return self.grid.with_obstacles(self.boxes[name] for name in known).data != 0

    def _way_out(self, cost: CostArray, cell: Cell, start: Point) -> Cell:
        """The nearest cell where a robot may be."""
        reach = math.ceil(_WAY_OUT_M / self._resolution)
        low = max(cell[0] - reach, 0), max(cell[1] - reach, 0)
        free = np.argwhere(np.isfinite(cost[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1])) + low
        apart = np.hypot(*(free - cell).T) if len(free) else np.empty(0)
        if not len(free) or apart.min() * self._resolution > _WAY_OUT_M:
            raise StartBlockedError(f"start ({start[0]:.2f}, {start[1]:.2f}) is closed in by obstacles")
        row, column = free[apart.argmin()]
        return int(row), int(column)


class _Search:
    """The paths to one goal, and how long they are from every cell of those that were asked for."""

    def __init__(self, cost: CostArray, goal: Cell, resolution: float) -> None:
        self._dstar, self._goal, self._resolution = DStarLite(cost), goal, resolution
        self._begun = False
        self.metres = np.full(cost.shape, np.nan, dtype=np.float32)  # (H, W); NaN where no path has come by
        self._planned = np.zeros(cost.shape, dtype=bool)  # cells of paths

    def cells(self, start: Cell) -> CellArray:
        """The cells (N, 2) from ``start`` to the goal; none where there is no way."""
        found = self._dstar.move(start) if self._begun else self._dstar.plan(start, self._goal)
        self._begun = True
        cells = found.cells
        if not len(cells):
            self.metres[start] = np.inf
        elif math.isnan(self.metres[start]):
            steps = cells[1:] != cells[:-1]
            lengths = np.where(steps.all(axis=1), math.sqrt(2.0), 1.0) * self._resolution
            self.metres[cells[:, 0], cells[:, 1]] = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
            self._planned[cells[:, 0], cells[:, 1]] = True
        return cells

    def metres_beside(self, cell: Cell) -> float | None:
        """The length by the best neighbour that is on a path planned before; None where none is."""
        rows, columns = (slice(max(k - 1, 0), k + 2) for k in cell)
        planned = self._planned[rows, columns]
        if not planned.any():
            return None
        self.metres[cell] = self.metres[rows, columns][planned].min() + self._resolution
        return float(self.metres[cell])


def corners(path: FloatArray) -> FloatArray:
    """The points (M, 2) of a path (N, 2) at which its direction changes, and both ends."""
    if len(path) < 3:
        return path
    steps = np.diff(path, axis=0)
    turns = np.abs(steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]) > 1e-9
    turns |= (steps[:-1] * steps[1:]).sum(axis=1) < 0.0
    return np.asarray(path[np.concatenate([[True], turns, [True]])])
