"""What every experiment of the papers takes and gives; ``NAMES`` says where each is found."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hitchhike_ros.experiments.bench.registry import Progress
from hitchhike_ros.experiments.scoring.figures import Figure

# Name on the command line: module, and what it is.
NAMES: dict[str, tuple[str, str]] = {
    "grid": ("grid_waiting", "P18 §8.1 in the grid simulator: waits, velocity tuning and the best profile"),
}


@dataclass(frozen=True)
class Options:
    """What the command line says. ``package`` and ``report`` are folders; ``scheduler`` is a Dask cluster's address."""

    package: Path
    report: Path
    runs: int = 1
    seed: int = 0
    scheduler: str | None = None


@dataclass(frozen=True)
class Findings:
    """Figures, and what stands in the report beside them: tables as lines of text."""

    figures: Sequence[Figure]
    tables: Sequence[str] = ()


class Experiment(Protocol):
    """A module with this function."""

    def run(self, options: Options, progress: Progress) -> Findings:
        """Do it; pictures go to ``options.report``."""


def load(name: str) -> Experiment:
    """The module of one of ``NAMES``."""
    return importlib.import_module(f"hitchhike_ros.experiments.bench.{NAMES[name][0]}")  # type: ignore[return-value]
