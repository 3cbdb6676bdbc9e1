"""A small walled room for tests of the simulation, written as a map and a world file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import save_map
from hitchhike_ros.simulation.physics.world import World, WorldParameters

PACKAGE = Path(__file__).resolve().parents[2]
RESOLUTION = 0.05
TINY = WorldParameters(renderer="tiny")


def write_world(
    folder: Path, robots: dict, size: tuple[float, float] = (6.0, 4.0), wall: float = 0.1, **content: object
) -> Path:
    """A room with its lower left inner corner at (0, 0) and inner ``size``; ``wall`` 0 leaves it open."""
    columns, rows = (round((length + 0.4) / RESOLUTION) for length in size)
    data = np.zeros((rows, columns), dtype=np.int8)
    cells, margin = round(wall / RESOLUTION), round(0.2 / RESOLUTION)
    if cells:
        data[margin - cells : rows - margin + cells, margin - cells : columns - margin + cells] = 100
        data[margin : rows - margin, margin : columns - margin] = 0
    save_map(OccupancyGrid(data, RESOLUTION, Pose2D(-0.2, -0.2)), folder / "room.yaml")
    path = folder / "room.world.yaml"
    path.write_text(yaml.safe_dump({"map": "room.yaml", "robots": robots, **content}))
    return path


def robot(model: str, x: float, y: float, theta: float = 0.0, marker: int | None = None) -> dict:
    return {"model": model, "start": {"x": x, "y": y, "theta": theta}, "marker": marker}


def make_world(folder: Path, robots: dict, seed: int = 1, params: WorldParameters = TINY, **content: object) -> World:
    return World(write_world(folder, robots, **content), seed, params, package=PACKAGE)
