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
from dataclasses import replace

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, distance, wrap_angle

# The stretch that is compared: longer ones gather drift of the odometry, shorter ones do not fix the heading.
_WINDOW_M, _SHORTEST_M, _FEWEST = 4.0, 1.0, 5
# Places nearer to the last one tell nothing new, and a driver that stands must not outweigh the way before.
_STEP_M = 0.05
# Error of one place across the track, and of the odometry's heading over the window (chosen).
_PLACE_SIGMA_M, _DRIFT_SIGMA_RAD = 0.01, 0.015
# How far the driver moves between the moment that a message tells of and the moment that it is heard (chosen).
_LATE_M = 0.1


class DriverTrack:
    """Collects places of the driver's marker and lays the seen ones on the told ones."""

    def __init__(self) -> None:
        self._places: deque[tuple[Pose2D, Pose2D]] = deque()

    def add(self, T_odom_marker: Pose2D, T_map_marker: Pose2D) -> None:
        """Adds a place of the marker, as seen in the own ``odom`` frame and as told in ``map`` at the same time.

        The headings of both poses are ignored.
        """
        if self._places and distance(self._places[-1][0], T_odom_marker) < _STEP_M:
            return
        self._places.append((T_odom_marker, T_map_marker))
        while distance(self._places[0][0], T_odom_marker) > _WINDOW_M:
            self._places.popleft()

    def turn(self) -> tuple[float, float] | None:
        """Returns the heading of ``odom`` in ``map`` in rad and its variance, or None while the track is too short."""
        if len(self._places) < _FEWEST or distance(self._places[0][0], self._places[-1][0]) < _SHORTEST_M:
            return None
        seen, told = self._tracks()
        seen, told = seen - seen.mean(axis=0), told - told.mean(axis=0)
        cross = float(np.sum(seen[:, 0] * told[:, 1] - seen[:, 1] * told[:, 0]))
        turn = math.atan2(cross, float(np.sum(seen * told)))
        c, s = math.cos(turn), math.sin(turn)
        residual = told - seen @ np.array([[c, s], [-s, c]])
        place = max(_PLACE_SIGMA_M**2, float(np.sum(residual**2)) / (2 * len(seen) - 3))
        return turn, place / float(np.sum(seen**2)) + _DRIFT_SIGMA_RAD**2

    def locate(self, stamp: float, T_odom_h: Pose2D) -> PoseEstimate | None:
        """Returns the own pose in ``map`` from that in ``odom``, or None while the track is too short."""
        turn = self.turn()
        if turn is None:
            return None
        heading, variance = turn
        seen, told = (Pose2D(*(float(v) for v in track.mean(axis=0))) for track in self._tracks())
        way = compose(Pose2D(theta=heading), Pose2D(T_odom_h.x - seen.x, T_odom_h.y - seen.y))
        pose = Pose2D(told.x + way.x, told.y + way.y, wrap_angle(T_odom_h.theta + heading))
        lever = np.array([-way.y, way.x, 1.0])  # what an error of the heading does, as far away as the robot is
        return PoseEstimate(stamp, pose, variance * np.outer(lever, lever) + np.diag([_LATE_M**2, _LATE_M**2, 1e-6]))

    def _tracks(self) -> tuple[FloatArray, FloatArray]:
        """Places (N, 2) as seen in ``odom`` and as told in ``map``."""
        seen, told = (np.array([(p[k].x, p[k].y) for p in self._places]) for k in (0, 1))
        return seen, told


def with_heading(
    observation: MarkerObservation, marker_heading: float, heading: float, variance: float
) -> MarkerObservation:
    """Improves the yaw of an observation by the own heading, which is known from elsewhere.

    Args:
        observation: T_h_marker as seen.
        marker_heading: direction of the marker's normal in ``map``, rad.
        heading: the own heading in ``map``, rad.
        variance: of that heading, rad².
    """
    innovation = wrap_angle(marker_heading - heading - observation.pose.theta)
    gain = observation.covariance[:, 2] / (observation.covariance[2, 2] + variance)
    dx, dy, dtheta = (float(v) for v in gain * innovation)
    p = observation.pose
    pose = Pose2D(p.x + dx, p.y + dy, wrap_angle(p.theta + dtheta))
    return replace(
        observation, pose=pose, covariance=observation.covariance - np.outer(gain, observation.covariance[2])
    )
