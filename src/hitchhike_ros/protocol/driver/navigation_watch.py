"""How navigation fares: that it arrives, or why it is given up.

What counts is how near the robot has come to where it is wanted. A robot that is blocked, makes room and drives on
again says something else every few seconds, and gets nowhere.
"""

from __future__ import annotations

import math

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.events import NavigationReport
from hitchhike_ros.protocol.matching import Planner
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Ending, Reason

# Coming nearer by less is none: recovery goes back by a metre and on again, and localization has noise (chosen).
_STEP_M = 0.5
# How far it is does not have to be known more often (s, chosen).
_LOOK_S = 0.5
# As boxes appear the way becomes longer; after so many new ways they no longer count (chosen).
_MOST_WAYS = 20


class Progress:
    """How far it is to a place, and how near the robot has been."""

    def __init__(self, place: Pose2D, planner: Planner) -> None:
        """``planner`` gives the path (N, 2) in ``map`` between two poses and raises PlanningError without one."""
        self.place = place
        self.left_m: float | None = None
        """Along the way from where it was seen last; None where there is no way."""
        self._planner = planner
        self._path: OwnPath | None = None
        self._nearest_m = math.inf
        self._ways = 0

    def comes_nearer(self, pose: Pose2D) -> bool:
        """Whether it is nearer by a step than it ever was, on the way that there is now."""
        if self._path is None or not self._path.advance(pose):
            try:
                self._path = OwnPath(self._planner(pose, self.place))
            except PlanningError:
                self._path = self.left_m = None  # navigation finds out too, and says why
                return False
            if self._path.left_m > self._nearest_m and self._ways < _MOST_WAYS:
                self._ways, self._nearest_m = self._ways + 1, self._path.left_m
        self.left_m = self._path.left_m
        if self.left_m > self._nearest_m - _STEP_M:
            return False
        self._nearest_m = self.left_m
        return True


class NavigationWatch:
    """Whether navigation arrives, is stuck, has no path or comes no nearer, of one order after another."""

    def __init__(self, params: HitchhikingParameters, planner: Planner) -> None:
        self._params, self._planner = params, planner
        self.ending: Ending | None = None
        """How the present order ends: ``Reason.ARRIVED``, or why it is given up; None while navigation is at it."""
        self._progress: Progress | None = None
        self._order: str | None = None
        self._noted_at: float | None = None
        self._look_at = -math.inf
        self._reason = ""  # of the last trouble
        # So long without a plan since it had one, blocked and in all since it last came nearer.
        self._without_plan_s = self._blocked_s = self._still_s = 0.0

    @property
    def left_m(self) -> float | None:
        """How long the way is to where the robot is wanted; None where that is not known."""
        return None if self._progress is None else self._progress.left_m

    def forget(self) -> None:
        """What the robot is wanted for now is new, even at the same place."""
        self._progress, self.ending = None, None

    def pause(self) -> None:
        """The robot stands for a reason of its own: that time does not count."""
        self._noted_at, self.ending = None, None

    def note(
        self,
        report: NavigationReport | None,
        order: str,
        towards: Pose2D,
        estimate: PoseEstimate | None,
        now: float,
    ) -> None:
        """Take what navigation says now.

        Args:
            report: navigation's newest; of another order it says nothing.
            order: the id of the present one.
            towards: where the robot is wanted in the end, in ``map``. Another order to the same place goes on with the
                time that the one before has spent.
            estimate: where it is.
            now: s.
        """
        if self._progress is None or self._progress.place != towards:
            self._progress = Progress(towards, self._planner)
            self._begin()
        if self._order != order:
            self._order, self._without_plan_s = order, 0.0
        passed_s = 0.0 if self._noted_at is None else max(0.0, now - self._noted_at)
        self._noted_at = now
        state = report.state if report is not None and report.goal_id == order else ""
        self._without_plan_s = self._without_plan_s + passed_s if state == "failed" else 0.0
        self._still_s += passed_s
        if report is not None and state in ("blocked", "failed"):
            self._blocked_s, self._reason = self._blocked_s + passed_s, report.reason
        if estimate is not None and not self._look_at - _LOOK_S <= now < self._look_at:
            self._look_at = now + _LOOK_S
            if self._progress.comes_nearer(estimate.pose):
                self._blocked_s = self._still_s = 0.0
        self.ending = self._judge(state)

    def _begin(self) -> None:
        self._without_plan_s = self._blocked_s = self._still_s = 0.0
        self._look_at, self._noted_at = -math.inf, None

    def _judge(self, state: str) -> Ending | None:
        p = self._params
        if state == "arrived":
            return Ending(Reason.ARRIVED)
        if self._without_plan_s > p.planner_patience_s or self._blocked_s > p.stuck_timeout_s:
            return Ending(Reason.CANNOT_GO_ON, self._reason)
        if self._still_s > p.progress_timeout_s:
            return Ending(Reason.CANNOT_GO_ON, f"no nearer for {p.progress_timeout_s:.0f} s")
        return None
