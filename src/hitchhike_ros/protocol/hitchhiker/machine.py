"""The hitchhiker of P17 Algorithm 2 as a table: ask, lock, wait, couple, ride, take over the pose, go on.

In a network (P18 §4) it asks all drivers, hears their answers for a while, chooses, and goes to where they meet. When
nobody can drive it, or driving alone is better, it leaves at once.

A driver that is lost from sight is sought by the camera first (``seeking``, while servoing coasts and looks around).
What fails there goes on by itself: it localizes from what it knows of the driver (``locating``), drives up behind the
driver, who waits (``catching_up``), couples anew (``recoupling``), and rides on. Whichever of these fails or takes too
long ends the ride: the robot lets the driver go first (``parting``) and drives to its goal alone, as P17 §4 does at
once.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from hitchhike_ros.core.datatypes import HitchhikingPoint, MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import between, compose, distance, inverse, wrap_angle
from hitchhike_ros.localization.driver_track import DriverTrack, with_heading
from hitchhike_ros.localization.handover import handover
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.itinerary import SoloMetres
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven, TakeObstacles, TakePose, Tick
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.loose_machine import Machine, Row, Timeout
from hitchhike_ros.protocol.matching import Meeting, choose
from hitchhike_ros.protocol.messages import (
    EVERYBODY,
    Accept,
    Ack,
    Aligned,
    Coupled,
    Decouple,
    Deny,
    Driver,
    Lock,
    Message,
    RearMarker,
    Request,
    RequestCancel,
    Terminate,
    covariance_rows,
)
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import LOCALIZATION_SILENT, Ending, Reason
from hitchhike_ros.protocol.status import GoalCommand, ModuleSwitches, RideStatus, ServoCommand

# What it tells its own modules of the driver's speed, which following knows to 0.3 m/s, and of the metres ridden, comes
# in steps, since every change of the status wakes all of them (chosen).
_SPEED_STEP_MPS = 0.05
# Of the driver's places those are kept that are this far apart, and as many metres of them (chosen).
_TOLD_STEP_M, _TOLD_M = 0.2, 4.0
# The place behind the driver from where it couples anew: so much farther off than the gap, and how well it is reached.
_CATCH_UP_M, _CATCH_UP_TOLERANCE_M, _CATCH_UP_TOLERANCE_RAD = 0.4, 0.25, 0.25
# A hitchhiker within this of the heading of its hitchhiking point is in line; it turns where it stands (chosen).
_IN_LINE_RAD, _IN_LINE_M = 0.06, 0.25
# Images of so long a time show it in the gap before it is coupled: four at 10 Hz. It goes no faster meanwhile, and may
# close the last centimetres while the driver sets off (chosen).
_SETTLED_S, _SETTLED_MPS = 0.25, 0.1
# It does not back up: who stands nearer than the gap, by no more than this, lets it open when the one ahead sets off.
_NEARER_M = 0.3
# A marker that is seen nearer than this beyond the gap can be coupled with, a farther one may be behind a corner.
_COUPLING_REACH_M = 1.2

# What a pose from the driver's message may be off by when the marker is lost: x, y in m, theta in rad (chosen).
_LOST_SIGMA = (0.5, 0.5, 0.3)
# Localization has taken a pose over when it answers with one that is this near to it (chosen: 4 of these sigmas).
_TAKEN_M = 4.0 * _LOST_SIGMA[0]


S = HitchhikerState
BEFORE_RIDE = (S.REQUESTING, S.LOCKING, S.AWAITING_ALIGNED, S.COUPLING)
COUPLED = (S.RIDING, S.SEEKING, S.SETTLING)
RETURNING = (S.LOCATING, S.CATCHING_UP, S.RECOUPLING)


class HitchhikerMachine(Machine[HitchhikerState]):
    """Rides towards a goal; back in IDLE, ``ending`` says how it ended and the robot goes on alone.

    ``camera`` is the camera's position in base_footprint: gaps are measured from there.
    """

    ROWS = (
        Row((S.IDLE,), GoalGiven, "_ask", (S.REQUESTING,)),
        Row((S.REQUESTING,), Tick, "_repeat_request", (S.LOCKING, S.IDLE)),
        Row((S.REQUESTING,), Accept, "_take_offer", (S.LOCKING,)),
        Row((S.REQUESTING,), Deny, "_note_denial"),
        Row((S.REQUESTING,), Request, "_note_question"),
        Row(tuple(s for s in S if s is not S.REQUESTING), Accept, "_refuse_offer"),
        Row((S.LOCKING,), Tick, "_repeat_lock"),
        Row((S.LOCKING,), Ack, "_locked", (S.AWAITING_ALIGNED,)),
        Row((S.AWAITING_ALIGNED,), Tick, "_approach", (S.REQUESTING,)),
        Row((S.AWAITING_ALIGNED,), Ack, "_note_place"),
        Row((S.LOCKING, S.AWAITING_ALIGNED), Aligned, "_couple", (S.COUPLING,)),
        Row((S.LOCKING, S.AWAITING_ALIGNED, S.COUPLING), Deny, "_offer_withdrawn", (S.REQUESTING,)),
        Row((S.LOCKING, S.AWAITING_ALIGNED, S.COUPLING), Terminate, "_offer_withdrawn", (S.REQUESTING,)),
        Row((S.COUPLING,), Tick, "_watch_gap", (S.RIDING,)),
        Row((S.RIDING,), Tick, "_watch_driver", (S.SEEKING, S.RELOCALIZING)),
        Row((S.SEEKING,), Tick, "_seek", (S.RIDING, S.RELOCALIZING)),
        Row((S.LOCATING,), Tick, "_locate", (S.CATCHING_UP, S.RELOCALIZING)),
        Row((S.CATCHING_UP,), Tick, "_catch_up", (S.RECOUPLING, S.PARTING)),
        Row((S.RECOUPLING,), Tick, "_recouple", (S.RIDING, S.PARTING)),
        Row((S.RIDING, S.SEEKING, *RETURNING), Driver, "_acknowledge"),
        Row((S.RIDING, S.SEEKING), Decouple, "_settle", (S.SETTLING,)),
        Row((S.RIDING, S.SEEKING, S.LOCATING), Terminate, "_abandoned", (S.RELOCALIZING,)),
        Row((S.CATCHING_UP, S.RECOUPLING), Terminate, "_left_behind", (S.PARTING,)),
        Row(RETURNING, Decouple, "_overtaken", (S.RELOCALIZING, S.PARTING)),
        Row((S.SETTLING,), Decouple, "_newer_pose"),
        Row((S.SETTLING,), Tick, "_take_over", (S.RELOCALIZING,)),
        Row((S.SETTLING,), Terminate, "_abandoned", (S.RELOCALIZING,)),
        Row((S.RELOCALIZING,), Tick, "_watch_localization", (S.IDLE, S.PARTING)),
        Row((S.RELOCALIZING, S.PARTING, S.IDLE), Decouple, "_answer_late"),
        Row((S.RELOCALIZING, S.PARTING, S.IDLE), Driver, "_answer_late"),
        Row((S.IDLE,), Aligned, "_answer_late"),
        Row(BEFORE_RIDE, GoalCancelled, "_cancel", (S.IDLE,)),
        Row((*COUPLED, S.LOCATING), GoalCancelled, "_cancel_ride", (S.RELOCALIZING,)),
        Row((S.CATCHING_UP, S.RECOUPLING), GoalCancelled, "_cancel_return", (S.IDLE,)),
        Row((S.PARTING,), GoalCancelled, "_cancel_parting", (S.IDLE,)),
        Row((S.IDLE, S.RELOCALIZING), GoalCancelled, "_nothing_to_cancel"),
    )
    TIMEOUTS = (
        Timeout(S.REQUESTING, "max_wait_s", "_driver_not_found", (S.IDLE,)),
        Timeout(S.LOCKING, "confirm_timeout_s", "_lock_lost", (S.REQUESTING,)),
        Timeout(S.AWAITING_ALIGNED, "max_align_s", "_not_aligned", (S.REQUESTING,)),
        Timeout(S.COUPLING, "max_couple_s", "_not_coupled", (S.REQUESTING,)),
        Timeout(S.SEEKING, "seek_timeout_s", "_not_found", (S.LOCATING,)),
        Timeout(S.LOCATING, "localize_timeout_s", "_give_up_locating", (S.PARTING,)),
        Timeout(S.CATCHING_UP, "catch_up_timeout_s", "_not_caught", (S.PARTING,)),
        Timeout(S.RECOUPLING, "max_couple_s", "_not_recoupled", (S.PARTING,)),
        Timeout(S.PARTING, "part_s", "_parted", (S.IDLE,)),
        Timeout(S.SETTLING, "settle_timeout_s", "_take_over_now", (S.RELOCALIZING,)),
        Timeout(S.RELOCALIZING, "localize_timeout_s", "_give_up_localizing", (S.IDLE,)),
    )

    def __init__(
        self,
        robot_id: str,
        params: HitchhikingParameters,
        sites: Sites,
        camera: tuple[float, float],
        rear_marker: RearMarker | None = None,
        neighbours: Neighbours | None = None,
        metres: SoloMetres = cdist,
    ) -> None:
        """``rear_marker`` is this robot's own. ``metres`` gives the way of driving alone, for choosing among rides."""
        super().__init__(S.IDLE, params)
        self._sites, self._own_rear_marker, self._metres = sites, rear_marker, metres
        self._neighbours = neighbours or Neighbours()
        self.ready_in_s = 0.0  # until it could start from where it asks: a ride to there may still be on
        self.meeting: Meeting | None = None
        self._offers: dict[str, tuple[Accept, float]] = {}
        self._answered: set[str] = set()
        self.window_s = params.offer_window_s
        self.asks = EVERYBODY
        self._requested_at = self._due_at = self._way_s = self._agreed_at = self._driver_due_at = 0.0
        self._place = 1
        self._rear_marker: RearMarker | None = None  # ahead
        self._sent_off = False
        self._lost_way_at: float | None = None
        self.rode = False  # since it was asked to bring the robot to its goal
        self.robot_id = robot_id
        self.params = params
        self.goal: Pose2D | None = None
        self.offer: Accept | None = None
        self.ride_id = ""
        self.ridden_m = 0.0
        self._camera = camera
        self._rides = 0
        self._asked_since = 0.0
        self._in_gap_since: float | None = None
        self._seen_at = 0.0
        self._heard_at = 0.0
        self._report_at: Driver | Decouple | None = None
        self._settled_pose: PoseEstimate | None = None
        self._taken_over = False  # by the handover of this ride
        self._track = DriverTrack()
        self.left_at: Pose2D | None = None  # where it saw its driver when it took to its own localization again
        self._told: deque[Pose2D] = deque()  # where the driver said that it was, on this ride
        self._ways = 0
        self._way: GoalCommand | None = None
        self._aimed_at: Pose2D | None = None
        self._places: deque[Pose2D] = deque()
        self._looking_since: float | None = None

    def step(self, event: object, now: float) -> list:
        """As Machine.step; messages of other rides than the current one are ignored."""
        if isinstance(event, Message) and not self._concerns(event):
            self.ignored += 1
            return []
        return super().step(event, now)

    @property
    def modules(self) -> ModuleSwitches:
        """P17 Table 3: while coupled only communication and servoing are on."""
        alone = self.state not in COUPLED
        return ModuleSwitches(PP=alone, OBS=alone, LZN=alone, MAP=alone, COM=True, VS=self.servo is not None)

    @property
    def servo(self) -> ServoCommand | None:
        rear_marker = self._rear_marker
        if rear_marker is None or self.state not in (S.COUPLING, S.CATCHING_UP, S.RECOUPLING, *COUPLED):
            return None
        if self.state is S.CATCHING_UP:
            return ServoCommand("observe", rear_marker.marker_id, rear_marker.marker_size_m)
        # A driver that has fallen silent may be standing: its old speed must not push.
        fresh = self._now - self._heard_at <= self.params.ack_timeout_s
        speed = self._report_at.v if fresh and isinstance(self._report_at, Driver) else 0.0
        speed = _SPEED_STEP_MPS * round(speed / _SPEED_STEP_MPS)
        return ServoCommand("follow", rear_marker.marker_id, rear_marker.marker_size_m, self.params.gap_m, speed)

    @property
    def way(self) -> GoalCommand | None:
        """Where it drives to by itself: to where it meets its driver and into line, or up behind one that it lost."""
        return self._way if self.state in (S.AWAITING_ALIGNED, S.CATCHING_UP) else None

    @property
    def ride(self) -> RideStatus | None:
        if self.offer is None:
            return None
        ride_m = self.offer.ride_m if self.meeting is None else self.meeting.ride_m
        return RideStatus(self.ride_id, self.offer.robot_id, self.robot_id, ride_m, math.floor(self.ridden_m))

    def gap_m(self) -> float | None:
        """Distance from the own camera to the driver's marker, None when it is not in view."""
        seen = self._observation()
        return None if seen is None else distance(Pose2D(*self._camera), seen.pose)

    # Actions of the table, in its order.

    def _ask(self, event: GoalGiven) -> None:
        self.goal, self.offer, self.ridden_m, self.rode = event.goal, None, 0.0, False
        self._asked_since, self._offers, self.meeting = self._now, {}, None
        self._new_request()
        self._go(S.REQUESTING)
        if self.situation.estimate is not None and self._every(self.params.request_period_s, "request"):
            self._send_request(self.situation.estimate.pose)

    def _repeat_request(self, _tick: Tick) -> None:
        estimate = self.situation.estimate
        if self.goal is None or estimate is None:
            return
        if self.params.mode == "network" and self._heard_enough():
            self._decide(estimate.pose)
            return
        if self._every(self.params.request_period_s, "request"):
            self._send_request(estimate.pose)

    def _send_request(self, pose: Pose2D) -> None:
        assert self.goal is not None
        self._send(
            Request(
                robot_id=self.robot_id,
                to=self.asks,
                ride_id=self.ride_id,
                x=pose.x,
                y=pose.y,
                theta=pose.theta,
                goal=self.goal,
                profile=self.params.profile,
                priority=self.params.priority,
                in_s=self.ready_in_s,
                rear_marker=self._own_rear_marker,
            )
        )

    def _take_offer(self, offer: Accept) -> None:
        """First come, first served where one waits for whoever passes (P17); in a network all are heard first."""
        if self.params.mode == "local":
            self._lock(offer)
        else:
            self._offers[offer.robot_id] = offer, self._now
            self._answered.add(offer.robot_id)

    def _note_denial(self, denial: Deny) -> None:
        told = Ending.told(denial.reason)
        if told != self.ending:
            self._report(f"{denial.robot_id} denies: {told}", told.reason)
        self.ending = told
        self._offers.pop(denial.robot_id, None)
        self._answered.add(denial.robot_id)

    def _note_question(self, request: Request) -> None:
        """Who asks for a ride itself when it is asked for one wants the roles reversed."""
        self._answered.add(request.robot_id)

    def _refuse_offer(self, offer: Accept) -> None:
        if self.offer is None or offer.robot_id != self.offer.robot_id:
            self._send(RequestCancel(robot_id=self.robot_id, to=offer.robot_id, ride_id=self.ride_id))

    def _repeat_lock(self, _tick: Tick | None = None) -> None:
        if self._every(self.params.repeat_period_s, "lock"):
            self._send_lock()

    def _locked(self, ack: Ack) -> None:
        if ack.of != Lock.type:
            return
        self._cancel_other_offers()
        self._place, self._sent_off, self._lost_way_at, self._heard_at = ack.place, False, None, self._now
        self._agreed_at, self._driver_due_at = self._now, self._now + ack.in_s
        self._way = None if self.meeting is not None else self._turn_into_line()
        self._go(S.AWAITING_ALIGNED)

    def _approach(self, _tick: Tick) -> None:
        """To where it meets its driver from afar; now and then it says when it will be there. There, and in line, it
        rests."""
        if self._arrived():
            self._way = None
        if self.meeting is None:
            return
        if not self._sent_off and self.ready_in_s <= 0.0 and self.situation.estimate is not None:
            self._way, self._sent_off = self._way_to_wait(), True
        if (reason := self._why_not_meet()) is not None:
            self._tell(Terminate(**self._to_driver(), reason=str(reason)))
            self._ask_again(reason)
        elif self._every(self.params.request_period_s, "lock"):
            self._send_lock()

    def _note_place(self, ack: Ack) -> None:
        self._heard_at = self._now
        if ack.of == Lock.type:
            self._driver_due_at = self._now + ack.in_s
        if ack.of == Lock.type and ack.place != self._place:
            self._place, self._sent_off = ack.place, False

    def _couple(self, aligned: Aligned) -> None:
        if self.meeting is not None and not self._in_place():
            self._heard_at = self._now
            return  # the driver says so again
        self._cancel_other_offers()  # that it is aligned confirms the lock as well
        self._in_gap_since = self._report_at = None
        if aligned.ahead is not None:
            self._rear_marker = aligned.ahead
        self._go(S.COUPLING)

    def _offer_withdrawn(self, message: Deny | Terminate) -> None:
        self._ask_again(Ending.told(message.reason))

    def _watch_gap(self, _tick: Tick) -> None:
        gap = self._settled_gap()
        if gap is None:
            return
        self._heard_at = self._now
        self._track, self._told, self.left_at = DriverTrack(), deque(), None
        self._start_riding(gap, Reason.NONE)

    def _watch_driver(self, _tick: Tick) -> None:
        gap = self.gap_m()
        if gap is not None:
            self._seen_at = self._now
            if self._report_at is None and self._every(self.params.repeat_period_s, "coupled"):
                self._send_coupled(gap)
        if self._silent():
            self._lose_driver(Reason.DRIVER_SILENT)
        elif gap is None and self._now - self._seen_at > self.params.repeat_period_s:
            self._go(S.SEEKING, Reason.OUT_OF_SIGHT)

    def _seek(self, _tick: Tick) -> None:
        gap = self.gap_m()
        if self._silent():
            self._lose_driver(Reason.DRIVER_SILENT)
        elif gap is not None:
            self._start_riding(gap, Reason.SEEN_AGAIN)

    def _locate(self, _tick: Tick) -> None:
        if self._silent():
            self._tell(Terminate(**self._to_driver(), reason=str(Reason.DRIVER_SILENT)))
            self._go(S.RELOCALIZING, Reason.DRIVER_SILENT)
        elif self._located():
            self._go(S.CATCHING_UP, Reason.OUT_OF_SIGHT)
            self._way = self._aimed_at = None

    def _catch_up(self, _tick: Tick) -> None:
        gap = self.gap_m()
        if self._silent():
            self._go_alone(Reason.DRIVER_SILENT)
        elif gap is not None and gap <= self.params.gap_m + _COUPLING_REACH_M:
            self._in_gap_since = None
            self._go(S.RECOUPLING, Reason.SEEN_AGAIN)
        elif not self._aim_at_driver():
            self._go_alone(Reason.NOT_CAUGHT)

    def _recouple(self, _tick: Tick) -> None:
        gap = self._settled_gap()
        if self._silent():
            self._go_alone(Reason.DRIVER_SILENT)
        elif gap is not None:
            self._start_riding(gap, Reason.SEEN_AGAIN)

    def _acknowledge(self, message: Driver) -> None:
        self._hear(message)
        seen, own = self._observation(), self.situation.seen_from
        if seen is not None and own is not None and self._rear_marker is not None:
            self._track.add(compose(own, seen.pose), compose(message.pose, self._rear_marker.marker_pose))
        gap = self.gap_m()
        following = self.state is S.RIDING and gap is not None
        self._send(
            Ack(
                **self._to_driver(),
                of=message.type,
                acknowledges=message.seq,
                following=following,
                gap_m=gap,
                seen=None if seen is None else seen.pose,
                seen_sigma=None if seen is None else covariance_rows(seen.covariance),
            )
        )

    def _settle(self, message: Decouple) -> None:
        self._hear(message)
        self._go(S.SETTLING)

    def _newer_pose(self, message: Decouple) -> None:
        self._hear(message)

    def _take_over(self, _tick: Tick) -> None:
        seen = self._observation()
        standing = abs(self.situation.speed_mps) <= self.params.standstill_mps
        # The driver's pose and the marker's must be of one moment: both robots stand, and the marker was seen since.
        if standing and seen is not None and self.time_in_state() >= self.params.repeat_period_s:
            self._take_over_now()

    def _take_over_now(self) -> None:
        seen = self._observation()
        if seen is None:
            self._lose_driver(Reason.DRIVER_LOST)
            return
        self._relocalize(self._pose_behind_driver(seen), Reason.NONE)
        self._taken_over = True
        if self._report_at is not None:
            self._answer_late(self._report_at)

    def _abandoned(self, message: Terminate) -> None:
        self._relocalize(self._rough_pose(), Ending.told(message.reason))

    def _left_behind(self, message: Terminate) -> None:
        self._part(Ending.told(message.reason))

    def _overtaken(self, message: Decouple) -> None:
        """The driver has come to the end of the ride without its rider."""
        self._hear(message)
        self._tell(Terminate(**self._to_driver(), reason=str(Reason.DRIVER_LOST)))
        if self.state is S.LOCATING:
            self._go(S.RELOCALIZING, Reason.DRIVER_LOST)
        else:
            self._part(Reason.DRIVER_LOST)

    def _watch_localization(self, _tick: Tick) -> None:
        if self._located():
            taken, estimate = self._settled_pose, self.situation.estimate
            if taken is not None and estimate is not None and self.left_at is not None:  # it stands as it did
                self.left_at = compose(estimate.pose, between(taken.pose, self.left_at))
            end = self._finish if self._taken_over or self.goal is None else self._part
            end(self.ending)

    def _answer_late(self, message: Decouple | Driver | Aligned) -> None:
        """The driver still carries on with the ride that is over here: what it was told was lost."""
        to_driver: dict[str, Any] = {"robot_id": self.robot_id, "to": message.robot_id, "ride_id": message.ride_id}
        if not self._taken_over:
            self._send(Terminate(**to_driver, reason=str(self.ending)))
        elif isinstance(message, Decouple):
            self._send(Ack(**to_driver, of=message.type, acknowledges=message.seq, gap_m=self.gap_m()))

    def _cancel(self, _event: GoalCancelled) -> None:
        self._cancel_offers()
        if self.offer is not None:
            self._tell(RequestCancel(**self._to_driver()))
        self._finish(Reason.GOAL_CANCELLED)

    def _cancel_ride(self, _event: GoalCancelled) -> None:
        self._tell(Terminate(**self._to_driver(), reason=str(Reason.GOAL_CANCELLED)))
        self.goal = None
        self._relocalize(self._rough_pose(), Reason.GOAL_CANCELLED)

    def _cancel_return(self, _event: GoalCancelled) -> None:
        self.goal = None
        self._tell(Terminate(**self._to_driver(), reason=str(Reason.GOAL_CANCELLED)))
        self._finish(Reason.GOAL_CANCELLED)

    def _cancel_parting(self, _event: GoalCancelled) -> None:
        self.goal = None
        self._finish(Reason.GOAL_CANCELLED)

    def _nothing_to_cancel(self, _event: GoalCancelled) -> None:
        self.goal = None

    # Timeouts.

    def _limit_s(self, name: str) -> float:
        """Who meets from afar has a way to go first; T_hwait depends on the priority."""
        if name == "max_wait_s":
            return self.params.patience_s
        if name == "max_align_s" and self.meeting is not None:
            return 2.0 * self.meeting.begins_in_s + self.params.patience_s + self.params.max_align_s
        return super()._limit_s(name)

    def _driver_not_found(self) -> None:
        self._cancel_offers()
        self._finish(Ending(Reason.DRIVER_NOT_FOUND, str(self.ending)))

    def _lock_lost(self) -> None:
        self._tell(RequestCancel(**self._to_driver()))
        self._ask_again(Reason.LOCK_NOT_CONFIRMED)

    def _not_aligned(self) -> None:
        self._tell(Terminate(**self._to_driver(), reason=str(Reason.DRIVER_NOT_ALIGNED)))
        self._ask_again(Reason.DRIVER_NOT_ALIGNED)

    def _not_coupled(self) -> None:
        self._tell(Terminate(**self._to_driver(), reason=str(Reason.LARGE_COUPLE_TIME)))
        self._ask_again(Reason.LARGE_COUPLE_TIME)

    def _not_found(self) -> None:
        self._restart_from(self._rough_pose())
        self._go(S.LOCATING, Reason.DRIVER_LOST)

    def _give_up_locating(self) -> None:
        self._go_alone(Ending(Reason.DRIVER_LOST, LOCALIZATION_SILENT))

    def _not_caught(self) -> None:
        self._go_alone(Reason.NOT_CAUGHT)

    def _not_recoupled(self) -> None:
        self._go_alone(Reason.LARGE_COUPLE_TIME)

    def _parted(self) -> None:
        self._finish(self.ending)

    def _give_up_localizing(self) -> None:
        self._finish(self.ending.adding(LOCALIZATION_SILENT))

    # What several actions do.

    def _concerns(self, message: Message) -> bool:
        if isinstance(message, Request):
            return message.to == self.robot_id
        if not self.ride_id or message.ride_id != self.ride_id:
            return False
        return self.offer is None or isinstance(message, Accept) or message.robot_id == self.offer.robot_id

    def _to_driver(self) -> dict[str, Any]:
        to = self.offer.robot_id if self.offer is not None else "*"
        return {"robot_id": self.robot_id, "to": to, "ride_id": self.ride_id}

    def _tell(self, end: Terminate | RequestCancel) -> None:
        self._send_last_word(end, self.params.repeat_period_s, self.params.confirm_timeout_s)

    def _observation(self) -> MarkerObservation | None:
        """The driver's marker, unless it was seen too long ago to act upon."""
        seen = self.situation.observation
        if seen is None or self._rear_marker is None or seen.marker_id != self._rear_marker.marker_id:
            return None
        return seen if self._now - seen.stamp <= self.params.repeat_period_s else None

    def _send_coupled(self, gap: float) -> None:
        self._every(self.params.repeat_period_s, "coupled")
        self._send(Coupled(**self._to_driver(), gap_m=gap))

    def _hear(self, message: Driver | Decouple) -> None:
        if message.ahead is not None and message.ahead != self._rear_marker:  # it moves up
            self._rear_marker, self._track, self._told = message.ahead, DriverTrack(), deque()
        self._heard_at, self._report_at, self.ridden_m = self._now, message, message.ridden_m
        if not self._told or distance(self._told[-1], message.pose) >= _TOLD_STEP_M:
            self._told.append(message.pose)
        while distance(self._told[0], message.pose) > _TOLD_M:
            self._told.popleft()

    def _new_request(self) -> None:
        self._rides, self._taken_over = self._rides + 1, False
        self.ride_id = f"{self.robot_id}-{self._rides}-{self._now:.1f}"
        self._requested_at, self._offers, self._answered, self.meeting = self._now, {}, set(), None
        self._sent_off, self._way = False, None

    def _ask_again(self, reason: Ending | Reason) -> None:
        """Back to asking, as long as T_hwait of the first request allows."""
        self._report(reason)
        self._cancel_offers()
        self.offer = self._rear_marker = None
        self._new_request()
        self._go(S.REQUESTING, reason)
        self._entered = self._asked_since

    def _finish(self, reason: Ending | Reason) -> None:
        self._report(reason or Reason.RIDE_COMPLETED)
        self._go(S.IDLE, reason)
        self.offer = self._rear_marker = self.meeting = None

    def _go_alone(self, reason: Ending | Reason) -> None:
        """The ride is over for one that knows where it is."""
        self._tell(Terminate(**self._to_driver(), reason=str(reason)))
        self._part(reason)

    def _part(self, reason: Ending | Reason) -> None:
        """Both are near each other, and neither sees well to its back: one goes first."""
        self._go(S.PARTING, reason)

    def _silent(self) -> bool:
        return self._now - self._heard_at > self.params.message_timeout_s

    # In a network.

    def _heard_enough(self) -> bool:
        """Whether all known drivers have answered, or the time for offers is over.

        Who has got its goal a moment ago offers a place in its next beacon only: until that, all are asked.
        """
        waited, ask = self._now - self._requested_at, self._neighbours.drivers
        if waited >= self.window_s:
            return True
        if self.asks != EVERYBODY:
            return self.asks in self._answered
        if waited < self.params.beacon_period_s:
            ask = self._neighbours.known
        return bool(self._answered) and ask(self._now, self.params.robot_timeout_s) <= self._answered

    def _decide(self, here: Pose2D) -> None:
        """Take the best offer; go at once where none is good enough."""
        assert self.goal is not None
        self.meeting = choose(
            here, self.goal, self.ready_in_s, self._offers, self._now, self._sites, self.params, self._metres
        )
        if self.meeting is not None:
            self._way_s = self.meeting.in_s - self.ready_in_s
            self._due_at = self._now + self.meeting.in_s
            self._lock(self._offers[self.meeting.driver][0])
        elif self._offers:
            self._cancel_offers()
            self._finish(Reason.ALONE_IS_BETTER)
        else:
            self._driver_not_found()

    def _lock(self, offer: Accept) -> None:
        self.offer, self._rear_marker = offer, offer.rear_marker
        self._go(S.LOCKING)
        self._repeat_lock()

    def _send_lock(self) -> None:
        if self.meeting is None:
            self._send(Lock(**self._to_driver(), rear_marker=self._own_rear_marker))
            return
        point = self.meeting.point
        self._send(
            Lock(
                **self._to_driver(),
                aligning=point.aligning_pose,
                waiting=point.waiting_pose,
                leave=self.meeting.leave,
                in_s=self._arrives_in_s(),
                rear_marker=self._own_rear_marker,
            )
        )

    def _cancel_other_offers(self) -> None:
        """Of all but the driver that is taken."""
        if self.offer is not None:
            self._offers.pop(self.offer.robot_id, None)
        self._cancel_offers()

    def _cancel_offers(self) -> None:
        """Nobody waits for a hitchhiker that has chosen otherwise."""
        for robot_id in self._offers:
            self._send(RequestCancel(robot_id=self.robot_id, to=robot_id, ride_id=self.ride_id))
        self._offers = {}

    def leaves_in_s(self) -> float:
        """Until the present ride ends, as far as can be told."""
        if self.meeting is None or self.state in (S.RELOCALIZING, S.PARTING):
            return 0.0
        if self.state not in (*COUPLED, *RETURNING):
            return max(0.0, self._due_at - self._now) + self.meeting.ends_in_s - self.meeting.in_s
        return max(0.0, self.meeting.ride_m - self.ridden_m) / self.params.ride_speed_mps + self.params.decouple_s

    def _arrives_in_s(self) -> float:
        """Until it is where it meets its driver."""
        assert self.meeting is not None
        if self.ready_in_s > 0.0:
            self._due_at = self._now + self.ready_in_s + self._way_s
            return self.ready_in_s + self._way_s
        estimate, waiting = self.situation.estimate, self.meeting.point.waiting_pose
        away_m = 0.0 if estimate is None or self._in_place() else distance(estimate.pose, waiting)
        return max(self._due_at - self._now, away_m / self.params.cruise_speed_mps, 0.0)

    def _waiting_pose(self, point: HitchhikingPoint) -> Pose2D:
        """Those with places farther back wait behind."""
        apart_m = distance(point.aligning_pose, point.waiting_pose)
        return compose(point.waiting_pose, Pose2D(-(self._place - 1) * apart_m))

    def _way_to_wait(self) -> GoalCommand | None:
        estimate = self.situation.estimate
        assert self.meeting is not None and estimate is not None
        pose = self._waiting_pose(self.meeting.point)
        if distance(estimate.pose, pose) <= _IN_LINE_M:
            return self._turn_into_line()
        return GoalCommand(f"{self.ride_id}-meet-{self._place}", pose.x, pose.y, pose.theta)

    def _in_place(self) -> bool:
        """Whether it stands where it meets its driver."""
        return self._sent_off and (self._way is None or self._arrived())

    def _arrived(self) -> bool:
        """Whether it is where it was to drive to by itself."""
        report, way = self.situation.navigation, self._way
        return report is not None and way is not None and (report.goal_id, report.state) == (way.id, "arrived")

    def _why_not_meet(self) -> Reason | None:
        """Why the ride that was arranged comes to nothing; None while it may still come about."""
        assert self.meeting is not None
        if self._now - self._heard_at > self.params.contact_timeout_s:
            return Reason.DRIVER_GONE
        if self._driver_due_at > self._agreed_at + self.meeting.begins_in_s + self.params.patience_s:
            return Reason.DRIVER_LATE
        return Reason.CANNOT_MEET if self._no_way() else None

    def _no_way(self) -> bool:
        """Whether navigation has had no path to there for a while."""
        report = self.situation.navigation
        if report is None or self._way is None or (report.goal_id, report.state) != (self._way.id, "failed"):
            self._lost_way_at = None
            return False
        if self._lost_way_at is None:
            self._lost_way_at = self._now
        return self._now - self._lost_way_at > self.params.planner_patience_s

    def _settled_gap(self) -> float | None:
        """The gap to the driver, once images over a while show that it is right and hardly changes."""
        gap, seen = self.gap_m(), self._observation()
        settled = (
            gap is not None
            and -_NEARER_M <= gap - self.params.gap_m <= self.params.gap_tolerance_m
            and abs(self.situation.speed_mps) <= _SETTLED_MPS
        )
        if not settled or seen is None:
            self._in_gap_since = None
            return None
        if self._in_gap_since is None:
            self._in_gap_since = seen.stamp
        return gap if seen.stamp - self._in_gap_since >= _SETTLED_S else None

    def _start_riding(self, gap: float, reason: Ending | Reason) -> None:
        self._seen_at, self.rode = self._now, True
        self._go(S.RIDING, reason)
        self._send_coupled(gap)

    def _located(self) -> bool:
        """Whether localization goes on from the pose that it was given."""
        taken, estimate = self._settled_pose, self.situation.estimate
        if taken is None or estimate is None or estimate.stamp <= taken.stamp:
            return False
        # It may wake up with what it knew where it went to sleep.
        return distance(taken.pose, estimate.pose) <= _TAKEN_M

    def _turn_into_line(self) -> GoalCommand | None:
        """A turn where it stands, unless it stands as the hitchhiking point asks; a wall tells better how it stands."""
        estimate = self.situation.estimate
        point = None if estimate is None else self._sites.hitchhiking_point_at(estimate.pose.x, estimate.pose.y)
        if estimate is None or point is None:
            return None
        own, heading = estimate.pose, point.waiting_pose.theta
        if abs(wrap_angle(own.theta - heading)) <= _IN_LINE_RAD:
            return None
        order = f"{self.ride_id}-line"
        return GoalCommand(order, own.x, own.y, heading, _IN_LINE_M, _IN_LINE_RAD, along_wall=point.wall)

    def _aim_at_driver(self) -> bool:
        """Order the way to the next place from where the marker may be seen; False when there is none left.

        A driver that has gone on is a reason to begin anew.
        """
        if not self._told:
            return False
        if self._told[-1] != self._aimed_at:
            self._aimed_at, self._places = self._told[-1], deque(self._places_to_look())
            self._way = None
        if self._way is not None and not self._looked_in_vain(self._way):
            return True
        if not self._places:
            return False
        place = self._places.popleft()
        self._ways, self._looking_since = self._ways + 1, None
        order = f"{self.ride_id}-behind-{self._ways}"
        self._way = GoalCommand(order, place.x, place.y, place.theta, _CATCH_UP_TOLERANCE_M, _CATCH_UP_TOLERANCE_RAD)
        return True

    def _places_to_look(self) -> list[Pose2D]:
        """On the driver's own track, or on the spot when it is near; then straight in front of its marker."""
        estimate = self.situation.estimate
        if self._rear_marker is None or estimate is None:
            return []
        marker = compose(self._told[-1], self._rear_marker.marker_pose)
        off = self._camera[0] + self.params.gap_m
        behind = next((p for p in reversed(self._told) if distance(p, marker) >= off + _CATCH_UP_M), self._told[0])
        behind = estimate.pose if distance(estimate.pose, marker) < off + _CATCH_UP_M else behind
        return [
            Pose2D(p.x, p.y, math.atan2(marker.y - p.y, marker.x - p.x)) for p in (behind, compose(marker, Pose2D(off)))
        ]

    def _looked_in_vain(self, way: GoalCommand) -> bool:
        """Whether it has stood at the place for a while, or there is no way to it."""
        report = self.situation.navigation
        if report is None or report.goal_id != way.id or report.state not in ("arrived", "failed"):
            self._looking_since = None
            return False
        if self._looking_since is None:
            self._looking_since = self._now
        return self._now - self._looking_since > self.params.look_s

    def _lose_driver(self, reason: Ending | Reason) -> None:
        self._tell(Terminate(**self._to_driver(), reason=str(reason)))
        self._relocalize(self._rough_pose(), reason)

    def _relocalize(self, pose: PoseEstimate | None, reason: Ending | Reason) -> None:
        self._restart_from(pose)
        self._go(S.RELOCALIZING, reason)

    def _restart_from(self, pose: PoseEstimate | None) -> None:
        """Localization and mapping take over from the ride."""
        self._settled_pose = pose
        seen = self._observation()
        if pose is not None and seen is not None and self._rear_marker is not None:
            self.left_at = compose(compose(pose.pose, seen.pose), inverse(self._rear_marker.marker_pose))
        if pose is not None:
            self._effects.append(TakePose(pose))
        if self._report_at is not None and self._report_at.new_obstacles.obstacles:
            self._effects.append(TakeObstacles(self._report_at.new_obstacles.obstacles))

    def _driver_estimate(self) -> PoseEstimate | None:
        message = self._report_at
        return None if message is None else PoseEstimate(self._now, message.pose, np.array(message.sigma))

    def _pose_behind_driver(self, seen: MarkerObservation) -> PoseEstimate | None:
        driver = self._driver_estimate()
        if driver is None or self._rear_marker is None:
            return None
        marker, own, turn = self._rear_marker.marker_pose, self.situation.seen_from, self._track.turn()
        if own is not None and turn is not None:
            seen = with_heading(seen, driver.pose.theta + marker.theta, own.theta + turn[0], turn[1])
        return handover(self.params.handover, driver, seen, marker, self.params.mounting)

    def _rough_pose(self) -> PoseEstimate | None:
        """From the driver's track and the own wheels, else from the driver's last message alone (P17 §4)."""
        own = self.situation.odom_pose
        located = None if own is None else self._track.locate(self._now, own)
        if located is not None:
            return located
        driver = self._driver_estimate()
        if driver is None or self._rear_marker is None:
            return self.situation.estimate  # still where it coupled: its own estimate has not been switched off yet
        marker = self._rear_marker.marker_pose
        ahead = Pose2D(self._camera[0] + self.params.gap_m, 0.0, np.pi)
        # Both may have gone on since the driver spoke last.
        gone_m = self.params.ride_speed_mps * (self._now - self._heard_at)
        covariance = np.diag(np.square([_LOST_SIGMA[0] + gone_m, _LOST_SIGMA[1] + gone_m, _LOST_SIGMA[2]]))
        assumed = MarkerObservation(self._now, self._rear_marker.marker_id, ahead, covariance)
        return handover("measured", driver, assumed, marker)
