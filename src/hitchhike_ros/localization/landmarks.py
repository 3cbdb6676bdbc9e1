"""Corners as landmarks: found once in the robot's own map, and in each scan by line extraction."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Positive
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.localization.ekf import LandmarkObservation, Landmarks
from hitchhike_ros.mapping.grid import UNKNOWN, OccupancyGrid
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise

CONVEX, CONCAVE = 1.0, 0.0


@dataclass(frozen=True)
class CornerParameters:
    """Which corners count, and how well they are seen (all chosen)."""

    map_side_m: Positive = 0.12  # straight wall on both sides of a corner of the map, and at least map_side_cells
    map_side_cells: int = 3
    max_range_m: Positive = 4.0
    min_points: int = 6
    min_length_m: Positive = 0.10
    min_length_sigmas: Positive = 8.0
    split_m: Positive = 0.04
    split_sigmas: Positive = 3.5
    max_gap_m: Positive = 0.12
    min_angle_rad: Positive = 1.0
    range_sigma_m: Positive = 0.01
    range_sigma_ratio: Positive = 0.01  # grows with the range, in quadrature
    bearing_sigma_rad: Positive = 0.008


def map_corners(grid: OccupancyGrid, parameters: CornerParameters) -> Landmarks:
    """Corners of the walls in a grid, of those whose two sides are straight for a while.

    At a convex corner one of the four cells that meet is occupied, at a concave one it is the only free one; the two
    sides run from there along that cell. The signature is CONVEX or CONCAVE. Ragged walls have few such corners.
    """
    occupied, free = grid.occupied, ~(grid.occupied | np.equal(grid.data, UNKNOWN))
    steps = max(parameters.map_side_cells, math.ceil(parameters.map_side_m / grid.resolution - 1e-6))
    wall, room = np.pad(occupied, steps), np.pad(free, steps)
    solid = ~room
    corners, signatures = [], []
    rows, columns = np.mgrid[steps : steps + grid.height + 1, steps : steps + grid.width + 1]
    for down, left in ((0, 0), (0, 1), (1, 0), (1, 1)):  # which of the four cells about a grid point differs
        row, column = (rows - down).ravel(), (columns - left).ravel()
        dr, dc = 1 - 2 * down, 1 - 2 * left  # from the grid point into that cell
        for signature, cell, others, sides in ((CONVEX, wall, room, room), (CONCAVE, room, solid, wall)):
            at = cell[row, column] & others[row - dr, column - dc]
            for k in range(steps):
                at &= cell[row + k * dr, column] & sides[row + k * dr, column - dc]
                at &= cell[row, column + k * dc] & sides[row - dr, column + k * dc]
            found = np.flatnonzero(at)
            points = np.column_stack([columns.ravel()[found], rows.ravel()[found]]) - steps
            corners.append(transform_points(grid.origin, points * grid.resolution))
            signatures.append(np.full(len(found), signature))
    return Landmarks(np.concatenate(corners), np.concatenate(signatures))


@dataclass(frozen=True, eq=False)
class Line:
    """A straight piece of a scan: points first..last (inclusive), along ``direction`` through ``centre``."""

    first: int
    last: int
    centre: FloatArray
    direction: FloatArray


def extract_lines(ends: EndPoints, noise: LaserNoise, parameters: CornerParameters) -> list[list[Line]]:
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


def scan_corners(
    ends: EndPoints, origin: FloatArray, noise: LaserNoise, parameters: CornerParameters
) -> list[LandmarkObservation]:
    """Corners seen in a scan, as range, bearing and signature in ``base_footprint``.

    Args:
        ends: end points in ``base_footprint``, in the order of their angles.
        origin: the laser's position (2,) in ``base_footprint``.
        noise: of the ranges.
        parameters: which corners count.
    """
    p = parameters
    near = ends.ranges <= p.max_range_m
    ends = EndPoints(ends.points[near], ends.ranges[near], ends.beams[near])
    sigma, observations = noise.sigma(ends.ranges), []
    for chain in extract_lines(ends, noise, p):
        for one, two in itertools.pairwise(chain):
            corner = _intersection(ends, one, two, sigma, p)
            if corner is None:
                continue
            sides = ends.points[one.first] + ends.points[two.last] - 2.0 * corner
            signature = CONCAVE if float(sides @ (origin - corner)) > 0 else CONVEX
            r = math.hypot(corner[0], corner[1])
            observations.append(
                LandmarkObservation(
                    r,
                    math.atan2(corner[1], corner[0]),
                    signature,
                    math.hypot(p.range_sigma_m, p.range_sigma_ratio * r),
                    p.bearing_sigma_rad,
                )
            )
    return observations


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

    def fit(self, first: int, last: int) -> Line:
        """Total least squares through the points first..last, without the ends that two pieces share."""
        a, b = (first + 1, last) if last - first >= 4 else (first, last + 1)
        n = b - a
        x, y, xx, yy, xy = ((high - low) / n for high, low in zip(self._sums[b], self._sums[a], strict=True))
        angle = 0.5 * math.atan2(2.0 * (xy - x * y), (xx - x * x) - (yy - y * y))
        return Line(first, last, np.array([x, y]), np.array([math.cos(angle), math.sin(angle)]))


def _merge(points: FloatArray, sums: _Sums, chain: list[Line], tolerance: FloatArray) -> list[Line]:
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


def _intersection(ends: EndPoints, one: Line, two: Line, sigma: FloatArray, p: CornerParameters) -> FloatArray | None:
    """Where two adjoining pieces meet (2,), if both are long enough and the angle between them is a corner's."""
    cross = float(one.direction[0] * two.direction[1] - one.direction[1] * two.direction[0])
    if abs(cross) < math.sin(p.min_angle_rad):
        return None
    for line in (one, two):
        # A piece no longer than its noise has no direction.
        needed = max(p.min_length_m, p.min_length_sigmas * float(sigma[line.first]))
        length = float(np.hypot(*(ends.points[line.last] - ends.points[line.first])))
        if line.last - line.first + 1 < p.min_points or length < needed:
            return None
    d = two.centre - one.centre
    along = (d[0] * two.direction[1] - d[1] * two.direction[0]) / cross
    corner: FloatArray = one.centre + along * one.direction
    return corner if np.hypot(*(corner - ends.points[one.last])) < p.max_gap_m else None
