"""When a plan is due: a new order, a changed map, a way that turned out to be blocked, a failure some time ago."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, PoseEstimate, Positive
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.planning.global_planner import GlobalPlanner


@dataclass(frozen=True)
class ReplannerParameters:
    """Section ``path_planning``; all values are chosen."""

    # Least time between two plans of the same order on the same map, after a failure or while the way is blocked.
    retry_s: Positive = 2.0
    # An estimate older than this is no longer where the robot is.
    pose_age_s: Positive = 1.0


@dataclass(frozen=True)
class Order:
    """A goal in ``map``; a new ``id`` is a new order, be it for the same place."""

    id: str
    goal: Pose2D


@dataclass(frozen=True, eq=False)
class Plan:
    """What the planner has for an order: a path (N, 2) in m in ``map`` when planned, else none and the reason why."""

    state: Literal["idle", "waiting", "planned", "failed"] = "idle"
    order: Order | None = None
    reason: str = ""
    path: FloatArray = field(default_factory=lambda: np.empty((0, 2)))


class Replanner:
    """Keeps the plan of the newest order up to date."""

    def __init__(self, planner: GlobalPlanner, params: ReplannerParameters) -> None:
        self._planner, self._params = planner, params
        self._plan, self._planned_at = Plan(), 0.0
        self._grid: OccupancyGrid | None = None

    def step(
        self,
        now: float,
        order: Order | None,
        grid: OccupancyGrid | None,
        estimate: PoseEstimate | None,
        blocked: bool,
    ) -> Plan:
        """The plan that holds now; the same object as before unless something has changed.

        Args:
            now: s, on the clock of the estimate.
            order: where the robot is wanted; None: nowhere.
            grid: the robot's map; another object is a changed map.
            estimate: where the robot is.
            blocked: whether the controller finds the planned way blocked.
        """
        if order is None:
            return self._settle(Plan())
        is_new = self._plan.order != order or self._plan.state == "waiting"
        if grid is None:
            return self._settle(Plan("waiting", order, "no map received")) if is_new else self._plan
        if estimate is None or now - estimate.stamp > self._params.pose_age_s:
            return self._settle(Plan("waiting", order, "no recent pose estimate")) if is_new else self._plan
        again = (blocked or self._plan.state == "failed") and not 0 <= now - self._planned_at < self._params.retry_s
        if is_new or again or grid is not self._grid:
            self._planned_at, self._grid = now, grid
            try:
                self._plan = Plan("planned", order, path=self._planner.plan(grid, estimate.pose, order.goal))
            except PlanningError as exc:
                self._settle(Plan("failed", order, str(exc)))
        return self._plan

    def _settle(self, plan: Plan) -> Plan:
        """Take over a plan without a path, unless it says the same as the one there is."""
        if (plan.state, plan.order, plan.reason) != (self._plan.state, self._plan.order, self._plan.reason):
            self._plan = plan
        return self._plan
