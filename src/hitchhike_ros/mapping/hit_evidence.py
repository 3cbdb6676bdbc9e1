"""Which cells were hit, how often, since when, and from how far apart: what stands still gathers all three."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray

CellKeys = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


class HitEvidence:
    """A sparse grid of hits: K cells, each named by one number, kept sorted."""

    def __init__(self, greatest_count: float) -> None:
        self._greatest = greatest_count
        self.keys: CellKeys = np.empty(0, dtype=np.int64)
        self._count = np.empty(0)
        self._first = np.empty((0, 3))  # stamp, x, y of the laser at the first hit
        self._age = np.empty(0)
        self._baseline = np.empty(0)

    def add(self, hit: CellKeys, stamp: float, position: FloatArray) -> None:
        """Count one scan's hit cells (N,), each once, seen from ``position`` (2,) in ``map``."""
        keys = np.union1d(self.keys, hit)
        old, now = np.searchsorted(keys, self.keys), np.searchsorted(keys, hit)
        first = np.tile([stamp, position[0], position[1]], (keys.size, 1))
        first[old] = self._first
        self._first, self.keys = first, keys
        self._count, self._age, self._baseline = (
            _spread(a, old, keys.size) for a in (self._count, self._age, self._baseline)
        )
        self._count[now] = np.minimum(self._count[now] + 1.0, self._greatest)
        self._age[now] = stamp - first[now, 0]
        apart = np.hypot(first[now, 1] - position[0], first[now, 2] - position[1])
        self._baseline[now] = np.maximum(self._baseline[now], apart)

    def weaken(self, passed: BoolArray, by: float) -> None:
        """Take ``by`` counts from the cells in the mask (K,); a cell without counts is forgotten."""
        self._count[passed] -= by
        self.keep(self._count > 0.0)

    def keep(self, kept: BoolArray) -> None:
        """Forget all cells but those in the mask (K,)."""
        self.keys, self._count, self._first = self.keys[kept], self._count[kept], self._first[kept]
        self._age, self._baseline = self._age[kept], self._baseline[kept]

    def standing(self, count: float, age_s: float, baseline_m: float) -> CellKeys:
        """Cells hit in at least ``count`` scans over ``age_s`` from places ``baseline_m`` apart."""
        return self.keys[(self._count >= count) & (self._age >= age_s) & (self._baseline >= baseline_m)]


def _spread(values: FloatArray, places: CellKeys, size: int) -> FloatArray:
    wider = np.zeros(size)
    wider[places] = values
    return wider
