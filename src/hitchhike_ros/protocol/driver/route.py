"""The driver's own way: its goal and the path there, how far it is to the boarding place."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.core.datatypes import HitchhikingPoint, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.matching import Planner, Stretch, shared_stretch, way_of
from hitchhike_ros.protocol.messages import Request, Waypoint
from hitchhike_ros.protocol.parameters import HitchhikingParameters

# Answers to so many questions are remembered (chosen).
_REMEMBERED = 30


class Route:
    """A goal of the robot's own, under one order to navigation, and the path to it as far as that is known."""

    def __init__(self, goal: Pose2D, order: str, planner: Planner, sites: Sites, params: HitchhikingParameters) -> None:
        self.goal, self.order = goal, order
        self._planner, self._sites, self._params = planner, sites, params
        self._path: OwnPath | None = None
        self._asked: dict[tuple[str, str], Stretch | None] = {}  # what it shares with who asked

    def path(self, estimate: PoseEstimate | None, may_plan: bool) -> OwnPath | None:
        """The path to the goal with how far the robot has come; None where it has no pose, or there is no way.

        ``may_plan``: a robot that has left its path, or has none yet, gets a new one.
        """
        if estimate is None:
            return None
        on_it = self._path is not None and self._path.advance(estimate.pose)
        if not on_it and may_plan:
            self._asked = {}
            try:
                self._path = OwnPath(self._planner(estimate.pose, self.goal))
            except PlanningError:
                self._path = None  # navigation finds out too, and says why
        return self._path

    def shared_with(
        self, request: Request, estimate: PoseEstimate | None, may_plan: bool, board_m: float | None
    ) -> Stretch | None:
        """What it shares with the hitchhiker's way, None where that is too little; a question is repeated, not this.

        ``board_m``: where along the path others board already.
        """
        key = (request.robot_id, request.ride_id)
        if key not in self._asked:
            path = self.path(estimate, may_plan)
            if path is None:
                return None
            self._asked = dict(list(self._asked.items())[-_REMEMBERED:])
            try:
                way = way_of(request, self._planner)
            except PlanningError:
                self._asked[key] = None  # it goes nowhere
            else:
                self._asked[key] = shared_stretch(path, way, self._sites, self._params, board_m)
        return self._asked[key]


def onward(
    path: OwnPath, point: HitchhikingPoint, board_m: float, speed_mps: float, in_s: float
) -> tuple[Waypoint, ...]:
    """The rest of ``path`` for whoever boards at ``point``, ``board_m`` along it, in ``in_s``."""
    ends = [(pose.x, pose.y) for pose in (point.waiting_pose, point.aligning_pose)]
    return OwnPath(np.vstack([ends, path.line.ahead(board_m).points[1:]])).waypoints(speed_mps, in_s)
