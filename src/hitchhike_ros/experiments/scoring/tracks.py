"""Where robots truly went: poses between samples, metres, the gap to the robot ahead, the distance from its trail."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.geometry import compose, distance, path_length, wrap_angle
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord, TimedEstimate, TimedPose
from hitchhike_ros.experiments.scoring.rides import Ride, Window

# A trail keeps places this far apart, so that a robot that stands neither adds metres nor counts more (chosen).
_TRAIL_STEP_M = 0.05


def poses_at(truth: Sequence[TimedPose], stamps: FloatArray) -> FloatArray:
    """Poses (N, 3) at the times (N,), interpolated, theta unwrapped."""
    track = track_of(truth)
    return np.column_stack([np.interp(stamps, track[:, 0], track[:, k]) for k in (1, 2, 3)])


def track_of(poses: Sequence[TimedPose], window: Window = (-math.inf, math.inf)) -> FloatArray:
    """Poses within ``window`` as rows (N, 4) of stamp, x, y, theta unwrapped, in order of time."""
    track = np.array([(p.stamp, p.x, p.y, p.theta) for p in poses], dtype=float).reshape(-1, 4)
    track = track[np.argsort(track[:, 0], kind="stable")]
    track[:, 3] = np.unwrap(track[:, 3])
    return track[(track[:, 0] >= window[0]) & (track[:, 0] <= window[1])]


def trail_of(poses: Sequence[TimedPose], window: Window) -> FloatArray:
    """Places (N, 2) within ``window``, a step or more apart but for the last: a robot that stands adds none."""
    points = track_of(poses, window)[:, 1:3]
    kept: list[FloatArray] = []
    for point in points:
        if not kept or np.hypot(*(point - kept[-1])) >= _TRAIL_STEP_M:
            kept.append(point)
    if len(points) and not np.array_equal(kept[-1], points[-1]):
        kept.append(points[-1])
    return np.array(kept).reshape(-1, 2)


def gap_errors(driver: RobotRecord, hitchhiker: RobotRecord, window: Window) -> FloatArray:
    """True distance from camera to marker minus the gap that was ordered, (N,) m, at the hitchhiker's truths."""
    track = track_of(hitchhiker.truth, window)
    order = next((s.servo.gap_m for s in hitchhiker.statuses if s.state == "riding" and s.servo is not None), None)
    if order is None or not driver.truth:
        return np.empty(0)
    camera = _mounted(track[:, 1:], hitchhiker.camera)
    marker = _mounted(poses_at(driver.truth, track[:, 0]), driver.marker)
    return np.linalg.norm(marker - camera, axis=1) - order


def gap_now(record: RideRecord, ride: Ride) -> float | None:
    """The newest true distance from the hitchhiker's camera to the driver's marker in m."""
    if ride.driver is None:
        return None
    driver, hitchhiker = record.robots[ride.driver], record.robots[ride.hitchhiker]
    if not driver.truth or not hitchhiker.truth:
        return None
    camera = compose(hitchhiker.truth[-1].pose, hitchhiker.camera)
    return distance(camera, compose(driver.truth[-1].pose, driver.marker))


def metres_driven(robot: RobotRecord, window: Window) -> float:
    """How far the robot truly went."""
    return path_length(trail_of(robot.truth, window))


def handover_error(robot: RobotRecord, taken: TimedEstimate) -> tuple[float | None, float | None, float | None]:
    """A pose that the robot took over against where it was: m, degrees, and in units of its own covariance."""
    if not robot.truth:
        return None, None, None
    error = np.array([taken.x, taken.y, taken.theta]) - poses_at(robot.truth, np.array([taken.stamp]))[0]
    error[2] = wrap_angle(error[2])
    place, heading = float(np.hypot(error[0], error[1])), float(np.degrees(abs(error[2])))
    return place, heading, mahalanobis(error, np.array(taken.sigma))


def mahalanobis(error: FloatArray, covariance: FloatArray) -> float | None:
    """sqrt(eᵀ Σ⁻¹ e) of an error (n,), None where Σ (n, n) is not positive definite."""
    try:
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), error)
    except np.linalg.LinAlgError:
        return None
    return float(np.linalg.norm(whitened))


def distances_from_trail(points: FloatArray, trail: FloatArray) -> FloatArray:
    """Distance in m of each of points (N, 2) from the polyline trail (M, 2), without the points before its start."""
    if len(trail) < 2:
        return np.empty(0)
    arcs, distances = Polyline(trail).project_all(points)
    behind = (points - trail[0]) @ (trail[1] - trail[0]) < 0.0
    return distances[(arcs > 0.0) | ~behind]


def _mounted(poses: FloatArray, mount: Pose2D) -> FloatArray:
    """Position (N, 2) in ``map`` of something mounted on a robot at poses (N, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses[:, :2] + np.column_stack([c * mount.x - s * mount.y, s * mount.x + c * mount.y])
