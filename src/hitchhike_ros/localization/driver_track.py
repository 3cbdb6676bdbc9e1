"""The rider's own pose, from the driver's track as the rider's camera saw it and as the driver told it.

A single look at a marker that is nearly square-on says little of its yaw: the outline of a square changes with the
square of the angle. The camera sees to millimetres, however, where the marker *is*. Over some metres of a ride these
places, joined with the own wheel odometry, form the same curve that the driver's messages tell in ``map``. The motion
that lays one curve on the other is the pose of the own odometry frame. Its heading improves the handover, and a rider
that has lost its driver starts from the whole pose. This is chosen: the papers take both robots to be in line (P18
Eq. 20; P17 §4).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, distance, wrap_angle

# The stretch that is compared: longer ones gather drift of the odometry, shorter ones do not fix the heading.
_WINDOW_M, _SHORTEST_M, _FEWEST = 4.0, 1.0, 5
# Places nearer to the last one tell nothing new, and a driver that stands must not outweigh the way before.
_STEP_M = 0.05
# Error of one place across the track, and of the odometry's heading over the window (chosen).
_PLACE_SIGMA_M, _DRIFT_SIGMA_RAD = 0.01, 0.015
# How far the driver moves between the moment that a message tells of and the moment that it is heard (chosen).
_LATE_M = 0.1


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the marker was, as seen in ``odom`` and as told in ``map``, with the covariance (2, 2) of the latter."""

    seen: Pose2D
    told: Pose2D
    sigma: FloatArray


class DriverTrack:
    """Collects places of the driver's marker and lays the seen ones on the told ones."""

    def __init__(self) -> None:
        self._places: deque[_Place] = deque()

    def add(self, T_odom_marker: Pose2D, T_map_marker: Pose2D, sigma: FloatArray | None = None) -> None:
        """Adds a place of the marker, as seen in the own ``odom`` frame and as told in ``map`` of the same time.

        The headings of both poses are ignored.

        Args:
            T_odom_marker: as seen.
            T_map_marker: as told.
            sigma: covariance (3, 3), in (x, y, theta), of the latter: how well the driver knows where it is. Exact
                unless given.
        """
        if self._places and distance(self._places[-1].seen, T_odom_marker) < _STEP_M:
            return
        known = np.zeros((2, 2)) if sigma is None else np.asarray(sigma)[:2, :2]
        self._places.append(_Place(T_odom_marker, T_map_marker, known))
        while distance(self._places[0].seen, T_odom_marker) > _WINDOW_M:
            self._places.popleft()

    def turn(self) -> tuple[float, float] | None:
        """Returns the heading of ``odom`` in ``map`` in rad and its variance, or None while the track is too short.

        The driver's own error hardly changes from one place to the next, so that neither do the residuals show it nor
        do many places average it out. What it is at one end of the track and at the other counts as independent.
        """
        if len(self._places) < _FEWEST:
            return None
        length = distance(self._places[0].seen, self._places[-1].seen)
        if length < _SHORTEST_M:
            return None
        seen, told = self._tracks()
        seen, told = seen - seen.mean(axis=0), told - told.mean(axis=0)
        cross = float(np.sum(seen[:, 0] * told[:, 1] - seen[:, 1] * told[:, 0]))
        turn = math.atan2(cross, float(np.sum(seen * told)))
        c, s = math.cos(turn), math.sin(turn)
        residual = told - seen @ np.array([[c, s], [-s, c]])
        place = max(_PLACE_SIGMA_M**2, float(np.sum(residual**2)) / (2 * len(seen) - 3))
        ends = (told[-1] - told[0]) / max(float(np.linalg.norm(told[-1] - told[0])), 1e-9)
        across = np.array([-ends[1], ends[0]])
        driver = 2.0 * float(across @ self._sigma() @ across) / length**2
        return turn, place / float(np.sum(seen**2)) + driver + _DRIFT_SIGMA_RAD**2

    def locate(self, stamp: float, T_odom_h: Pose2D) -> PoseEstimate | None:
        """Returns the own pose in ``map`` from that in ``odom``, or None while the track is too short.

        It is no better known than the driver knows where it is itself.
        """
        turn = self.turn()
        if turn is None:
            return None
        heading, variance = turn
        seen, told = (Pose2D(*(float(v) for v in track.mean(axis=0))) for track in self._tracks())
        way = compose(Pose2D(theta=heading), Pose2D(T_odom_h.x - seen.x, T_odom_h.y - seen.y))
        pose = Pose2D(told.x + way.x, told.y + way.y, wrap_angle(T_odom_h.theta + heading))
        lever = np.array([-way.y, way.x, 1.0])  # what an error of the heading does, as far away as the robot is
        covariance = variance * np.outer(lever, lever) + np.diag([_LATE_M**2, _LATE_M**2, 1e-6])
        covariance[:2, :2] += self._sigma()
        return PoseEstimate(stamp, pose, covariance)

    def _sigma(self) -> FloatArray:
        """Covariance (2, 2) of the middle of the told track: the errors of its places are one and the same."""
        return np.mean([place.sigma for place in self._places], axis=0)

    def _tracks(self) -> tuple[FloatArray, FloatArray]:
        """Places (N, 2) as seen in ``odom`` and as told in ``map``."""
        return (
            np.array([(place.seen.x, place.seen.y) for place in self._places]),
            np.array([(place.told.x, place.told.y) for place in self._places]),
        )


def with_heading(estimate: PoseEstimate, heading: float, variance: float) -> PoseEstimate:
    """Improves an estimate of the own pose by the own heading, which is known from elsewhere.

    The whole covariance enters, as that of what the estimate was made from: the driver's own, of the mounting and of
    the look at the marker (:func:`.handover.handover`). So what is corrected is what is known the worst.

    Args:
        estimate: the own pose in ``map``.
        heading: the own heading in ``map`` at that time, rad.
        variance: of that heading, rad².
    """
    P, pose = estimate.covariance, estimate.pose
    gain = P[:, 2] / (P[2, 2] + variance)
    dx, dy, dtheta = (float(v) for v in gain * wrap_angle(heading - pose.theta))
    better = Pose2D(pose.x + dx, pose.y + dy, wrap_angle(pose.theta + dtheta))
    covariance = P - np.outer(gain, P[2])
    return PoseEstimate(estimate.stamp, better, (covariance + covariance.T) / 2)
