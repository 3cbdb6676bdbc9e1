"""Which obstacle touches the footprint, in words: a robot that stands for ever needs somebody who finds it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hitchhike_ros.control.clearance import Footprint
from hitchhike_ros.control.leg import TOUCHED
from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.geometry import wrap_angle

# While the deepest point is of the same source and no farther than this from the one that was named, it is the same
# obstacle, and the words stay: they are told whenever they change (chosen).
_SAME_RAD = 0.35


class Contact:
    """Names the deepest point within the footprint by its range and bearing from the middle of the base."""

    def __init__(self, footprint: Footprint) -> None:
        self._footprint = footprint
        self.clear()

    def clear(self) -> None:
        """Nothing touches it."""
        self._said, self._source, self._bearing = TOUCHED, "", math.inf

    def describe(self, points: FloatArray, sources: Sequence[tuple[str, int]]) -> str:
        """Of obstacle points (N, 2), N > 0, in the base frame; ``sources`` are names and, in their order, counts."""
        apart = np.linalg.norm(points[:, None] - self._footprint.centres, axis=2).min(axis=1)
        deepest = int(np.argmin(apart))
        x, y = points[deepest].tolist()
        last = np.cumsum([count for _, count in sources])
        source, bearing = sources[int(np.searchsorted(last, deepest, side="right"))][0], math.atan2(y, x)
        if source != self._source or not abs(wrap_angle(bearing - self._bearing)) <= _SAME_RAD:
            self._source, self._bearing = source, bearing
            at = f"{math.degrees(bearing):.0f}°, {math.hypot(x, y):.2f} m"
            self._said = f"{TOUCHED} at {at} from its middle ({source})"
        return self._said
