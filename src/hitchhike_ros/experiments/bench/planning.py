"""Benchmark of the searches: optimal lengths, time beside peers, growth with the map, and what a repair saves.

Peers are looked for by name, as they are no part of the package: a figure without its peer is left without a bound.
MCP_Geometric (scikit-image) finds cheapest paths that may cut corners; pyastar2d counts a diagonal step as a straight
one. Neither solves the same problem, but both are what one would otherwise take. Times are processor time of the thread
that searches (nothing here uses another): what else the machine does matters less.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Picture

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.experiments.bench.moving_ai import SearchProblem, load_moving_ai_map, load_problems
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.mapping.grid import FREE, CellArray
from hitchhike_ros.planning.astar import Cell, CostArray, search
from hitchhike_ros.planning.dstar_lite import DStarLite

# The lengths in the files are rounded, the older ones to 6 digits.
_LENGTH_ERROR = 0.006
# Random maps: this share of cells is blocked, at random.
_BLOCKED = 0.25
# Changes near the robot: so many cells, at most so many rows and columns away.
_CHANGED, _NEAR = 20, 10

_Problem = tuple[CostArray, SearchProblem]


def run(options: Options, progress: Progress) -> Findings:
    """All figures of the benchmark; the plot of growth is ``planning_growth.png`` in the output folder."""
    problems = _problems(options.data / "movingai")
    figures = []
    if problems:
        # Neighbours in the files are alike: every so-manieth of all is a fair sample of maps and lengths.
        figures += _optimal(problems[:: 20 if options.quick else 1], progress)
        figures += _beside_peers(problems[:: 60 if options.quick else 10], progress)
    else:
        print(f"left out: no Moving AI maps in {options.data / 'movingai'}", file=sys.stderr)
    figures += _growth(options, progress)
    figures += _repair(options, progress)
    return Findings(figures)


def _problems(folder: Path) -> list[_Problem]:
    """Every scenario of every map in a folder, with the map's costs."""
    problems: list[_Problem] = []
    for file in sorted(folder.glob("*.map")):
        cost = np.where(load_moving_ai_map(file).data == FREE, 1, np.inf).astype(np.float32)
        problems += [(cost, scenario) for scenario in load_problems(file.with_suffix(".map.scen"))]
    return problems


def _optimal(problems: Sequence[_Problem], progress: Progress) -> list[Figure]:
    """How far the lengths of both searches are from the optimal ones of the files."""
    errors = np.empty((len(problems), 2))
    planner, its_cost = None, None
    for k, (cost, scenario) in enumerate(problems):
        if planner is None or its_cost is not cost:
            planner, its_cost = DStarLite(cost), cost
        lengths = [plan.cost for plan in (search(cost, *_ends(scenario)), planner.plan(*_ends(scenario)))]
        errors[k] = np.abs(np.array(lengths) - scenario.length)
        progress("scenarios with optimal lengths", k + 1, len(problems))
    optimal = (errors <= _LENGTH_ERROR).sum(axis=0)
    figures = []
    for name, count, worst in zip(("astar", "dstar_lite"), optimal, errors.max(axis=0), strict=True):
        figures.append(Figure(f"{name}_optimal_scenarios", int(count), "count", len(problems), "higher"))
        figures.append(Figure(f"{name}_length_error_max", float(worst), "cells", _LENGTH_ERROR))
    return figures


def _beside_peers(problems: Sequence[_Problem], progress: Progress) -> list[Figure]:
    """Median time of a query, A* and peers in turn on each problem."""
    skimage_graph, pyastar2d = _peer("skimage.graph"), _peer("pyastar2d")
    times = np.full((len(problems), 3), np.nan)
    geometric, its_cost = None, None
    for k, (cost, scenario) in enumerate(problems):
        start, goal = _ends(scenario)
        times[k, 0] = _seconds(search, cost, start, goal)
        if skimage_graph is not None:
            if its_cost is not cost:  # made once a map: it may keep what it can
                geometric, its_cost = skimage_graph.MCP_Geometric(np.where(np.isfinite(cost), 1.0, -1.0)), cost
            times[k, 1] = _seconds(_geometric, geometric, start, goal)
        if pyastar2d is not None:
            times[k, 2] = _seconds(pyastar2d.astar_path, cost, start, goal, True)
        progress("queries beside peers", k + 1, len(problems))
    medians = np.median(times, axis=0)
    figures = [Figure("astar_query_median", float(1e3 * medians[0]), "ms")]
    maps = np.array([scenario.map for _, scenario in problems])
    for column, name, bound in ((1, "mcp_geometric", 1.0), (2, "pyastar2d", 2.0)):
        if np.isnan(medians[column]):
            figures.append(Figure(f"astar_time_by_{name}", None, "ratio"))
            continue
        ratios = [_ratio(times[maps == name_of_map], column) for name_of_map in np.unique(maps)]
        figures.append(Figure(f"{name}_query_median", float(1e3 * medians[column]), "ms"))
        figures.append(Figure(f"astar_time_by_{name}", _ratio(times, column), "ratio", bound))
        figures.append(Figure(f"astar_time_by_{name}_worst_map", max(ratios), "ratio"))
    return figures


def _growth(options: Options, progress: Progress) -> list[Figure]:
    """Time of A* from corner to corner of random maps, against the number of cells that it expands."""
    random = np.random.default_rng(options.seed)
    sizes = (256, 512, 1024) if options.quick else (256, 512, 1024, 2048)
    rounds = 3 if options.quick else 5
    points = []
    for turn in range(rounds):  # the sizes in turn, so that a slower minute slows all of them
        for k, size in enumerate(sizes):
            cost, start, goal = _random_map(random, size)
            began = time.thread_time()
            expanded = search(cost, start, goal).expanded
            points.append((size, expanded, time.thread_time() - began))
            progress("growth with the map", turn * len(sizes) + k + 1, rounds * len(sizes))
    measured = np.array(points)
    logs = np.log([np.median(measured[measured[:, 0] == size, 1:], axis=0) for size in sizes])
    exponent, offset = (float(value) for value in np.polyfit(logs[:, 0], logs[:, 1], 1))
    _draw_growth(options.output / "planning_growth.png", measured, exponent, offset)
    per_cell = 1e9 * np.exp(logs[:, 1] - logs[:, 0])
    return [
        # Linear but for the heap's logarithm and for maps that outgrow the processor's caches.
        Figure("astar_growth_exponent", exponent, "", 1.2),
        Figure(f"astar_time_per_cell_{sizes[0]}", float(per_cell[0]), "ns"),
        Figure(f"astar_time_per_cell_{sizes[-1]}", float(per_cell[-1]), "ns"),
    ]


def _repair(options: Options, progress: Progress) -> list[Figure]:
    """D* Lite against A* from scratch after cells near the robot have changed, as it drives along its path."""
    random = np.random.default_rng(options.seed)
    maps, steps = (3, 8) if options.quick else (10, 20)
    times, errors = [], []
    for k in range(maps):
        cost, start, goal = _random_map(random, 1000)
        planner = DStarLite(cost)
        path = planner.plan(start, goal).cells
        for step in range(steps):
            start = _cell(path[min(5, len(path) - 1)])
            cells = _near(random, cost, start, goal)
            before = cost[tuple(cells.T)]
            changed = np.where(np.isfinite(before), np.inf, 1).astype(np.float32)
            cost[tuple(cells.T)] = changed
            began = time.thread_time()
            planner.change(cells, changed)
            repaired = planner.move(start)
            between = time.thread_time()
            fresh = search(cost, start, goal)
            times.append((between - began, time.thread_time() - between))
            errors.append(0.0 if repaired.cost == fresh.cost else abs(repaired.cost - fresh.cost))
            if not repaired.found:  # shut in: it counts, and is undone
                cost[tuple(cells.T)] = before
                planner.change(cells, before)
                repaired = planner.move(start)
            path = repaired.cells
            progress("repairs near the robot", k * steps + step + 1, maps * steps)
    speed_up = np.array([fresh / repaired for repaired, fresh in times])
    repaired_s, fresh_s = np.median(times, axis=0)
    return [
        Figure("dstar_lite_repair_median", float(1e3 * repaired_s), "ms"),
        Figure("astar_from_scratch_median", float(1e3 * fresh_s), "ms"),
        Figure("dstar_lite_speed_up_median", float(np.median(speed_up)), "ratio", 10.0, "higher"),
        Figure("dstar_lite_slower_than_astar", float(100 * (speed_up < 1).mean()), "%"),
        Figure("dstar_lite_cost_error_max", max(errors), "cells", 1e-6),
    ]


def _random_map(random: np.random.Generator, size: int) -> tuple[CostArray, Cell, Cell]:
    """Costs (size, size), and free cells near two opposite corners that a path joins."""
    start, goal = (size // 50, size // 50), (size - 1 - size // 50, size - 1 - size // 50)
    while True:
        cost = np.where(random.random((size, size)) < _BLOCKED, np.inf, 1).astype(np.float32)
        cost[start] = cost[goal] = 1.0
        if search(cost, start, goal).found:
            return cost, start, goal


def _near(random: np.random.Generator, cost: CostArray, start: Cell, goal: Cell) -> CellArray:
    """Different cells (20, 2) near ``start``, neither it nor the goal."""
    offsets = np.array([(r, c) for r in range(-_NEAR, _NEAR + 1) for c in range(-_NEAR, _NEAR + 1) if (r, c) != (0, 0)])
    cells = np.array(start) + offsets
    inside = ((cells >= 0) & (cells < cost.shape)).all(axis=1) & (cells != goal).any(axis=1)
    return np.asarray(random.choice(cells[inside], _CHANGED, replace=False), dtype=np.int64)


def _draw_growth(path: Path, measured: FloatArray, exponent: float, offset: float) -> None:
    """Expanded cells and seconds, the last two columns of ``measured`` (N, 3), and the line fitted to them."""
    picture = Picture(figsize=(7.0, 4.5), layout="constrained")
    axes = picture.add_subplot()
    for size in np.unique(measured[:, 0]):
        at_size = measured[measured[:, 0] == size]
        axes.loglog(at_size[:, 1], 1e3 * at_size[:, 2], "o", label=f"{size:.0f}² cells")
    ends = np.array([measured[:, 1].min(), measured[:, 1].max()])
    axes.loglog(ends, 1e3 * np.exp(offset) * ends**exponent, "k-", linewidth=1, label=f"exponent {exponent:.2f}")
    axes.set(xlabel="expanded cells", ylabel="time of a query (ms)", title="A* from corner to corner of random maps")
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(frameon=False)
    FigureCanvasAgg(picture).print_png(str(path))


def _peer(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"left out: {name} is not installed", file=sys.stderr)
        return None


def _geometric(mcp: Any, start: Cell, goal: Cell) -> None:
    mcp.find_costs([start], [goal])
    mcp.traceback(goal)


def _seconds(call: Callable[..., object], *arguments: object) -> float:
    began = time.thread_time()
    call(*arguments)
    return time.thread_time() - began


def _ratio(times: FloatArray, peer: int) -> float:
    """Median of the first column of times (N, 3) by that of a peer's."""
    medians = np.median(times, axis=0)
    return float(medians[0] / medians[peer])


def _ends(scenario: SearchProblem) -> tuple[Cell, Cell]:
    return scenario.start, scenario.goal


def _cell(cell: CellArray) -> Cell:
    return int(cell[0]), int(cell[1])
