"""What every benchmark takes and gives; one module ``<name>`` of this folder each, found by its name."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hitchhike_ros.experiments.scoring.figures import Figure

# Says what is being done, and how far: step, done, of so many.
Progress = Callable[[str, int, int], None]

NAMES: tuple[str, ...] = (
    "planning",
    "localization",
    "mapping",
    "avoidance",
    "tracking",
    "following",
    "itineraries",
    "faults",
    "fleet",
)


@dataclass(frozen=True)
class Options:
    """What the command line says. ``package`` and ``data`` are folders; data that is missing is left out and said."""

    package: Path
    data: Path
    output: Path
    seed: int = 0
    quick: bool = False
    seeds: int | None = None
    """How many, where a benchmark has seeds; None: as many as it thinks right."""


class Benchmark(Protocol):
    """A module with this function."""

    def run(self, options: Options, progress: Progress) -> Sequence[Figure]:
        """Measure; pictures go to ``options.output``."""


def load(name: str) -> Benchmark:
    """The module of one of ``NAMES``."""
    return importlib.import_module(f"hitchhike_ros.experiments.bench.{name}")  # type: ignore[return-value]
