"""D* Lite: after every change its path costs what a fresh A* finds, and is a path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hitchhike_ros.planning.astar import SearchResult, search, search_reference
from hitchhike_ros.planning.dstar_lite import DStarLite, DStarLiteReference, RepairedSearch
from path_checks import check_path

BOTH = pytest.mark.parametrize("planner", [DStarLite, DStarLiteReference])
COSTS = [1.0, 1.0, 1.0, 1.5, 2.25, 7.0, math.inf, math.inf, math.nan, 0.5, -1.0]


def check(cost: np.ndarray, start, goal, result: SearchResult, fresh: SearchResult) -> None:
    assert result.found == fresh.found == math.isfinite(result.cost)
    assert result.cost == pytest.approx(fresh.cost, abs=1e-9)
    if result.found:
        check_path(cost, start, goal, result)


@st.composite
def journeys(draw):
    """A grid, a goal, and what happens: each time some cells change and the robot is somewhere."""
    shape = draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    costs = st.sampled_from(COSTS).map(np.float32)
    cells = st.tuples(*(st.integers(0, n - 1) for n in shape))
    events = st.tuples(st.lists(st.tuples(cells, costs), max_size=4), cells)
    grid = draw(hnp.arrays(np.float32, shape, elements=costs))
    return grid, draw(cells), draw(cells), draw(st.lists(events, max_size=6))


@BOTH
@given(journeys())
@settings(max_examples=150)
def test_every_repair_costs_what_a_fresh_search_finds(planner, journey):
    cost, start, goal, events = journey
    its = planner(cost)
    check(cost, start, goal, its.plan(start, goal), search_reference(cost, start, goal))
    for changes, place in events:
        cost = cost.copy()
        for cell, value in changes:
            cost[cell] = value
        its.change([cell for cell, _ in changes], [value for _, value in changes])
        check(cost, place, goal, its.move(place), search_reference(cost, place, goal))


@pytest.mark.parametrize("seed", range(50))
def test_ten_thousand_changes_on_random_maps(seed):
    """200 changes a map, of up to 20 cells, as the robot drives along its path and is now and then put elsewhere."""
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(20, 50, 2))
    plain = seed % 2 == 0  # only free and blocked: many paths cost the same
    values = np.array([1.0, 1.0, math.inf] if plain else [1.0, 1.0, 1.0, 1.7, 3.0, math.inf], dtype=np.float32)
    cost = random.choice(values, shape)
    if plain:
        cost[random.random(shape) < 0.3] = 1.0
    start, goal = ((int(row), int(column)) for row, column in random.integers(0, shape, (2, 2)))
    cost[start] = cost[goal] = 1.0
    its = DStarLite(cost)
    result = its.plan(start, goal)
    found = 0
    for i in range(200):
        cells = random.integers(0, shape, (random.integers(1, 20), 2))
        if i % 2:  # near the robot, where it matters most
            cells = np.clip(start + random.integers(-3, 4, cells.shape), 0, np.array(shape) - 1)
        new = random.choice(values, len(cells))
        for cell, value in zip(cells, new, strict=True):
            cost[tuple(cell)] = value
        its.change(cells, new)
        if i % 25 == 24:
            start = int(random.integers(shape[0])), int(random.integers(shape[1]))
        elif len(result.cells) > 1:
            start = int(result.cells[1, 0]), int(result.cells[1, 1])
        result = its.move(start)
        check(cost, start, goal, result, search(cost, start, goal))
        found += result.found
        if i % 50 == 49:
            goal = int(random.integers(shape[0])), int(random.integers(shape[1]))
            check(cost, start, goal, its.plan(start, goal), search(cost, start, goal))
    assert found > 20


@pytest.mark.parametrize("seed", range(5))
def test_one_search_after_another_on_grids_that_boxes_come_to(seed):
    random = np.random.default_rng(seed)
    its, goal, empty = RepairedSearch(), (35, 35), np.ones((40, 40), dtype=np.float32)
    repaired = 0
    for i in range(60):
        cost = empty.copy()
        for row, column in random.integers(0, 36, (3, 2)):
            cost[row : row + 4, column : column + 4] = random.choice([2.0, math.inf])
        start = int(random.integers(40)), int(random.integers(40))
        if i % 10 == 9:
            goal = int(random.integers(40)), int(random.integers(40))
        result, fresh = its(cost, start, goal), search(cost, start, goal)
        check(cost, start, goal, result, fresh)
        repaired += result.expanded < fresh.expanded
    assert repaired > 10


def test_another_goal_or_another_size_is_searched_from_scratch():
    its = RepairedSearch()
    for shape, goal in (((5, 5), (4, 4)), ((5, 5), (0, 4)), ((3, 9), (0, 4)), ((1, 3), (0, 2))):
        assert its(np.ones(shape, dtype=np.float32), (0, 0), goal).cells[-1].tolist() == list(goal)
    blocked = np.full((1, 3), math.inf, dtype=np.float32)
    assert not its(blocked, (0, 0), (0, 2)).found


@BOTH
def test_a_corner_that_appears_closes_the_diagonal_beside_it(planner):
    cost = np.ones((2, 2), dtype=np.float32)
    its = planner(cost)
    assert its.plan((0, 0), (1, 1)).cost == pytest.approx(math.sqrt(2))
    its.change([(0, 1)], [math.inf])
    assert its.move((0, 0)).cells.tolist() == [[0, 0], [1, 0], [1, 1]]
    its.change([(0, 1)], [1.0])
    assert its.move((0, 0)).cost == pytest.approx(math.sqrt(2))


@BOTH
def test_start_and_goal_that_are_blocked_and_freed_again(planner):
    its = planner(np.ones((3, 5), dtype=np.float32))
    its.plan((1, 0), (1, 4))
    for cell in ((1, 0), (1, 4)):
        its.change([cell], [math.inf])
        assert not its.move((1, 0)).found
        its.change([cell], [1.0])
        assert its.move((1, 0)).cost == 4.0
    assert its.plan((2, 2), (2, 2)).cells.tolist() == [[2, 2]]
    its.change([(2, 2)], [math.nan])
    assert its.move((2, 2)).cost == math.inf


def test_a_change_near_the_robot_is_repaired_there():
    cost = np.ones((200, 200), dtype=np.float32)
    cost[100, 10:] = math.inf
    its = DStarLite(cost)
    first = its.plan((150, 150), (50, 150))
    its.change([(150, 149), (149, 149)], [math.inf, math.inf])
    assert 0 < its.move((150, 150)).expanded < first.expanded / 20


def test_what_is_outside_changes_nothing():
    its = DStarLite(np.ones((4, 5), dtype=np.float32))
    for start, goal in (((4, 0), (0, 0)), ((0, 0), (0, 5)), ((-1, 0), (0, 0))):
        with pytest.raises(IndexError, match="outside the grid"):
            its.plan(start, goal)
    with pytest.raises(ValueError, match="before the first plan"):
        its.move((0, 0))
    its.plan((0, 0), (0, 4))
    with pytest.raises(IndexError, match="outside the grid"):
        its.change([(0, 2), (4, 4)], [math.inf, math.inf])
    with pytest.raises(IndexError, match="outside the grid"):
        its.move((0, 5))
    with pytest.raises(ValueError, match="costs"):
        its.change([(0, 2)], [1.0, 1.0])
    with pytest.raises(ValueError, match="1e6"):
        its.change([(0, 2), (0, 3)], [math.inf, 2e6])
    assert its.move((0, 0)).cost == 4.0


@pytest.mark.parametrize("seed", range(5))
def test_costs_that_swallow_cheap_steps_are_refused_and_all_others_work(seed):
    random = np.random.default_rng(seed)
    values = np.array([1.0, 1.0, 1.3, 1e3, 1e6, math.inf], dtype=np.float32)
    cost = random.choice(values, (40, 40))
    cost[0, 0] = cost[39, 39] = 1.0
    its = DStarLite(cost)
    its.plan((0, 0), (39, 39))
    for _ in range(100):
        cells = random.permutation(1600)[:6]
        new = random.choice(values, 6)
        cost.flat[cells] = new
        its.change(np.column_stack(np.unravel_index(cells, cost.shape)), new)
        result, fresh = its.move((0, 0)), search(cost, (0, 0), (39, 39))
        assert result.found == fresh.found
        assert result.cost == pytest.approx(fresh.cost, rel=1e-12)
    with pytest.raises(ValueError, match="1e6"):
        DStarLite(np.full((2, 2), 1.1e6, dtype=np.float32))


def test_the_callers_array_is_its_own():
    cost = np.ones((1, 3), dtype=np.float32)
    its = DStarLite(cost)
    cost[0, 1] = math.inf
    assert its.plan((0, 0), (0, 2)).cost == 2.0
    with pytest.raises(TypeError):
        DStarLite(np.ones((4, 4)))
