"""A* on 8-connected grids: a readable reference, and the compiled search that does the work.

Both search an array ``cost`` (H, W) of float32: a cell is passable when its cost is at least 1 and finite. A step
between two cells costs its length in cells, 1 or √2, times the mean cost of the two, so a path costs the same in either
direction. A diagonal step is allowed only when both cells beside it are passable: no corners are cut, and therefore
two cells are connected exactly when they are 4-connected. The heuristic is the octile distance, which never
overestimates because no cell costs less than 1. Among equal estimates the cell farther along goes first, then the one
with the lower index, so that the same grid always gives the same path.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros import _grid_search
from hitchhike_ros.mapping.grid import CellArray

CostArray = npt.NDArray[np.float32]
Cell = tuple[int, int]

_DIAGONAL = math.sqrt(2.0)
# East, west, north, south, then the diagonals, each after the two steps it lies between.
_STRAIGHT = ((0, 1), (0, -1), (1, 0), (-1, 0))
_OBLIQUE = ((1, 1), (-1, 1), (1, -1), (-1, -1))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Cells (N, 2) as (row, column) from start to goal, their cost in cells, and how many cells were expanded.

    Without a path there are no cells and the cost is infinite.
    """

    cells: CellArray
    cost: float
    expanded: int

    @property
    def found(self) -> bool:
        return len(self.cells) > 0


def search(cost: CostArray, start: Cell, goal: Cell) -> SearchResult:
    """The cheapest path from ``start`` to ``goal``; compiled, and other threads run meanwhile.

    Raises:
        IndexError: start or goal is outside the grid.
        TypeError: ``cost`` is not a contiguous float32 array; it is never copied.
    """
    return SearchResult(*_grid_search.astar(cost, start, goal))


def search_reference(cost: CostArray, start: Cell, goal: Cell) -> SearchResult:
    """The same as :func:`search`, slow and plain: the specification that tests hold the compiled search to."""
    height, width = cost.shape

    def passable(row: int, column: int) -> bool:
        return 0 <= row < height and 0 <= column < width and 1.0 <= cost[row, column] < math.inf

    def heuristic(row: int, column: int) -> float:
        dr, dc = abs(row - goal[0]), abs(column - goal[1])
        return max(dr, dc) + (_DIAGONAL - 1.0) * min(dr, dc)

    for name, cell in (("start", start), ("goal", goal)):
        if not (0 <= cell[0] < height and 0 <= cell[1] < width):
            raise IndexError(f"{name} {cell} is outside the grid of {height} x {width}")
    best: dict[Cell, float] = {start: 0.0}
    parent: dict[Cell, Cell] = {}
    closed: set[Cell] = set()
    open_cells = [(heuristic(*start), 0.0, start)] if passable(*start) and passable(*goal) else []
    while open_cells:
        here = heapq.heappop(open_cells)[-1]
        if here in closed:
            continue  # it was pushed again when a cheaper way to it was found
        closed.add(here)
        if here == goal:
            break
        row, column = here
        steps = [(dr, dc, 1.0) for dr, dc in _STRAIGHT if passable(row + dr, column + dc)]
        steps += [
            (dr, dc, _DIAGONAL)
            for dr, dc in _OBLIQUE
            if passable(row + dr, column) and passable(row, column + dc) and passable(row + dr, column + dc)
        ]
        for dr, dc, length in steps:
            cell = (row + dr, column + dc)
            g = best[here] + length * (float(cost[here]) + float(cost[cell])) / 2.0
            if g < best.get(cell, math.inf):
                best[cell], parent[cell] = g, here
                h = heuristic(*cell)
                heapq.heappush(open_cells, (g + h, h, cell))
    if goal not in closed:
        return SearchResult(np.empty((0, 2), dtype=np.int64), math.inf, len(closed))
    path = [goal]
    while path[-1] != start:
        path.append(parent[path[-1]])
    return SearchResult(np.array(path[::-1], dtype=np.int64), best[goal], len(closed))
