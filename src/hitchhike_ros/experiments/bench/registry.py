"""What every benchmark takes and gives; each is the module of this folder that has its name, ``_`` for a blank."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.results import RunResult

BENCHMARKS: dict[str, str] = {
    "planning": "searches on Moving AI's maps beside peers, growth with the map, repairs",
    "localization": "a real robot's log, simulated routes, kidnapping",
    "mapping": "the boxes that a drive down a corridor puts on the map",
    "avoidance": "drives down a corridor past boxes and people",
    "tracking": "markers in photographs and in rendered pictures, beside peers",
    "following": "coupling, riding along courses, drivers lost on the way",
    "itineraries": "chains of rides: optimal, and how time grows with the fleet",
    "faults": "fleets on bad networks and with robots that fail",
    "fleet": "up to 1000 robots in one grid world, and when riding pays",
    "fuzz files": "maps, worlds, parameters, robots and scans that went wrong: read or refused, in bounded time",
    "cost": "rides and driving alone with the real nodes, in separate processes and in one (half an hour)",
}
"""What ``bench`` measures, by name."""
EXPERIMENTS: dict[str, str] = {
    "grid": "P18 §8.1 in the grid simulator: waits, velocity tuning and the best profile",
}
"""The papers' experiments that no robot is driven for, by name."""


Drive = Callable[[RideScenario, int, Path], RunResult]
"""Drives a scenario with a seed; what it leaves is in the folder, and may be there already."""


@dataclass(frozen=True)
class Options:
    """What the command line says. ``package`` and ``data`` are folders; what needs data that is missing is left out.

    ``seeds`` is how many a benchmark takes that has seeds to choose from; None: as many as it thinks right. ``drive``
    drives a scenario with the real nodes, for those benchmarks that measure them.
    """

    package: Path
    data: Path
    output: Path
    seed: int = 0
    quick: bool = False
    seeds: int | None = None
    drive: Drive | None = None


@dataclass(frozen=True)
class Findings:
    """Figures, and the tables that stand beside them."""

    figures: Sequence[Figure]
    tables: Sequence[Table] = ()


class Benchmark(Protocol):
    """A module with this function."""

    def run(self, options: Options, progress: Progress) -> Findings:
        """Measure; pictures go to ``options.output``."""


def load(name: str) -> Benchmark:
    """The module of one of ``BENCHMARKS`` or ``EXPERIMENTS``."""
    return importlib.import_module("hitchhike_ros.experiments.bench." + name.replace(" ", "_"))  # type: ignore[return-value]
