"""Lengths of ways in the grid simulator, against the paths that it plans."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.simulation.grid.paths import GridPaths
from hitchhike_ros.simulation.grid.scenario import Scenario, load_scenario
from repository import ROOT

MAPS = ROOT / "maps"
SCENARIOS = sorted(path.name for path in MAPS.glob("p18_grid*.scenario.yaml"))
WALL_M, WEST = 60.0, (5.25, 21.625)


def paths_of(scenario: Scenario, wall: bool = False) -> GridPaths:
    """Paths for the scenario's robots on its map; ``wall`` cuts it in two at x = 60 m."""
    grid, params = load_map(scenario.map), scenario.world
    data = grid.data.copy()
    if wall:
        data[:, round(WALL_M / grid.resolution)] = 100
    grid = OccupancyGrid(data, grid.resolution, grid.origin)
    return GridPaths(grid, params.radius_m + params.margin_m, scenario.boxes, params.clearance_weight)


def planned_m(paths: GridPaths, sources: FloatArray, targets: FloatArray) -> FloatArray:
    """Lengths (A, B) of the paths; infinite where there is none."""
    lengths = np.full((len(sources), len(targets)), math.inf)
    for i, start in enumerate(sources.tolist()):
        for j, goal in enumerate(targets.tolist()):
            try:
                lengths[i, j] = path_length(paths.plan(start, goal))
            except PlanningError:
                continue
    return lengths


def middles(paths: GridPaths, rng: np.random.Generator, count: int, free: bool = True) -> FloatArray:
    """Middles (count, 2) of random cells; ``free``: where a robot may be."""
    grid, found = paths.grid, []
    while len(found) < count:
        cell = rng.integers((grid.width, grid.height))
        place = (cell + 0.5) * grid.resolution + (grid.origin.x, grid.origin.y)
        if not free or paths.free((place[0], place[1])):
            found.append(place)
    return np.array(found)


@pytest.mark.parametrize("wall", [False, True])
@pytest.mark.parametrize("name", SCENARIOS)
def test_metres_are_those_of_the_paths(name: str, wall: bool) -> None:
    scenario, rng = load_scenario(MAPS / name), np.random.default_rng(3)
    paths = paths_of(scenario, wall)
    cell_m, targets = paths.grid.resolution, middles(paths, rng, 5)
    sources = np.vstack([middles(paths, rng, 12), middles(paths, rng, 8, free=False)])
    # Those that come later are beside paths that were asked for.
    sources = np.vstack([sources, np.repeat(sources[:4], 5, axis=0) + cell_m * rng.integers(-4, 5, (20, 2))])
    expected = planned_m(paths_of(scenario, wall), sources, targets)
    found = paths.all_metres(sources, targets)
    reached = np.isfinite(expected)
    assert (np.isfinite(found) == reached).all()
    off = np.abs(found[reached] - expected[reached]) / cell_m
    assert off.max() < 3.001
    assert np.mean(off > 1.5) < 0.05
    assert reached.all() != wall


@pytest.mark.parametrize("wall", [False, True])
def test_all_at_once_are_as_one_by_one(wall: bool) -> None:
    scenario, rng = load_scenario(MAPS / SCENARIOS[0]), np.random.default_rng(4)
    at_once, one_by_one = paths_of(scenario, wall), paths_of(scenario, wall)
    targets = middles(at_once, rng, 2)
    path = at_once.plan(WEST, (50.0, 37.0))[1:-1]  # sources whose paths come by one another
    sources = np.vstack([middles(at_once, rng, 10), path, path[::-1], middles(at_once, rng, 10, free=False)])
    expected = [[one_by_one.metres(tuple(a), tuple(b)) for b in targets.tolist()] for a in sources.tolist()]
    assert np.array_equal(at_once.all_metres(sources, targets), expected)


def test_a_place_off_the_map_is_not_reached() -> None:
    paths = paths_of(load_scenario(MAPS / SCENARIOS[0]))
    inside = middles(paths, np.random.default_rng(1), 1)
    off = np.array([(-1.0, 10.0), (10.0, -1.0), (117.6, 10.0), (10.0, 75.1)])
    assert np.isinf(paths.all_metres(off, inside)).all()
    assert np.isinf(paths.all_metres(inside, off)).all()
    assert paths.metres((-0.01, 10.0), tuple(inside[0])) == math.inf
    assert paths.metres(tuple(inside[0]), (math.nan, 10.0)) == math.inf
    assert paths.all_metres(np.empty((0, 2)), inside).shape == (0, 1)


def test_no_one_may_be_in_a_wall_nor_be_wanted_there() -> None:
    paths = paths_of(load_scenario(MAPS / SCENARIOS[0]), wall=True)
    inside = middles(paths, np.random.default_rng(1), 1)
    assert paths.metres(tuple(inside[0]), (WALL_M + 0.1, 37.0)) == math.inf
