"""A*: the reference's paths are right, and the compiled search finds paths of the same cost."""

from __future__ import annotations

import math
import sys
import threading
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from hitchhike_ros.experiments.bench.moving_ai import load_moving_ai_map, load_problems
from hitchhike_ros.mapping.grid import FREE
from hitchhike_ros.planning.astar import search, search_reference
from hitchhike_ros.planning.dstar_lite import DStarLite
from path_checks import check_path, is_passable

SEARCHES = pytest.mark.parametrize("find", [search, search_reference])


def grid_of(*rows: str) -> np.ndarray:
    """A cost array drawn with the first row on top as row 0: ``#`` blocked, digits the cost."""
    return np.array([[math.inf if c == "#" else float(c) for c in row] for row in rows], dtype=np.float32)


@st.composite
def problems(draw):
    shape = draw(st.tuples(st.integers(1, 14), st.integers(1, 14)))
    costs = st.sampled_from([1.0, 1.0, 1.0, 1.5, 2.25, 7.0, math.inf, math.inf, math.nan, 0.5, -1.0])
    cost = draw(hnp.arrays(np.float32, shape, elements=costs.map(np.float32)))
    start, goal = (tuple(draw(st.integers(0, n - 1)) for n in shape) for _ in range(2))
    return cost, start, goal


def dijkstra_cost(cost: np.ndarray, start, goal) -> float:
    """An oracle that shares no code with either search: SciPy's Dijkstra on the graph of allowed steps."""
    passable, index = is_passable(cost), np.arange(cost.size).reshape(cost.shape)
    rows, columns, weights = [], [], []
    for row, column in np.argwhere(passable):
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                r, c = row + dr, column + dc
                if (dr, dc) == (0, 0) or not (0 <= r < cost.shape[0] and 0 <= c < cost.shape[1]):
                    continue
                if passable[r, c] and passable[row, c] and passable[r, column]:
                    rows.append(index[row, column])
                    columns.append(index[r, c])
                    weights.append(math.hypot(dr, dc) * (float(cost[row, column]) + float(cost[r, c])) / 2)
    graph = coo_matrix((weights, (rows, columns)), shape=(cost.size, cost.size)).tocsr()
    return float(dijkstra(graph, indices=index[start])[index[goal]]) if passable[start] else math.inf


@given(problems())
@settings(max_examples=150)
def test_the_reference_is_optimal(problem):
    cost, start, goal = problem
    result = search_reference(cost, start, goal)
    assert result.cost == pytest.approx(dijkstra_cost(cost, start, goal), abs=1e-9)


@given(problems())
@settings(max_examples=400)
def test_compiled_and_reference_agree(problem):
    cost, start, goal = problem
    result, reference = search(cost, start, goal), search_reference(cost, start, goal)
    assert result.found == reference.found == math.isfinite(result.cost)
    assert result.cost == pytest.approx(reference.cost, abs=1e-9)
    for each in (result, reference):
        if each.found:
            check_path(cost, start, goal, each)


@given(problems())
@settings(max_examples=150)
def test_reachable_means_four_connected(problem):
    cost, start, goal = problem
    labels, _ = ndimage.label(is_passable(cost))
    assert search(cost, start, goal).found == (labels[start] == labels[goal] != 0)


@given(problems())
@settings(max_examples=100)
def test_the_way_back_costs_the_same(problem):
    cost, start, goal = problem
    assert search(cost, start, goal).cost == pytest.approx(search(cost, goal, start).cost, abs=1e-9)


@SEARCHES
def test_straight_and_diagonal(find):
    cost = grid_of("1111", "1111", "1111")
    assert find(cost, (0, 0), (0, 3)).cost == pytest.approx(3)
    assert find(cost, (0, 0), (2, 3)).cost == pytest.approx(1 + 2 * math.sqrt(2))


@SEARCHES
def test_a_corner_is_not_cut(find):
    cost = grid_of("11", "#1")
    assert find(cost, (0, 0), (1, 1)).cells.tolist() == [[0, 0], [0, 1], [1, 1]]
    assert not find(grid_of("1#", "#1"), (0, 0), (1, 1)).found


@SEARCHES
def test_a_costly_cell_is_avoided_when_the_way_round_is_cheaper(find):
    assert [1, 1] not in find(grid_of("111", "191", "111"), (1, 0), (1, 2)).cells.tolist()
    assert [1, 1] in find(grid_of("###", "191", "###"), (1, 0), (1, 2)).cells.tolist()


@SEARCHES
def test_start_is_goal(find):
    result = find(grid_of("11"), (0, 1), (0, 1))
    assert (result.cells.tolist(), result.cost) == ([[0, 1]], 0.0)


@SEARCHES
@pytest.mark.parametrize(("start", "goal"), [((0, 0), (0, 2)), ((0, 1), (0, 0)), ((0, 1), (0, 1))])
def test_no_path_from_or_to_or_through_a_wall(find, start, goal):
    result = find(grid_of("1#1"), start, goal)
    assert (result.found, result.cost, result.cells.shape) == (False, math.inf, (0, 2))


@SEARCHES
@pytest.mark.parametrize("cell", [(-1, 0), (0, 2), (1, 0)])
def test_cells_outside_the_grid(find, cell):
    with pytest.raises(IndexError, match="goal"):
        find(grid_of("11"), (0, 0), cell)
    with pytest.raises(IndexError, match="start"):
        find(grid_of("11"), cell, (0, 0))


def test_arrays_that_would_have_to_be_copied_are_refused():
    for cost in (np.ones((4, 4)), np.ones((4, 8), dtype=np.float32)[:, ::2], np.ones((4, 4), dtype=int)):
        with pytest.raises(TypeError):
            search(cost, (0, 0), (1, 1))


def test_the_same_grid_gives_the_same_path():
    cost = np.where(np.random.default_rng(2).random((60, 60)) < 0.25, np.inf, 1).astype(np.float32)
    cost[0, 0] = cost[59, 59] = 1
    paths = [search(cost.copy(), (0, 0), (59, 59)).cells.tolist() for _ in range(3)]
    assert paths[0]
    assert paths[0] == paths[1] == paths[2]


def test_other_threads_run_during_a_search():
    cost = np.ones((1500, 1500), dtype=np.float32)
    cost[0, 0:-1] = np.inf
    begun, ran = threading.Event(), []

    def run() -> None:
        begun.wait(60.0)
        ran.append(True)

    thread, interval = threading.Thread(target=run), sys.getswitchinterval()
    sys.setswitchinterval(60.0)  # so this thread loses the interpreter only where it gives it up
    thread.start()
    try:
        begun.set()
        before = list(ran)
        for _ in range(100):  # on a busy machine the other thread may get no core during one search
            search(cost, (1499, 0), (0, 1499))
            if ran:
                break
        after = list(ran)
    finally:
        sys.setswitchinterval(interval)
        thread.join(timeout=10.0)
    assert (before, after) == ([], [True])


@pytest.mark.parametrize("name", ["arena", "32room_000", "lak303d"])
def test_moving_ai_scenarios_have_the_optimal_length(shared_data, name):
    """A spread of each file's scenarios; lengths in the files are rounded."""
    file = shared_data / "movingai" / f"{name}.map"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    cost = np.where(load_moving_ai_map(file).data == FREE, 1, np.inf).astype(np.float32)
    scenarios = load_problems(file.with_suffix(".map.scen"))
    its = DStarLite(cost)
    for scenario in scenarios[:: max(1, len(scenarios) // 25)]:
        for plan in (partial(search, cost), its.plan):
            assert plan(scenario.start, scenario.goal).cost == pytest.approx(scenario.length, abs=0.006)
