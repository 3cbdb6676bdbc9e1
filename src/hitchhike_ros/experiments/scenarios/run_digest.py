"""What a run was driven with, as one digest: a run is kept as long as it stays the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.simulation.world_file import WorldFile

DATA = ("config", "launch_scripts", "maps", "urdf")
"""Folders of the package that count with all their files."""
_CODE = (".py", ".so")


def run_digest(
    scenario: RideScenario, world: WorldFile, package: Path, code: Iterable[Path], versions: Mapping[str, str]
) -> str:
    """SHA-256 of all that a run depends on, beside its seed.

    Args:
        scenario: what was asked for; its texts do not count.
        world: with its map, wherever that is.
        package: folder of this package, whose configuration, robots, maps and launch files count.
        code: folders of the Python package, in which modules and compiled modules count.
        versions: of what the package computes with.

    Raises:
        MapFileError: the world's map cannot be read.
    """
    grid = load_map(world.map)
    asked = (scenario.launch, scenario.rides, scenario.denial, scenario.end, world)
    found = hashlib.sha256(repr((asked, sorted(versions.items()), grid.resolution, grid.origin)).encode())
    _add(found, "map", grid.data.tobytes())
    for folder in (package / name for name in DATA):
        for path in _files(folder):
            _add(found, f"{folder.name}/{path.relative_to(folder)}", path.read_bytes())
    for folder in code:
        for path in _files(folder):
            if path.suffix in _CODE:
                _add(found, str(path.relative_to(folder)), path.read_bytes())
    return found.hexdigest()


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_file())


def _add(digest: hashlib._Hash, name: str, content: bytes) -> None:
    """Names and lengths too, so that nothing can move from one file to the next."""
    digest.update(f"{name} {len(content)}\n".encode())
    digest.update(content)
