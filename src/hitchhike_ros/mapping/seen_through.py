"""Where beams went through: a memory of the space that is surely empty, in the cells of the map."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Obstacle, Pose2D
from hitchhike_ros.mapping.grid import FREE, OccupancyGrid
from hitchhike_ros.mapping.laser import LaserNoise, passed_through


class SeenThrough:
    """For each cell that the map has as free, when a beam last went through it; nothing if a beam ended there since.

    And whether a beam ever did: what stands there now has come since.
    """

    def __init__(self, grid: OccupancyGrid, noise: LaserNoise, reach_m: float, clearance_m: float) -> None:
        self._grid, self._noise, self._reach_m, self._clearance_m = grid, noise, reach_m, clearance_m
        self._free = np.equal(grid.data, FREE)
        self._stamps = np.full(grid.data.shape, -np.inf)
        self._ever = np.zeros(grid.data.shape, dtype=bool)

    def look(self, scan: LaserScan, T_map_laser: Pose2D, ends: FloatArray) -> None:
        """Take in a scan whose beams end at ``ends`` (N, 2) in ``map``."""
        here, reach = self._grid.world_to_cell([[T_map_laser.x, T_map_laser.y]])[0], self._reach_m
        around = math.ceil(reach / self._grid.resolution)
        low = np.clip(here - around, 0, self._grid.data.shape)
        high = np.clip(here + around + 1, 0, self._grid.data.shape)
        cells = np.argwhere(self._free[low[0] : high[0], low[1] : high[1]]) + low
        passed, range_m = passed_through(
            scan, T_map_laser, self._grid.cell_to_world(cells), self._noise, self._clearance_m
        )
        through = tuple(cells[passed & (range_m < reach)].T)
        self._stamps[through], self._ever[through] = scan.stamp, True
        near = np.hypot(ends[:, 0] - T_map_laser.x, ends[:, 1] - T_map_laser.y) < reach
        hit = self._grid.world_to_cell(ends[near])
        self._stamps[tuple(hit[self._grid.in_bounds(hit)].T)] = -np.inf

    def ever(self, points: FloatArray) -> npt.NDArray[np.bool_]:
        """Whether beams ever went through the cell of each of points (N, 2) of the map, and through all cells about it.

        Through a single one they go beside a thing, too, of whose face it holds a bit.
        """
        about = np.array(list(itertools.product((-1, 0, 1), repeat=2)))
        cells = self._grid.world_to_cell(points)[:, None] + about
        inside = self._grid.in_bounds(cells.reshape(-1, 2)).reshape(cells.shape[:2])
        rows, columns = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return np.asarray((self._ever[rows, columns] & inside).all(axis=1))

    def crosses(self, box: Obstacle, margin_m: float, since: float) -> bool:
        """Whether a beam went through a box, farther from its sides than a margin, since a time.

        Of a box that is thinner than two margins it is the line along its middle that counts.
        """
        cells = self._grid.world_to_cell(_lattice(box, margin_m, self._grid.resolution / 2))
        cells = cells[self._grid.in_bounds(cells)]
        return bool((self._stamps[tuple(cells.T)] > since).any())


def _lattice(box: Obstacle, margin_m: float, step_m: float) -> FloatArray:
    """Points (N, 2) within a box, no farther apart than a step in x and y."""
    axes = []
    for start, length in ((box.x, box.w), (box.y, box.b)):
        inner = max(length - 2 * margin_m, 0.0)
        middle = start + length / 2
        axes.append(np.linspace(middle - inner / 2, middle + inner / 2, math.ceil(inner / step_m) + 1))
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
