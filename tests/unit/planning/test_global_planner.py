"""Plans of a robot: from start to goal, clear of obstacles, and a reason where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Obstacle, Pose2D
from hitchhike_ros.core.errors import (
    GoalBlockedError,
    OutsideMapError,
    PlanningError,
    StartBlockedError,
    UnreachableError,
)
from hitchhike_ros.core.geometry import compose, path_length
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters

LIMITS = RobotLimits(0.3, 0.1, 0.2, 0.2, 0.2, 1.0, 2.0)  # inscribed radius 0.2 m
PARAMS = GlobalPlannerParameters(margin_m=0.05)


def room(origin: Pose2D | None = None) -> OccupancyGrid:
    """Free from 0.1 to 5.9 m in x and 3.9 m in y, behind walls one cell thick."""
    data = np.zeros((40, 60), dtype=np.int8)
    data[[0, -1], :] = data[:, [0, -1]] = 100
    return OccupancyGrid(data, 0.1, origin or Pose2D())


def planner() -> GlobalPlanner:
    return GlobalPlanner(PARAMS, LIMITS)


def least_clearance(grid: OccupancyGrid, path: np.ndarray) -> float:
    return float(planner().costmap(grid).clearance[tuple(grid.world_to_cell(path).T)].min())


def test_a_path_runs_from_exactly_start_to_exactly_goal_a_cell_a_step():
    path = planner().plan(room(), Pose2D(0.512, 0.537, 1.0), Pose2D(5.333, 3.111, 2.0))
    assert path[0].tolist() == [0.512, 0.537]
    assert path[-1].tolist() == [5.333, 3.111]
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.min() > 0
    assert steps.max() < 0.25


def test_a_path_is_hardly_longer_than_it_must_be():
    start, goal = Pose2D(0.6, 0.6), Pose2D(5.4, 3.0)
    octile = (4.8 - 2.4) + math.sqrt(2) * 2.4
    assert math.hypot(4.8, 2.4) <= path_length(planner().plan(room(), start, goal)) <= octile + 0.2


@pytest.mark.parametrize("goal", [Pose2D(1.01, 1.02), Pose2D(1.12, 1.02), Pose2D(1.02, 1.02)])
def test_next_door(goal):
    path = planner().plan(room(), Pose2D(1.02, 1.02), goal)
    assert path[0].tolist() == [1.02, 1.02]
    assert path[-1].tolist() == [goal.x, goal.y]


def test_a_rotated_map_gives_the_rotated_path():
    origin = Pose2D(-7.0, 3.0, 0.7)
    start, goal = Pose2D(0.62, 0.63), Pose2D(5.21, 3.33)
    path = planner().plan(room(origin), compose(origin, start), compose(origin, goal))
    straight = planner().plan(room(), start, goal)
    rotated = np.array([[(p := compose(origin, Pose2D(*point))).x, p.y] for point in straight])
    np.testing.assert_allclose(path, rotated, atol=1e-6)


def test_it_goes_round_a_box_with_room_to_spare_and_keeps_to_the_middle_of_a_gap():
    grid = room().with_obstacles([Obstacle("low", 2.9, 0.0, 0.2, 1.0), Obstacle("high", 2.9, 2.6, 0.2, 1.4)])
    path = planner().plan(grid, Pose2D(0.8, 1.8), Pose2D(5.2, 1.8))
    assert least_clearance(grid, path) >= 0.25
    inside = path[np.abs(path[:, 0] - 3.0) < 0.1]
    assert np.abs(inside[:, 1] - 1.8).max() < 0.15


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_among_random_boxes_a_plan_is_safe_or_there_is_a_reason(seed):
    rng = np.random.default_rng(seed)
    boxes = [Obstacle(str(i), *rng.uniform((0, 0, 0.05, 0.05), (5.5, 3.5, 0.6, 0.6))) for i in range(10)]
    grid = room().with_obstacles(boxes)
    start, goal = (Pose2D(*rng.uniform((0, 0), (6, 4))) for _ in range(2))
    its = planner()
    try:
        path = its.plan(grid, start, goal)
    except PlanningError as error:
        assert str(error)
        return
    clearance = its.costmap(grid).clearance[tuple(grid.world_to_cell(path).T)]
    assert (clearance > 0).all()
    leaves = int(np.argmax(clearance >= its.costmap(grid).lethal_m))
    assert (clearance[leaves:] >= its.costmap(grid).lethal_m).all(), "once it is clear it stays clear"
    assert path_length(path[: leaves + 1]) < 3 * its.costmap(grid).lethal_m


@pytest.mark.parametrize(
    "outside", [Pose2D(-0.1, 1.0), Pose2D(1.0, 4.01), Pose2D(math.nan, 1.0), Pose2D(math.inf, 1.0)]
)
def test_outside_the_map(outside):
    inside = Pose2D(1.0, 1.0)
    with pytest.raises(OutsideMapError, match="start"):
        planner().plan(room(), outside, inside)
    with pytest.raises(OutsideMapError, match="goal"):
        planner().plan(room(), inside, outside)


def test_the_goal_must_be_clear_of_obstacles():
    for goal in (Pose2D(5.95, 2.0), Pose2D(5.75, 2.0)):
        with pytest.raises(GoalBlockedError, match=r"0\.25 m"):
            planner().plan(room(), Pose2D(1.0, 1.0), goal)


def test_a_start_beside_a_wall_may_be_left_by_the_shortest_way():
    grid = room()
    path = planner().plan(grid, Pose2D(3.0, 0.15), Pose2D(3.0, 3.0))
    clearance = planner().costmap(grid).clearance[tuple(grid.world_to_cell(path).T)]
    assert clearance[0] < 0.25 <= clearance[4:].min()


def test_a_start_in_an_obstacle_or_closed_in_is_blocked():
    goal = Pose2D(5.0, 3.0)
    with pytest.raises(StartBlockedError, match="inside"):
        planner().plan(room(), Pose2D(0.05, 2.0), goal)
    ring = [Obstacle("w", 0.6, 0.6, 0.1, 0.8), Obstacle("e", 1.3, 0.6, 0.1, 0.8)]
    ring += [Obstacle("s", 0.6, 0.6, 0.8, 0.1), Obstacle("n", 0.6, 1.3, 0.8, 0.1)]
    smaller = [Obstacle(b.id, 0.6 + (b.x - 0.6) / 2, 0.6 + (b.y - 0.6) / 2, b.w / 2, b.b / 2) for b in ring]
    with pytest.raises(StartBlockedError, match="closed in"):
        planner().plan(room().with_obstacles(smaller), Pose2D(0.8, 0.8), goal)


def test_a_wall_without_a_door_and_a_door_too_narrow():
    start, goal = Pose2D(1.0, 2.0), Pose2D(5.0, 2.0)
    low, high = Obstacle("low", 3.0, 0.0, 0.1, 1.8), Obstacle("high", 3.0, 2.2, 0.1, 1.8)
    with pytest.raises(UnreachableError, match=r"0\.50 m wide"):
        planner().plan(room().with_obstacles([low, high]), start, goal)
    wide = [low, Obstacle("high", 3.0, 2.4, 0.1, 1.6)]
    assert len(planner().plan(room().with_obstacles(wide), start, goal))


def test_inflation_is_computed_once_for_a_grid_and_anew_for_another():
    its, grid = planner(), room()
    assert its.costmap(grid) is its.costmap(grid)
    boxed = grid.with_obstacles([Obstacle("box", 2.8, 1.8, 0.4, 0.4)])
    assert its.costmap(boxed) is not its.costmap(grid)
    start, goal = Pose2D(1.0, 2.0), Pose2D(5.0, 2.0)
    assert (
        least_clearance(boxed, its.plan(grid, start, goal)) < 0 < least_clearance(boxed, its.plan(boxed, start, goal))
    )


def test_smoothing_shortens_and_gives_up_no_more_than_a_cell_of_clearance():
    grid = room().with_obstacles([Obstacle("box", 2.0, 0.0, 1.0, 2.5)])
    start, goal = Pose2D(0.6, 0.6), Pose2D(5.0, 0.7)
    rough = GlobalPlanner(GlobalPlannerParameters(smoothing_rounds=0), LIMITS).plan(grid, start, goal)
    smooth = planner().plan(grid, start, goal)
    assert path_length(smooth) < path_length(rough)
    assert least_clearance(grid, smooth) >= max(0.25, least_clearance(grid, rough) - 0.1)

    def sharpest_turn(path: np.ndarray) -> float:
        headings = np.unwrap(np.arctan2(*np.diff(path[2:-2], axis=0).T[::-1]))
        return float(np.abs(np.diff(headings)).max())

    assert sharpest_turn(rough) == pytest.approx(math.pi / 4)
    assert sharpest_turn(smooth) < math.pi / 8


@given(st.floats(0.05, 5.95), st.floats(0.05, 3.95), st.floats(0.0, 2.0))
@settings(max_examples=60)
def test_a_relaxed_goal_is_the_nearest_place_to_stand_within_tolerance(x, y, tolerance):
    grid, its, goal = room().with_obstacles([Obstacle("box", 2.0, 1.0, 1.5, 1.5)]), planner(), Pose2D(x, y, 1.0)
    cost, found = its.costmap(grid).cost, its.relax(grid, goal, tolerance)
    free = grid.cell_to_world(np.argwhere(np.isfinite(cost)))
    away = np.hypot(*(free - [x, y]).T).min()
    if np.isfinite(cost[tuple(grid.world_to_cell([x, y])[0])]) or away > tolerance:
        assert found == goal
    else:
        assert math.hypot(found.x - x, found.y - y) == pytest.approx(away)
        assert found.theta == goal.theta
        assert len(its.plan(grid, Pose2D(1.0, 0.5), found)) > 1


def test_willow_garage(shared_data):
    path = shared_data / "maps" / "willow-2010-02-18-0.10.yaml"
    if not path.exists():
        pytest.skip("the Willow Garage map is not there")
    grid, its = load_map(path), planner()
    regions = its.costmap(grid).regions
    rooms = np.argwhere(regions == np.bincount(regions[regions > 0]).argmax())
    start, goal = (Pose2D(*point) for point in grid.cell_to_world(rooms[[0, -1]]))
    plan = its.plan(grid, start, goal)
    assert path_length(plan) >= math.hypot(start.x - goal.x, start.y - goal.y)
    assert least_clearance(grid, plan) >= 0.25
