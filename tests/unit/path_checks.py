"""What every path on a grid has to keep."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.planning.astar import SearchResult


def is_passable(cost: np.ndarray) -> np.ndarray:
    return (cost >= 1) & np.isfinite(cost)


def check_path(cost: np.ndarray, start, goal, result: SearchResult) -> None:
    """The path joins start and goal, is free, cuts no corner and costs what it says."""
    cells = result.cells
    passable = is_passable(cost)
    assert tuple(cells[0]) == start
    assert tuple(cells[-1]) == goal
    assert passable[tuple(cells.T)].all()
    steps = np.diff(cells, axis=0)
    assert (np.abs(steps).max(axis=1, initial=1) == 1).all()
    assert passable[cells[:-1, 0], cells[1:, 1]].all()
    assert passable[cells[1:, 0], cells[:-1, 1]].all()
    along = cost[tuple(cells.T)].astype(float)
    total = (np.hypot(*steps.T) * (along[:-1] + along[1:]) / 2).sum()
    assert result.cost == pytest.approx(total, abs=1e-9)
