"""The axis-aligned box that best explains the beams that ended on it and those that passed it by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchhike_ros.datatypes import FloatArray

OFFSETS_M = np.array([0.0, -0.005, 0.005, -0.01, 0.01, -0.02, 0.02, -0.04, 0.04, -0.08, 0.08, -0.16, 0.16])
LEAST_SIDE_M = 0.03  # chosen
GREATEST_COST = 5.0  # of one beam, in standard deviations: beyond it is an outlier (chosen)
COST_PER_METRE = 1.0  # of a side: what no beam tells about is kept small (chosen)


@dataclass(frozen=True, eq=False)
class View:
    """What N beams from one place tell about a box.

    ``rows`` (6, N): x and y of the laser in ``map``, x and y of the direction, range and its standard deviation in m,
    followed by the cost (N,) ``elsewhere`` of the beam when it misses the box, in standard deviations: 0 when it passed
    or ended on a known wall. ``distance`` in m from the laser to the box.
    """

    position: FloatArray
    rows: FloatArray
    distance: float


def view_rows(
    origin: FloatArray, directions: FloatArray, ranges: FloatArray, sigma: FloatArray, elsewhere: FloatArray
) -> FloatArray:
    """Rows (7, N) of a :class:`View`."""
    places = np.broadcast_to(origin[:, None], (2, ranges.size))
    cost = np.minimum(elsewhere / sigma, GREATEST_COST)
    return np.vstack([places, directions.T, ranges, sigma, cost])


def sweep(bounds: FloatArray, rows: FloatArray) -> FloatArray:
    """Move each side of a box once to where the beams cost least.

    The cost of a beam is the distance, along the beam, between its end and the box, in standard deviations and no more
    than an outlier's; so a side comes to lie at the median of the returns from it, with no bias from the extreme ones,
    and between the beams that pass and those that do not.

    Args:
        bounds: (4,) least x, y, greatest x, y in ``map``, m.
        rows: (7, N) as in :class:`View`, of all views.

    Returns:
        The new bounds (4,).
    """
    bounds = bounds.copy()
    for side in range(4):
        axis, opposite = side % 2, (side + 2) % 4
        places = bounds[side] + OFFSETS_M
        length = places - bounds[opposite] if side >= 2 else bounds[opposite] - places
        places = places[length >= LEAST_SIDE_M]
        if places.size:
            length = np.abs(places - bounds[opposite])
            cost = _costs(places, bounds[opposite], bounds[1 - axis], bounds[3 - axis], axis, rows)
            bounds[side] = places[np.argmin(cost + COST_PER_METRE * length)]
    return bounds


def _costs(places: FloatArray, opposite: float, low: float, high: float, axis: int, rows: FloatArray) -> FloatArray:
    """Cost (C,) of all beams for each place (C,) of a side across ``axis``; low, high bound the other axis."""
    ranges, sigma, elsewhere = rows[4], rows[5], rows[6]
    along, across = _inverse(rows[2 + axis]), _inverse(rows[3 - axis])
    a, b = (low - rows[1 - axis]) * across, (high - rows[1 - axis]) * across
    fixed = (opposite - rows[axis]) * along
    moved = (places[:, None] - rows[axis]) * along
    enter = np.maximum(np.minimum(moved, fixed), np.minimum(a, b))
    leave = np.minimum(np.maximum(moved, fixed), np.maximum(a, b))
    cost = np.minimum(np.abs(ranges - enter) / sigma, GREATEST_COST)
    # A beam that ended before the box says nothing against it, if a wall is there.
    cost = np.where(ranges < enter, np.minimum(cost, elsewhere), cost)
    return np.where((enter <= leave) & (enter > 0.0), cost, elsewhere).sum(axis=1)


def _inverse(directions: FloatArray) -> FloatArray:
    """1 / directions, large but finite where they vanish."""
    return 1.0 / np.where(np.abs(directions) < 1e-9, 1e-9, directions)
