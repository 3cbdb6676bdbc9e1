"""D* Lite: shortest paths that are repaired, not searched anew, when cells change and the robot moves on.

Koenig and Likhachev, "Fast replanning for navigation in unknown terrain", AAAI 2002 and IEEE T-RO 21(3), 2005; the
optimised version. Grids, steps and costs are those of :mod:`hitchhike_ros.planning.astar`. The search grows from the
goal, so that its distances outlive the robot's moves, and repairs only what a change makes wrong and the robot's path
may depend on. It pays off where changes are near the robot and the same goal is planned for again and again; for a
single path A* expands fewer cells.
"""

from __future__ import annotations

import math
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from hitchhike_ros import _grid_search
from hitchhike_ros.mapping.grid import CellArray
from hitchhike_ros.planning.astar import Cell, CostArray, SearchResult


class DStarLite:
    """Plans on one grid whose costs change; compiled, and other threads run meanwhile.

    Args:
        cost: (H, W) float32 as of :mod:`hitchhike_ros.planning.astar`, passable cells of at most 10⁶; copied.

    Raises:
        TypeError: ``cost`` is not a contiguous float32 array.
        ValueError: a passable cell costs more than 10⁶: sums of such costs lose what cheap steps add to them.
    """

    def __init__(self, cost: CostArray) -> None:
        self._search = _grid_search.DStarLite(cost)

    def plan(self, start: Cell, goal: Cell) -> SearchResult:
        """The cheapest path from ``start`` to a new ``goal``, searched from scratch.

        Raises:
            IndexError: start or goal is outside the grid.
        """
        return SearchResult(*self._search.plan(start, goal))

    def move(self, start: Cell) -> SearchResult:
        """The cheapest path from where the robot is now to the goal of the last :meth:`plan`, after all changes.

        Raises:
            IndexError: start is outside the grid.
            ValueError: nothing was planned before.
        """
        return SearchResult(*self._search.move(start))

    def change(self, cells: npt.ArrayLike, costs: npt.ArrayLike) -> None:
        """Give ``cells`` (N, 2) as (row, column) the new ``costs`` (N,); what is not passable is blocked.

        When a cell is named twice, its last cost holds.

        Raises:
            IndexError: a cell is outside the grid; then nothing has changed.
            ValueError: there are not as many costs as cells, or one is above the limit; then nothing has changed.
        """
        self._search.change(np.asarray(cells, dtype=np.int64).reshape(-1, 2), np.asarray(costs, dtype=np.float32))


class RepairedSearch:
    """One search after another, each of them a repair of the last where that saves something.

    It does when the goal and the size of the grid are the same and few cells have changed, as when a box appears or
    vanishes in the map of a robot under way. The cost is that of a fresh search; of paths that cost the same it may be
    another one. Threads may share it and take turns.
    """

    # With more cells changed than this share of all, a search from scratch costs less; chosen.
    _FEW = 0.1

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: tuple[DStarLite, Cell, CostArray] | None = None

    def __call__(self, cost: CostArray, start: Cell, goal: Cell) -> SearchResult:
        """As :func:`hitchhike_ros.planning.astar.search`; ``cost`` is kept, and must not change afterwards."""
        with self._lock:
            if self._last is not None and self._last[1] == goal and self._last[2].shape == cost.shape:
                search, _, before = self._last
                cells = np.argwhere(cost != before)
                if len(cells) <= self._FEW * cost.size:
                    search.change(cells, cost[tuple(cells.T)])
                    self._last = search, goal, cost
                    return search.move(start)
            search = DStarLite(cost)
            self._last = search, goal, cost
            return search.plan(start, goal)


_DIAGONAL = math.sqrt(2.0)
# The heuristic is this much of the octile distance: on free grids f is the same all along a path, and rounding must not
# end the search before a cell of the path whose g is out of date.
_OF_OCTILE = 1.0 - 1e-3

_Key = tuple[float, float]


class DStarLiteReference:
    """The same as :class:`DStarLite`, slow and close to the paper's Fig. 4: the specification for the tests.

    Names are the paper's: ``g`` is the cost to the goal of a cell as last expanded, ``rhs`` the one-step look-ahead on
    its neighbours' g, and the queue U holds the cells where the two differ.
    """

    def __init__(self, cost: CostArray) -> None:
        self._cost = np.array(cost, dtype=np.float32)

    def plan(self, start: Cell, goal: Cell) -> SearchResult:
        """See :meth:`DStarLite.plan`."""
        for name, cell in (("start", start), ("goal", goal)):
            if not self._inside(cell):
                raise IndexError(f"{name} {cell} is outside the grid")
        self._start = self._last = start
        self._goal = goal
        self._g: dict[Cell, float] = defaultdict(lambda: math.inf)
        self._rhs: dict[Cell, float] = defaultdict(lambda: math.inf)
        self._rhs[goal] = 0.0
        self._k_m = 0.0
        self._queue = {goal: self._calculate_key(goal)}
        return self._result(self._compute_shortest_path())

    def move(self, start: Cell) -> SearchResult:
        """See :meth:`DStarLite.move`."""
        if not self._inside(start):
            raise IndexError(f"start {start} is outside the grid")
        self._start = start
        self._follow_robot()
        return self._result(self._compute_shortest_path())

    def change(self, cells: Iterable[Cell], costs: Iterable[float]) -> None:
        """See :meth:`DStarLite.change`."""
        self._follow_robot()
        for cell, cost in zip(cells, costs, strict=True):
            self._cost[cell] = cost
            # A cell also opens and closes the diagonals between its neighbours.
            for near in [cell, *self._around(cell)]:
                if near != self._goal:
                    self._rhs[near] = self._look_ahead(near)
                self._update_vertex(near)

    def _inside(self, cell: Cell) -> bool:
        return 0 <= cell[0] < self._cost.shape[0] and 0 <= cell[1] < self._cost.shape[1]

    def _passable(self, cell: Cell) -> bool:
        return self._inside(cell) and 1.0 <= self._cost[cell] < math.inf

    def _around(self, cell: Cell) -> Iterator[Cell]:
        """The neighbours of a cell: its successors and its predecessors, as the way back costs the same."""
        for row in range(cell[0] - 1, cell[0] + 2):
            for column in range(cell[1] - 1, cell[1] + 2):
                if (row, column) != cell and self._inside((row, column)):
                    yield row, column

    def _c(self, a: Cell, b: Cell) -> float:
        """Cost of the step between two neighbours, infinite where it is not allowed."""
        if not all(map(self._passable, (a, b, (a[0], b[1]), (b[0], a[1])))):
            return math.inf
        length = _DIAGONAL if a[0] != b[0] and a[1] != b[1] else 1.0
        return length * (float(self._cost[a]) + float(self._cost[b])) / 2.0

    def _look_ahead(self, cell: Cell) -> float:
        return min((self._c(cell, to) + self._g[to] for to in self._around(cell)), default=math.inf)

    def _h(self, a: Cell, b: Cell) -> float:
        dr, dc = abs(a[0] - b[0]), abs(a[1] - b[1])
        return _OF_OCTILE * (max(dr, dc) + (_DIAGONAL - 1.0) * min(dr, dc))

    def _calculate_key(self, s: Cell) -> _Key:
        g = min(self._g[s], self._rhs[s])
        return g + self._h(self._start, s) + self._k_m, g

    def _update_vertex(self, u: Cell) -> None:
        if self._g[u] != self._rhs[u]:
            self._queue[u] = self._calculate_key(u)
        else:
            self._queue.pop(u, None)

    def _follow_robot(self) -> None:
        self._k_m += self._h(self._last, self._start)
        self._last = self._start

    def _compute_shortest_path(self) -> int:
        """Number of expanded cells."""
        expanded = 0
        while self._queue:
            u = min(self._queue, key=self._queue.__getitem__)
            old, new = self._queue[u], self._calculate_key(u)
            if old >= self._calculate_key(self._start) and self._rhs[self._start] <= self._g[self._start]:
                break
            if old < new:
                self._queue[u] = new
                continue
            expanded += 1
            if self._g[u] > self._rhs[u]:
                self._g[u] = self._rhs[u]
                del self._queue[u]
                for s in self._around(u):
                    if s != self._goal:
                        self._rhs[s] = min(self._rhs[s], self._c(s, u) + self._g[u])
                    self._update_vertex(s)
            else:
                g_old, self._g[u] = self._g[u], math.inf
                for s in [*self._around(u), u]:
                    if s != self._goal and (s == u or self._rhs[s] == self._c(s, u) + g_old):
                        self._rhs[s] = self._look_ahead(s)
                    self._update_vertex(s)
        return expanded

    def _result(self, expanded: int) -> SearchResult:
        cost = self._rhs[self._start]
        if not (self._passable(self._start) and self._passable(self._goal) and math.isfinite(cost)):
            return SearchResult(np.empty((0, 2), dtype=np.int64), math.inf, expanded)
        path = [self._start]
        while path[-1] != self._goal:
            here = path[-1]
            path.append(min(self._around(here), key=lambda to: self._c(here, to) + self._g[to]))
        cells: CellArray = np.array(path, dtype=np.int64)
        return SearchResult(cells, cost, expanded)
