"""The stretch that two paths have in common: where a ride can begin and where it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.polyline import Polyline


@dataclass(frozen=True)
class Overlap:
    """The common stretch of paths a and b; lengths in m, counted along each path from its beginning.

    ``nearest`` and ``farthest`` are its first and last pose on path a, looking along it: P18's coupling point and
    P17's decoupling point. Paths without one have length 0 and neither pose.
    """

    length_m: float = 0.0
    nearest: Pose2D | None = None
    farthest: Pose2D | None = None
    start_a_m: float = 0.0
    end_a_m: float = 0.0
    start_b_m: float = 0.0
    end_b_m: float = 0.0


def common_stretch(path_a: FloatArray, path_b: FloatArray, tolerance_m: float, gap_m: float = 3.0) -> Overlap:
    """The longest stretch along ``path_a`` on which ``path_b`` runs beside it in the same direction.

    The papers intersect the nodes of two A* paths, Q_d ∩ Q_h, and take its farthest (P17 §3.1) or nearest node
    (P18 §5). Two plans rarely share cells exactly, so a pose of a counts as common when some pose of b has
    distance² + 2 tolerance² sin²(angle / 2) <= tolerance²: in line they may be ``tolerance_m`` apart, and paths that
    cross at a right angle or run against each other have nothing in common. Interruptions up to ``gap_m`` along a,
    such as one robot's wider berth around a pillar, do not end a stretch.

    Args:
        path_a, path_b: (N, 2) and (M, 2) in m in ``map``, in the order of travel.
        tolerance_m: how far apart paths in line still share a stretch, > 0.
        gap_m: longest interruption of a stretch (the default is chosen: less than a way round a block of rooms).
    """
    step = tolerance_m / 5.0
    arcs_a, poses_a = _sample(path_a, step, tolerance_m)
    arcs_b, poses_b = _sample(path_b, step, tolerance_m)
    if not len(arcs_a) or not len(arcs_b):
        return Overlap()
    distance, partner = cKDTree(poses_b).query(poses_a, distance_upper_bound=tolerance_m * (1 + 1e-9))
    common = np.flatnonzero(np.isfinite(distance))
    if not len(common):
        return Overlap()
    breaks = np.flatnonzero(np.diff(arcs_a[common]) > gap_m + step) + 1
    stretch = max(np.split(common, breaks), key=lambda run: arcs_a[run[-1]] - arcs_a[run[0]])
    first, last = int(stretch[0]), int(stretch[-1])
    return Overlap(
        length_m=float(arcs_a[last] - arcs_a[first]),
        nearest=_pose(poses_a[first]),
        farthest=_pose(poses_a[last]),
        start_a_m=float(arcs_a[first]),
        end_a_m=float(arcs_a[last]),
        start_b_m=float(arcs_b[partner[first]]),
        end_b_m=float(arcs_b[partner[last]]),
    )


def _sample(path: FloatArray, step: float, tolerance_m: float) -> tuple[FloatArray, FloatArray]:
    """Arc lengths (K,) about ``step`` apart, ends included, and the poses there as (K, 4).

    The last two columns are the heading's cosine and sine times tolerance / √2, so that the Euclidean distance of two
    rows weighs position and heading as :func:`common_stretch` says. Headings are taken over a tolerance's length to
    either side: the corners of a grid path are not its direction.
    """
    if not len(path):
        return np.empty(0), np.empty((0, 4))
    line = Polyline(path)
    if line.length_m == 0.0:
        return np.empty(0), np.empty((0, 4))
    arcs = np.linspace(0.0, line.end_m, max(2, math.ceil(line.length_m / step) + 1))
    return arcs, np.hstack([line.at(arcs), line.tangents(arcs, tolerance_m) * tolerance_m / math.sqrt(2.0)])


def _pose(row: FloatArray) -> Pose2D:
    return Pose2D(float(row[0]), float(row[1]), math.atan2(row[3], row[2]))
