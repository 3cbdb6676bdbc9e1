"""What robots may know of a world file: known markers, hitchhiking points (P17 §3) and their own parameters."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hitchhike_ros.core.datatypes import HitchhikingPoint, Marker
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.geometry import point_in_polygon
from hitchhike_ros.core.parameters import convert, read_yaml, require_finite

T = TypeVar("T")


@dataclass(frozen=True)
class Sites:
    """Markers on walls and pillars, and the places where robots couple, all in ``map``."""

    markers: tuple[Marker, ...] = ()
    hitchhiking_points: tuple[HitchhikingPoint, ...] = ()

    def marker(self, marker_id: int) -> Marker | None:
        """The marker of that id, or None."""
        return next((marker for marker in self.markers if marker.id == marker_id), None)

    def hitchhiking_point_at(self, x: float, y: float) -> HitchhikingPoint | None:
        """The hitchhiking point whose area holds (x, y) in ``map``, or None."""
        return next((point for point in self.hitchhiking_points if point_in_polygon(x, y, point.area)), None)


def read_world(path: Path | str) -> dict[str, Any]:
    """The content of a world or scenario file, its ``map`` as a path from here.

    It may begin with ``base``, another file whose content it changes: mappings are merged, everything else is replaced,
    and what is null is gone.

    Raises:
        WorldFileError: the file, or one that it is based on, is missing, malformed or no mapping.
    """
    return _merged(Path(path), ())


def load_hitchhiking(path: Path | str, robot: str) -> dict[str, object]:
    """What a world file says of one robot's parameters of hitchhiking: its rear marker, what holds for all
    robots, and what is its own. Nothing is checked but that these are mappings.

    Raises:
        WorldFileError: as :func:`load_sites`.
    """
    content = read_world(path)
    entry = read_mapping(read_mapping(content, "robots", path), robot, path)
    own = {} if entry.get("marker") is None else {"marker_id": entry["marker"]}
    return {**own, **read_mapping(content, "hitchhiking", path), **read_mapping(entry, "hitchhiking", path)}


def load_sites(path: Path | str) -> Sites:
    """Markers and hitchhiking points of a world file; whatever else it holds is ignored.

    Raises:
        WorldFileError: names the file, the field, its value and what was expected.
    """
    return parse_sites(read_world(path), path)


def parse_sites(content: Mapping[str, Any], path: Path | str) -> Sites:
    """As :func:`load_sites`, from a world file that is already read.

    Raises:
        WorldFileError: as :func:`load_sites`.
    """
    markers = read_list(content, "markers", Marker, path)
    points = read_list(content, "hitchhiking_points", HitchhikingPoint, path)
    require_unique((m.id for m in markers), "markers", "id", path)
    require_unique((p.name for p in points), "hitchhiking_points", "name", path)
    known = {marker.id for marker in markers}
    for i, point in enumerate(points):
        field = f"hitchhiking_points[{i}]"
        if len(point.area) < 3:
            raise WorldFileError(path, f"{field}.area", point.area, "a polygon of at least three corners [x, y]")
        if point.marker is not None and point.marker not in known:
            raise WorldFileError(path, f"{field}.marker", point.marker, "the id of one of the markers")
        for name in ("aligning_pose", "waiting_pose"):
            pose = getattr(point, name)
            if not point_in_polygon(pose.x, pose.y, point.area):
                raise WorldFileError(path, f"{field}.{name}", (pose.x, pose.y), "a pose inside the area")
    return Sites(markers, points)


def read_list(content: Mapping[str, Any], key: str, cls: type[T], path: Path | str) -> tuple[T, ...]:
    """The list ``content[key]`` (missing: empty) as checked ``cls`` with finite numbers.

    Raises:
        WorldFileError: as :func:`load_sites`.
    """
    entries = content.get(key) or []
    if not isinstance(entries, list):
        raise WorldFileError(path, key, entries, "a list")
    return tuple(read_entry(entry, cls, path, f"{key}[{i}]") for i, entry in enumerate(entries))


def read_mapping(content: Mapping[str, Any], key: str, path: Path | str) -> dict[str, Any]:
    """The mapping ``content[key]``, empty where there is none.

    Raises:
        WorldFileError: as :func:`load_sites`.
    """
    value = content.get(key) or {}
    if not isinstance(value, dict):
        raise WorldFileError(path, key, value, "a mapping")
    return value


def read_entry(value: object, cls: type[T], path: Path | str, field: str) -> T:
    """``value`` as a checked ``cls`` whose numbers are all finite.

    Raises:
        WorldFileError: as :func:`load_sites`.
    """
    entry = convert(value, cls, path, field, WorldFileError)
    require_finite(entry, path, field, WorldFileError)
    return entry


def require_unique(values: Iterable[object], key: str, field: str, path: Path | str) -> None:
    """Raises WorldFileError when a value comes twice."""
    seen = set()
    for i, value in enumerate(values):
        if value in seen:
            raise WorldFileError(path, f"{key}[{i}].{field}", value, "a value that no other entry has")
        seen.add(value)


def _merged(path: Path, over: tuple[Path, ...]) -> dict[str, Any]:
    content = read_yaml(path, WorldFileError)
    base = content.pop("base", None)
    if isinstance(content.get("map"), str):
        content["map"] = str(path.parent / content["map"])
    if base is None:
        return content
    if not isinstance(base, str) or not os.path.isfile(path.parent / base):
        raise WorldFileError(path, "base", base, "the path of another such file")
    below = path.parent / base
    if below.resolve() in (p.resolve() for p in (*over, path)):
        raise WorldFileError(path, "base", base, "a file that is not based on this one")
    return _over(_merged(below, (*over, path)), content)


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """``above`` laid over ``below``; what is null above is gone."""
    merged = dict(below)
    for key, value in above.items():
        if value is None:
            merged.pop(key, None)
        elif isinstance(value, dict) and isinstance(below.get(key), dict):
            merged[key] = _over(below[key], value)
        else:
            merged[key] = value
    return merged
