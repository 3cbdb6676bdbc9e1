"""Beams that were near and then say nothing: what they saw may have come too close to be measured.

Lasers send NaN, 0.0 or a code for what is nearer than they can measure, and the same for no return.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, LaserScan

# Nearer than this beyond range_min something may soon be too close to be measured; it comes on no faster than this; and
# a beam that has said nothing for longer is taken for what it is, as one that fails must not hold the robot for ever.
_NEAR_M, _CLOSING_MPS, _HOLD_S = 0.3, 1.0, 5.0


class NearBeams:
    """Remembers for each bearing of a laser that something was near, and when (all values are chosen)."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget, as after a pause."""
        self._header = (0, 0.0, 0.0)
        self._near_at: FloatArray = np.empty(0)  # (N,) stamps, -inf where nothing is near,
        self._near_m: FloatArray = np.empty(0)  # and how near it was

    def fill(self, scan: LaserScan) -> LaserScan:
        """The scan; beams that are left out tell of what was near just before, as near as it may have come since."""
        header = (scan.ranges.size, scan.angle_min, scan.angle_increment)
        if header != self._header:
            self._take_over(header)
        bad = np.isnan(scan.ranges)
        with np.errstate(invalid="ignore"):
            near = scan.ranges < scan.range_min + _NEAR_M  # false for NaN
        self._near_at[~bad | (self._near_at > scan.stamp)] = -np.inf  # the latter where time ran backwards
        self._near_at[near], self._near_m[near] = scan.stamp, np.maximum(scan.ranges[near], 0.0)
        since = scan.stamp - self._near_at
        came = bad & (since <= _HOLD_S)
        if not came.any():
            return scan
        ranges = scan.ranges.copy()
        now_m = (self._near_m[came] - _CLOSING_MPS * since[came]).astype(np.float32)
        ranges[came] = np.where(now_m < scan.range_min, np.float32(-np.inf), now_m)
        return replace(scan, ranges=ranges)

    def _take_over(self, header: tuple[int, float, float]) -> None:
        """Keep what is remembered by its bearing where the header changes: some drivers send a beam more or less."""
        (size, angle_min, increment), (old_size, old_min, old_increment) = header, self._header
        at, near_m = np.full(size, -np.inf), np.zeros(size)
        if old_size:
            beams = np.rint((angle_min - old_min + increment * np.arange(size)) / old_increment).astype(np.int64)
            known = (beams >= 0) & (beams < old_size)
            at[known], near_m[known] = self._near_at[beams[known]], self._near_m[beams[known]]
        self._header, self._near_at, self._near_m = header, at, near_m
