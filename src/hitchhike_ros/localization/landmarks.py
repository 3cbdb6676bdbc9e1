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
from hitchhike_ros.mapping.scan_lines import LineParameters, ScanLine, extract_lines

CONVEX, CONCAVE = 1.0, 0.0


@dataclass(frozen=True)
class CornerParameters(LineParameters):
    """Which corners of a map and of the lines in a scan count, and how well they are seen (all chosen)."""

    map_side_m: Positive = 0.12  # straight wall on both sides of a corner of the map, and at least map_side_cells
    map_side_cells: int = 3
    max_range_m: Positive = 4.0
    min_length_m: Positive = 0.10
    min_length_sigmas: Positive = 8.0
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


def _intersection(
    ends: EndPoints, one: ScanLine, two: ScanLine, sigma: FloatArray, p: CornerParameters
) -> FloatArray | None:
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
