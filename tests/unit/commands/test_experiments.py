"""Which experiments a command line means, what they leave, and what the exit status says."""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from hitchhike_ros.commands import experiments
from hitchhike_ros.commands.experiments import command_of
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.results import RunResult, ScenarioResult
from repository import ROOT

RIDE = RideScenario("A ride", "P17", {"base": str(ROOT / "maps" / "p17_exp1.world.yaml")}, name="ride", quick=True)
SCENARIOS = {
    "alone": replace(RIDE, name="alone", end="alone", alone_of="ride", quick=False),
    "ride": RIDE,
    "far": replace(RIDE, name="far", needs="no/such/data", quick=False),
}


class Grid:
    """Stands in for the experiment in the grid simulator."""

    @staticmethod
    def run(options: Options, _progress: object) -> Findings:
        return Findings(
            [Figure("wait", float(options.seeds or 0), "s", 30.0)], [Table("Waits", ["", "s"], [["a", "9"]])]
        )


class Driver:
    """Stands in for the nodes; ``trouble`` is how all runs end, ``gap_m`` a figure with a bound."""

    def __init__(self) -> None:
        self.driven: list[tuple[str, list[int]]] = []
        self.trouble, self.gap_m = "", 0.02

    def __call__(
        self, scenario: RideScenario, seeds: Sequence[int], output: Path, _port: object, _report: object
    ) -> ScenarioResult:
        self.driven.append((scenario.name, list(seeds)))
        figures = (Figure("gap", self.gap_m, "m", 0.1),)
        runs = (RunResult(seed, str(output / scenario.name), self.trouble, figures, 90.0, 60.0) for seed in seeds)
        return ScenarioResult(scenario, tuple(runs))


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    made = Driver()
    monkeypatch.setattr(experiments, "drive", made)
    monkeypatch.setattr(experiments, "load", lambda _name: Grid)
    monkeypatch.setattr(experiments, "_ledgers", lambda _results: ())
    return made


def invoke(folder: Path, *arguments: str) -> tuple[Result, int]:
    """What was printed, and what the command returned or the status of wrong usage."""
    result = CliRunner().invoke(
        command_of(ROOT, SCENARIOS), [*arguments, "--report", str(folder / "report")], standalone_mode=False
    )
    return result, result.return_value if result.exception is None else getattr(result.exception, "exit_code", -1)


def test_all_of_them_are_driven_once_and_those_that_compare_come_last(tmp_path: Path, driver: Driver) -> None:
    result, status = invoke(tmp_path, "all", "ride", "--runs", "2", "--seed", "3")
    assert status == 0, result.output
    assert driver.driven == [("ride", [3, 4]), ("alone", [3, 4])]
    assert "far: A ride: left out" in result.output
    assert "3 of 3 experiments ended as they should" in result.output
    assert (tmp_path / "report" / "report.html").is_file()
    assert "Waits" in (tmp_path / "report" / "grid.txt").read_text()


def test_the_quick_set_is_what_is_marked_as_such(tmp_path: Path, driver: Driver) -> None:
    assert invoke(tmp_path, "all", "--quick")[1] == 0
    assert driver.driven == [("ride", [0])]


def test_figures_are_written_as_json(tmp_path: Path, driver: Driver) -> None:
    assert invoke(tmp_path, "grid", "ride", "--runs", "2", "--json", str(tmp_path / "figures.json"))[1] == 0
    written = json.loads((tmp_path / "figures.json").read_text())
    assert (written["seed"], written["runs"], written["ok"]) == (0, 2, {"grid": True, "ride": True})
    assert written["figures"]["grid"][0]["value"] == 2.0
    assert written["figures"]["ride"][0] == {
        "name": "gap",
        "value": 0.02,
        "worst": 0.02,
        "unit": "m",
        "bound": 0.1,
        "better": "lower",
        "peer": None,
        "ok": True,
        "runs": 2,
        "failed": 0,
    }
    assert written["versions"]["hitchhike_ros"]


@pytest.mark.parametrize(
    ("trouble", "gap_m", "arguments", "status"),
    [
        ("", 0.02, ["--check"], 0),
        ("", 0.2, [], 0),
        ("", 0.2, ["--check"], 1),
        ("node /p3dx/slam died", 0.02, [], 1),
    ],
)
def test_the_status_says_whether_all_ended_well_and_if_asked_whether_bounds_hold(
    tmp_path: Path, driver: Driver, trouble: str, gap_m: float, arguments: list[str], status: int
) -> None:
    driver.trouble, driver.gap_m = trouble, gap_m
    result, returned = invoke(tmp_path, "ride", *arguments)
    assert returned == status
    assert ("Not: ride" in result.output) == (status == 1)


def test_what_was_driven_until_an_interruption_is_reported(
    tmp_path: Path, driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drive(scenario: RideScenario, *others: object) -> ScenarioResult:
        if scenario.name == "alone":
            raise KeyboardInterrupt
        return driver(scenario, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(experiments, "drive", drive)
    invoke(tmp_path, "ride", "alone")
    assert [r["scenario"]["name"] for r in json.loads((tmp_path / "report" / "rides.json").read_text())] == ["ride"]
    assert (tmp_path / "report" / "report.html").is_file()


def test_wrong_usage_is_said_before_anything_is_driven(tmp_path: Path, driver: Driver) -> None:
    with socket.socket() as taken:
        taken.bind(("localhost", 0))
        taken.listen()
        for arguments, words in (
            (["gibberish"], "gibberish"),
            ([], "Missing"),
            (["ride", "--runs", "0"], "--runs"),
            (["ride", "--port", str(taken.getsockname()[1])], "something listens there"),
        ):
            result, status = invoke(tmp_path, *arguments)
            assert status == 2 and isinstance(result.exception, click.ClickException), arguments
            assert words in result.exception.format_message(), arguments
    assert driver.driven == []
