"""The new boxes in a robot's map beside those that truly stand in the world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle

# A found box belongs to a true one when their centres are nearer than this (chosen: less than any two boxes' distance).
_BOX_MATCH_M = 0.5


@dataclass(frozen=True)
class BoxMatch:
    """A true box beside the one in the hitchhiker's map, None where it has none there.

    ``place_m`` is the distance of the centres, ``size_m`` the larger of both differences of width and breadth.
    """

    true: Obstacle
    found: Obstacle | None
    place_m: float | None = None
    size_m: float | None = None


def match_boxes(true: Iterable[Obstacle], found: Iterable[Obstacle]) -> list[BoxMatch]:
    """Each true box with the found one whose centre is nearest, nearest pairs first; no box is used twice."""
    true, found = list(true), list(found)
    pairs = sorted(
        (float(np.linalg.norm(_centre(t) - _centre(f))), i, j) for i, t in enumerate(true) for j, f in enumerate(found)
    )
    partner: dict[int, tuple[int, float]] = {}
    for off, i, j in pairs:
        if off <= _BOX_MATCH_M and i not in partner and j not in {other for other, _ in partner.values()}:
            partner[i] = (j, off)
    matches = []
    for i, box in enumerate(true):
        if i not in partner:
            matches.append(BoxMatch(box, None))
            continue
        j, off = partner[i]
        size = max(abs(box.w - found[j].w), abs(box.b - found[j].b))
        matches.append(BoxMatch(box, found[j], off, size))
    return matches


def _centre(box: Obstacle) -> FloatArray:
    return np.array([box.x + box.w / 2, box.y + box.b / 2])
