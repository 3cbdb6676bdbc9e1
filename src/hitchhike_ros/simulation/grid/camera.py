"""Who sees whose marker in the grid simulator, and where it seems to be."""

from __future__ import annotations

import math
from random import Random

import numpy as np

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D
from hitchhike_ros.core.geometry import between, compose
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.paths import GridPaths
from hitchhike_ros.simulation.grid.robot import GridRobot


class MarkerCamera:
    """The camera that every robot has, and the rear marker of every other."""

    def __init__(self, params: GridWorldParameters, paths: GridPaths, random: Random) -> None:
        self._params, self._paths, self._random = params, paths, random
        self._marker = params.marker_pose
        sigmas = [params.marker_sigma_m, params.marker_sigma_m, params.marker_sigma_rad]
        self._covariance = np.diag(np.square(sigmas))

    def look(self, robot: GridRobot, leader: GridRobot, now: float) -> bool:
        """Whether the robot sees the rear marker of ``leader``; one that follows keeps turning to what it sees."""
        body, p = robot.body, self._params
        leader.body.advance(now)
        marker = compose(leader.body.pose, self._marker)
        here = body.pose
        if body.leader is leader.body and body.sees:
            here = Pose2D(here.x, here.y, math.atan2(leader.body.y - here.y, leader.body.x - here.x))
        eye = compose(here, Pose2D(p.camera_x_m, 0.0, 0.0))
        apart = math.hypot(marker.x - eye.x, marker.y - eye.y)
        sees = p.camera_nearest_m <= apart <= p.camera_range_m
        if sees:
            bearing = math.atan2(marker.y - eye.y, marker.x - eye.x)
            ahead = abs(math.remainder(bearing - here.theta, 2.0 * math.pi))
            aside = abs(math.remainder(bearing + math.pi - marker.theta, 2.0 * math.pi))
            sees = ahead <= p.camera_view_rad / 2 and aside <= p.marker_view_rad
            sees = sees and self._paths.sees((eye.x, eye.y), (marker.x, marker.y))
        if body.leader is leader.body:
            body.look(sees)
        return sees

    def observation(self, robot: GridRobot, leader: GridRobot, stamp: float) -> MarkerObservation:
        """The rear marker of ``leader`` in the robot's frame, with noise."""
        p, gauss = self._params, self._random.gauss
        true = between(robot.body.pose, compose(leader.body.pose, self._marker))
        seen = Pose2D(
            true.x + gauss(0.0, p.marker_sigma_m),
            true.y + gauss(0.0, p.marker_sigma_m),
            true.theta + gauss(0.0, p.marker_sigma_rad),
        )
        return MarkerObservation(stamp, leader.params.marker_id, seen, self._covariance)
