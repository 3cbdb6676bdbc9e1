"""The driver of P17 Algorithm 1 as a table: check, offer, align, drive with a rider, hand over; and drive alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from hitchhike_ros.datatypes import FloatArray, HitchhikingPoint, Pose2D
from hitchhike_ros.errors import PlanningError
from hitchhike_ros.geometry import between, compose, distance, point_in_polygon
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.overlap import common_stretch
from hitchhike_ros.protocol.machine import (
    Award,
    GoalCancelled,
    GoalGiven,
    Machine,
    Row,
    Tick,
    Timeout,
)
from hitchhike_ros.protocol.messages import (
    Accept,
    Ack,
    Aligned,
    Coupled,
    Covariance,
    Decouple,
    Deny,
    Driver,
    Lock,
    Message,
    NewObstacles,
    Request,
    RequestCancel,
    Terminate,
    covariance_rows,
)
from hitchhike_ros.protocol.parameters import TIME_CRITICAL_PRIORITY, HitchhikingParameters
from hitchhike_ros.protocol.status import GoalCommand, ModuleSwitches, RideStatus, ServoCommand

INVALID_PLACE = "Invalid HH place"
PATH_TOO_SHORT = "Path too short"
PROFILE_MISMATCH = "Profile mismatch"
UNABLE_TO_ALIGN = "Unable to align"
LARGE_COUPLE_TIME = "Large couple_time"
HIGH_PRIORITY = "High priority"  # the paper's driver says nothing (P17) or denies at once (P18 §4): it denies
ALREADY_DRIVING = "Already carrying a hitchhiker"
NO_DRIVER = "Does not drive others"
RIDER_LOST = "Hitchhiker lost"
NO_HANDOVER = "Handover not acknowledged"
CANNOT_GO_ON = "Navigation failed"
ARRIVED = "Goal reached"
GOAL_CHANGED = "Goal cancelled"
ASKED_ANEW = "Hitchhiker asks anew"

# The driver aligns this well, so that the hitchhiker finds the marker in front of it (chosen).
_ALIGN_TOLERANCE_M, _ALIGN_TOLERANCE_RAD = 0.08, 0.06
# A hitchhiker may stand so far ahead of its waiting place (chosen): it sees nothing behind itself and does not go back.
_AHEAD_M = 0.5
# Of a hitchhiker's camera from its base, at most (chosen).
_CAMERA_M = 0.2
# Where exactly a ride ends does not matter, but a driver that turned for the last centimetres would lose its rider.
_RIDE_TOLERANCE_M = 0.25
# Steps of the driver's own pose that count as metres ridden: noise of a standing robot does not.
_ODOMETER_STEP_M = 0.2

Planner = Callable[[Pose2D, Pose2D], FloatArray]


class DriverState(Enum):
    """Where the robot stands as the one who drives, alone or with a rider."""

    IDLE = "idle"
    NAVIGATING = "navigating"
    OFFERING = "offering"
    ALIGNING = "aligning"
    ALIGNED = "aligned"
    DRIVING = "driving"
    WAITING_FOR_RIDER = "waiting_for_rider"
    DECOUPLING = "decoupling"


S = DriverState
WITH_RIDER = (S.DRIVING, S.WAITING_FOR_RIDER, S.DECOUPLING)
ENGAGED = (S.OFFERING, S.ALIGNING, S.ALIGNED, *WITH_RIDER)


@dataclass(frozen=True, eq=False)
class Offer:
    """A ride that was offered: to whom, from which point (aligned as the hitchhiker stands there), how far."""

    hitchhiker: str
    ride_id: str
    point: HitchhikingPoint
    ride_m: float
    decouple_pose: Pose2D


class DriverMachine(Machine[DriverState]):
    """Drives to the robot's own goal and takes a hitchhiker along where that is allowed.

    ``planner`` gives the path (N, 2) in ``map`` between two poses and raises PlanningError where there is none;
    ``marker_pose`` is the marker on the own back in base_footprint.
    """

    ROWS = (
        Row((S.IDLE,), GoalGiven, "_start", (S.NAVIGATING,)),
        Row((S.NAVIGATING,), GoalGiven, "_start", (S.NAVIGATING,)),
        Row(ENGAGED, GoalGiven, "_change_goal", (S.NAVIGATING,)),
        Row((S.IDLE, S.NAVIGATING), GoalCancelled, "_stop", (S.IDLE,)),
        Row(ENGAGED, GoalCancelled, "_stop_ride", (S.IDLE,)),
        Row((S.NAVIGATING,), Tick, "_watch_own_goal", (S.IDLE,)),
        Row((S.NAVIGATING, S.IDLE), Request, "_consider", (S.OFFERING,)),
        Row(ENGAGED, Request, "_asked_again", (S.OFFERING, S.NAVIGATING)),
        Row((S.OFFERING,), Lock, "_align", (S.ALIGNING,)),
        Row((S.ALIGNING, S.ALIGNED), Lock, "_confirm_lock"),
        Row((S.ALIGNING,), Tick, "_watch_alignment", (S.ALIGNED, S.NAVIGATING)),
        Row((S.ALIGNED,), Tick, "_repeat_aligned"),
        Row((S.ALIGNED,), Coupled, "_drive", (S.DRIVING,)),
        Row((S.DRIVING,), Tick, "_watch_ride", (S.WAITING_FOR_RIDER, S.DECOUPLING, S.NAVIGATING)),
        Row((S.DRIVING, S.WAITING_FOR_RIDER), Coupled, "_inform"),
        Row((S.DRIVING,), Ack, "_note_ack"),
        Row((S.WAITING_FOR_RIDER,), Tick, "_wait_for_rider", (S.DRIVING,)),
        Row((S.WAITING_FOR_RIDER,), Ack, "_note_ack"),
        Row((S.DECOUPLING,), Tick, "_repeat_handover"),
        Row((S.DECOUPLING,), Ack, "_handed_over", (S.NAVIGATING,)),
        Row((S.OFFERING, S.ALIGNING, S.ALIGNED), RequestCancel, "_rider_gone", (S.NAVIGATING,)),
        Row(ENGAGED, Terminate, "_rider_gone", (S.NAVIGATING,)),
    )
    TIMEOUTS = (
        Timeout(S.OFFERING, "confirm_timeout_s", "_offer_expired", (S.NAVIGATING,)),
        Timeout(S.ALIGNING, "max_align_s", "_unable_to_align", (S.NAVIGATING,)),
        Timeout(S.ALIGNED, "max_couple_s", "_couple_time", (S.NAVIGATING,)),
        Timeout(S.WAITING_FOR_RIDER, "lost_timeout_s", "_rider_lost", (S.NAVIGATING,)),
        Timeout(S.DECOUPLING, "decouple_timeout_s", "_not_handed_over", (S.NAVIGATING,)),
    )

    def __init__(
        self, robot_id: str, params: HitchhikingParameters, sites: Sites, planner: Planner, marker_pose: Pose2D
    ) -> None:
        super().__init__(S.IDLE, params)
        self.robot_id = robot_id
        self.params = params
        self.own_goal: Pose2D | None = None
        self.offer: Offer | None = None
        self.ridden_m = 0.0
        self.gap_m: float | None = None  # as the rider reports it
        self._sites, self._planner, self._marker_pose = sites, planner, marker_pose
        self._goals, self._own_goal_id = 0, ""
        self._acked_at = 0.0
        self._following = True
        self._odometer_at: Pose2D | None = None
        self._stuck_since = self._planned_at = 0.0

    def step(self, event: object, now: float) -> list:
        """As Machine.step; while engaged only the hitchhiker of the current ride is heard."""
        if isinstance(event, Message) and not self._concerns(event):
            self.ignored += 1
            return []
        return super().step(event, now)

    @property
    def goal(self) -> GoalCommand | None:
        """Where navigation has to go now; None is standing still."""
        if self.state is S.NAVIGATING and self.own_goal is not None:
            g = self.own_goal
            return GoalCommand(self._own_goal_id, g.x, g.y, g.theta)
        if self.offer is not None and self.state is S.ALIGNING:
            p = self.offer.point.aligning_pose
            return GoalCommand(self._align_id, p.x, p.y, p.theta, _ALIGN_TOLERANCE_M, _ALIGN_TOLERANCE_RAD)
        if self.offer is not None and self.state is S.DRIVING:
            p = self.offer.decouple_pose
            return GoalCommand(self._ride_goal_id, p.x, p.y, p.theta, _RIDE_TOLERANCE_M, math.pi)
        return None

    @property
    def modules(self) -> ModuleSwitches:
        return ModuleSwitches(VS=self.servo is not None)

    @property
    def servo(self) -> ServoCommand | None:
        """While it aligns, the driver looks for the marker of the hitchhiking point."""
        if self.state is not S.ALIGNING or self.offer is None or self.offer.point.marker is None:
            return None
        marker = self._sites.marker(self.offer.point.marker)
        return None if marker is None else ServoCommand("observe", marker.id, marker.size_m)

    @property
    def speed_limit_mps(self) -> float:
        return self.params.ride_speed_mps if self.state in WITH_RIDER else self.params.cruise_speed_mps

    @property
    def ride(self) -> RideStatus | None:
        if self.offer is None:
            return None
        return RideStatus(self.offer.ride_id, self.robot_id, self.offer.hitchhiker, self.offer.ride_m, self.ridden_m)

    # Actions of the table, in its order.

    def _start(self, event: GoalGiven) -> None:
        self.own_goal = event.goal
        self._go_to_own_goal()

    def _change_goal(self, event: GoalGiven) -> None:
        self._end_ride(GOAL_CHANGED, tell=True)
        self._start(event)

    def _stop(self, _event: GoalCancelled) -> None:
        self.own_goal = None
        self._go(S.IDLE, GOAL_CHANGED)

    def _stop_ride(self, _event: GoalCancelled) -> None:
        self._tell(GOAL_CHANGED)
        self._credit()
        self.offer, self.own_goal = None, None
        self._go(S.IDLE, GOAL_CHANGED)

    def _watch_own_goal(self, _tick: Tick) -> None:
        if (outcome := self._navigation_outcome()) is not None:
            self.own_goal = None
            self._report(outcome)
            self._go(S.IDLE, outcome)

    def _consider(self, request: Request) -> None:
        """P17 Algorithm 1, lines 5 to 12, and P18 Algorithm 2."""
        offer = self._check(request)
        if isinstance(offer, str):
            self._deny(request, offer)
            return
        self.offer, self.ridden_m, self.gap_m = offer, 0.0, None
        # The same request may be offered a ride again after the first offer has expired.
        self._last_words = [(due, word) for due, word in self._last_words if word.ride_id != offer.ride_id]
        self._report(f"Offering {offer.hitchhiker} a ride of {offer.ride_m:.1f} m")
        self._go(S.OFFERING)
        self._accept(offer)

    def _accept(self, offer: Offer) -> None:
        estimate = self.situation.estimate
        pose = estimate.pose if estimate is not None else offer.point.aligning_pose
        self._send(
            Accept(
                **self._to_rider(),
                x=pose.x,
                y=pose.y,
                theta=pose.theta,
                profile=self.params.profile,
                ride_m=offer.ride_m,
                decouple_point=(offer.decouple_pose.x, offer.decouple_pose.y),
                marker_id=self.params.marker_id,
                marker_size_m=self.params.marker_size_m,
                marker_pose=self._marker_pose,
            )
        )

    def _asked_again(self, request: Request) -> None:
        """A request while engaged: the acceptance was lost, the hitchhiker has begun anew, or it is another one."""
        assert self.offer is not None
        if request.robot_id != self.offer.hitchhiker:
            self._deny(request, ALREADY_DRIVING)
        elif request.ride_id != self.offer.ride_id:
            self._end_ride(ASKED_ANEW, tell=False)
            self._consider(request)
        elif self.state is S.OFFERING:
            self._accept(self.offer)

    def _align(self, lock: Lock) -> None:
        self._go(S.ALIGNING)
        self._confirm_lock(lock)

    def _confirm_lock(self, lock: Lock) -> None:
        self._send(Ack(**self._to_rider(), of=lock.type, acknowledges=lock.seq))

    def _watch_alignment(self, _tick: Tick) -> None:
        outcome = self._navigation_outcome()
        if outcome == ARRIVED:
            self._go(S.ALIGNED)
            self._repeat_aligned()
        elif outcome is not None:
            self._end_ride(UNABLE_TO_ALIGN, tell=True)

    def _repeat_aligned(self, _tick: Tick | None = None) -> None:
        estimate = self.situation.estimate
        if self.offer is None or estimate is None or not self._every(self.params.repeat_period_s, "aligned"):
            return
        pose, end = estimate.pose, self.offer.decouple_pose
        self._send(Aligned(**self._to_rider(), x=pose.x, y=pose.y, theta=pose.theta, decouple_point=(end.x, end.y)))

    def _drive(self, coupled: Coupled) -> None:
        self.gap_m = coupled.gap_m
        self._acked_at, self._following, self._odometer_at = self._now, True, None
        self._go(S.DRIVING)
        self._inform()

    def _watch_ride(self, _tick: Tick) -> None:
        self._count_metres()
        outcome = self._navigation_outcome()
        if outcome == ARRIVED:
            self._count_metres(last=True)
            self._go(S.DECOUPLING)
            self._repeat_handover()
            return
        if outcome is not None:
            self._end_ride(outcome, tell=True)
            return
        if self._every(self.params.update_period_s, "driver"):
            self._inform()
        if not self._following or self._now - self._acked_at > self.params.ack_timeout_s:
            self._go(S.WAITING_FOR_RIDER, "No acknowledgement" if self._following else "Hitchhiker does not follow")

    def _inform(self, _coupled: Coupled | None = None) -> None:
        """The message of every δ seconds; it also answers a *Coupling successful* that is repeated."""
        estimate = self.situation.estimate
        if estimate is None:
            return
        self._every(self.params.update_period_s, "driver")
        speed = self.situation.speed_mps
        self._send(Driver(**self._to_rider(), **self._state_fields(), v=speed if math.isfinite(speed) else 0.0))

    def _note_ack(self, ack: Ack) -> None:
        if ack.of == Driver.type:
            self._acked_at, self._following, self.gap_m = self._now, ack.following, ack.gap_m

    def _wait_for_rider(self, _tick: Tick) -> None:
        self._count_metres()
        if self._every(self.params.update_period_s, "driver"):
            self._inform()
        if self._following and self._acked_at > self._entered:
            self._go(S.DRIVING)

    def _repeat_handover(self, _tick: Tick | None = None) -> None:
        standing = abs(self.situation.speed_mps) <= self.params.standstill_mps
        if standing and self.situation.estimate is not None and self._every(self.params.repeat_period_s, "decouple"):
            self._send(Decouple(**self._to_rider(), **self._state_fields()))

    def _handed_over(self, ack: Ack) -> None:
        if ack.of == Decouple.type:
            self._end_ride("Ride completed", tell=False)

    def _rider_gone(self, message: RequestCancel | Terminate) -> None:
        self._end_ride(getattr(message, "reason", "Request cancelled"), tell=False)

    # Timeouts.

    def _offer_expired(self) -> None:
        self._end_ride("Offer not taken", tell=True)

    def _unable_to_align(self) -> None:
        self._end_ride(UNABLE_TO_ALIGN, tell=True)

    def _couple_time(self) -> None:
        self._end_ride(LARGE_COUPLE_TIME, tell=True)

    def _rider_lost(self) -> None:
        self._end_ride(RIDER_LOST, tell=True)

    def _not_handed_over(self) -> None:
        self._end_ride(NO_HANDOVER, tell=True)

    # What several actions do.

    def _concerns(self, message: Message) -> bool:
        if isinstance(message, Request):
            return True
        return (
            self.offer is not None
            and message.robot_id == self.offer.hitchhiker
            and message.ride_id == self.offer.ride_id
        )

    @property
    def _align_id(self) -> str:
        return f"{self.offer.ride_id}-align" if self.offer else ""

    @property
    def _ride_goal_id(self) -> str:
        return f"{self.offer.ride_id}-ride" if self.offer else ""

    def _to_rider(self) -> dict[str, Any]:
        assert self.offer is not None
        return {"robot_id": self.robot_id, "to": self.offer.hitchhiker, "ride_id": self.offer.ride_id}

    def _check(self, request: Request) -> Offer | str:
        """The offer, or the reason of the denial, in the order of P17 Algorithm 1."""
        estimate = self.situation.estimate
        if not self.params.may_drive:
            return NO_DRIVER
        if max(self.params.priority, request.priority) >= TIME_CRITICAL_PRIORITY:
            return HIGH_PRIORITY
        point = None if estimate is None else self._point_around(estimate.pose, request.pose)
        if point is None:
            return INVALID_PLACE
        if self.own_goal is None:
            return PATH_TOO_SHORT
        try:
            apart_m = self.params.gap_m - self._marker_pose.x + _CAMERA_M
            point = _aligned_with(request.pose, point, apart_m)
            own_path = self._planner(point.aligning_pose, self.own_goal)
            shared = common_stretch(
                own_path, self._planner(request.pose, request.goal), self.params.overlap_tolerance_m
            )
        except PlanningError:
            return PATH_TOO_SHORT
        if shared.farthest is None or shared.length_m < self.params.min_ride_m:
            return PATH_TOO_SHORT
        if request.profile > self.params.profile:
            return PROFILE_MISMATCH
        return Offer(request.robot_id, request.ride_id, point, shared.length_m, shared.farthest)

    def _point_around(self, own: Pose2D, other: Pose2D) -> HitchhikingPoint | None:
        """The hitchhiking point in whose area both robots are, the nearest to the driver first."""
        for point in sorted(self._sites.hitchhiking_points, key=lambda p: distance(own, p.aligning_pose)):
            if all(point_in_polygon(pose.x, pose.y, point.area) for pose in (own, other)):
                return point
        return None

    def _deny(self, request: Request, reason: str) -> None:
        self._send(Deny(robot_id=self.robot_id, to=request.robot_id, ride_id=request.ride_id, reason=reason))

    def _tell(self, reason: str) -> None:
        end = Terminate(**self._to_rider(), reason=reason)
        self._send_last_word(end, self.params.repeat_period_s, self.params.confirm_timeout_s)

    def _navigation_outcome(self) -> str | None:
        """ARRIVED, or why the current goal is given up; None while navigation is at it."""
        goal, report = self.goal, self.situation.navigation
        current = goal is not None and report is not None and report.goal_id == goal.id
        state = report.state if report is not None and current else ""
        if state != "failed":
            self._planned_at = self._now
        if state not in ("blocked", "failed"):
            self._stuck_since = self._now
            return ARRIVED if state == "arrived" else None
        # A new order is not stuck because the one before was.
        without_plan = self._now - max(self._planned_at, self._entered)
        stuck = self._now - max(self._stuck_since, self._entered)
        if without_plan <= self.params.planner_patience_s and stuck <= self.params.stuck_timeout_s:
            return None
        return f"{CANNOT_GO_ON}: {report.reason if report is not None else ''}"

    def _state_fields(self) -> dict[str, Any]:
        estimate = self.situation.estimate
        assert estimate is not None
        sigma: Covariance = covariance_rows(estimate.covariance)
        return {
            "x": estimate.pose.x,
            "y": estimate.pose.y,
            "theta": estimate.pose.theta,
            "sigma": sigma,
            "new_obstacles": NewObstacles(obstacles=self.situation.obstacles),
            "ridden_m": self.ridden_m,
        }

    def _count_metres(self, last: bool = False) -> None:
        estimate = self.situation.estimate
        if estimate is None:
            return
        if self._odometer_at is None:
            self._odometer_at = estimate.pose
        step = distance(self._odometer_at, estimate.pose)
        if last or step >= _ODOMETER_STEP_M:
            self.ridden_m += step
            self._odometer_at = estimate.pose

    def _credit(self) -> None:
        """κ · metres ridden, once a ride (P17 §5)."""
        if self.offer is not None and self.ridden_m > 0.0:
            points = self.params.award_rate * self.ridden_m
            self._effects.append(Award(self.offer.ride_id, self.offer.hitchhiker, self.ridden_m, points))

    def _end_ride(self, reason: str, tell: bool) -> None:
        """The ride is over, whatever the cause; the driver goes on to its own goal."""
        if tell:
            self._tell(reason)
        self._credit()
        self._report(reason)
        self.offer = None
        self._go_to_own_goal(reason)

    def _go_to_own_goal(self, reason: str = "") -> None:
        """A new order, with an id that no earlier order had, not even one of before a restart."""
        self._goals += 1
        self._own_goal_id = f"{self.robot_id}-{self._goals}-{self._now:.1f}"
        self._go(S.NAVIGATING, reason)


def _aligned_with(hitchhiker: Pose2D, point: HitchhikingPoint, apart_m: float) -> HitchhikingPoint:
    """The point, aligned at farther on where a hitchhiker ahead of its place would stand nearer than ``apart_m``."""
    ahead_m = between(point.waiting_pose, hitchhiker).x
    missing_m = apart_m - between(point.waiting_pose, point.aligning_pose).x + ahead_m
    farther_m = min(max(min(ahead_m, missing_m), 0.0), _AHEAD_M)
    return replace(point, aligning_pose=compose(point.aligning_pose, Pose2D(farther_m)))
