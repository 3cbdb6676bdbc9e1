"""The driver of P17 Algorithm 1 as a table: check, offer, align, drive with riders, hand over; and drive alone.

In a network (P18 §4) it answers requests from afar. Such an answer binds nobody until the hitchhiker locks it; then the
driver goes to where they meet, faster than usual where the hitchhiker would wait otherwise, and waits there for a while
itself. With several places it takes whoever asks before it has left (convoy).
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from hitchhike_ros.core.datatypes import HitchhikingPoint, Pose2D
from hitchhike_ros.core.errors import ItineraryInputError, PlanningError
from hitchhike_ros.core.geometry import between, compose, distance, point_in_polygon
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.overlap import common_stretch
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.driver.convoy import Convoy, Offer, Rider
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import Award, GoalCancelled, GoalGiven, Tick
from hitchhike_ros.protocol.loose_machine import Machine, Row, Timeout
from hitchhike_ros.protocol.matching import Boardings, Planner, stretch
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
    RearMarker,
    Request,
    RequestCancel,
    Terminate,
    Waypoint,
    covariance_rows,
)
from hitchhike_ros.protocol.parameters import TIME_CRITICAL_PRIORITY, HitchhikingParameters
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.protocol.status import ANY_MARKER, GoalCommand, ModuleSwitches, RideStatus, ServoCommand

# The driver aligns this well, so that the hitchhiker finds the marker in front of it (chosen).
_ALIGN_TOLERANCE_M, _ALIGN_TOLERANCE_RAD = 0.08, 0.06
# A hitchhiker may stand so far ahead of its waiting place (chosen): it sees nothing behind itself and does not go back.
_AHEAD_M = 0.5
# Of a hitchhiker's camera from its base, at most (chosen).
_CAMERA_M = 0.2
# Where exactly a ride ends does not matter, but a driver that turned for the last centimetres would lose its rider.
_RIDE_TOLERANCE_M = 0.25
# A rider that follows has caught up when it is no farther behind than this beyond the gap (chosen).
_CAUGHT_UP_M = 0.3
# Steps of the driver's own pose that count as metres ridden: noise of a standing robot does not.
_ODOMETER_STEP_M = 0.2

# Riders who leave within this of each other leave together (chosen).
_LEAVE_TOGETHER_M = 1.0
# Answers to so many questions are remembered (chosen).
_REMEMBERED = 30
# A robot that joins boards within this of where the first rider does (chosen).
_JOIN_M = 0.5
_NOWHERE = HitchhikingPoint("", (), Pose2D(), Pose2D())  # before a hitchhiker has said where


S = DriverState
WITH_RIDER = (S.DRIVING, S.WAITING_FOR_RIDER, S.DECOUPLING)
ENGAGED = (S.OFFERING, S.ALIGNING, S.ALIGNED, *WITH_RIDER)


class DriverMachine(Machine[DriverState]):
    """Drives to the robot's own goal and takes a hitchhiker along where that is allowed.

    ``planner`` gives the path (N, 2) in ``map`` between two poses and raises PlanningError where there is none;
    ``marker_pose`` is the own rear marker in base_footprint.
    """

    ROWS = (
        Row((S.IDLE,), GoalGiven, "_start", (S.NAVIGATING,)),
        Row((S.NAVIGATING,), GoalGiven, "_start", (S.NAVIGATING,)),
        Row(ENGAGED, GoalGiven, "_change_goal", (S.NAVIGATING,)),
        Row((S.IDLE, S.NAVIGATING), GoalCancelled, "_stop", (S.IDLE,)),
        Row(ENGAGED, GoalCancelled, "_stop_ride", (S.IDLE,)),
        Row((S.NAVIGATING,), Tick, "_watch_own_goal", (S.IDLE,)),
        Row((S.NAVIGATING, S.IDLE), Request, "_consider", (S.OFFERING,)),
        Row((S.OFFERING, S.ALIGNING), Request, "_asked_again", (S.OFFERING, S.NAVIGATING)),
        Row((S.ALIGNED,), Request, "_asked_again", (S.OFFERING, S.NAVIGATING, S.DRIVING)),
        Row((S.DRIVING, S.WAITING_FOR_RIDER), Request, "_asked_again", (S.OFFERING, S.NAVIGATING)),
        Row((S.DECOUPLING,), Request, "_asked_again", (S.OFFERING, S.NAVIGATING, S.WAITING_FOR_RIDER)),
        Row((S.NAVIGATING,), Lock, "_take_lock", (S.ALIGNING,)),
        Row((S.OFFERING,), Tick, "_repeat_accept"),
        Row((S.OFFERING,), Lock, "_align", (S.ALIGNING,)),
        Row((S.ALIGNING, S.ALIGNED), Lock, "_confirm_lock"),
        Row((S.IDLE, *WITH_RIDER), Lock, "_refuse_lock"),
        Row((S.ALIGNING,), Tick, "_watch_alignment", (S.ALIGNED, S.NAVIGATING)),
        Row((S.ALIGNED,), Tick, "_repeat_aligned", (S.NAVIGATING, S.DRIVING)),
        Row((S.ALIGNED,), Coupled, "_note_coupled", (S.ALIGNED, S.DRIVING)),
        Row((S.ALIGNED,), Ack, "_note_ack"),
        Row((S.DRIVING,), Tick, "_watch_ride", (S.WAITING_FOR_RIDER, S.DECOUPLING, S.NAVIGATING)),
        Row((S.DRIVING, S.WAITING_FOR_RIDER, S.DECOUPLING), Coupled, "_inform"),
        Row((S.DRIVING,), Ack, "_note_ack"),
        Row((S.WAITING_FOR_RIDER,), Tick, "_wait_for_riders", (S.DRIVING,)),
        Row((S.WAITING_FOR_RIDER,), Ack, "_note_ack"),
        Row((S.DECOUPLING,), Tick, "_repeat_handover"),
        Row((S.DECOUPLING,), Ack, "_handed_over", (S.NAVIGATING, S.WAITING_FOR_RIDER)),
        Row((S.OFFERING, S.ALIGNING), RequestCancel, "_rider_gone", (S.NAVIGATING,)),
        Row((S.ALIGNED,), RequestCancel, "_rider_gone", (S.NAVIGATING, S.DRIVING)),
        Row((S.OFFERING, S.ALIGNING, S.DRIVING, S.WAITING_FOR_RIDER), Terminate, "_rider_gone", (S.NAVIGATING,)),
        Row((S.ALIGNED,), Terminate, "_rider_gone", (S.NAVIGATING, S.DRIVING)),
        Row((S.DECOUPLING,), Terminate, "_rider_gone", (S.NAVIGATING, S.WAITING_FOR_RIDER)),
    )
    TIMEOUTS = (
        Timeout(S.OFFERING, "confirm_timeout_s", "_offer_expired", (S.NAVIGATING,)),
        Timeout(S.ALIGNING, "max_align_s", "_unable_to_align", (S.NAVIGATING,)),
        Timeout(S.ALIGNED, "max_couple_s", "_couple_time", (S.NAVIGATING, S.ALIGNED, S.DRIVING)),
        Timeout(S.WAITING_FOR_RIDER, "lost_timeout_s", "_rider_lost", (S.NAVIGATING, S.WAITING_FOR_RIDER)),
        Timeout(S.DECOUPLING, "decouple_timeout_s", "_not_handed_over", (S.NAVIGATING, S.WAITING_FOR_RIDER)),
    )

    def __init__(
        self, robot_id: str, params: HitchhikingParameters, sites: Sites, planner: Planner, marker_pose: Pose2D
    ) -> None:
        super().__init__(S.IDLE, params)
        self.robot_id = robot_id
        self.params = params
        self.own_goal: Pose2D | None = None
        self.refused = 0  # locks of offers that were not made, or no longer hold
        self._sites, self._planner, self._marker_pose = sites, planner, marker_pose
        self._rear_marker = RearMarker(
            marker_id=params.marker_id, marker_size_m=params.marker_size_m, marker_pose=marker_pose
        )
        self._convoy = Convoy(self._rear_marker)
        self._offered: dict[tuple[str, str], tuple[float, Offer]] = {}  # to whom, and until when it holds
        self._asked: dict[tuple[str, str], bool] = {}  # whether it could serve who asked
        self._path: OwnPath | None = None
        self._boardings: tuple[OwnPath, Boardings] | None = None  # along that path
        self._board_m = 0.0  # along that path, where it aligns
        self._way_s = 0.0  # to there, at most
        self._goals, self._own_goal_id = 0, ""
        self._odometer_at: Pose2D | None = None
        self._stuck_since = self._planned_at = 0.0

    def step(self, event: object, now: float) -> list:
        """As Machine.step; while engaged only hitchhikers of the current rides are heard."""
        if isinstance(event, Message) and not self._concerns(event):
            self.ignored += 1
            return []
        return super().step(event, now)

    @property
    def offer(self) -> Offer | None:
        """The ride of the first hitchhiker."""
        return self._convoy.first.offer if self._convoy.first is not None else None

    @property
    def riders(self) -> tuple[str, ...]:
        """Who rides or is about to, in the order of their places."""
        return tuple(rider.offer.hitchhiker for rider in self._convoy)

    @property
    def gap_m(self) -> float | None:
        """As the first rider reports it."""
        return self._convoy.first.gap_m if self._convoy.first is not None else None

    @property
    def goal(self) -> GoalCommand | None:
        """Where navigation has to go now; None is standing still."""
        if self.state is S.NAVIGATING and self.own_goal is not None:
            g = self.own_goal
            return GoalCommand(self._own_goal_id, g.x, g.y, g.theta)
        if self.offer is not None and self.state is S.ALIGNING:
            p = self.offer.point.aligning_pose
            order = f"{self.offer.ride_id}-align"
            return GoalCommand(order, p.x, p.y, p.theta, _ALIGN_TOLERANCE_M, _ALIGN_TOLERANCE_RAD)
        leaves = self._convoy.next_to_leave
        if leaves is not None and self.state is S.DRIVING:
            p = leaves.offer.decouple_pose
            return GoalCommand(f"{leaves.offer.ride_id}-ride", p.x, p.y, p.theta, _RIDE_TOLERANCE_M, math.pi)
        return None

    @property
    def modules(self) -> ModuleSwitches:
        return ModuleSwitches(VS=self.servo is not None)

    @property
    def servo(self) -> ServoCommand | None:
        """While it aligns, the driver looks for the marker of the hitchhiking point; by itself for any, if it is to."""
        if self.state is S.NAVIGATING and self.params.watch_markers:
            return ServoCommand("observe", ANY_MARKER)
        if self.state is not S.ALIGNING or self.offer is None or self.offer.point.marker is None:
            return None
        marker = self._sites.marker(self.offer.point.marker)
        return None if marker is None else ServoCommand("observe", marker.id, marker.size_m)

    @property
    def speed_limit_mps(self) -> float:
        """On the way to a hitchhiker who would wait, up to the safe limit (velocity tuning, P18 §4)."""
        if self.state in WITH_RIDER:
            return self.params.ride_speed_mps
        cruise, rider = self.params.cruise_speed_mps, self._convoy.first
        if self.state is not S.ALIGNING or rider is None or self.params.mode == "local":
            return cruise
        needed = self._to_board_m() / max(rider.due - self._now, 1e-3)
        return min(max(cruise, needed), max(cruise, self.params.safe_speed_mps))

    @property
    def ride(self) -> RideStatus | None:
        rider = self._convoy.first
        if rider is None:
            return None
        offer = rider.offer
        return RideStatus(offer.ride_id, self.robot_id, offer.hitchhiker, offer.ride_m, rider.ridden_m)

    @property
    def free_places(self) -> int:
        """For hitchhikers who might ask now."""
        if not self.params.may_drive or self.params.priority >= TIME_CRITICAL_PRIORITY:
            return 0
        if self.state is S.NAVIGATING:
            return self.params.places
        riders = tuple(self._convoy)
        open_to_more = self.state in (S.ALIGNING, S.ALIGNED) and riders[-1].rear_marker
        return self.params.places - len(riders) if open_to_more else 0

    def announced(self) -> tuple[Waypoint, ...]:
        """The way on which it would take a hitchhiker along, and when: from here, or from where it aligns."""
        if not self.free_places or self.own_goal is None or self._own_path() is None:
            return ()
        assert self._path is not None
        if self.state is S.NAVIGATING:
            return self._path.waypoints(self.params.cruise_speed_mps)
        assert self.offer is not None
        ends = [(pose.x, pose.y) for pose in (self.offer.point.waiting_pose, self.offer.point.aligning_pose)]
        onward = OwnPath(np.vstack([ends, self._path.line.ahead(self._board_m).points[1:]]))
        return onward.waypoints(self.params.ride_speed_mps, self._to_board_m() / self.speed_limit_mps)

    # Actions of the table, in its order.

    def _start(self, event: GoalGiven) -> None:
        self.own_goal = event.goal
        self._go_to_own_goal(event.why)

    def _change_goal(self, event: GoalGiven) -> None:
        self._end_rides(Reason.GOAL_CANCELLED)
        self._start(event)

    def _stop(self, _event: GoalCancelled) -> None:
        self.own_goal = self._path = None
        self._go(S.IDLE, Reason.GOAL_CANCELLED)

    def _stop_ride(self, event: GoalCancelled) -> None:
        self._end_rides(Reason.GOAL_CANCELLED)
        self._stop(event)

    def _watch_own_goal(self, _tick: Tick) -> None:
        if (outcome := self._navigation_outcome()) is not None:
            self.own_goal = self._path = None
            self._report(outcome)
            self._go(S.IDLE, outcome)

    def _consider(self, request: Request) -> None:
        """P17 Algorithm 1, lines 5 to 12, and P18 Algorithm 2."""
        if self.params.mode == "network":
            self._answer_from_afar(request)
            return
        offer = self._check(request)
        if isinstance(offer, Reason):
            self._deny(request, offer)
            return
        self._convoy.add(Rider(offer, request.rear_marker))
        # The same request may be offered a ride again after the first offer has expired.
        self._last_words = [(due, word) for due, word in self._last_words if word.ride_id != offer.ride_id]
        self._report(f"Offering {offer.hitchhiker} a ride of {offer.ride_m:.1f} m")
        self._go(S.OFFERING)
        self._repeat_accept()

    def _asked_again(self, request: Request) -> None:
        """A request while engaged: the acceptance was lost, the hitchhiker has begun anew, or it is another one."""
        rider = self._convoy.of(request.robot_id)
        if rider is None:
            self._ask_to_join(request)
        elif request.in_s > 0.0:
            self._deny(request, Reason.ALREADY_DRIVING)  # of another driver, it means, for when this ride is over
        elif request.ride_id != rider.offer.ride_id:
            self._drop(rider, Reason.ASKED_ANEW, tell=False)
            answer = self._consider if self.state is S.NAVIGATING else self._ask_to_join
            answer(request)
        elif self.state is S.OFFERING:
            self._accept(rider.offer)

    def _repeat_accept(self, _tick: Tick | None = None) -> None:
        rider = self._convoy.first
        if rider is not None and self._every(self.params.repeat_period_s, "accept"):
            self._accept(rider.offer)

    def _take_lock(self, lock: Lock) -> None:
        """A hitchhiker that was offered a ride from afar says where they meet (P18 §4)."""
        offer = self._offer_of(lock)
        if isinstance(offer, Reason):
            self._refuse_lock(lock, offer)
            return
        self._join(lock, offer)
        self._go(S.ALIGNING)
        self._confirm_lock(lock)

    def _align(self, lock: Lock) -> None:
        if self._convoy.find(lock) is None:
            self._refuse_lock(lock)
            return
        self._go(S.ALIGNING)
        self._confirm_lock(lock)

    def _confirm_lock(self, lock: Lock) -> None:
        """Also of one that joins, and of one that says anew when it will be there."""
        rider = self._convoy.find(lock)
        if rider is None:
            offer = self._offer_to_join(lock)
            if isinstance(offer, Reason):
                self._refuse_lock(lock, offer)
                return
            rider = self._join(lock, offer)
        rider.due, rider.heard_at = self._now + lock.in_s, self._now
        place = self._convoy.place(rider)
        in_s = self._to_board_m() / self.speed_limit_mps if self.params.mode == "network" else 0.0
        self._send(Ack(**self._to(rider), of=lock.type, acknowledges=lock.seq, place=place, in_s=in_s))

    def _refuse_lock(self, lock: Lock, reason: Reason = Reason.NOT_OFFERED) -> None:
        if self._convoy.find(lock) is None:
            self.refused += 1
            self._deny(lock, Reason.ALREADY_DRIVING if self.state in WITH_RIDER else reason)

    def _watch_alignment(self, _tick: Tick) -> None:
        outcome = self._navigation_outcome()
        if outcome is not None and outcome.reason is Reason.ARRIVED:
            self._go(S.ALIGNED)
            self._repeat_aligned()
        elif outcome is not None:
            self._unable_to_align()
        else:
            self._drop_silent()

    def _repeat_aligned(self, _tick: Tick | None = None) -> None:
        self._drop_silent()
        if self.state is not S.ALIGNED:
            return
        self._inform_all()
        rider, estimate = self._convoy.next_to_couple, self.situation.estimate
        if rider is None or estimate is None or not self._every(self.params.repeat_period_s, "aligned"):
            return
        pose, end = estimate.pose, rider.offer.decouple_pose
        self._send(
            Aligned(
                **self._to(rider),
                x=pose.x,
                y=pose.y,
                theta=pose.theta,
                decouple_point=(end.x, end.y),
                place=self._convoy.place(rider),
                ahead=self._convoy.ahead_of(rider),
            )
        )

    def _note_coupled(self, coupled: Coupled) -> None:
        rider = self._convoy.find(coupled)
        assert rider is not None
        if not rider.coupled:
            rider.coupled, rider.gap_m, rider.acked_at, rider.following = True, coupled.gap_m, self._now, True
            self._odometer_at = None
            self._go(S.ALIGNED if self._convoy.next_to_couple is not None else S.DRIVING)
        self._inform_one(rider)

    def _watch_ride(self, _tick: Tick) -> None:
        self._count_metres()
        outcome = self._navigation_outcome()
        if outcome is not None and outcome.reason is Reason.ARRIVED:
            self._count_metres(last=True)
            leaves = self._convoy.next_to_leave
            for rider in self._convoy.coupled:
                rider.leaving = leaves is not None and rider.left_m <= leaves.left_m + _LEAVE_TOGETHER_M
            self._go(S.DECOUPLING)
            self._repeat_handover()
            return
        if outcome is not None:
            self._end_rides(outcome)
            self._go_to_own_goal(outcome)
            return
        self._inform_all()
        if self._missing(self._now - self.params.ack_timeout_s):
            said = all(rider.following for rider in self._convoy.coupled)
            self._go(S.WAITING_FOR_RIDER, Reason.NO_ACKNOWLEDGEMENT if said else Reason.NOT_FOLLOWING)

    def _inform(self, coupled: Coupled) -> None:
        """The message of every δ seconds also answers a *Coupling successful* that is repeated."""
        rider = self._convoy.find(coupled)
        if rider is not None:
            self._inform_one(rider)

    def _note_ack(self, ack: Ack) -> None:
        rider = self._convoy.find(ack)
        if rider is not None and ack.of == Driver.type:
            rider.hear(ack, self._now)

    def _wait_for_riders(self, _tick: Tick) -> None:
        self._count_metres()
        self._inform_all()
        if not self._behind():
            self._go(S.DRIVING)

    def _repeat_handover(self, _tick: Tick | None = None) -> None:
        leaving = self._leaving()
        self._inform_all(but=leaving)
        standing = abs(self.situation.speed_mps) <= self.params.standstill_mps
        if standing and self.situation.estimate is not None and self._every(self.params.repeat_period_s, "decouple"):
            for rider in leaving:
                self._send(Decouple(**self._to(rider), **self._state_fields(rider)))

    def _handed_over(self, ack: Ack) -> None:
        rider = self._convoy.find(ack)
        if rider is None:
            return
        if ack.of == Driver.type:
            rider.hear(ack, self._now)
        elif ack.of == Decouple.type and rider in self._leaving():
            last = len(self._leaving()) == 1
            self._finish(rider, Reason.RIDE_COMPLETED, tell=False)
            if last:
                self._close_up(Reason.RIDE_COMPLETED)

    def _rider_gone(self, message: RequestCancel | Terminate) -> None:
        rider = self._convoy.find(message)
        if rider is not None:
            why = Ending.told(message.reason) if isinstance(message, Terminate) else Reason.REQUEST_CANCELLED
            self._drop(rider, why, tell=False)

    # Timeouts.

    def _limit_s(self, name: str) -> float:
        """Who meets from afar has a way to go first, and waits for whoever comes later."""
        rider = self._convoy.first
        if self.params.mode == "local" or rider is None:
            return super()._limit_s(name)
        if name == "max_align_s":
            return self._way_s + self.params.max_align_s
        if name == "max_couple_s":
            rider = self._convoy.next_to_couple or rider
            return max(0.0, rider.due - self._entered) + self.params.patience_s + self.params.max_couple_s
        return super()._limit_s(name)

    def _offer_expired(self) -> None:
        self._end_rides(Reason.OFFER_NOT_TAKEN)
        self._go_to_own_goal(Reason.OFFER_NOT_TAKEN)

    def _unable_to_align(self) -> None:
        self._end_rides(Reason.UNABLE_TO_ALIGN)
        self._go_to_own_goal(Reason.UNABLE_TO_ALIGN)

    def _couple_time(self) -> None:
        rider = self._convoy.next_to_couple
        assert rider is not None
        self._drop(rider, Reason.LARGE_COUPLE_TIME, tell=True)
        if self.state is S.ALIGNED:
            self._go(S.ALIGNED)

    def _rider_lost(self) -> None:
        for rider in self._behind():
            self._finish(rider, Reason.RIDER_LOST, tell=True)
        self._close_up(Reason.RIDER_LOST)

    def _not_handed_over(self) -> None:
        for rider in self._leaving():
            self._finish(rider, Reason.NO_HANDOVER, tell=True)
        self._close_up(Reason.NO_HANDOVER)

    # What several actions do.

    def _concerns(self, message: Message) -> bool:
        return isinstance(message, Request | Lock) or self._convoy.find(message) is not None

    def _to(self, rider: Rider) -> dict[str, Any]:
        return {"robot_id": self.robot_id, "to": rider.offer.hitchhiker, "ride_id": rider.offer.ride_id}

    # Offers.

    def _check(self, request: Request) -> Offer | Reason:
        """The offer, or the reason of the denial, in the order of P17 Algorithm 1."""
        estimate = self.situation.estimate
        if (refusal := self._unwilling(request)) is not None:
            return refusal
        point = None if estimate is None else self._point_around(estimate.pose, request.pose)
        if point is None:
            return Reason.INVALID_PLACE
        if self.own_goal is None:
            return Reason.PATH_TOO_SHORT
        try:
            apart_m = self.params.gap_m - self._marker_pose.x + _CAMERA_M
            point = _aligned_with(request.pose, point, apart_m)
            own_path = self._planner(point.aligning_pose, self.own_goal)
            shared = common_stretch(
                own_path, self._planner(request.pose, request.goal), self.params.overlap_tolerance_m
            )
        except PlanningError:
            return Reason.PATH_TOO_SHORT
        if shared.farthest is None or shared.length_m < self.params.min_ride_m:
            return Reason.PATH_TOO_SHORT
        if request.profile > self.params.profile:
            return Reason.PROFILE_MISMATCH
        return Offer(request.robot_id, request.ride_id, point, shared.length_m, shared.farthest)

    def _unwilling(self, request: Request) -> Reason | None:
        if not self.params.may_drive:
            return Reason.NO_DRIVER
        if max(self.params.priority, request.priority) >= TIME_CRITICAL_PRIORITY:
            return Reason.HIGH_PRIORITY
        return None

    def _answer_from_afar(self, request: Request) -> None:
        """Every able driver accepts, with its way and its times; it denies at once with the reason (P18 Alg. 2)."""
        reason = self._unwilling(request)
        if reason is None and not self.free_places:
            reason = Reason.PATH_TOO_SHORT if self.state in (S.IDLE, S.NAVIGATING) else Reason.ALREADY_DRIVING
        if reason is None and not self._on_the_way(request):
            reason = Reason.PATH_TOO_SHORT
        if reason is None and request.profile > self.params.profile:
            reason = Reason.PROFILE_MISMATCH
        waypoints = self.announced() if reason is None else ()
        if reason is None and not waypoints:
            reason = Reason.PATH_TOO_SHORT
        if reason is not None:
            self._deny(request, reason)
            return
        length = math.fsum(math.dist(a[:2], b[:2]) for a, b in pairwise(waypoints))
        offer = Offer(request.robot_id, request.ride_id, _NOWHERE, length, Pose2D(*waypoints[-1][:2]))
        self._promise(offer)
        self._accept(offer, waypoints)

    def _on_the_way(self, request: Request) -> bool:
        """Whether it comes by a place from where its way is the hitchhiker's too; a question is repeated, not this."""
        key = (request.robot_id, request.ride_id)
        if key not in self._asked:
            path = self._own_path()
            if path is None:
                return False
            if self._boardings is None or self._boardings[0] is not path:
                self._boardings = path, Boardings(path, self._sites, self.params)
            self._asked = dict(list(self._asked.items())[-_REMEMBERED:])
            self._asked[key] = self._boardings[1].serve(request.goal)
        return self._asked[key]

    def _ask_to_join(self, request: Request) -> None:
        """Another hitchhiker asks a driver that has riders already, or is about to."""
        if self.params.mode == "network":
            self._answer_from_afar(request)
            return
        offer = self._check(request) if self.free_places else Reason.ALREADY_DRIVING
        if isinstance(offer, Reason):
            self._deny(request, offer)
            return
        self._promise(offer)
        self._accept(offer)

    def _promise(self, offer: Offer) -> None:
        """The offer holds until the hitchhiker has heard all others; it binds nobody."""
        self._offered = {key: (until, o) for key, (until, o) in self._offered.items() if until >= self._now}
        holds_s = 2.0 * self.params.offer_window_s + self.params.confirm_timeout_s
        self._offered[offer.hitchhiker, offer.ride_id] = self._now + holds_s, offer

    def _promised(self, lock: Lock) -> Offer | None:
        until, offer = self._offered.get((lock.robot_id, lock.ride_id), (-math.inf, None))
        return offer if until >= self._now else None

    def _accept(self, offer: Offer, path: tuple[Waypoint, ...] = ()) -> None:
        estimate = self.situation.estimate
        pose = estimate.pose if estimate is not None else offer.point.aligning_pose
        riders = tuple(self._convoy)
        ahead = riders[-1].rear_marker if riders and riders[-1].offer is not offer else None
        rear_marker = ahead or self._rear_marker
        self._send(
            Accept(
                robot_id=self.robot_id,
                to=offer.hitchhiker,
                ride_id=offer.ride_id,
                x=pose.x,
                y=pose.y,
                theta=pose.theta,
                profile=self.params.profile,
                ride_m=offer.ride_m,
                decouple_point=(offer.decouple_pose.x, offer.decouple_pose.y),
                marker_id=rear_marker.marker_id,
                marker_size_m=rear_marker.marker_size_m,
                marker_pose=rear_marker.marker_pose,
                path=path,
                safe_speed_mps=self.params.safe_speed_mps,
            )
        )

    def _offer_of(self, lock: Lock) -> Offer | Reason:
        """The ride that a lock from afar is about, or the reason of the denial."""
        if self._promised(lock) is None or lock.aligning is None or lock.waiting is None or lock.leave is None:
            return Reason.NOT_OFFERED
        path = self._own_path()
        if path is None:
            return Reason.PATH_TOO_SHORT
        try:
            begin_m, end_m = stretch(path, lock.aligning, lock.leave)
        except ItineraryInputError:
            return Reason.INVALID_PLACE
        if end_m - begin_m < self.params.min_ride_m - _RIDE_TOLERANCE_M:
            return Reason.PATH_TOO_SHORT
        known = (
            p for p in self._sites.hitchhiking_points if distance(p.waiting_pose, lock.waiting) < _RIDE_TOLERANCE_M
        )
        point = next(known, HitchhikingPoint("", (), lock.aligning, lock.waiting))
        self._board_m = begin_m
        self._way_s = self.params.patience_s + 2.0 * self._to_board_m() / self.params.cruise_speed_mps
        return Offer(lock.robot_id, lock.ride_id, point, end_m - begin_m, path.line.pose(end_m))

    def _offer_to_join(self, lock: Lock) -> Offer | Reason:
        """As of :meth:`_offer_of`, for one that boards where the first rider does."""
        assert self.offer is not None
        if not self.free_places:
            return Reason.ALREADY_DRIVING
        offer: Offer | Reason | None = self._promised(lock)
        if offer is not None and self.params.mode == "network":
            board_m, way_s = self._board_m, self._way_s
            offer = self._offer_of(lock)
            self._board_m, self._way_s = board_m, way_s
        if not isinstance(offer, Offer):
            return offer or Reason.NOT_OFFERED
        here = self.offer.point
        if distance(offer.point.aligning_pose, here.aligning_pose) > _JOIN_M:
            return Reason.INVALID_PLACE
        return replace(offer, point=here)

    def _join(self, lock: Lock, offer: Offer) -> Rider:
        self._offered.pop((lock.robot_id, lock.ride_id), None)
        rider = Rider(offer, lock.rear_marker, self._now + lock.in_s)
        self._convoy.add(rider, may_pass=self.state is not S.ALIGNED)  # there one may be coupling already
        self._last_words = [(due, word) for due, word in self._last_words if word.ride_id != offer.ride_id]
        self._report(f"Meeting {offer.hitchhiker} for a ride of {offer.ride_m:.1f} m")
        return rider

    # Riders come, are told where they are, and go.

    def _leaving(self) -> tuple[Rider, ...]:
        """At the end of a ride, those for whom it is the end."""
        return tuple(rider for rider in self._convoy.coupled if rider.leaving)

    def _missing(self, since: float) -> tuple[Rider, ...]:
        """Those that do not follow, or have not said so since then."""
        return tuple(r for r in self._convoy.coupled if not r.following or r.acked_at <= since)

    def _behind(self) -> tuple[Rider, ...]:
        """Those for whom the driver waits: missing, or not caught up (P17 §4)."""
        missing, most = self._missing(self._entered), self.params.gap_m + _CAUGHT_UP_M
        return tuple(r for r in self._convoy.coupled if r in missing or (r.gap_m or 0.0) > most)

    def _drop_silent(self) -> None:
        """A hitchhiker that is to come says now and then when; one that does not is gone."""
        for rider in self._convoy:
            silent = self._now - max(rider.heard_at, rider.due) > self.params.contact_timeout_s
            if self.params.mode == "network" and not rider.coupled and silent:
                self._drop(rider, Reason.RIDER_GONE, tell=True)

    def _inform_all(self, but: tuple[Rider, ...] = ()) -> None:
        """The message of every δ seconds (P17 §4)."""
        if self._every(self.params.update_period_s, "driver"):
            for rider in self._convoy.coupled:
                if rider not in but:
                    self._inform_one(rider)

    def _inform_one(self, rider: Rider) -> None:
        if self.situation.estimate is None:
            return
        self._every(self.params.update_period_s, "driver")
        speed = self.situation.speed_mps
        self._send(Driver(**self._to(rider), **self._state_fields(rider), v=speed if math.isfinite(speed) else 0.0))

    def _state_fields(self, rider: Rider) -> dict[str, Any]:
        assert self.situation.estimate is not None
        estimate = self._convoy.pose_ahead_of(rider, self.situation.estimate, self.params.mounting)
        sigma: Covariance = covariance_rows(estimate.covariance)
        return {
            "x": estimate.pose.x,
            "y": estimate.pose.y,
            "theta": estimate.pose.theta,
            "sigma": sigma,
            "new_obstacles": NewObstacles(obstacles=self.situation.obstacles),
            "ridden_m": rider.ridden_m,
            "place": self._convoy.place(rider),
            "ahead": self._convoy.ahead_of(rider),
        }

    def _count_metres(self, last: bool = False) -> None:
        estimate = self.situation.estimate
        if estimate is None:
            return
        if self._odometer_at is None:
            self._odometer_at = estimate.pose
        step = distance(self._odometer_at, estimate.pose)
        if last or step >= _ODOMETER_STEP_M:
            for rider in self._convoy.coupled:
                rider.ridden_m += step
            self._odometer_at = estimate.pose

    def _finish(self, rider: Rider, reason: Ending | Reason, tell: bool) -> None:
        """The ride is over for one, whatever the cause; κ · metres ridden are credited once (P17 §5)."""
        if tell:
            end = Terminate(**self._to(rider), reason=str(reason))
            self._send_last_word(end, self.params.repeat_period_s, self.params.confirm_timeout_s)
        if rider.ridden_m > 0.0:
            offer, points = rider.offer, self.params.award_rate * rider.ridden_m
            self._effects.append(Award(offer.ride_id, offer.hitchhiker, rider.ridden_m, points))
        self._report(reason)
        self._convoy.remove(rider)

    def _end_rides(self, reason: Ending | Reason) -> None:
        for rider in self._convoy:
            self._finish(rider, reason, tell=True)

    def _drop(self, rider: Rider, reason: Ending | Reason, tell: bool) -> None:
        """One goes, the others come along; the driver goes on to its own goal when nobody is left."""
        self._finish(rider, reason, tell)
        if not len(self._convoy) or (self.state is S.DECOUPLING and not self._leaving()):
            self._close_up(reason)
        elif self.state is S.ALIGNED and self._convoy.next_to_couple is None:
            self._odometer_at = None
            self._go(S.DRIVING, reason)

    def _close_up(self, reason: Ending | Reason) -> None:
        """On to the own goal, or with the riders that are left, once they have moved up."""
        if len(self._convoy):
            self._go(S.WAITING_FOR_RIDER, Reason.CLOSING_UP)
        else:
            self._go_to_own_goal(reason)

    # Ways.

    def _own_path(self) -> OwnPath | None:
        """The way to the own goal as far as it is ahead; None without one."""
        estimate = self.situation.estimate
        if self.own_goal is None or estimate is None:
            return None
        on_it = self._path is not None and self._path.advance(estimate.pose)
        if not on_it and self.state in (S.IDLE, S.NAVIGATING):
            try:
                self._path = OwnPath(self._planner(estimate.pose, self.own_goal))
            except PlanningError:
                self._path = None  # navigation finds out too, and says why
        return self._path

    def _to_board_m(self) -> float:
        """Along the own path to where it aligns."""
        path = self._own_path()
        return 0.0 if path is None else max(0.0, self._board_m - path.come_m)

    def _point_around(self, own: Pose2D, other: Pose2D) -> HitchhikingPoint | None:
        """The hitchhiking point in whose area both robots are, the nearest to the driver first."""
        for point in sorted(self._sites.hitchhiking_points, key=lambda p: distance(own, p.aligning_pose)):
            if all(point_in_polygon(pose.x, pose.y, point.area) for pose in (own, other)):
                return point
        return None

    def _deny(self, message: Request | Lock, reason: Reason) -> None:
        self._send(Deny(robot_id=self.robot_id, to=message.robot_id, ride_id=message.ride_id, reason=str(reason)))

    def _navigation_outcome(self) -> Ending | None:
        """Reason.ARRIVED, or why the current goal is given up; None while navigation is at it."""
        goal, report = self.goal, self.situation.navigation
        current = goal is not None and report is not None and report.goal_id == goal.id
        state = report.state if report is not None and current else ""
        if state != "failed":
            self._planned_at = self._now
        if state not in ("blocked", "failed"):
            self._stuck_since = self._now
            return Ending(Reason.ARRIVED) if state == "arrived" else None
        # A new order is not stuck because the one before was.
        without_plan = self._now - max(self._planned_at, self._entered)
        stuck = self._now - max(self._stuck_since, self._entered)
        if without_plan <= self.params.planner_patience_s and stuck <= self.params.stuck_timeout_s:
            return None
        return Ending(Reason.CANNOT_GO_ON, report.reason if report is not None else "")

    def _go_to_own_goal(self, reason: Ending | Reason = Reason.NONE) -> None:
        """A new order, with an id that no earlier order had, not even one of before a restart."""
        self._goals += 1
        self._path, self._asked = None, {}
        self._own_goal_id = f"{self.robot_id}-{self._goals}-{self._now:.1f}"
        self._go(S.NAVIGATING, reason)


def _aligned_with(hitchhiker: Pose2D, point: HitchhikingPoint, apart_m: float) -> HitchhikingPoint:
    """The point, aligned at farther on where a hitchhiker ahead of its place would stand nearer than ``apart_m``."""
    ahead_m = between(point.waiting_pose, hitchhiker).x
    missing_m = apart_m - between(point.waiting_pose, point.aligning_pose).x + ahead_m
    farther_m = min(max(min(ahead_m, missing_m), 0.0), _AHEAD_M)
    return replace(point, aligning_pose=compose(point.aligning_pose, Pose2D(farther_m)))
