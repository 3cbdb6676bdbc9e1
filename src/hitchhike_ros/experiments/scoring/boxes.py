"""The new boxes in a robot's map beside those that truly stand in the world."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle
from hitchhike_ros.core.geometry import distance_to_box

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


def centres_apart_m(true: Obstacle, found: Obstacle) -> float:
    """The distance of the centres of two boxes in m."""
    return float(np.linalg.norm(_centre(true) - _centre(found)))


def beside_m(true: Obstacle, found: Obstacle) -> float:
    """How far the found box's centre is outside of the true box, in m."""
    x, y = _centre(found)
    return distance_to_box(float(x), float(y), true)


def match_boxes(
    true: Iterable[Obstacle],
    found: Iterable[Obstacle],
    apart_m: Callable[[Obstacle, Obstacle], float] = centres_apart_m,
    most_m: float = _BOX_MATCH_M,
) -> list[BoxMatch]:
    """Each true box with the nearest found one, nearest pairs first; no box is used twice.

    ``apart_m`` measures how far a true box and a found one are apart, which is at most ``most_m`` where they match.
    """
    true, found = list(true), list(found)
    pairs = sorted((apart_m(t, f), i, j) for i, t in enumerate(true) for j, f in enumerate(found))
    partner: dict[int, int] = {}
    for off, i, j in pairs:
        if off <= most_m and i not in partner and j not in partner.values():
            partner[i] = j
    matches = []
    for i, box in enumerate(true):
        if i not in partner:
            matches.append(BoxMatch(box, None))
            continue
        other = found[partner[i]]
        size = max(abs(box.w - other.w), abs(box.b - other.b))
        matches.append(BoxMatch(box, other, centres_apart_m(box, other), size))
    return matches


def _centre(box: Obstacle) -> FloatArray:
    return np.array([box.x + box.w / 2, box.y + box.b / 2])
