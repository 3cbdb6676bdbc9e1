"""What the modules of a robot do in the grid simulator, by formula: drive, follow, find new boxes, localize."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from random import Random

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import between, distance_to_box
from hitchhike_ros.protocol.events import NavigationReport, Situation
from hitchhike_ros.protocol.status import ServoCommand
from hitchhike_ros.simulation.grid.body import Body
from hitchhike_ros.simulation.grid.camera import MarkerCamera
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.paths import GridPaths, corners
from hitchhike_ros.simulation.grid.robot import GridRobot


class StandIns:
    """In place of path_planning, slam, obstacle_avoidance and visual_servoing of all robots.

    ``by_marker`` are the robots by the marker on their backs, ``boxes`` what stands in the world and not in the map.
    """

    def __init__(
        self,
        params: GridWorldParameters,
        paths: GridPaths,
        boxes: Sequence[Obstacle],
        by_marker: Mapping[int, GridRobot],
        random: Random,
    ) -> None:
        self._params, self._paths, self._boxes, self._random = params, paths, boxes, random
        self._by_marker = by_marker
        self._camera = MarkerCamera(params, paths, random)
        sigmas = [params.position_sigma_m, params.position_sigma_m, params.heading_sigma_rad]
        self._covariance = np.diag(np.square(sigmas))

    def obey(self, robot: GridRobot, now: float) -> None:
        """Do what the robot's status says."""
        status, body = robot.status, robot.body
        if status.servo is not None and status.servo.task == "follow":
            self._follow(robot, status.servo, now)
            return
        robot.followed = None
        goal = status.goal
        if goal is None or not (status.modules.PP and status.modules.OBS):
            if body.leader is not None or body.speed_mps > 0.0 or robot.goal_id:
                body.stop()
            robot.goal_id, robot.goal_error, robot.perceives_at_m = "", None, math.inf
            return
        speed = min(status.speed_limit_mps or robot.params.cruise_speed_mps, robot.safe_speed_mps)
        if robot.goal_id != goal.id:
            robot.goal_id = goal.id
            if goal.along_wall:
                body.turn(goal.theta)
                robot.goal_error, robot.news = None, True
            else:
                self._drive(robot, speed)
        elif body.speed_mps not in (0.0, speed):
            body.set_speed(speed)

    def perceive(self, robot: GridRobot) -> None:
        """Take new boxes around the robot into its map, and drive around them."""
        robot.perceives_at_m = math.inf
        body, status = robot.body, robot.status
        if not (status.modules.MAP and status.modules.LZN):
            return
        for box in self._boxes:
            near = distance_to_box(body.x, body.y, box) <= self._params.perception_m + 0.5
            if near and box.id not in robot.known and self._paths.sees_box((body.x, body.y), box):
                self.learn(robot, box)
        if robot.goal_id and status.goal is not None and not status.goal.along_wall and body.remaining_m > 0.0:
            self._drive(robot, body.speed_mps)

    def learn(self, robot: GridRobot, box: Obstacle) -> None:
        """Take a box into the robot's map."""
        if box.id not in robot.known:
            self._paths.add_box(box)
            robot.known[box.id] = box
            robot.known_ids = tuple(sorted(robot.known))
            robot.obstacles = tuple(robot.known[name] for name in robot.known_ids)

    def situation(self, robot: GridRobot, now: float) -> Situation:
        """What the robot's modules tell its agent."""
        stamp, status, body = now + robot.clock_offset_s, robot.status, robot.body
        estimate = self._estimate(body, stamp) if status.modules.LZN else None
        if not robot.engaged:
            return Situation(estimate, body.speed_mps, robot.obstacles, _report(robot))
        seen, following = None, ""
        if status.servo is not None:
            leader = self._leader(robot, status.servo)
            sees = leader is not None and self._camera.look(robot, leader, now)
            seen = self._camera.observation(robot, leader, stamp) if sees and leader is not None else None
            following = "following" if sees else "coasting"
        odom = between(robot.start, body.pose)
        return Situation(
            estimate,
            body.speed_mps,
            robot.obstacles,
            _report(robot),
            seen,
            odom if seen else None,
            odom,
            following,
        )

    def _follow(self, robot: GridRobot, servo: ServoCommand, now: float) -> None:
        """Behind the robot with that marker, once for each order."""
        leader, order = self._leader(robot, servo), (servo.task, servo.marker_id)
        if leader is None or robot.followed == order:
            return
        leader.body.advance(now)
        lag = self._params.camera_x_m + servo.gap_m - self._params.marker_x_m
        robot.body.follow(leader.body, lag, self._params.follow_factor * robot.params.ride_speed_mps)
        robot.followed, robot.goal_id, robot.goal_error = order, "", None
        self._camera.look(robot, leader, now)

    def _leader(self, robot: GridRobot, servo: ServoCommand) -> GridRobot | None:
        leader = self._by_marker.get(servo.marker_id)
        return None if leader is robot else leader

    def _drive(self, robot: GridRobot, speed_mps: float) -> None:
        """To the goal of its status, by a path around what it knows."""
        goal, body = robot.status.goal, robot.body
        assert goal is not None
        end = goal.theta if goal.tolerance_rad < math.pi else None
        if math.hypot(goal.x - body.x, goal.y - body.y) <= 0.5 * goal.tolerance_m:
            body.turn(body.theta if end is None else end)
            robot.goal_error, robot.news = None, True
            return
        try:
            path = self._paths.plan((body.x, body.y), (goal.x, goal.y), robot.known_ids)
        except PlanningError as exc:
            body.stop()
            robot.goal_error, robot.news = str(exc), True
            return
        robot.goal_error = None
        body.drive(corners(path), speed_mps, end)
        self._watch_for_boxes(robot, path)

    def _watch_for_boxes(self, robot: GridRobot, path: FloatArray) -> None:
        """Note where on its path (N, 2) the robot comes to see a box that it does not know."""
        robot.perceives_at_m = math.inf
        if not self._boxes or not robot.status.modules.MAP:
            return
        unknown = [box for box in self._boxes if box.id not in robot.known]
        if not unknown:
            return
        driven = robot.body.odometer_m + np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        reach = self._params.perception_m
        for box in unknown:
            low, high = np.array([box.x, box.y]), np.array([box.x + box.w, box.y + box.b])
            apart = np.hypot(*np.maximum(np.maximum(low - path, path - high), 0.0).T)
            for k in np.flatnonzero(apart <= reach):
                if driven[k] >= robot.perceives_at_m:
                    break
                if self._paths.sees_box((float(path[k, 0]), float(path[k, 1])), box):
                    robot.perceives_at_m = float(driven[k])
                    break

    def _estimate(self, body: Body, stamp: float) -> PoseEstimate:
        """The true pose with noise."""
        p, gauss = self._params, self._random.gauss
        x, y, theta = body.x, body.y, body.theta
        if p.position_sigma_m:
            x, y = x + gauss(0.0, p.position_sigma_m), y + gauss(0.0, p.position_sigma_m)
        if p.heading_sigma_rad:
            theta += gauss(0.0, p.heading_sigma_rad)
        return PoseEstimate(stamp, Pose2D(x, y, theta), self._covariance)


def _report(robot: GridRobot) -> NavigationReport | None:
    if not robot.goal_id:
        return None
    if robot.goal_error is not None:
        return NavigationReport(robot.goal_id, "failed", robot.goal_error)
    arrived = robot.body.remaining_m <= 1e-6
    return NavigationReport(robot.goal_id, "arrived" if arrived else "driving")
