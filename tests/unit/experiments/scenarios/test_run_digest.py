"""A run that is kept is shown again only while nothing has changed that it was driven with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hitchhike_ros.core.datatypes import Obstacle
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scenarios.run_digest import DATA, run_digest
from hitchhike_ros.simulation.world_file import WorldFile, load_world
from repository import ROOT

SCENARIO = RideScenario("Title", "P17", {}, launch={"loss": 0.1}, name="ride")
VERSIONS = {"numpy": "1.24.2"}

MAP = """image: map.pgm
resolution: 0.1
origin: [0.0, 0.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A package with a file of every kind, its code, and a map elsewhere."""
    for name in ("config/robot.yaml", "urdf/robot.urdf", "maps/some.world.yaml", "launch_scripts/ride.launch"):
        path = tmp_path / "package" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("before")
    (tmp_path / "package" / "README.md").write_text("before")
    for name in ("control/planner.py", "_search.so", "control/__pycache__/planner.pyc", "notes.txt"):
        path = tmp_path / "code" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("before")
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "map.pgm").write_bytes(b"P5 2 1 255\n\x00\xfe")
    return tmp_path


def digest_of(place: Path, scenario: RideScenario = SCENARIO, boxes: tuple[Obstacle, ...] = ()) -> str:
    world: WorldFile = replace(load_world(ROOT / "maps" / "p17_exp1.world.yaml"), map=place / "map.yaml", boxes=boxes)
    return run_digest(scenario, world, place / "package", [place / "code"], VERSIONS)


def write(name: str) -> Callable[[Path], object]:
    return lambda place: (place / name).write_text("after")


@pytest.mark.parametrize(
    "change",
    [
        write("code/control/planner.py"),
        write("code/_search.so"),
        write("package/config/robot.yaml"),
        write("package/urdf/robot.urdf"),
        write("package/maps/some.world.yaml"),
        write("package/launch_scripts/ride.launch"),
        write("package/config/another.yaml"),
        lambda place: (place / "map.pgm").write_bytes(b"P5 2 1 255\n\xfe\xfe"),
        lambda place: (place / "map.yaml").write_text(MAP.replace("0.1", "0.2")),
        lambda place: (place / "code/control/planner.py").rename(place / "code/control/other.py"),
        lambda place: (place / "package/urdf/robot.urdf").unlink(),
    ],
)
def test_what_a_run_is_driven_with_changes_its_digest(place: Path, change: Callable[[Path], object]) -> None:
    before = digest_of(place)
    assert digest_of(place) == before
    change(place)
    assert digest_of(place) != before


@pytest.mark.parametrize(
    "change", [write("package/README.md"), write("code/control/__pycache__/planner.pyc"), write("code/notes.txt")]
)
def test_what_it_is_not_driven_with_does_not(place: Path, change: Callable[[Path], object]) -> None:
    before = digest_of(place)
    change(place)
    assert digest_of(place) == before


def test_a_file_that_moves_its_end_into_the_next_one_is_another(place: Path) -> None:
    folder = place / "package" / "config"
    (folder / "a.yaml").write_text("ab")
    (folder / "b.yaml").write_text("c")
    before = digest_of(place)
    (folder / "a.yaml").write_text("a")
    (folder / "b.yaml").write_text("bc")
    assert digest_of(place) != before


def test_what_was_asked_for_changes_its_digest(place: Path) -> None:
    before = digest_of(place)
    assert digest_of(place, replace(SCENARIO, launch={"loss": 0.2})) != before
    assert digest_of(place, replace(SCENARIO, end="lost")) != before
    assert digest_of(place, boxes=(Obstacle("a", 1.0, 1.0, 0.2, 0.2),)) != before
    assert digest_of(place, replace(SCENARIO, title="Other")) == before


def test_versions_change_it(place: Path) -> None:
    world = load_world(ROOT / "maps" / "p17_exp1.world.yaml")
    digests = {run_digest(SCENARIO, world, ROOT, [], {"numpy": version}) for version in ("1.24.2", "1.24.3")}
    assert len(digests) == 2


def test_the_package_has_every_folder_that_counts() -> None:
    assert all(any((ROOT / name).iterdir()) for name in DATA)
