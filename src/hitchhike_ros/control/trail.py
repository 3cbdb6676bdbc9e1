"""The last bit of the way that a robot came."""

from __future__ import annotations

from collections import deque

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import distance

_STEP_M, _JUMP_M = 0.1, 0.4


class Trail:
    """Places that a robot came through, up to a length; forgotten when its pose jumps."""

    def __init__(self, length_m: float) -> None:
        self._places: deque[Pose2D] = deque(maxlen=round(length_m / _STEP_M) + 1)

    def add(self, pose: Pose2D) -> None:
        """The robot is there now (in ``map``)."""
        gone = distance(self._places[-1], pose) if self._places else _STEP_M
        if gone > _JUMP_M:
            self._places.clear()
        if gone >= _STEP_M:
            self._places.append(pose)

    def back(self, pose: Pose2D) -> FloatArray:
        """The way back from ``pose``, points (N, 2) in ``map``."""
        return np.array([(place.x, place.y) for place in (pose, *reversed(self._places))])
