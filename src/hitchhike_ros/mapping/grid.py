"""Occupancy grids in the values and the layout of nav_msgs/OccupancyGrid."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import BoolArray, FloatArray, Obstacle, Pose2D
from hitchhike_ros.core.geometry import inverse, transform_points

FREE, OCCUPIED, UNKNOWN = 0, 100, -1

CellArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of square cells.

    ``data`` is (H, W) int8: 0 free, 100 occupied, -1 unknown, between them the probability in percent. Row 0 has the
    smallest y of the grid's own frame. ``origin`` is the pose in ``map`` of the outer corner of cell (0, 0); it may be
    rotated. A cell is written (row, column), so that ``data[tuple(cells.T)]`` reads the values of cells (N, 2).
    The array is kept read-only: a changed map is a new grid, and a grid's identity may serve as a key to a cache. One
    that is read-only already is taken over, any other is copied.
    """

    data: npt.NDArray[np.int8]
    resolution: float
    origin: Pose2D = field(default_factory=Pose2D)

    def __post_init__(self) -> None:
        data = self.data
        if not _is_kept(data):
            data = np.array(data, dtype=np.int8, order="C")
        if data.ndim != 2 or data.size == 0:
            raise ValueError(f"grid data has shape {data.shape}, expected (H, W) with at least one cell")
        if not (np.isfinite(self.resolution) and self.resolution > 0 and self.origin.is_finite()):
            raise ValueError(f"grid has resolution {self.resolution} and origin {self.origin}, expected finite and > 0")
        data.setflags(write=False)
        object.__setattr__(self, "data", data)

    @property
    def height(self) -> int:
        """Number of rows."""
        return int(self.data.shape[0])

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.data.shape[1])

    @property
    def occupied(self) -> BoolArray:
        """Mask (H, W) of the cells that are surely occupied."""
        return np.equal(self.data, OCCUPIED)

    def world_to_cell(self, points: npt.ArrayLike) -> CellArray:
        """Cells (N, 2) as (row, column) in which points (N, 2) in ``map`` lie; they may be out of bounds."""
        xy = transform_points(inverse(self.origin), np.asarray(points, dtype=float).reshape(-1, 2))
        # A point a rounding error below a cell's edge belongs to the cell that starts there.
        return np.floor(xy[:, ::-1] / self.resolution + 1e-9).astype(np.int64)

    def cell_to_world(self, cells: npt.ArrayLike) -> FloatArray:
        """Centres (N, 2) in ``map``, in m, of cells (N, 2) given as (row, column)."""
        centres = (np.asarray(cells, dtype=float).reshape(-1, 2)[:, ::-1] + 0.5) * self.resolution
        return transform_points(self.origin, centres)

    def in_bounds(self, cells: npt.ArrayLike) -> BoolArray:
        """Mask (N,) of the cells (N, 2) that are on the grid."""
        rc = np.asarray(cells).reshape(-1, 2)
        return ((rc >= 0) & (rc < self.data.shape)).all(axis=1)

    def with_obstacles(self, obstacles: Iterable[Obstacle]) -> OccupancyGrid:
        """A new grid in which every cell that a box overlaps is occupied; parts of boxes off the grid are left out."""
        data = self.data.copy()
        turn = abs(np.cos(self.origin.theta)) + abs(np.sin(self.origin.theta))
        # A box that ends on a cell's edge does not reach into the next, though messages carry resolutions as float32.
        tiny = 1e-3 * self.resolution
        for box in obstacles:
            centre = np.array([box.x + box.w / 2, box.y + box.b / 2])
            half = np.maximum([box.w / 2, box.b / 2], 2 * tiny)
            corners = centre + half * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
            touched = self.world_to_cell(corners)
            low = np.clip(touched.min(axis=0) - 1, 0, self.data.shape)
            high = np.clip(touched.max(axis=0) + 2, 0, self.data.shape)
            rows, columns = np.mgrid[low[0] : high[0], low[1] : high[1]]
            offset = np.abs(self.cell_to_world(np.column_stack([rows.ravel(), columns.ravel()])) - centre)
            overlaps = (offset < half + self.resolution / 2 * turn - tiny).all(axis=1).reshape(rows.shape)
            data[low[0] : high[0], low[1] : high[1]][overlaps] = OCCUPIED
        data.setflags(write=False)
        return replace(self, data=data)


def _is_kept(data: npt.NDArray[np.int8]) -> bool:
    """Whether nobody can write into the array, also not by the one that it is a view of."""
    owners = (data, data.base) if isinstance(data, np.ndarray) and data.base is not None else (data,)
    read_only = all(isinstance(owner, np.ndarray) and not owner.flags.writeable for owner in owners)
    return read_only and data.dtype == np.int8 and data.flags.c_contiguous


def distance_to(mask: BoolArray, resolution: float) -> npt.NDArray[np.float32]:
    """Distance (H, W) in m from each cell's centre to the centre of the nearest cell of ``mask`` (H, W).

    Cells of the mask have 0; without any the distance is infinite.
    """
    if not mask.any():
        return np.full(mask.shape, np.inf, dtype=np.float32)
    cells = cv2.distanceTransform((~mask).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = np.asarray(cells, dtype=np.float32)
    # OpenCV's last digit depends on how its buffer is aligned. Squares are whole numbers, so they can be rounded; in
    # place, as maps may have many cells.
    np.square(distance, out=distance)
    np.rint(distance, out=distance)
    np.sqrt(distance, out=distance)
    distance *= np.float32(resolution)
    return distance
