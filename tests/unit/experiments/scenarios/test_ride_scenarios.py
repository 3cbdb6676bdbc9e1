"""Scenario files that ship, and what is said of bad ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario, in_order, load_scenario, load_scenarios
from hitchhike_ros.simulation.world_file import load_world
from repository import ROOT

PACKAGE = ROOT
SCENARIOS = load_scenarios(PACKAGE / "config" / "experiments")
GOOD: dict[str, Any] = {
    "title": "A ride",
    "source": "P17",
    "world": {"base": str(PACKAGE / "maps" / "p17_exp1.world.yaml")},
    "rides": [{"hitchhiker": "turtlebot", "driver": "p3dx", "ride_m": 20.4}],
}


def loaded(tmp_path: Path, **changes: object) -> RideScenario:
    content = {key: value for key, value in {**GOOD, **changes}.items() if value is not None}
    path = tmp_path / "ride.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_scenario(path)


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_those_that_ship_have_a_world_with_all_their_robots(scenario: RideScenario, tmp_path: Path) -> None:
    assert scenario.title and scenario.source
    assert scenario.paper or scenario.chosen
    if scenario.needs and not (PACKAGE.parent / "shared" / "data" / scenario.needs).exists():
        pytest.skip("third-party data is missing")
    world = load_world(scenario.write_world(tmp_path))
    for ride in scenario.rides:
        assert {ride.hitchhiker, ride.driver} <= world.robots.keys()
    if scenario.denial is not None:
        assert scenario.denial.hitchhiker in world.robots
    if scenario.alone_of:
        assert scenario.alone_of in SCENARIOS


def test_what_a_scenario_changes_of_its_world() -> None:
    world = SCENARIOS["p17_exp1_no_boxes"].world
    assert world["boxes"] == []
    assert SCENARIOS["p17_exp1"].rides[0].paper is not None
    assert SCENARIOS["p18_exp3"].rides[1].driver_waits_s == 21.0


def test_the_quick_set_has_a_ride_and_denials() -> None:
    ends = {scenario.end for scenario in SCENARIOS.values() if scenario.quick}
    assert {"rides", "denied"} <= ends


def test_what_is_compared_comes_after_what_it_is_compared_with() -> None:
    names = [scenario.name for scenario in in_order(SCENARIOS.values())]
    for scenario in SCENARIOS.values():
        if scenario.alone_of:
            assert names.index(scenario.alone_of) < names.index(scenario.name)


def test_the_base_is_found_from_any_folder(tmp_path: Path) -> None:
    path = tmp_path / "scenario" / "x.yaml"
    path.parent.mkdir()
    (tmp_path / "w.world.yaml").write_text((PACKAGE / "maps/p17_exp1.world.yaml").read_text().replace(
        "map: ", f"map: {PACKAGE}/maps/"), encoding="utf-8")  # fmt: skip
    path.write_text(yaml.safe_dump({**GOOD, "world": {"base": "../w.world.yaml", "boxes": []}}), encoding="utf-8")
    out = tmp_path / "elsewhere"
    out.mkdir()
    world = load_world(load_scenario(path).write_world(out))
    assert (world.path.name, world.boxes) == ("x.world.yaml", ())


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"title": None}, "title"),
        ({"end": "never"}, "end"),
        ({"end": "denied"}, "denial"),
        ({"rides": []}, "rides"),
        ({"rides": [{"hitchhiker": "turtlebot"}]}, "driver"),
        ({"rides": [{"hitchhiker": "a", "driver": "b", "ride_m": -1.0}]}, "ride_m"),
        ({"end": "alone"}, "alone_of"),
        ({"alone_of": "p17_exp1"}, "alone_of"),
        ({"name": "x"}, "name"),
        ({"spead": 1}, "spead"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, changes: dict[str, object], field: str) -> None:
    with pytest.raises(WorldFileError) as error:
        loaded(tmp_path, **changes)
    assert error.value.file.endswith("ride.yaml")
    assert field in str(error.value)
