"""Obstacle points around the robot: those of the newest scan, and those it saw before and cannot see now."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.control.clearance import Footprint
from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D
from hitchhike_ros.core.geometry import compose, inverse, transform_points
from hitchhike_ros.mapping.laser import beam_towards, check_scan

_REACH_M = 4.0  # farther points do not matter to a local controller
_SEE_THROUGH_M = 0.1  # a beam that ends this much behind a remembered point has shown that the point is gone
_CELL_M = 0.04


def scan_points(scan: LaserScan, max_bad_share: float = 1.0) -> FloatArray:
    """Where the beams ended, (N, 2) in the laser's frame; what is too close to be measured is at ``range_min``.

    Raises:
        SensorDataError: the scan is empty, its geometry is senseless, or too many of its beams are bad.
    """
    check_scan(scan, max_bad_share)
    with np.errstate(invalid="ignore"):
        hit = scan.ranges <= min(scan.range_max, _REACH_M)  # false for NaN
    ranges, angles = np.maximum(scan.ranges[hit], scan.range_min), scan.angles()[hit]
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)


class ObstacleMemory:
    """Scan points in ``map``, forgotten after a while, or at once where the laser looks through them.

    Points that the turning footprint could touch are kept for ``near_s``: a robot that waited beside a box must still
    know of the box when it turns (chosen: contact is worse than waiting). No remembered point is left where the robot
    itself now stands.
    """

    def __init__(self, keep_s: float, near_s: float, footprint: Footprint) -> None:
        self._keep_s, self._near_s, self._footprint = keep_s, near_s, footprint
        self._near_m = float(np.hypot(*footprint.centres.T).max()) + footprint.radius_m + 0.1
        self.clear()

    def clear(self) -> None:
        self._points: FloatArray = np.empty((0, 2))
        self._stamps: FloatArray = np.empty(0)

    def forget_far(self, pose: Pose2D) -> None:
        """Forget what the footprint could not touch by turning at ``pose`` (in ``map``); scans tell what is there."""
        near = np.hypot(self._points[:, 0] - pose.x, self._points[:, 1] - pose.y) < self._near_m
        self._points, self._stamps = self._points[near], self._stamps[near]

    def update(self, scan: LaserScan, points_laser: FloatArray, pose: Pose2D, T_base_laser: Pose2D) -> FloatArray:
        """Take in a scan made at ``pose`` (in ``map``); its and the remembered points (N, 2) in the base frame."""
        if self._stamps.size and scan.stamp < self._stamps.max():
            self.clear()  # time ran backwards: a simulation was reset
        T_map_laser = compose(pose, T_base_laser)
        base = transform_points(inverse(pose), self._points)
        age = scan.stamp - self._stamps
        near = np.hypot(base[:, 0], base[:, 1]) < self._near_m
        young = age <= np.where(near, self._near_s, self._keep_s)
        to_discs = np.linalg.norm(base[:, None] - self._footprint.centres, axis=2).min(axis=1)
        outside = to_discs > self._footprint.radius_m
        kept = young & outside & ~self._seen_through(scan, transform_points(inverse(T_map_laser), self._points))
        new = transform_points(T_map_laser, points_laser)
        self._points = np.concatenate([new, self._points[kept]])
        self._stamps = np.concatenate([np.full(len(new), scan.stamp), self._stamps[kept]])
        keys = np.floor(self._points / _CELL_M).astype(np.int64) @ np.array([1 << 32, 1])
        newest = np.unique(keys, return_index=True)[1]  # the first of a cell is its newest
        self._points, self._stamps = self._points[newest], self._stamps[newest]
        remembered = self._points[self._stamps < scan.stamp]
        return np.concatenate(
            [transform_points(T_base_laser, points_laser), transform_points(inverse(pose), remembered)]
        )

    @staticmethod
    def _seen_through(scan: LaserScan, points: FloatArray) -> np.ndarray:
        """Mask (N,) of points in the laser's frame where a beam passes or ends: the scan itself tells of them."""
        beam = beam_towards(scan, np.arctan2(points[:, 1], points[:, 0]))
        in_view = beam < scan.ranges.size
        ranges = np.hypot(points[:, 0], points[:, 1])
        measured = scan.ranges[np.where(in_view, beam, 0)]
        with np.errstate(invalid="ignore"):
            passes = measured >= ranges - _SEE_THROUGH_M  # false for NaN
        return in_view & (ranges >= scan.range_min) & passes
