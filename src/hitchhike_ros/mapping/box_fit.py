"""The axis-aligned box that best explains the beams that ended on it and those that passed it by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray
from hitchhike_ros.mapping.beams import Beams

# Where a side is tried, relative to its place (chosen): the wide steps find it, the small ones settle it.
STEPS_M = np.array([0.0, -0.004, 0.004, -0.012, 0.012, -0.04, 0.04, -0.12, 0.12])
LEAST_SIDE_M = 0.03  # chosen
GREATEST_COST = 5.0  # of one beam, in standard deviations: what is farther off belongs to something else (chosen)
LEAST_POSE_SIGMA_M = 0.015  # filters think too well of themselves (chosen)
FAR_M = 100.0  # range of a beam that hit nothing: any that is beyond every box
COST_PER_METRE = 1.0  # of moving a side away from where it is expected: it decides where no beam does (chosen)


@dataclass(frozen=True, eq=False)
class View:
    """What N beams from one place tell about a box, ``distance`` in m from the laser.

    ``rows`` (8, N): place of the laser along x and y in ``map``, 1 / direction along x and y, 1 / standard deviation in
    1/m of the way to a side across x and across y, range in m, and the cost of the beam when it misses the box, in
    standard deviations.
    """

    distance: float
    rows: FloatArray


def take_view(beams: Beams, chosen: npt.NDArray[np.int64], distance: float, elsewhere: FloatArray) -> View:
    """The view of some beams.

    Args:
        beams: of one scan.
        chosen: (N,) which of them.
        distance: from the laser to the box, m.
        elsewhere: (N,) distance in m from each end to what else explains it; 0 when the beam has passed the box.
    """
    inverse = 1.0 / np.where(np.abs(beams.directions[chosen].T) < 1e-3, 1e-3, beams.directions[chosen].T)
    range_sigma, pose_sigma = beams.range_sigma[chosen], np.maximum(beams.pose_sigma[chosen], LEAST_POSE_SIGMA_M)
    # A beam that meets a side at a shallow angle meets it much later when the pose is a little off.
    weights = 1.0 / np.hypot(range_sigma, pose_sigma * inverse)
    ranges = np.minimum(beams.ranges[chosen], FAR_M)
    missed = np.minimum(elsewhere / np.hypot(range_sigma, pose_sigma), GREATEST_COST)
    places = np.broadcast_to(beams.origin[:, None], (2, chosen.size))
    return View(distance, np.vstack([places, inverse, weights, ranges, missed]))


def sweep(bounds: FloatArray, views: list[View], expected: FloatArray | None = None) -> FloatArray:
    """Move each side of a box once to where the beams cost least.

    The cost of a beam is the distance, along the beam, from its end to the box in standard deviations, and no more than
    an outlier's. So a side comes to lie at the median of the returns from it, without the bias that the extreme ones
    have, and between the beams that it stops and those that pass.

    Args:
        bounds: (4,) least x, y, greatest x, y in ``map``, m.
        views: at least one.
        expected: (4,) as ``bounds``, where sides are that no beam tells about; without it the box is kept small.

    Returns:
        The new bounds (4,).
    """
    rows = np.hstack([view.rows for view in views])
    bounds = bounds.copy()
    for side in range(4):
        axis, opposite = side % 2, bounds[(side + 2) % 4]
        places = bounds[side] + STEPS_M
        length = np.abs(places - opposite)
        allowed = (length >= LEAST_SIDE_M) & ((places > opposite) == (side >= 2))
        if allowed.any():
            places, length = places[allowed], length[allowed]
            prior = length if expected is None else np.abs(places - expected[side])
            cost = _costs(places, opposite, bounds[[1 - axis, 3 - axis]], axis, rows)
            bounds[side] = places[np.argmin(cost + COST_PER_METRE * prior)]
    return bounds


def _costs(places: FloatArray, opposite: float, across: FloatArray, axis: int, rows: FloatArray) -> FloatArray:
    """Cost (C,) of all beams for each place (C,) of a side; ``across`` (2,) are the sides along the other axis."""
    ranges, missed = rows[6:]
    other = (across[:, None] - rows[1 - axis]) * rows[3 - axis]
    enter_other, leave = other.min(axis=0), other.max(axis=0)
    fixed = (opposite - rows[axis]) * rows[2 + axis]
    moved = (places[:, None] - rows[axis]) * rows[2 + axis]
    enter, leave = np.minimum(moved, fixed), np.minimum(np.maximum(moved, fixed), leave)
    beyond = np.where(enter > enter_other, (ranges - enter) * rows[4 + axis], (ranges - enter_other) * rows[5 - axis])
    enter = np.maximum(enter, enter_other)
    cost = np.minimum(np.abs(beyond), GREATEST_COST)
    # A beam that a known wall has stopped before the box says nothing against it.
    cost = np.where(beyond < 0.0, np.minimum(cost, missed), cost)
    return np.where((enter <= leave) & (enter > 0.0), cost, missed).sum(axis=1)
