"""Benchmark of itineraries: the optimum against trying everything, and how the time grows with the drivers in reach.

Times are processor time of the planning thread and include everything from the announced paths to the legs. Speeds,
paths and places are chosen; drivers go along corridors, and so does the hitchhiker where it drives alone. Measuring
distances for it takes no time here, which a planner's would. The bounds are for paths that share nodes, as grid paths
do; where no two nodes are the same and one may board anywhere, the figures say what that costs.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Picture
from scipy.spatial.distance import cdist

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.experiments.bench.itinerary_reference import cheapest
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.planning.announced import AnnouncedDriver, RideRules, usable_drivers
from hitchhike_ros.planning.itinerary import (
    Itinerary,
    ItineraryCosts,
    ItineraryParameters,
    ItineraryRequest,
    plan_itinerary,
)

# Costs are sums of some hundred seconds in another order.
_COST_ERROR = 1e-6
_DRIVERS = (10, 30, 100)
# The building: so many corridors each way, so far apart, and so many of their crossings are hitchhiking points.
_CORRIDORS, _SPACING_M, _SITES = 12, 10.0, 30
# Name, label, whether one may board anywhere, and how far nodes are moved, which then no two paths share.
_BOARDING = (
    ("", "at hitchhiking points", False, 0.0),
    ("_anywhere", "anywhere", True, 0.0),
    ("_apart", "anywhere, nodes not shared", True, 0.2),
)


def run(options: Options, progress: Progress) -> Findings:
    """All figures of the benchmark; the plot of time against drivers is ``itineraries_growth.png``."""
    fleets, buildings = (50, 5) if options.quick else (1000, 50)
    return Findings([*_optimal(options.seed, fleets, progress), *_growth(options, buildings, progress)])


def small_fleet(seed: int) -> tuple[ItineraryRequest, tuple[AnnouncedDriver, ...], ItineraryParameters]:
    """Two to six drivers between points of a coarse grid, so that paths share nodes; rules and costs at random."""
    random = np.random.default_rng(seed)
    crossings = 12.0 * np.stack(np.meshgrid(np.arange(3), np.arange(6)), axis=-1).reshape(-1, 2)
    start, goal = crossings[random.integers(0, 3)], crossings[random.integers(15, 18)]
    sites = random.choice(crossings, int(random.integers(0, 7)), replace=False)
    drivers = []
    for k in range(int(random.integers(2, 7))):
        path = random.choice(crossings, int(random.integers(2, 4)), replace=False)
        if random.random() < 0.9:  # the hitchhiker's way
            path = path[np.argsort(path[:, 1], kind="stable")]
        path = path + random.normal(0.0, 0.2, path.shape) * (random.random() < 0.3)
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        times = random.uniform(0.0, 90.0) + np.concatenate([[0.0], np.cumsum(lengths / random.uniform(0.4, 0.9))])
        drivers.append(AnnouncedDriver(f"driver{k}", path, times, safe_speed_mps=float(random.uniform(0.4, 1.2))))
    if random.random() < 0.3:  # with a heading
        sites = np.column_stack([sites, random.choice([0.0, 1.6, -1.6], len(sites))])
    request = ItineraryRequest(
        (float(start[0]), float(start[1])),
        (float(goal[0]), float(goal[1])),
        solo_speed_mps=float(random.uniform(0.2, 0.7)),
        sites=sites,
        now=0.0,
    )
    rules = RideRules(
        min_ride_m=random.uniform(0.0, 13.0),
        max_wait_s=random.uniform(20.0, 120.0),
        couple_s=random.uniform(0.0, 5.0),
        decouple_s=random.uniform(0.0, 5.0),
        board_anywhere=bool(random.random() < 0.5),
        leave_anywhere=bool(random.random() < 0.7),
    )
    costs = ItineraryCosts(*random.uniform([0.0, 2.0, 0.0, 0.0, 0.0], [1.0, 12.0, 0.5, 0.5, 10.0]).tolist())
    return request, tuple(drivers), ItineraryParameters(rules, costs)


def building_fleet(
    random: np.random.Generator, count: int, spread_m: float = 0.0
) -> tuple[ItineraryRequest, tuple[AnnouncedDriver, ...]]:
    """``count`` drivers with three to six straight stretches each, starting within two minutes, and a robot that asks.

    Where paths meet they share nodes, unless these are moved at random by ``spread_m`` (standard deviation).
    """
    grid = _SPACING_M * np.arange(_CORRIDORS)
    drivers = []
    for k in range(count):
        corners = [random.choice(grid, 2)]
        for turn in range(int(random.integers(3, 7))):
            here = corners[-1].copy()
            axis = (turn + k) % 2
            here[axis] = random.choice(grid[grid != here[axis]])
            corners.append(here)
        path = np.array(corners) + random.normal(0.0, spread_m, (len(corners), 2))
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        times = random.uniform(0.0, 120.0) + np.concatenate([[0.0], np.cumsum(lengths / random.uniform(0.4, 0.7))])
        drivers.append(AnnouncedDriver(f"driver{k}", path, times, safe_speed_mps=0.8))
    crossings = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    sites = random.choice(crossings, _SITES, replace=False)
    start, goal = random.choice(grid[:3], 2), random.choice(grid[-3:], 2)
    return ItineraryRequest((start[0], start[1]), (goal[0], goal[1]), 0.6, sites, 0.0), tuple(drivers)


def along_corridors(a: FloatArray, b: FloatArray) -> FloatArray:
    """Metres (A, B) between points (A, 2) and (B, 2) of a building whose corridors cross at right angles."""
    return np.asarray(cdist(a, b, "cityblock"))


def _optimal(seed: int, fleets: int, progress: Progress) -> list[Figure]:
    """How often the optimum is found, and how many rides it has."""
    errors, rides = np.empty(fleets), np.empty(fleets)
    for k in range(fleets):
        request, drivers, parameters = small_fleet(seed + k)
        plan = plan_itinerary(request, drivers, parameters=parameters)
        errors[k] = abs(plan.cost - cheapest(request, drivers, cdist, parameters))
        rides[k] = len(plan.rides)
        progress("small fleets", k + 1, fleets)
    return [
        Figure("optimal_itineraries", int((errors <= _COST_ERROR).sum()), "count", fleets, "higher"),
        Figure("cost_error_max", float(errors.max()), "s", _COST_ERROR),
        Figure("optimal_with_one_ride", int((rides == 1).sum()), "count"),
        Figure("optimal_with_more_rides", int((rides > 1).sum()), "count"),
    ]


def _growth(options: Options, buildings: int, progress: Progress) -> list[Figure]:
    """Time of a plan for growing fleets, one line for each way of boarding."""
    figures, lines = [], {}
    for name, label, anywhere, spread_m in _BOARDING:
        parameters = ItineraryParameters(RideRules(board_anywhere=anywhere))
        random = np.random.default_rng(options.seed)
        times, plans = np.empty((len(_DRIVERS), buildings)), []
        for i, count in enumerate(_DRIVERS):
            for k in range(buildings):
                request, drivers = building_fleet(random, count, spread_m)
                times[i, k], plan = _timed(request, drivers, parameters)
                plans.append(plan)
                progress(f"plans{name.replace('_', ' ')} with {count} drivers", k + 1, buildings)
        none_cut = None if spread_m else 0
        medians = np.median(times, axis=1)
        for count, median, worst in zip(_DRIVERS, medians, times.max(axis=1), strict=True):
            bound = 50.0 if count == 100 and not spread_m else None
            figures.append(Figure(f"plan{name}_{count}_drivers_median", float(1e3 * median), "ms", bound))
            figures.append(Figure(f"plan{name}_{count}_drivers_worst", float(1e3 * worst), "ms"))
        exponent = float(np.polyfit(np.log(_DRIVERS), np.log(medians), 1)[0])
        figures.append(Figure(f"plan{name}_growth_exponent", exponent, "exponent"))
        most = plans[-buildings:]
        figures.append(
            Figure(f"plan{name}_100_drivers_rides_mean", float(np.mean([len(p.rides) for p in most])), "rides")
        )
        figures.append(Figure(f"plan{name}_cut_short", sum(not plan.optimal for plan in plans), "count", none_cut))
        lines[f"boarding {label}, exponent {exponent:.2f}"] = times
    _draw(options.output / "itineraries_growth.png", lines)
    return figures


def _timed(
    request: ItineraryRequest, announced: tuple[AnnouncedDriver, ...], parameters: ItineraryParameters
) -> tuple[float, Itinerary]:
    began = time.thread_time()
    drivers, _ = usable_drivers(announced, request.now, parameters.rules)
    plan = plan_itinerary(request, drivers, along_corridors, parameters)
    return time.thread_time() - began, plan


def _draw(path: Path, lines: dict[str, FloatArray]) -> None:
    """Seconds (fleet sizes, plans) of each line: its medians, and every plan as a dot."""
    picture = Picture(figsize=(7.0, 4.5), layout="constrained")
    axes = picture.add_subplot()
    for i, (label, times) in enumerate(lines.items()):
        axes.loglog(_DRIVERS, 1e3 * np.median(times, axis=1), "-", color=f"C{i}", label=label)
        axes.loglog(np.repeat(_DRIVERS, times.shape[1]), 1e3 * times.reshape(-1), ".", color=f"C{i}", alpha=0.3)
    axes.axhline(50.0, color="k", linewidth=1, linestyle="--")
    axes.set(xlabel="drivers in reach", ylabel="time of a plan (ms)", title="Itineraries in a building of corridors")
    axes.set_xticks(_DRIVERS, [str(count) for count in _DRIVERS])
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(frameon=False)
    FigureCanvasAgg(picture).print_png(str(path))
