"""What two paths have in common: where a ride can begin and where it ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.polyline import Polyline

# Paths are compared at places no farther apart, their headings are those over so much to either side, and a place
# beside another one is ahead of it or behind it by no more than so much (chosen).
_LONGEST_STEP_M, _REACH_M, _ALONG_M = 0.1, 1.0, 0.3
# The papers' A* paths have one length between two nodes that both pass. Plans on maps that differ may not: two
# stretches belong to one ride where the way between them is no longer than so many times the other robot's (chosen).
_WAY_BETWEEN = 1.5


@dataclass(frozen=True)
class Overlap:
    """What paths a and b have in common; lengths in m, counted along each path from its beginning.

    ``nearest`` and ``farthest`` are its first and last pose on path a, looking along it: P18's coupling point and
    P17's decoupling point. Between them the paths may part and meet again; ``length_m`` is what they share alone. Paths
    that share nothing have length 0 and neither pose.
    """

    length_m: float = 0.0
    nearest: Pose2D | None = None
    farthest: Pose2D | None = None
    start_a_m: float = 0.0
    end_a_m: float = 0.0
    start_b_m: float = 0.0
    end_b_m: float = 0.0


def common_path(
    path_a: FloatArray, path_b: FloatArray, tolerance_m: float, gap_m: float = 3.0, from_a_m: float = 0.0
) -> Overlap:
    """All that ``path_a`` shares with ``path_b``, which runs beside it in the same direction there.

    The papers intersect the nodes of two A* paths, Q_d ∩ Q_h, hold all of it against T_dhh (P18 Alg. 2), and take its
    farthest (P17 §3.1) or nearest node (P18 §5). Two plans rarely share cells exactly, so a pose of a counts as common
    when some pose of b has distance² + 2 tolerance² sin²(angle / 2) <= tolerance²: in line they may be ``tolerance_m``
    apart, and paths that cross at a right angle or run against each other have nothing in common. Interruptions up to
    ``gap_m`` along a, such as one robot's wider berth around a pillar, do not end a stretch. Paths that part and meet
    again share several stretches; those count that follow one another on both paths without a detour on a, and of
    several such sequences the one that shares the most.

    Args:
        path_a, path_b: (N, 2) and (M, 2) in m in ``map``, in the order of travel.
        tolerance_m: how far apart paths in line still share a stretch, > 0.
        gap_m: longest interruption of a stretch (the default is chosen: less than a way round a block of rooms).
        from_a_m: what a shares before this does not count.
    """
    step = min(tolerance_m / 5.0, _LONGEST_STEP_M)
    arcs_a, poses_a = _sample(path_a, step, tolerance_m)
    arcs_b, poses_b = _sample(path_b, step, tolerance_m)
    ahead = arcs_a >= from_a_m - step / 2.0
    arcs_a, poses_a = arcs_a[ahead], poses_a[ahead]
    if not len(arcs_a) or not len(arcs_b):
        return Overlap()
    distance, partner = cKDTree(poses_b).query(poses_a, distance_upper_bound=tolerance_m * (1 + 1e-9))
    near = np.flatnonzero(np.isfinite(distance))
    # What lies before b begins, behind its end or round a corner is near b, but not beside it.
    apart, headings = poses_a[near] - poses_b[partner[near]], poses_b[partner[near], 2:] * math.sqrt(2.0) / tolerance_m
    common = near[np.abs((apart[:, :2] * headings).sum(axis=1)) <= _ALONG_M]
    if not len(common):
        return Overlap()
    along_a, along_b = arcs_a[common], arcs_b[partner[common]]
    # A path that runs side by side with an earlier or later part of itself has its partner now here, now there.
    breaks = (np.diff(along_a) > gap_m + step) | (np.abs(np.diff(along_b)) > np.diff(along_a) + gap_m + step)
    stretches = np.split(np.arange(len(common)), np.flatnonzero(breaks) + 1)
    chain = _chain([(along_a[k[0]], along_a[k[-1]], along_b[k[0]], along_b[k[-1]]) for k in stretches], gap_m)
    first, last = int(stretches[chain[0]][0]), int(stretches[chain[-1]][-1])
    shared = [along_a[stretches[k][-1]] - along_a[stretches[k][0]] for k in chain]
    return Overlap(
        length_m=float(sum(shared)),
        nearest=_pose(poses_a[common[first]]),
        farthest=_pose(poses_a[common[last]]),
        start_a_m=float(along_a[first]),
        end_a_m=float(along_a[last]),
        start_b_m=float(along_b[first]),
        end_b_m=float(along_b[last]),
    )


def _chain(stretches: Sequence[tuple[float, float, float, float]], gap_m: float) -> list[int]:
    """Indices of stretches (begin and end on a, begin and end on b) that follow one another, the longest in sum."""
    best: list[tuple[float, list[int]]] = []
    for k, (begin_a, end_a, begin_b, _) in enumerate(stretches):
        before = (0.0, list[int]())
        for (_, other_a, _, other_b), found in zip(stretches, best, strict=False):
            follows = begin_b >= other_b and begin_a - other_a <= _WAY_BETWEEN * (begin_b - other_b) + gap_m
            if follows and found[0] > before[0]:
                before = found
        best.append((before[0] + end_a - begin_a, [*before[1], k]))
    return max(best, key=lambda found: found[0])[1]


def _sample(path: FloatArray, step: float, tolerance_m: float) -> tuple[FloatArray, FloatArray]:
    """Arc lengths (K,) about ``step`` apart, ends included, and the poses there as (K, 4).

    The last two columns are the heading's cosine and sine times tolerance / √2, so that the Euclidean distance of two
    rows weighs position and heading as :func:`common_path` says. Headings are taken over a tolerance's length to
    either side, or less: the corners of a grid path are not its direction.
    """
    if not len(path):
        return np.empty(0), np.empty((0, 4))
    line = Polyline(path)
    if line.length_m == 0.0:
        return np.empty(0), np.empty((0, 4))
    arcs = np.linspace(0.0, line.end_m, max(2, math.ceil(line.length_m / step) + 1))
    return arcs, np.hstack(
        [line.at(arcs), line.tangents(arcs, min(tolerance_m, _REACH_M)) * tolerance_m / math.sqrt(2.0)]
    )


def _pose(row: FloatArray) -> Pose2D:
    return Pose2D(float(row[0]), float(row[1]), math.atan2(row[3], row[2]))
