"""Fleets by simulation on networks and with robots that fail: after every event the invariants of a ride are checked.

All runs have a network that loses up to 30 %, doubles, delays and reorders; a tenth as many again have partitions,
crashes and restarts as well. A run that fails prints what led there and the command that repeats it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.faults.fleets import SEVERE, FaultResult, fault_run
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import run_all, write_results
from hitchhike_ros.experiments.scoring.figures import Figure

_SEEDS, _QUICK = 10_000, 100
# So many of all runs have partitions and crashes.
_SEVERE_SHARE = 0.1
# So many runs that failed are printed, with so many of their last events.
_PRINTED, _TRACE = 5, 40


def run(options: Options, progress: Progress) -> Findings:
    """Every seed's result is a line of ``faults.json``."""
    seeds = options.seeds or (_QUICK if options.quick else _SEEDS)
    first = options.seed
    if first >= SEVERE:
        jobs = {"partitions and crashes": range(first, first + seeds)}
    else:
        severe = range(SEVERE + first, SEVERE + first + round(_SEVERE_SHARE * seeds))
        jobs = {"loss, delay, copies": range(first, first + seeds), "partitions and crashes": severe}
    results = {name: run_all(name, fault_run, wanted, progress) for name, wanted in jobs.items() if len(wanted)}
    brief = {name: [replace(result, trace=()) for result in of_it] for name, of_it in results.items()}
    write_results(options.output / "faults.json", brief)
    failed = [result for of_it in results.values() for result in of_it if result.failure]
    for result in failed[:_PRINTED]:
        _print(result)
    return Findings([figure for name, of_it in results.items() for figure in fault_figures(name, of_it)])


def fault_figures(name: str, results: Sequence[FaultResult]) -> list[Figure]:
    """How many runs held, and that there was something to hold: rides that came about and were completed."""
    rides, completed = sum(r.rides for r in results), sum(r.completed for r in results)
    return [
        Figure(f"{name}: runs", len(results), "count"),
        Figure(f"{name}: runs with a broken invariant", sum(bool(r.failure) for r in results), "count", 0),
        Figure(f"{name}: events", sum(r.events for r in results), "count"),
        Figure(f"{name}: rides begun", rides, "count", better="higher"),
        Figure(f"{name}: rides completed", completed, "count", better="higher"),
        Figure(f"{name}: messages per ride begun", sum(r.messages for r in results) / max(rides, 1), "count"),
    ]


def _print(result: FaultResult) -> None:
    command = f"rosrun hitchhike_ros bench faults --seed {result.seed} --seeds 1"
    lines = "\n".join(f"  {line}" for line in result.trace[-_TRACE:])
    print(f"seed {result.seed}: {result.failure}\n{lines}\nagain: {command}\n", file=sys.stderr, flush=True)
