"""Which runs of a scenario are driven, and which are shown again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hitchhike_ros.commands import scenario_runs
from hitchhike_ros.commands.scenario_runs import code_folders, drive
from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.experiments.scenarios.ride_scenario import ExpectedRide, RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.results import RunResult
from repository import ROOT

SCENARIO = RideScenario(
    "Title",
    "P17",
    {"base": str(ROOT / "maps" / "p17_exp1.world.yaml")},
    rides=(ExpectedRide("turtlebot", "p3dx"),),
    name="ride",
)


class Driver:
    """Stands in for a run of the nodes; ``trouble`` is how the runs of some seeds end."""

    def __init__(self) -> None:
        self.driven: list[int] = []
        self.trouble: dict[int, str] = {}

    def __call__(
        self, _scenario: object, _world: object, seed: int, folder: Path, _port: object, _shown: object
    ) -> RunResult:
        self.driven.append(seed)
        figures = (Figure("couple", 5.0 + seed, "s", 15.0),)
        return RunResult(seed, str(folder), self.trouble.get(seed, ""), figures, 90.0, 60.0)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    made = Driver()
    monkeypatch.setattr(scenario_runs, "_drive_one", made)
    return made


def drive_seeds(output: Path, *seeds: int) -> list[float | None]:
    result = drive(SCENARIO, seeds, output, None, lambda _text: None)
    return [run.figures[0].value for run in result.runs]


def test_a_run_that_ended_well_is_not_driven_again(tmp_path: Path, driver: Driver) -> None:
    assert drive_seeds(tmp_path, 0, 1) == [5.0, 6.0]
    assert drive_seeds(tmp_path, 0, 1, 2) == [5.0, 6.0, 7.0]
    assert driver.driven == [0, 1, 2]


def test_a_run_that_did_not_end_well_is(tmp_path: Path, driver: Driver) -> None:
    driver.trouble[0] = "node /p3dx/slam died"
    drive_seeds(tmp_path, 0)
    drive_seeds(tmp_path, 0)
    assert driver.driven == [0, 0]


def test_a_run_of_other_code_is(tmp_path: Path, driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    drive_seeds(tmp_path, 0)
    monkeypatch.setattr(scenario_runs, "run_digest", lambda *_driven_with: "another")
    drive_seeds(tmp_path, 0)
    drive_seeds(tmp_path, 0)
    assert driver.driven == [0, 0]


def test_what_another_version_kept_in_another_form_is_driven_anew(tmp_path: Path, driver: Driver) -> None:
    drive_seeds(tmp_path, 0)
    file = tmp_path / "ride" / "seed-0" / "result.json"
    file.write_text(json.dumps({"digest": "of another version", "result": {"seed": "zero"}}))
    assert drive_seeds(tmp_path, 0) == [5.0]
    assert driver.driven == [0, 0]


def test_a_file_that_nobody_can_read_is_named(tmp_path: Path, driver: Driver) -> None:
    drive_seeds(tmp_path, 0)
    (tmp_path / "ride" / "seed-0" / "result.json").write_text("not JSON")
    with pytest.raises(InputFileError, match=r"result\.json"):
        drive_seeds(tmp_path, 0)


def test_what_a_ride_saves_is_told_anew_each_time(
    tmp_path: Path, driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run alone may be kept, and the ride driven anew."""
    asked: list[tuple[Path, Path]] = []

    def beside(ridden: Path, alone: Path) -> list[Figure]:
        asked.append((ridden, alone))
        return [Figure("ride_cpu_ratio", float(len(asked)), "")]

    monkeypatch.setattr(scenario_runs, "figures_beside", beside)
    alone = replace(SCENARIO, name="alone", end="alone", alone_of="ride")
    results = [drive(alone, [0], tmp_path, None, lambda _text: None) for _ in range(2)]
    assert [[f.name for f in result.runs[0].figures] for result in results] == [["couple", "ride_cpu_ratio"]] * 2
    assert [result.runs[0].figures[1].value for result in results] == [1.0, 2.0]
    assert asked == [(tmp_path / "ride" / "seed-0", tmp_path / "alone" / "seed-0")] * 2
    assert driver.driven == [0]


def test_modules_and_compiled_modules_are_among_the_code() -> None:
    names = {path.name.partition(".")[0] for folder in code_folders() for path in folder.rglob("*")}
    assert {"scenario_runs", "local_planner", "_grid_search", "_visp_tracker", "_octree"} <= names
