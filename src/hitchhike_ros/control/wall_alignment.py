"""Which way a robot has to turn to stand parallel to a wall beside it (P17 §7.2: the left wall as the landmark)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import LaserScan, Pose2D, Positive, Side
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.mapping.laser import LaserNoise, end_points
from hitchhike_ros.mapping.scan_lines import LineParameters, extract_lines


@dataclass(frozen=True)
class WallAlignmentParameters:
    """Section ``wall_alignment``; all values are chosen."""

    min_length_m: Positive = 0.8
    max_range_m: Positive = 4.0
    max_surprise_rad: Positive = 0.5
    """A wall that runs otherwise than expected by more than this is another wall."""


def in_line(
    pose: Pose2D, heading_rad: float, side: Side, scan: LaserScan, T_base_laser: Pose2D, params: WallAlignmentParameters
) -> Pose2D:
    """``pose`` turned parallel to the wall on its ``side``, which runs at about ``heading_rad``; both in ``map``.

    Raises:
        PlanningError: the scan shows no such wall.
    """
    turn = turn_along_wall(scan, T_base_laser, side, wrap_angle(heading_rad - pose.theta), params)
    if turn is None:
        raise PlanningError(f"no wall on the {side} along {math.degrees(heading_rad):.0f}°")
    return Pose2D(pose.x, pose.y, wrap_angle(pose.theta + turn))


def turn_along_wall(
    scan: LaserScan, T_base_laser: Pose2D, side: Side, expected_rad: float, params: WallAlignmentParameters
) -> float | None:
    """The turn, in rad, after which the robot stands parallel to the wall on its ``side``; None without such a wall.

    A least-squares line through the wall's points gives it. Of several walls the longest near the turn that is
    ``expected_rad`` counts: in a corner more than one is in view.
    """
    ends = end_points(scan, T_base_laser, params.max_range_m)
    longest, turn = params.min_length_m, None
    for chain in extract_lines(ends, LaserNoise(), LineParameters()):
        for line in chain:
            length = float(np.linalg.norm(ends.points[line.last] - ends.points[line.first]))
            along = line.direction
            to_the_left = along[0] * line.centre[1] - along[1] * line.centre[0] > 0.0
            if to_the_left != (side == "left"):
                along = -along
            angle = math.atan2(along[1], along[0])
            if length >= longest and abs(wrap_angle(angle - expected_rad)) <= params.max_surprise_rad:
                longest, turn = length, angle
    return turn
