"""A robot of the package, for tests that build modules."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.modules.robot_files import PlainFiles
from repository import ROOT


def plain_files(model: str, **changes: Mapping[str, object]) -> PlainFiles:
    """Its files in an empty world; ``changes`` are fields by section."""
    grid = OccupancyGrid(np.zeros((40, 60)), 0.1)
    config, urdf = ROOT / "config" / f"{model}.yaml", ROOT / "urdf" / f"{model}.urdf"
    return PlainFiles(model, config, urdf, Sites((), ()), grid, changes, first_seq=70)
