"""What part of a map a picture of a ride shows."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.mapping.grid import FREE, OccupancyGrid

_MARGIN_M = 1.2


def driven_area(record: RideRecord, grid: OccupancyGrid | None) -> FloatArray | None:
    """Lowest and highest corner (2, 2) of what was driven, with a margin, in m in ``map``.

    All that is free when nothing was driven, and None where there is no map either.
    """
    points = np.array([(p.x, p.y) for robot in record.robots.values() for p in robot.truth]).reshape(-1, 2)
    if not len(points) and grid is not None:
        points = grid.cell_to_world(np.argwhere(np.equal(grid.data, FREE)))
    if not len(points):
        return None
    return np.stack([points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M])
