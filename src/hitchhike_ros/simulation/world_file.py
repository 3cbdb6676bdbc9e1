"""World files: what the simulator builds beside a map. Robots read less of it, by ``mapping.sites``."""

from __future__ import annotations

import os
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from hitchhike_ros.core.datatypes import NonNegative, Obstacle, Pose2D, Positive
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.mapping.sites import (
    Sites,
    parse_sites,
    read_entry,
    read_list,
    read_mapping,
    read_world,
    require_unique,
)
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.simulation.people import Person

T = TypeVar("T")


@dataclass(frozen=True)
class Box(Obstacle):
    """A box that stands on the floor and is not in the map."""

    height_m: Positive = 0.3


@dataclass(frozen=True)
class RobotEntry:
    """A robot: its model (``urdf/<model>.urdf``, ``config/<model>.yaml``), where it starts, where a ride takes it, and
    the id of its rear marker (None: its back stays blank).

    The goal is given ``goal_at_s`` after all robots know where they are. ``hitchhiking`` is what differs from the
    model's parameters.
    """

    model: str
    start: Pose2D
    goal: Pose2D | None = None
    marker: int | None = None
    goal_at_s: NonNegative = 0.0
    hitchhiking: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class WorldFile:
    """Everything in a world file; ``map`` is the path of the map_server YAML."""

    path: Path
    map: Path
    robots: Mapping[str, RobotEntry]
    wall_height_m: float = 1.0
    boxes: tuple[Box, ...] = ()
    sites: Sites = field(default_factory=Sites)
    people: tuple[Person, ...] = ()


@dataclass(frozen=True)
class _Scalars:
    map: str
    wall_height_m: Positive = 1.0


def load_world(path: Path | str) -> WorldFile:
    """Read and check a world file; it may change another one (:func:`hitchhike_ros.mapping.sites.read_world`).

    A relative ``map`` starts at the folder of the file that names it, and ``hitchhiking`` holds for all robots.

    Raises:
        WorldFileError: names the file, the field, its value and what was expected.
    """
    path = Path(path)
    content = read_world(path)
    known = {f.name for f in fields(_Scalars)} | {
        *("boxes", "markers", "hitchhiking_points", "people", "hitchhiking", "robots"),
    }
    for key in content:
        if key not in known:
            raise WorldFileError(path, str(key), content[key], f"one of the fields {', '.join(sorted(known))}")
    if "map" not in content:
        raise WorldFileError(path, "map", None, "the path of a map_server YAML file")
    scalars = convert(
        {f.name: content[f.name] for f in fields(_Scalars) if f.name in content}, _Scalars, path, error=WorldFileError
    )
    map_file = Path(scalars.map)
    if not os.path.isfile(map_file):
        raise WorldFileError(path, "map", scalars.map, f"the path of a map_server YAML file; {map_file} is not one")
    boxes = read_list(content, "boxes", Box, path)
    require_unique((box.id for box in boxes), "boxes", "id", path)
    for i, box in enumerate(boxes):
        check_box(box, path, f"boxes[{i}]")
    robots, people = _robots(content, path), read_list(content, "people", Person, path)
    check_people(people, {*robots, *(box.id for box in boxes)}, path)
    return WorldFile(path, map_file, robots, scalars.wall_height_m, boxes, parse_sites(content, path), people)


@dataclass(frozen=True)
class _BoxName:
    id: str


def decode_box(text: str, source: str) -> Box:
    """A box as JSON, as it stands in a world file; ``source`` says where it comes from.

    Raises:
        WorldFileError: it is none.
    """
    return _decode(text, Box, source)


def decode_box_id(text: str, source: str) -> str:
    """The id in JSON ``{"id"}``.

    Raises:
        WorldFileError: there is none.
    """
    return _decode(text, _BoxName, source).id


def _decode(text: str, cls: type[T], source: str) -> T:
    try:
        value = msgspec.json.decode(text)
    except msgspec.DecodeError as exc:
        raise WorldFileError(source, "", text, f"a JSON object ({exc})") from exc
    return read_entry(value, cls, source, "box")


def check_box(box: Box, path: Path | str, field_name: str) -> None:
    """Raises WorldFileError for a box without extent."""
    for name in ("w", "b"):
        if getattr(box, name) <= 0.0:
            raise WorldFileError(path, f"{field_name}.{name}", getattr(box, name), "more than 0 m")


def check_people(people: Sequence[Person], taken: Container[str], path: Path | str) -> None:
    """Raises WorldFileError for a person without a way to walk, or with a name that somebody or something has."""
    require_unique((person.id for person in people), "people", "id", path)
    for i, person in enumerate(people):
        if person.id in taken:
            raise WorldFileError(path, f"people[{i}].id", person.id, "a name that no robot and no box has")
        if len(person.path) < 2 or any(a == b for a, b in pairwise(person.path)):
            raise WorldFileError(path, f"people[{i}].path", person.path, "two points or more, each apart from the next")


def _robots(content: Mapping[str, Any], path: Path) -> dict[str, RobotEntry]:
    entries, common = content.get("robots"), read_mapping(content, "hitchhiking", path)
    if not isinstance(entries, dict) or not entries:
        raise WorldFileError(path, "robots", entries, "a mapping from robot names to model and start")
    convert(common, HitchhikingParameters, path, "hitchhiking", WorldFileError)
    robots = {}
    for name, entry in entries.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise WorldFileError(path, "robots", name, "a robot name of letters, digits and _ (it is a ROS namespace)")
        robot = read_entry(entry, RobotEntry, path, f"robots.{name}")
        convert(robot.hitchhiking, HitchhikingParameters, path, f"robots.{name}.hitchhiking", WorldFileError)
        robots[name] = replace(robot, hitchhiking={**common, **robot.hitchhiking})
    return robots
