"""What it costs to head for a velocity: one function a term, each with a weight of the parameters.

A term is about 1 where a motion is as bad as can be expected and 0 where nothing is wrong with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.core.datatypes import FloatArray, Twist2D
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.core.robot_model import RobotLimits

# The way ahead is looked at in such steps, and so much farther than the robot could come (m).
_STEP_M, _BEYOND_M = 0.06, 0.3
# Beside the way by this much costs 1; what is farther than twice that off costs no more (m).
_BESIDE_M = 0.3
# The direction of the way counts so much ahead of where a motion leads (m).
_LOOK_AHEAD_M = 0.2
_CREEP_MPS, _SHORT_M = 0.05, 0.05


@dataclass(frozen=True, eq=False)
class Motions:
    """K motions rolled out at P times in the robot's frame, judged until contact or the end of the way.

    Attributes:
        targets: velocities (K, 2) in (v, omega) that they head for.
        last: the command before.
        poses: (K, P, 3).
        clearance: (K, P) m of the footprint.
        judged: (K,) index of the last pose that counts.
        free: (K,) how many poses are free, from the first on.
        before_end: (K,) how many poses, from the first on, are not past the end of the way.
        way: the way on, from the robot.
        possible_m: how far along the way the robot could come.
        reached_m: (K,) how far along the way each motion leads.
        beside_m: (K, 3) m beside the way after one, two and three thirds of each motion.
    """

    targets: FloatArray
    last: Twist2D
    poses: FloatArray
    clearance: FloatArray
    judged: npt.NDArray[np.intp]
    free: npt.NDArray[np.intp]
    before_end: npt.NDArray[np.intp]
    way: Polyline
    possible_m: float
    reached_m: FloatArray
    beside_m: FloatArray


def judge(
    targets: FloatArray,
    last: Twist2D,
    poses: FloatArray,
    velocities: FloatArray,
    step_s: float,
    clearance: FloatArray,
    floor_m: float,
    way: Polyline,
    max_speed_mps: float,
) -> Motions:
    """Motions towards ``targets`` (K, 2), rolled out to ``poses`` (K, P, 3) and ``velocities`` (K, P, 2) every
    ``step_s``, with the ``clearance`` (K, P) of the footprint; nearer than ``floor_m`` to an obstacle is contact."""
    length = poses.shape[1]
    travelled = np.cumsum(velocities[..., 0], axis=1) * step_s
    free = np.logical_and.accumulate(clearance >= floor_m, axis=1).sum(axis=1)
    before_end = (travelled < way.end_m).sum(axis=1) + 1
    judged = np.clip(np.minimum(free, before_end) - 1, 0, length - 1)
    possible_m = min(max(max_speed_mps, _CREEP_MPS) * step_s * length, way.end_m)
    s = np.arange(0.0, possible_m + _BEYOND_M, _STEP_M)
    line = way.at(s)
    thirds = np.minimum(np.array([length // 3, 2 * length // 3, length - 1]), judged[:, None])
    places = poses[np.arange(len(poses))[:, None], thirds]
    squared = (places[..., 0, None] - line[:, 0]) ** 2 + (places[..., 1, None] - line[:, 1]) ** 2
    nearest = squared.argmin(axis=-1)
    return Motions(
        *(targets, last, poses, clearance, judged, free, before_end, way, possible_m),
        reached_m=s[nearest[:, -1]],
        beside_m=np.sqrt(squared.min(axis=-1)),
    )


def costs(motions: Motions, limits: RobotLimits, params: LocalPlannerParameters) -> FloatArray:
    """Cost (K,) of each motion: the weighted sum of the terms below."""
    return (
        params.progress_weight * progress(motions)
        + params.lateral_weight * lateral(motions)
        + params.heading_weight * heading(motions)
        + params.clearance_weight * clearance(motions, params.comfort_m)
        + params.contact_weight * contact(motions)
        + params.smoothness_weight * smoothness(motions, limits.max_yaw_rate_rps)
    )


def progress(motions: Motions) -> FloatArray:
    """How much of the way that it could come it does not come: a robot that can go on goes on."""
    return 1.0 - motions.reached_m / max(motions.possible_m, _SHORT_M)


def lateral(motions: Motions) -> FloatArray:
    """How far beside the way it leads, by the square."""
    return np.minimum((motions.beside_m / _BESIDE_M) ** 2, 4.0).mean(axis=1)


def heading(motions: Motions) -> FloatArray:
    """How far it ends off the direction in which the way goes on: 1 - cos."""
    along = motions.way.tangents(motions.reached_m + _LOOK_AHEAD_M)
    theta = motions.poses[np.arange(len(motions.poses)), motions.judged, 2]
    return 1.0 - (along[:, 0] * np.cos(theta) + along[:, 1] * np.sin(theta))


def clearance(motions: Motions, comfort_m: float) -> FloatArray:
    """How much nearer to an obstacle than ``comfort_m`` it leads, by the square."""
    counted = np.arange(motions.poses.shape[1]) <= motions.judged[:, None]
    closest = np.where(counted, motions.clearance, np.inf).min(axis=1)
    return np.clip(1.0 - closest / comfort_m, 0.0, 1.0) ** 2


def contact(motions: Motions) -> FloatArray:
    """How soon it would touch something before the way ends, if it went on: 1 is at once."""
    length = motions.poses.shape[1]
    hits = motions.free < np.minimum(motions.before_end, length)
    return np.where(hits, 1.0 - motions.free / length, 0.0)


def smoothness(motions: Motions, max_yaw_rate_rps: float) -> FloatArray:
    """How much it changes the yaw rate from the command before, by the square."""
    return ((motions.targets[:, 1] - motions.last.omega) / max_yaw_rate_rps) ** 2
