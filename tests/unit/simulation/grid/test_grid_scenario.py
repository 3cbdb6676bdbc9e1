"""Scenario files of the grid simulator, what is drawn of their worlds, and the papers' scenarios that ship."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.image import imread

from hitchhike_ros.core.errors import ParameterError, WorldFileError
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.experiments.scenarios.grid_waits import DRIVERS, Job, orders, run, scenario_of
from hitchhike_ros.simulation.grid.drawing import Recorder, animate, draw_state
from hitchhike_ros.simulation.grid.scenario import Fleet, build, load_scenario
from repository import ROOT

MAPS = ROOT / "maps"
SHIPPED = sorted(MAPS.glob("*.scenario.yaml"))

SMALL: dict[str, Any] = {
    "map": str(MAPS / "p18_grid.yaml"),
    "hitchhiking": {"cruise_speed_mps": 0.7},
    "network": {"range_m": 20.0},
    "robots": {"a": {"start": {"x": 10.0, "y": 8.5}, "goal": {"x": 30.0, "y": 8.5}, "hitchhiking": {"profile": 20}}},
}


def written(folder: Path, content: dict[str, Any], name: str = "a.scenario.yaml") -> Path:
    path = folder / name
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_a_scenario_that_ships_makes_a_world(path: Path) -> None:
    scenario = load_scenario(path)
    if scenario.fleet is not None:
        scenario = scenario.changed()
    world = build(scenario)
    assert (world.grid.width, world.grid.height, world.grid.resolution) == (470, 300, 0.25)
    assert world.robots
    for point in world.sites.hitchhiking_points:
        assert world.paths.free((point.aligning_pose.x, point.aligning_pose.y))
        assert world.paths.free((point.waiting_pose.x, point.waiting_pose.y))


def test_what_a_robot_has_of_its_own_and_of_all(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, SMALL))
    world = build(scenario, trace_events=7)
    params = world.robots["a"].params
    assert (params.profile, params.cruise_speed_mps, world.params.trace_events) == (20.0, 0.7, 7)
    assert scenario.seeded(5).network.seed == 5
    assert scenario.changed(network={"delay_s": 0.5}).network.delay_s == 0.5


def test_a_scenario_is_laid_over_its_base(tmp_path: Path) -> None:
    written(tmp_path, {**SMALL, "settings": {"runs": 3, "kept": 1}}, "base.yaml")
    above = {
        "base": "base.yaml",
        "network": {"delay_s": 0.2},
        "robots": {"a": None, "b": {"start": {"x": 12.0, "y": 8.5}}},
        "settings": {"runs": 4},
    }
    scenario = load_scenario(written(tmp_path, above))
    assert list(scenario.robots) == ["b"]
    assert (scenario.network.range_m, scenario.network.delay_s) == (20.0, 0.2)
    assert scenario.settings == {"runs": 4, "kept": 1}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"map": None}, "map"),
        ({"map": "nowhere.yaml"}, "map"),
        ({"robots": {}}, "robots"),
        ({"robots": {"a": {}}}, "robots.a"),
        ({"robots": {"a": {"start": {"x": float("nan"), "y": 1.0}}}}, "robots.a.start.x"),
        (
            {"robots": {"a": {"start": {"x": 10.0, "y": 8.5}, "hitchhiking": {"profil": 1}}}},
            "robots.a.hitchhiking.profil",
        ),
        ({"hitchhiking": {"profile": 101}}, "hitchhiking.profile"),
        ({"hitchhiking": {"marker_id": 3}, "robots": {k: {"start": {"x": 10.0, "y": 8.5}} for k in "ab"}}, "robots.b"),
        ({"world": {"radius_m": -1.0}}, "world.radius_m"),
        ({"fleet": {"robots": 0}}, "fleet.robots"),
        ({"boxes": [{"id": "b", "x": 1.0, "y": 1.0, "w": 1.0}]}, "boxes[0]"),
        ({"boxes": [{"id": "b", "x": 1.0, "y": 1.0, "w": 1.0, "b": 1.0}] * 2}, "boxes[1].id"),
        ({"base": "nothing.yaml"}, "base"),
        ({"base": "a.scenario.yaml"}, "base"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_mistake_in_a_scenario_is_named(tmp_path: Path, change: dict[str, Any], field: str) -> None:
    content = {key: value for key, value in {**SMALL, **change}.items() if value is not None}
    with pytest.raises(WorldFileError) as caught:
        load_scenario(written(tmp_path, content))
    assert caught.value.field == field
    assert caught.value.file.endswith("a.scenario.yaml")


def test_a_mistake_in_the_network_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="loss"):
        load_scenario(written(tmp_path, {**SMALL, "network": {"loss": 2.0}}))


@pytest.mark.parametrize("what", ["start", "goal"])
def test_a_robot_in_a_wall_is_named(tmp_path: Path, what: str) -> None:
    robot = {**SMALL["robots"]["a"], what: {"x": 1.0, "y": 1.0}}
    with pytest.raises(WorldFileError) as caught:
        build(load_scenario(written(tmp_path, {**SMALL, "robots": {"a": robot}})))
    assert caught.value.field == f"robots.a.{what}"


def test_a_fleet_is_drawn_by_its_seed_and_a_larger_one_has_the_same_robots() -> None:
    scenario = load_scenario(MAPS / "fleet.scenario.yaml")

    def starts(seed: int, robots: int) -> list[tuple[float, float]]:
        world = build(scenario.seeded(seed).sized(robots))
        return [(robot.body.x, robot.body.y) for robot in world.robots.values()]

    assert starts(1, 5) == starts(1, 5) == starts(1, 8)[:5]
    assert starts(1, 5) != starts(2, 5)


def test_a_fleet_that_has_no_room_is_refused(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, {**SMALL, "robots": {}, "fleet": {"places": 9000}}))
    assert scenario.fleet == Fleet(places=9000)
    with pytest.raises(WorldFileError, match="no more room"):
        build(scenario)


# The paper's numbers (P18 §8.1).


@pytest.mark.parametrize(("driver", "metres"), [("D1", 20.0), ("D2", 30.0), ("D3", 40.0)])
def test_drivers_that_deny_stand_where_the_paper_says(driver: str, metres: float) -> None:
    scenario = load_scenario(MAPS / "p18_grid_priority.scenario.yaml")
    world = build(scenario)
    hitchhiker, start = scenario.robots["H"].start, scenario.robots[driver].start
    path = world.paths.plan((start.x, start.y), (hitchhiker.x, hitchhiker.y))
    assert path_length(path) == pytest.approx(metres, abs=0.02)
    assert scenario.parameters(scenario.robots[driver], 0).cruise_speed_mps == 0.5


def test_the_first_driver_is_225_cells_from_the_hitchhiking_point() -> None:
    world = build(load_scenario(MAPS / "p18_grid_speed.scenario.yaml"))
    driver, (point,) = world.robots["D1"].start, world.sites.hitchhiking_points
    path = world.paths.plan((driver.x, driver.y), (point.aligning_pose.x, point.aligning_pose.y))
    assert path_length(path) / 0.25 == pytest.approx(225.0, abs=0.1)


def test_waits_without_and_with_a_network() -> None:
    def waits(mode: Any, **varied: Any) -> float:
        return run(Job(str(MAPS), mode=mode, **varied)).wait_s

    assert waits("local", experiment="no_drivers") == pytest.approx(150.0, abs=0.5)
    assert waits("network", experiment="no_drivers") < 5.0
    assert waits("local", experiment="priority", driver="D1") == pytest.approx(40.0, rel=0.1)
    assert waits("network", experiment="priority", driver="D1") < 1.5
    assert waits("network", experiment="priority", driver="D1", delay_s=3.0) == pytest.approx(6.5, abs=0.5)
    once, twice = (waits("network", experiment="speed", factor=factor) for factor in (1.0, 2.0))
    assert 2.0 * twice == pytest.approx(once, rel=0.05)


def test_a_job_varies_places_and_profiles() -> None:
    scenario = scenario_of(Job(str(MAPS), "profiles", "network", places=(2, 0, 1), profiles=(1, 2, 0)))
    places, scores = scenario.settings["places"], scenario.settings["profiles"]
    assert [scenario.robots[name].start.x for name in DRIVERS] == [places[k]["x"] for k in (2, 0, 1)]
    assert [scenario.robots[name].hitchhiking["profile"] for name in DRIVERS] == [scores[k] for k in (2, 0, 1)]
    assert len(set(orders())) == 6


# Pictures.


def test_a_state_is_drawn_to_be_read(tmp_path: Path) -> None:
    world = build(load_scenario(MAPS / "p18_grid_profiles.scenario.yaml"))
    world.run(20.0)
    draw_state(tmp_path / "state.png", world, "a state")
    pixels = imread(tmp_path / "state.png")
    assert pixels.shape[1] >= 1000
    assert pixels.shape[0] >= 600
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 50


def test_a_run_is_animated(tmp_path: Path) -> None:
    world = build(load_scenario(MAPS / "p18_grid_no_drivers.scenario.yaml"))
    recorder = Recorder(world, 1.0)
    world.run(3.5)
    assert [frame.time for frame in recorder.frames] == [0.0, 1.0, 2.0, 3.0]
    animate(tmp_path / "run.gif", world, recorder.frames[:2])
    assert (tmp_path / "run.gif").read_bytes()[:6] == b"GIF89a"


@pytest.mark.parametrize("profiles", list(permutations(range(3))))
def test_with_a_network_the_best_profile_drives_however_far_it_is(profiles: tuple[int, ...]) -> None:
    """P18 Table 1, the rows in which D1 is the nearest and D3 the farthest."""
    outcome = run(Job(str(MAPS), "profiles", "network", places=(0, 1, 2), profiles=profiles))
    assert outcome.driver == DRIVERS[profiles[0]]
