"""Following: coupling and decoupling; straight, fast, round corners and through an S; drivers lost on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from hitchhike_ros.experiments.bench.coupling_scores import CouplingResult, couple
from hitchhike_ros.experiments.bench.following_scores import RideResult, ride
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios.couplings import MARKER, WALL, CouplingPlace
from hitchhike_ros.experiments.scenarios.following_rides import CORNERS, FAST, S_BEND, STRAIGHT, Course
from hitchhike_ros.experiments.scenarios.lost_drivers import RIDES_ON_S, LostResult, lose
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import run_all, write_results
from hitchhike_ros.experiments.scoring.figures import Figure

R = TypeVar("R")

_SEEDS, _QUICK = 20, 1
_LOST_SEEDS, _LOST_QUICK = 50, 7  # one of each kind when quick
# Bounds of medians, in s, and what the paper's real robots took without boxes (P17 Table 2).
_COUPLE_S, _DECOUPLE_S = {MARKER: 6.0, WALL: 12.0}, 4.0
_PAPER_COUPLE_S, _PAPER_DECOUPLE_S = {MARKER: 15.0, WALL: 33.0}, {MARKER: 17.67, WALL: 19.0}
_STRAIGHT_GAP_M, _STRAIGHT_LATERAL_M, _CORNER_LATERAL_M = 0.03, 0.04, 0.10


def run(options: Options, progress: Progress) -> Findings:
    """Ride; every figure is the worst of its rides unless it says otherwise. Each run is in ``following.json``."""

    written: dict[str, Sequence[Any]] = {}

    def runs(what: str, run: Callable[[int], R], quick: int, full: int) -> tuple[R, ...]:
        seeds = range(options.seed, options.seed + (quick if options.quick else full))
        written[what] = results = run_all(what, run, seeds, progress)
        write_results(options.output / "following.json", written)  # what is known is kept, whatever comes after
        return results

    coupled = {
        place: runs(f"coupling {place.name}", partial(couple, options.package, place), _QUICK, _SEEDS)
        for place in (MARKER, WALL)
    }
    straight, fast, corners, s_bend = (
        runs(course.name, partial(ride, options.package, course), _QUICK, _SEEDS)
        for course in (STRAIGHT, FAST, CORNERS, S_BEND)
    )
    lost = runs("drivers lost", partial(lose, options.package), _LOST_QUICK, _LOST_SEEDS)
    figures = [
        *(figure for place, results in coupled.items() for figure in coupling_figures(place, results)),
        *course_figures(STRAIGHT, straight),
        Figure(f"{STRAIGHT.name}: gap error, RMS", _worst(r.gap_rms_m for r in straight), "m", _STRAIGHT_GAP_M),
        Figure(f"{STRAIGHT.name}: lateral, RMS", _worst(r.lateral_rms_m for r in straight), "m", _STRAIGHT_LATERAL_M),
        *course_figures(FAST, fast),
        Figure(f"{FAST.name}: gap error, RMS", _worst(r.gap_rms_m for r in fast), "m"),
        *course_figures(CORNERS, corners),
        Figure(f"{CORNERS.name}: lateral, most", _worst(r.lateral_max_m for r in corners), "m", _CORNER_LATERAL_M),
        Figure(f"{CORNERS.name}: gap error, RMS", _worst(r.gap_rms_m for r in corners), "m"),
        *course_figures(S_BEND, s_bend),
        Figure(f"{S_BEND.name}: lateral, most", _worst(r.lateral_max_m for r in s_bend), "m"),
        Figure(f"{S_BEND.name}: gap error, RMS", _worst(r.gap_rms_m for r in s_bend), "m"),
        *lost_figures(lost),
    ]
    return Findings(figures)


def coupling_figures(place: CouplingPlace, results: tuple[CouplingResult, ...]) -> list[Figure]:
    """Medians over the runs; None where a run did not come so far, which no bound forgives."""
    rows = (
        ("coupling", [r.couple_s for r in results], _COUPLE_S[place], _PAPER_COUPLE_S[place]),
        ("decoupling", [r.decouple_s for r in results], _DECOUPLE_S, _PAPER_DECOUPLE_S[place]),
    )
    figures = []
    for step, values, bound, paper in rows:
        known = [value for value in values if value is not None]
        median = float(np.median(known)) if known and len(known) == len(values) else None
        figures.append(Figure(f"{step} {place.name}: median", median, "s", bound, peer=paper))
        figures.append(Figure(f"{step} {place.name}: longest", _worst(values), "s"))
    figures.append(Figure(f"coupling {place.name}: contacts", float(sum(len(r.contacts) for r in results)), "", 0.0))
    return figures


def course_figures(course: Course, rides: tuple[RideResult, ...]) -> list[Figure]:
    """What has to hold on every course: all rides are completed, nothing is touched, the marker is never lost."""
    name, count = course.name, float(len(rides))
    return [
        Figure(f"{name}: rides completed", float(sum(r.completed for r in rides)), "", count, "higher"),
        Figure(f"{name}: metres ridden, least", min((r.ridden_m for r in rides), default=None), "m", better="higher"),
        Figure(f"{name}: contacts", float(sum(len(r.contacts) for r in rides)), "", 0.0),
        Figure(f"{name}: times that the marker was lost", float(sum(r.lost for r in rides)), "", 0.0),
    ]


def lost_figures(runs: tuple[LostResult, ...]) -> list[Figure]:
    """How the runs with a lost driver ended."""
    short = [run.rides_on_s for run in runs if run.short]
    return [
        Figure(
            "driver lost: runs in which both come to their goals",
            _count(r.arrived for r in runs),
            "",
            len(runs),
            "higher",
        ),
        Figure("driver lost: contacts", float(sum(len(run.contacts) for run in runs)), "", 0.0),
        Figure("driver lost: until both ride again after a short cover", _worst(short), "s", RIDES_ON_S),
        Figure("driver lost: rides completed all the same", _count(run.rode_on for run in runs), ""),
        Figure("driver lost: distance from the goal at the end", _worst(run.goal_error_m for run in runs), "m"),
        Figure("driver lost: longest run", max((run.duration_s for run in runs), default=None), "s"),
    ]


def _count(values: Iterable[bool]) -> float:
    return float(sum(values))


def _worst(values: Iterable[float | None]) -> float | None:
    """The largest; None where one is missing, which no bound forgives."""
    known = list(values)
    return None if not known or None in known else float(np.max(np.array(known, dtype=float)))
