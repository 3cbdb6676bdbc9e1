"""Plans through the robot's own map to where hitchhike_comm wants the robot (module PP).

A path is searched for when there is a new goal or a changed map, and again from time to time while obstacle avoidance
finds the way blocked and after a failure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, PoseEstimate, Positive
from hitchhike_ros.core.errors import PlanningError, StaleInputError
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.modules.inputs import NO_PATH, PlannedPath, PlanReport
from hitchhike_ros.modules.module import Fresh, Health, Level, Order, Orders, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.protocol.events import NavigationReport
from hitchhike_ros.protocol.status import ModuleSwitches, Status

_LEVELS = {"idle": Level.OK, "waiting": Level.WARN, "planned": Level.OK, "failed": Level.ERROR}
_COUNTERS: dict[type, str] = {
    PoseEstimate: "bad_poses",
    OccupancyGrid: "bad_maps",
    NavigationReport: "bad_navigation_status",
}


@dataclass(frozen=True)
class PathPlanningParameters:
    """Section ``path_planning``; all values are chosen."""

    retry_s: Annotated[float, msgspec.Meta(ge=0.1)] = 2.0
    """Least time between two plans to the same goal on the same map, after a failure or while the way is blocked."""
    pose_age_s: Positive = 1.0
    """An estimate older than this is no longer where the robot is."""


@dataclass(frozen=True, kw_only=True)
class PathPlanningOutputs(Outputs):
    """A new plan, and the report on it."""

    report: PlanReport | None = None
    plan: PlannedPath | None = None


@dataclass(frozen=True)
class _Goal:
    """Where the robot is wanted, in ``map``; a new ``id`` is a new goal, be it at the same place."""

    id: str
    pose: Pose2D


@dataclass(frozen=True, eq=False)
class _Plan:
    """What there is for a goal: a path (N, 2) in m in ``map`` when planned, else none and the reason why."""

    state: Literal["idle", "waiting", "planned", "failed"] = "idle"
    goal: _Goal | None = None
    reason: str = ""
    path: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    def says_the_same(self, other: _Plan) -> bool:
        """Of plans without a path."""
        return (self.state, self.goal, self.reason) == (other.state, other.goal, other.reason)


class PathPlanning:
    """Keeps the plan to the newest goal up to date.

    The map does not age: it is published when it changes. It is kept while the module is off; whoever is subscribed to
    it again gets the newest.
    """

    name: ClassVar[str] = "path_planning"
    inputs: ClassVar[frozenset[type]] = frozenset(_COUNTERS)
    patient: ClassVar[frozenset[type]] = frozenset()

    def __init__(self, planner: GlobalPlanner, params: PathPlanningParameters, *, always_on: bool = False) -> None:
        """With ``always_on`` it is on without anyone's status, for :meth:`make_plan` alone."""
        self._planner, self._params = planner, params
        alone = Status(0.0, self.name, modules=ModuleSwitches(OBS=False, LZN=False, MAP=False, COM=False))
        self._orders = Orders(alone if always_on else None)
        self._grid: OccupancyGrid | None = None
        self._no_map = "no map received"
        self._estimate: Fresh[PoseEstimate] = Fresh("pose estimate", params.pose_age_s)
        self._navigation: NavigationReport | None = None
        self._refused = dict.fromkeys(_COUNTERS.values(), 0)
        self._plan = _Plan()
        self._planned_at = -math.inf
        self._planned_on: OccupancyGrid | None = None
        self._news = True  # since the last step
        self._obeys = False  # an order that counted at the last step
        self._lacks_input = False  # for the search that is due
        self._stepped_at = -math.inf

    @classmethod
    def build(cls, files: RobotFiles, *, always_on: bool = False) -> PathPlanning:
        """That of the robot that ``files`` describe."""
        limits = files.load(RobotLimits, "robot")
        planner = GlobalPlanner(files.load(GlobalPlannerParameters, "global_planner"), limits)
        return cls(planner, files.load(PathPlanningParameters, "path_planning"), always_on=always_on)

    @property
    def on(self) -> bool:
        """Whether the module is switched on."""
        status = self._orders.newest()
        return status is not None and status.modules.PP

    def listens(self) -> frozenset[type]:
        """All of its inputs while it is on."""
        return self.inputs if self.on else frozenset()

    def sense(self, x: object, now: float) -> None:
        """Store the map, where the robot is, or how driving fares; what is not new wants no step."""
        if isinstance(x, OccupancyGrid):
            if not _same(x, self._grid):
                self._grid, self._news = x, True
        elif isinstance(x, PoseEstimate):
            if x.pose.is_finite():
                self._estimate.put(x, x.stamp)
                self._news |= self._lacks_input
            else:
                self._refuse(PoseEstimate)
        elif isinstance(x, NavigationReport):
            self._navigation = x
        elif isinstance(x, Refused):
            self._refuse(x.what)
            if x.what is OccupancyGrid:
                self._no_map = f"no map received, only one that was refused: {x.reason}"
                self._news |= self._lacks_input

    def order(self, order: Order, now: float) -> None:
        """The status says whether the module is on, and the goal."""
        self._orders.put(order, now)
        self._news = True

    def next_due(self, now: float) -> float:
        """At once on news, when a search is due that lacks nothing, and when the order expires."""
        if self._news or now < self._stepped_at:
            return now
        due = self._orders.expires() if self._obeys else math.inf
        goal = self._plan.goal
        return due if goal is None or self._lacks_input else min(due, self._search_at(now, goal))

    def step(self, now: float) -> PathPlanningOutputs:
        """Search for a path where that is due; the outputs hold what is new."""
        first, before = not math.isfinite(self._stepped_at), self._plan
        self._stepped_at, self._news, self._lacks_input = now, False, False
        problem, goal = "", None
        try:
            goal = self._goal(now)
        except StaleInputError as exc:
            problem = str(exc)
        self._obeys = self.on and not problem
        if goal is None:
            self._settle(_Plan())
        elif self._search_at(now, goal) <= now:
            self._search(now, goal)
        health = self._health(problem)
        if self._plan is before and not first:
            return PathPlanningOutputs(health=health)
        report = PlanReport("" if goal is None else goal.id, self._plan.state, self._plan.reason)
        path = NO_PATH
        if goal is not None and self._plan.state == "planned":
            path = PlannedPath(self._plan.path, goal.pose)
        return PathPlanningOutputs(health=health, report=report, plan=path)

    def make_plan(self, start: Pose2D | None, goal: Pose2D, tolerance_m: float, now: float) -> FloatArray:
        """A path (N, 2) in m in ``map``, as of move_base; the plan to the robot's own goal stays as it is.

        Args:
            start: in ``map``; None: from where the robot is.
            goal: in ``map``; one that is occupied is moved by up to ``tolerance_m``.
            tolerance_m: 0 where the goal is to stay.
            now: s.

        Raises:
            StaleInputError: the module is off, has no map or does not know where the robot is.
            PlanningError: there is no path.
        """
        if not self.on:
            raise StaleInputError("path planning is off")
        if self._grid is None:
            raise StaleInputError(self._no_map)
        start = self._estimate.at(now).pose if start is None else start
        if tolerance_m > 0.0 and math.isfinite(tolerance_m):
            goal = self._planner.relax(self._grid, goal, tolerance_m)
        return self._planner.plan(self._grid, start, goal)

    def _goal(self, now: float) -> _Goal | None:
        """Where the robot is wanted at ``now``; a turn along a wall needs no path.

        Raises:
            StaleInputError: the order is too old.
        """
        status = self._orders.at(now)
        goal = status.goal if status.modules.PP else None
        return None if goal is None or goal.along_wall else _Goal(goal.id, goal.pose)

    def _search_at(self, now: float, goal: _Goal) -> float:
        """When a path to ``goal`` is to be searched for, if nothing that is needed is missing."""
        plan, navigation = self._plan, self._navigation
        if plan.goal != goal or plan.state == "waiting" or self._grid is not self._planned_on:
            return now
        blocked = navigation is not None and (navigation.goal_id, navigation.state) == (goal.id, "blocked")
        if not blocked and plan.state != "failed":
            return math.inf
        return self._planned_at + self._params.retry_s if now >= self._planned_at else now

    def _search(self, now: float, goal: _Goal) -> None:
        """Plan from where the robot is. A plan to this goal stands while map or pose is missing."""
        grid, estimate = self._grid, self._estimate.get(now)
        if grid is None or estimate is None:
            self._lacks_input = True
            if self._plan.goal != goal or self._plan.state == "waiting":
                self._settle(_Plan("waiting", goal, self._no_map if grid is None else "no recent pose estimate"))
            return
        self._planned_at, self._planned_on = now, grid
        try:
            self._plan = _Plan("planned", goal, path=self._planner.plan(grid, estimate.pose, goal.pose))
        except PlanningError as exc:
            self._settle(_Plan("failed", goal, str(exc)))

    def _settle(self, plan: _Plan) -> None:
        """Take over a plan without a path, unless it says the same as the one there is."""
        if not plan.says_the_same(self._plan):
            self._plan = plan

    def _refuse(self, what: type) -> None:
        self._refused[_COUNTERS[what]] += 1
        self._news = True

    def _health(self, problem: str) -> Health:
        counters: dict[str, object] = {name: count for name, count in self._refused.items() if count}
        if not self.on:
            return Health(Level.OK, "off", counters)
        plan = self._plan
        counters["length_m"] = round(path_length(plan.path), 2) if plan.state == "planned" else ""
        level = Level.ERROR if problem else _LEVELS[plan.state]
        return Health(level, problem or plan.reason or plan.state, counters)


def _same(grid: OccupancyGrid, known: OccupancyGrid | None) -> bool:
    """Whether a map that has come says nothing new."""
    return known is not None and (
        grid is known
        or (
            (grid.resolution, grid.origin) == (known.resolution, known.origin) and np.array_equal(grid.data, known.data)
        )
    )
