"""World files: what ships is read, and every bad field is named."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from hitchhike_ros.core.datatypes import Marker, Pose2D
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.mapping.sites import Sites, load_hitchhiking, load_sites
from hitchhike_ros.simulation.world_file import load_world
from simulated_room import PACKAGE

SHIPPED = PACKAGE / "maps" / "p17_exp1.world.yaml"


def test_the_shipped_world() -> None:
    world = load_world(SHIPPED)
    assert world.map == PACKAGE / "maps" / "p17_exp1.yaml"
    assert [box.height_m for box in world.boxes] == [0.3, 0.3, 0.3]
    assert {name: (entry.model, entry.marker) for name, entry in world.robots.items()} == {
        "p3dx": ("p3dx", 0), "turtlebot": ("turtlebot", 1)
    }  # fmt: skip
    assert world.robots["p3dx"].start.theta == pytest.approx(1.5707963)
    assert world.sites == load_sites(SHIPPED)


def test_robots_know_markers_and_hitchhiking_points() -> None:
    sites = load_sites(SHIPPED)
    marker = sites.marker(10)
    assert isinstance(marker, Marker)
    assert (marker.x, marker.y, marker.z) == (5.2, 6.62, 0.34)
    assert sites.marker(99) is None
    here = sites.hitchhiking_point_at(3.0, 5.72)
    assert here is not None
    assert (here.name, here.marker, here.aligning_pose.theta) == ("west", 10, 0.0)
    assert sites.hitchhiking_point_at(12.0, 5.72) is None


CONTENT: dict[str, Any] = {
    "map": "room.yaml",
    "boxes": [{"id": "b", "x": 1.0, "y": 1, "w": 0.2, "b": 0.3}],
    "markers": [{"id": 4, "x": 1, "y": 2, "z": 0.34, "yaw": 0}],
    "hitchhiking_points": [
        {
            "name": "h",
            "area": [[0, 0], [4, 0], [4, 4], [0, 4]],
            "aligning_pose": {"x": 2, "y": 2, "theta": 0},
            "waiting_pose": {"x": 1, "y": 2, "theta": 0},
            "marker": 4,
        }
    ],
    "robots": {"r": {"model": "p3dx", "start": {"x": 1, "y": 1, "theta": 0}}},
}


def write(folder: Path, content: object) -> Path:
    (folder / "room.yaml").write_text("image: room.pgm\n")
    path = folder / "test.world.yaml"
    path.write_text(yaml.safe_dump(content) if not isinstance(content, str) else content)
    return path


def altered(path: str, value: object) -> dict[str, Any]:
    """CONTENT with one field set (or deleted, for None) by a path such as ``boxes.0.w``."""
    content = yaml.safe_load(yaml.safe_dump(CONTENT))
    *parents, last = (int(part) if part.isdigit() else part for part in path.split("."))
    node = content
    for part in parents:
        node = node[part]
    if value is None:
        del node[last]
    else:
        node[last] = value
    return content


def test_defaults(tmp_path: Path) -> None:
    world = load_world(write(tmp_path, CONTENT))
    assert (world.wall_height_m, world.boxes[0].height_m) == (1.0, 0.3)
    assert (world.robots["r"].start, world.robots["r"].goal) == (Pose2D(1.0, 1.0, 0.0), None)


BAD = [
    ("map", None, "map", "map_server YAML"),
    ("map", "nowhere.yaml", "map", "nowhere.yaml"),
    ("map", 3, "map", "str"),
    ("wall_height_m", -1.0, "wall_height_m", "> 0"),
    ("walls", [], "walls", "one of the fields"),
    ("boxes", {"id": "b"}, "boxes", "a list"),
    ("boxes.0.w", 0.0, "boxes[0].w", "more than 0"),
    ("boxes.0.x", "left", "boxes[0].x", "float"),
    ("boxes.0.x", float("nan"), "boxes[0].x", "finite"),
    ("boxes.0.y", None, "boxes[0]", "y"),
    ("boxes.0.colour", "red", "boxes[0].colour", "one of the fields"),
    ("boxes.0.height_m", 0, "boxes[0].height_m", "> 0"),
    ("boxes", [CONTENT["boxes"][0]] * 2, "boxes[1].id", "no other"),
    ("markers", [CONTENT["markers"][0]] * 2, "markers[1].id", "no other"),
    ("markers.0.id", "ten", "markers[0].id", "int"),
    ("markers.0.size_m", 0.0, "markers[0].size_m", "> 0"),
    ("markers.0.yaw", float("inf"), "markers[0].yaw", "finite"),
    ("hitchhiking_points.0.marker", 5, "hitchhiking_points[0].marker", "id of one of the markers"),
    ("hitchhiking_points.0.area", [[0, 0], [4, 0]], "hitchhiking_points[0].area", "three corners"),
    ("hitchhiking_points.0.area", [[0, 0], [4, 0], [4]], "hitchhiking_points[0].area[2]", "length 2"),
    ("hitchhiking_points.0.waiting_pose.x", 9.0, "hitchhiking_points[0].waiting_pose", "inside the area"),
    ("hitchhiking_points.0.name", None, "hitchhiking_points[0]", "name"),
    ("robots", {}, "robots", "mapping"),
    ("robots", {"my robot": CONTENT["robots"]["r"]}, "robots", "ROS namespace"),
    ("robots.r.start", None, "robots.r", "start"),
    ("robots.r.start.x", "east", "robots.r.start.x", "float"),
    ("robots.r.goal", {"x": 1, "y": 1, "theta": float("nan")}, "robots.r.goal.theta", "finite"),
    ("robots.r.goal_at_s", -1.0, "robots.r.goal_at_s", ">= 0"),
    ("robots.r.hitchhiking", {"seats": 2}, "robots.r.hitchhiking.seats", "one of the fields"),
    ("robots.r.hitchhiking", {"places": 0}, "robots.r.hitchhiking.places", ">= 1"),
    ("hitchhiking", {"mode": "radio"}, "hitchhiking.mode", "local"),
    ("hitchhiking", ["network"], "hitchhiking", "a mapping"),
    ("base", "nowhere.yaml", "base", "the path of another"),
    ("base", "x" * 300, "base", "the path of another"),
    ("map", "x" * 300, "map", "the path of a map_server"),
    ("base", "test.world.yaml", "base", "not based on this one"),
]


@pytest.mark.parametrize(("path", "value", "field", "expected"), BAD)
def test_a_bad_field_is_named(path: str, value: object, field: str, expected: str, tmp_path: Path) -> None:
    file = write(tmp_path, altered(path, value))
    with pytest.raises(WorldFileError) as caught:
        load_world(file)
    assert caught.value.file == str(file)
    assert caught.value.field == field
    assert expected in caught.value.expected


def test_a_file_may_change_another_one(tmp_path: Path) -> None:
    base = write(tmp_path, {**CONTENT, "hitchhiking": {"mode": "network"}})
    (tmp_path / "other").mkdir()
    path = tmp_path / "other" / "changed.world.yaml"
    changes = {"r": {"goal": {"x": 3, "y": 1, "theta": 0}, "goal_at_s": 2}, "s": CONTENT["robots"]["r"]}
    path.write_text(yaml.safe_dump({"base": "../test.world.yaml", "boxes": None, "robots": changes}))
    world = load_world(path)
    assert world.map.samefile(tmp_path / "room.yaml")
    assert world.sites == load_sites(path) == load_world(base).sites != Sites()
    assert (world.boxes, list(world.robots)) == ((), ["r", "s"])
    assert (world.robots["r"].start, world.robots["r"].goal) == (Pose2D(1.0, 1.0, 0.0), Pose2D(3.0, 1.0, 0.0))
    assert [robot.goal_at_s for robot in world.robots.values()] == [2.0, 0.0]
    path.write_text(yaml.safe_dump({"base": "../test.world.yaml", "robots": {"r": None, "s": changes["s"]}}))
    assert list(load_world(path).robots) == ["s"]


def test_what_a_file_says_of_hitchhiking_holds_for_all_or_for_one(tmp_path: Path) -> None:
    entry = {**CONTENT["robots"]["r"], "marker": 7}
    robots = {"a": {**entry, "hitchhiking": {"places": 2, "policy": "arrival"}}, "b": CONTENT["robots"]["r"]}
    file = write(tmp_path, {**CONTENT, "robots": robots, "hitchhiking": {"mode": "network", "policy": "proximity"}})
    own = {"mode": "network", "policy": "arrival", "places": 2}
    common = {"mode": "network", "policy": "proximity"}
    assert {name: robot.hitchhiking for name, robot in load_world(file).robots.items()} == {"a": own, "b": common}
    assert load_hitchhiking(file, "a") == {"marker_id": 7, **own}
    assert load_hitchhiking(file, "b") == load_hitchhiking(file, "nobody") == common
    assert load_hitchhiking(SHIPPED, "turtlebot") == {"marker_id": 1}


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "map: [", "\x00\x01"])
def test_what_is_no_mapping_is_refused(text: str, tmp_path: Path) -> None:
    file = write(tmp_path, text)
    for load in (load_world, load_sites):
        with pytest.raises(WorldFileError, match=r"test\.world\.yaml"):
            load(file)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(WorldFileError, match=r"nowhere\.world\.yaml.*readable"):
        load_world(tmp_path / "nowhere.world.yaml")
