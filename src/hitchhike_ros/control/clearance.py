"""How far a footprint is from the obstacles around the robot, for thousands of poses at once."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import distance_transform_edt

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.robot_model import RobotLimits

_CELL_M = 0.05
_X_MIN_M, _X_MAX_M, _Y_MAX_M = -1.6, 3.2, 2.4  # more ahead than behind
_FAR_M = 2.0  # what is farther from every point than this is as good as infinitely far


class Footprint:
    """A body as equal discs: a round one is one disc, a rectangle 2 x 3, which cover it and stand out by a few cm.

    ``centres`` is (D, 2) in the base frame.
    """

    def __init__(self, limits: RobotLimits) -> None:
        if limits.radius_m is not None:
            self.radius_m, self.centres = limits.radius_m, np.zeros((1, 2))
            return
        length, width = (limits.front_m + limits.rear_m) / 3.0, limits.half_width_m
        x = -limits.rear_m + length * (0.5 + np.arange(3))
        self.centres = np.array([(xi, yi) for xi in x for yi in (-0.5 * width, 0.5 * width)])
        self.radius_m = 0.5 * math.hypot(length, width)


class ClearanceField:
    """Distances to obstacle points (N, 2), in the robot's frame, from a local grid.

    A distance is right to about half a cell (2.5 cm). What lies off the grid counts as far from everything.
    """

    def __init__(self, points: FloatArray) -> None:
        rows, columns = round(2 * _Y_MAX_M / _CELL_M), round((_X_MAX_M - _X_MIN_M) / _CELL_M)
        cells = np.floor((points - (_X_MIN_M, -_Y_MAX_M)) / _CELL_M).astype(np.int64)
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < columns) & (cells[:, 1] < rows)
        free = np.ones((rows, columns), dtype=bool)
        free[cells[inside, 1], cells[inside, 0]] = False
        self._distance = np.full((rows + 2, columns + 2), _FAR_M)  # a border of one cell, for the interpolation
        if inside.any():
            near = np.minimum(distance_transform_edt(free, sampling=_CELL_M), _FAR_M)
            self._distance[1:-1, 1:-1] = near
        self._flat = self._distance.ravel()

    def distance(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Distance in m from each place (x, y), arrays of one shape, to the nearest obstacle; at most 2 m."""
        rows, columns = self._distance.shape
        column = np.clip((x - _X_MIN_M) / _CELL_M + 0.5, 0.0, columns - 1.001)
        row = np.clip((y + _Y_MAX_M) / _CELL_M + 0.5, 0.0, rows - 1.001)
        c, r = column.astype(np.int64), row.astype(np.int64)
        u, v = column - c, row - r
        corner = r * columns + c
        low = self._flat[corner] * (1.0 - u) + self._flat[corner + 1] * u
        high = self._flat[corner + columns] * (1.0 - u) + self._flat[corner + columns + 1] * u
        return low * (1.0 - v) + high * v

    def clearance(self, footprint: Footprint, poses: FloatArray) -> FloatArray:
        """Distance in m of the footprint at each pose (..., 3) to the nearest obstacle; negative where they overlap."""
        c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
        forward, left = footprint.centres.T
        x = poses[..., 0, None] + forward * c - left * s
        y = poses[..., 1, None] + forward * s + left * c
        return self.distance(x, y).min(axis=-1) - footprint.radius_m
