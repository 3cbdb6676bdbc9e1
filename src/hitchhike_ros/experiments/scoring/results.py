"""What became of a scenario: one result for each of its runs."""

from __future__ import annotations

from dataclasses import dataclass

from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure, Summary, summarize


@dataclass(frozen=True)
class RunResult:
    """One run: the folder of what it left, how it ended (``trouble`` empty: as it should), and its figures."""

    seed: int
    folder: str
    trouble: str
    figures: tuple[Figure, ...]
    sim_s: float
    wall_s: float

    @property
    def ok(self) -> bool:
        return not self.trouble


@dataclass(frozen=True)
class ScenarioResult:
    """All runs of a scenario."""

    scenario: RideScenario
    runs: tuple[RunResult, ...]

    @property
    def figures(self) -> list[Summary]:
        return summarize([run.figures for run in self.runs])

    @property
    def ok(self) -> bool:
        return bool(self.runs) and all(run.ok for run in self.runs)
