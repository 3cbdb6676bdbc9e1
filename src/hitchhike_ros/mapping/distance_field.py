"""Signed distance to the walls of an occupancy grid, smooth enough to align scans to."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from hitchhike_ros.core.datatypes import BoolArray, FloatArray
from hitchhike_ros.core.geometry import inverse, transform_points
from hitchhike_ros.mapping.grid import UNKNOWN, OccupancyGrid, distance_to

# Interpolation rounds corners off, within a cell; therefore cells are cut into parts, along each side.
_PARTS = 2


class DistanceField:
    """Distance in m to the nearest face of a wall: positive before it, negative inside.

    A wall's face is the edge of an occupied cell, half a cell from the centres on both sides of it. What is unknown and
    nearer to a wall than to free space lies behind the wall and counts as inside, so that a wall mapped from one side
    keeps its sign behind its face. Where the nearest edge is none of an occupied cell there is no wall to align to, and
    the field is not valid.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        occupied, unknown = grid.occupied, np.equal(grid.data, UNKNOWN)
        behind = unknown & (distance_to(occupied, 1.0) < distance_to(~(occupied | unknown), 1.0))
        occupied, solid = (
            cells.repeat(_PARTS, axis=0).repeat(_PARTS, axis=1) for cells in (occupied, occupied | behind)
        )
        self._origin, self._resolution = grid.origin, grid.resolution / _PARTS
        self._face_variance = np.zeros(solid.shape)
        if solid.all() or not occupied.any():
            self._signed = np.zeros(solid.shape)
            self._wall = np.zeros(solid.shape, dtype=bool)
            return
        outside, to_solid = ndimage.distance_transform_edt(~solid, return_indices=True)
        inside, to_free = ndimage.distance_transform_edt(solid, return_indices=True)
        self._signed = np.where(solid, 0.5 - inside, outside - 0.5) * self._resolution
        beside_wall = ndimage.binary_dilation(occupied, np.ones((3, 3)))
        self._wall = np.where(solid, beside_wall[tuple(to_free)], occupied[tuple(to_solid)])
        # Between four centres that are not all on one side there is a face, and where it ends the field should be zero.
        four = [(slice(0, -1), slice(0, -1)), (slice(0, -1), slice(1, None)), (slice(1, None), slice(0, -1))]
        four.append((slice(1, None), slice(1, None)))
        low, high = (f([self._signed[k] for k in four], axis=0) for f in (np.min, np.max))
        face = (low < 0.0) & (high > 0.0)
        # On each face between them the error falls evenly from there to none: a third of its square in the mean. Noise
        # takes end points to faces next to theirs, so the mean is over those.
        squares = np.where(face, np.mean([self._signed[k] for k in four], axis=0) ** 2 / 3.0, 0.0)
        faces = ndimage.uniform_filter(face.astype(float), 3, mode="constant")
        mean = ndimage.uniform_filter(squares, 3, mode="constant") / np.maximum(faces, 1.0 / 9.0)
        self._face_variance[:-1, :-1] = np.maximum(mean, 0.0)

    def lookup(self, points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Interpolated field at points (N, 2) in ``map``.

        Returns:
            Distance (N,) in m, its gradient (N, 2) in ``map``, and a mask (N,) of the points that have a wall next to
            them; elsewhere distance and gradient mean nothing.
        """
        origin, (rows, columns) = self._origin, self._signed.shape
        local = transform_points(inverse(origin), points) / self._resolution - 0.5
        floor = np.floor(local)
        column, row = floor[:, 0].astype(np.int64), floor[:, 1].astype(np.int64)
        on_grid = (column >= 0) & (row >= 0) & (column < columns - 1) & (row < rows - 1)
        k = np.where(on_grid, row * columns + column, 0)
        u, v = (local - floor).T
        flat, wall = self._signed.ravel(), self._wall.ravel()
        d00, d10, d01, d11 = flat[k], flat[k + 1], flat[k + columns], flat[k + columns + 1]
        low, high = d00 + u * (d10 - d00), d01 + u * (d11 - d01)
        gx = (d10 - d00) * (1.0 - v) + (d11 - d01) * v
        gradient = np.column_stack([gx, high - low]) / self._resolution
        if origin.theta:
            c, s = np.cos(origin.theta), np.sin(origin.theta)
            gradient = gradient @ np.array([[c, s], [-s, c]])
        valid = on_grid & wall[k] & wall[k + 1] & wall[k + columns] & wall[k + columns + 1]
        return low + v * (high - low), gradient, valid

    def face_variance(self, points: FloatArray) -> FloatArray:
        """Mean square error of the field, (N,) in m^2, at the faces of walls near points (N, 2) in ``map``.

        Interpolation is exact before straight walls and rounds corners off, so ragged walls are known less well.
        """
        local = transform_points(inverse(self._origin), points) / self._resolution - 0.5
        rows, columns = self._signed.shape
        column = np.clip(np.floor(local[:, 0]).astype(np.int64), 0, columns - 1)
        row = np.clip(np.floor(local[:, 1]).astype(np.int64), 0, rows - 1)
        return self._face_variance[row, column]

    def distances(self, poses: FloatArray, points: FloatArray) -> FloatArray:
        """The distances (N, B) in m alone, computed fast, of points (B, 2) as seen from poses (N, 3) in ``map``.

        They are infinite where there is no wall.
        """
        rows, columns = self._signed.shape
        # In cells from here on, so that little is left to do for each pose and point.
        origin = transform_points(inverse(self._origin), poses[:, :2]) / self._resolution - 0.5
        heading, seen = poses[:, 2, None] - self._origin.theta, points / self._resolution
        c, s = np.cos(heading), np.sin(heading)
        u = origin[:, :1] + c * seen[:, 0] - s * seen[:, 1]
        v = origin[:, 1:] + s * seen[:, 0] + c * seen[:, 1]
        column, row = np.floor(u), np.floor(v)
        u -= column
        v -= row
        on_grid = (column >= 0) & (row >= 0) & (column < columns - 1) & (row < rows - 1)
        k = np.where(on_grid, row * columns + column, 0).astype(np.int64)
        d00, d10, d01, d11 = (self._signed.take(k + step) for step in (0, 1, columns, columns + 1))
        low = d00 + u * (d10 - d00)
        distance = low + v * (d01 + u * (d11 - d01) - low)
        distance[~(on_grid & self._wall.take(k))] = np.inf
        return distance
