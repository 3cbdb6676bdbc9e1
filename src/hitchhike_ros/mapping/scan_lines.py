"""Straight pieces of a scan, by iterative end-point fit and least squares."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Positive
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise


@dataclass(frozen=True)
class LineParameters:
    """Which points of a scan are one straight piece (all chosen)."""

    min_points: int = 6
    split_m: Positive = 0.04
    split_sigmas: Positive = 3.5
    max_gap_m: Positive = 0.12


@dataclass(frozen=True, eq=False)
class ScanLine:
    """A straight piece of a scan: points first..last (inclusive), along ``direction`` through ``centre``."""

    first: int
    last: int
    centre: FloatArray
    direction: FloatArray


def extract_lines(ends: EndPoints, noise: LaserNoise, parameters: LineParameters) -> list[list[ScanLine]]:
    """Chains of adjoining straight pieces, by iterative end-point fit (split) and least squares.

    Beams must be in the order of their angles. A chain ends where the scan has a gap.
    """
    p = parameters
    points, sigma = ends.points, noise.sigma(ends.ranges)
    if len(points) < p.min_points:
        return []
    sums, tolerance = _Sums(points), np.maximum(p.split_m, p.split_sigmas * sigma)
    gap = np.hypot(*np.diff(points, axis=0).T) > np.maximum(p.max_gap_m, 4.0 * sigma[1:])
    starts = np.concatenate([[0], np.flatnonzero(gap | (np.diff(ends.beams) > 2)) + 1, [len(points)]])
    chains = []
    for start, stop in itertools.pairwise(starts):
        if stop - start >= p.min_points:
            breaks = [start, *(start + b for b in _split(points[start:stop], tolerance[start:stop])), stop - 1]
            chain = [sums.fit(int(a), int(b)) for a, b in itertools.pairwise(breaks)]
            chains.append(_merge(points, sums, chain, tolerance))
    return chains


def _split(points: FloatArray, tolerance: FloatArray) -> list[int]:
    """Indices at which the points bend away from the chord of their piece by more than their tolerance."""
    breaks, pieces = [], [(0, len(points) - 1)]
    while pieces:
        a, b = pieces.pop()
        if b - a < 2:
            continue
        chord = points[b] - points[a]
        offset = points[a + 1 : b] - points[a]
        length = math.hypot(chord[0], chord[1])
        away = (
            np.abs(chord[0] * offset[:, 1] - chord[1] * offset[:, 0]) / length
            if length > 1e-9
            else np.hypot(offset[:, 0], offset[:, 1])
        )
        k = int(np.argmax(away / tolerance[a + 1 : b])) + a + 1
        if away[k - a - 1] > tolerance[k]:
            breaks.append(k)
            pieces += [(a, k), (k, b)]
    return sorted(breaks)


class _Sums:
    """Sums over the points before each, from which a line through any stretch follows at once."""

    def __init__(self, points: FloatArray) -> None:
        x, y = points.T
        terms = np.column_stack([x, y, x * x, y * y, x * y])
        self._sums = np.vstack([np.zeros(5), np.cumsum(terms, axis=0)]).tolist()

    def fit(self, first: int, last: int) -> ScanLine:
        """Total least squares through the points first..last, without the ends that two pieces share."""
        a, b = (first + 1, last) if last - first >= 4 else (first, last + 1)
        n = b - a
        x, y, xx, yy, xy = ((high - low) / n for high, low in zip(self._sums[b], self._sums[a], strict=True))
        angle = 0.5 * math.atan2(2.0 * (xy - x * y), (xx - x * x) - (yy - y * y))
        return ScanLine(first, last, np.array([x, y]), np.array([math.cos(angle), math.sin(angle)]))


def _merge(points: FloatArray, sums: _Sums, chain: list[ScanLine], tolerance: FloatArray) -> list[ScanLine]:
    """Join neighbours that are one line after all: together they stay within the tolerance (N,) of their points."""
    merged = chain[:1]
    for line in chain[1:]:
        both = sums.fit(merged[-1].first, line.last)
        d = points[both.first : both.last + 1] - both.centre
        away = np.abs(d[:, 1] * both.direction[0] - d[:, 0] * both.direction[1])
        if (away < tolerance[both.first : both.last + 1]).all():
            merged[-1] = both
        else:
            merged.append(line)
    return merged
