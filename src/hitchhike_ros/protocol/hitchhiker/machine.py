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

import itertools
import math
from collections.abc import Collection
from typing import Any

from scipy.spatial.distance import cdist

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.itinerary import SoloMetres
from hitchhike_ros.protocol.events import Effect, GoalCancelled, GoalGiven, Situation, TakeObstacles, TakePose, Tick
from hitchhike_ros.protocol.hitchhiker.asking import Asking
from hitchhike_ros.protocol.hitchhiker.meeting import Rendezvous
from hitchhike_ros.protocol.hitchhiker.pursuit import Pursuit
from hitchhike_ros.protocol.hitchhiker.ride import Restart, Ride
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.loose_machine import Machine, Row, Timeout
from hitchhike_ros.protocol.matching import Meeting
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
        self.robot_id = robot_id
        self.params = params
        self._sites, self._own_rear_marker, self._metres, self._camera = sites, rear_marker, metres, camera
        self._neighbours = neighbours or Neighbours()
        # Of the goal.
        self.goal: Pose2D | None = None
        self.rode = False  # since it was asked to bring the robot to its goal
        self._asked_since = 0.0
        self._whom, self._window_s = EVERYBODY, params.offer_window_s
        self._ready_in_s = 0.0
        # Of the newest request. Its driver may speak of it when it is over.
        self.ride_id = ""
        self._rides = 0
        self._handed_over = False
        # Of one phase or some.
        self.offer: Accept | None = None  # the one that is taken
        self._asking: Asking | None = None
        self._rendezvous: Rendezvous | None = None
        self._ride: Ride | None = None
        self._pursuit: Pursuit | None = None
        self._pursuit_ways = itertools.count(1)
        self._restart: Restart | None = None

    def step(self, event: object, now: float) -> list:
        """As Machine.step; messages of other rides than the current one are ignored."""
        if isinstance(event, Message) and not self._concerns(event):
            self.ignored += 1
            return []
        if isinstance(event, Tick):
            self._look(event.situation, now)
        return super().step(event, now)

    def ask(
        self,
        goal: Pose2D,
        now: float,
        whom: str = EVERYBODY,
        window_s: float | None = None,
        ready_in_s: float = 0.0,
    ) -> list[Effect]:
        """Ask for a ride to ``goal``.

        Args:
            goal: where the robot wants to be, in ``map``.
            now: the present time.
            whom: the only robot that is asked, by default all are.
            window_s: for how long offers are awaited in a network, by default as the parameters say.
            ready_in_s: how long until the ride could begin: the one before it may still be on.

        Returns:
            What is to be done, as :meth:`step`.
        """
        self._whom, self._ready_in_s = whom, ready_in_s
        self._window_s = self.params.offer_window_s if window_s is None else window_s
        return self.step(GoalGiven(goal), now)

    def can_start_in(self, seconds: float) -> None:
        """The ride before the one that is asked for will be over in so long."""
        self._ready_in_s = seconds

    @property
    def modules(self) -> ModuleSwitches:
        """P17 Table 3: while coupled only communication and servoing are on."""
        alone = self.state not in COUPLED
        return ModuleSwitches(PP=alone, OBS=alone, LZN=alone, MAP=alone, COM=True, VS=self.servo is not None)

    @property
    def servo(self) -> ServoCommand | None:
        """What the camera is for: the marker ahead, to follow it or to look for it."""
        if self._ride is None or self.state not in (S.COUPLING, S.CATCHING_UP, S.RECOUPLING, *COUPLED):
            return None
        marker = self._ride.rear_marker
        if self.state is S.CATCHING_UP:
            return ServoCommand("observe", marker.marker_id, marker.marker_size_m)
        speed_mps = self._ride.speed_mps(self._now)
        return ServoCommand("follow", marker.marker_id, marker.marker_size_m, self.params.gap_m, speed_mps)

    @property
    def way(self) -> GoalCommand | None:
        """Where it drives to by itself: to where it meets its driver and into line, or up behind one that it lost."""
        if self.state is S.AWAITING_ALIGNED and self._rendezvous is not None:
            return self._rendezvous.way
        return self._pursuit.way if self.state is S.CATCHING_UP and self._pursuit is not None else None

    @property
    def offers(self) -> Collection[str]:
        """The drivers that have made an offer and wait for the answer."""
        return () if self._asking is None else self._asking.offers.keys()

    @property
    def meeting(self) -> Meeting | None:
        """The ride that it has chosen in a network."""
        return None if self._rendezvous is None else self._rendezvous.meeting

    @property
    def ridden_m(self) -> float:
        """Metres of the present ride."""
        return 0.0 if self._ride is None else self._ride.ridden_m

    @property
    def ride(self) -> RideStatus | None:
        """The ride for the status, in whole metres, as every change of the status wakes all modules."""
        if self.offer is None:
            return None
        ride_m = self.offer.ride_m if self.meeting is None else self.meeting.ride_m
        return RideStatus(self.ride_id, self.offer.robot_id, self.robot_id, ride_m, math.floor(self.ridden_m))

    def gap_m(self) -> float | None:
        """Distance from the own camera to the marker ahead, None when it is not in view."""
        return None if self._ride is None else self._ride.gap_m(self.situation, self._now)

    def ride_ends_in_s(self) -> float:
        """How long until the present ride ends, as far as can be told."""
        if self._rendezvous is None or self.meeting is None or self.state in (S.RELOCALIZING, S.PARTING):
            return 0.0
        if self.state not in (*COUPLED, *RETURNING):
            return self._rendezvous.ride_ends_in_s(self._now)
        return max(0.0, self.meeting.ride_m - self.ridden_m) / self.params.ride_speed_mps + self.params.decouple_s

    # Actions of the table, in its order.

    def _ask(self, event: GoalGiven) -> None:
        self.goal, self.rode, self._asked_since = event.goal, False, self._now
        self._new_request()
        self._go(S.REQUESTING)
        if self.situation.estimate is not None and self._every(self.params.request_period_s, "request"):
            self._send_request(self.situation.estimate.pose)

    def _repeat_request(self, _tick: Tick) -> None:
        estimate = self.situation.estimate
        if self._asking is None or estimate is None:
            return
        if self.params.mode == "network" and self._asking.heard_enough(self._now, self._neighbours):
            self._decide(self._asking, estimate.pose)
            return
        if self._every(self.params.request_period_s, "request"):
            self._send_request(estimate.pose)

    def _send_request(self, pose: Pose2D) -> None:
        assert self.goal is not None
        self._send(
            Request(
                robot_id=self.robot_id,
                to=self._whom,
                ride_id=self.ride_id,
                x=pose.x,
                y=pose.y,
                theta=pose.theta,
                goal=self.goal,
                profile=self.params.profile,
                priority=self.params.priority,
                in_s=self._ready_in_s,
                rear_marker=self._own_rear_marker,
            )
        )

    def _take_offer(self, offer: Accept) -> None:
        """In a network (P18) all drivers are heard first; else (P17) the first one that offers a ride is taken."""
        assert self._asking is not None
        if self.params.mode == "local":
            self._lock(offer, None)
        else:
            self._asking.note_offer(offer, self._now)

    def _note_denial(self, denial: Deny) -> None:
        assert self._asking is not None
        told = Ending.told(denial.reason)
        if told != self.ending:
            self._report(f"{denial.robot_id} denies: {told}", told.reason)
        self.ending = told
        self._asking.note_denial(denial.robot_id)

    def _note_question(self, request: Request) -> None:
        assert self._asking is not None
        self._asking.note_question(request.robot_id)

    def _refuse_offer(self, offer: Accept) -> None:
        if self.offer is None or offer.robot_id != self.offer.robot_id:
            self._send(RequestCancel(robot_id=self.robot_id, to=offer.robot_id, ride_id=self.ride_id))

    def _repeat_lock(self, _tick: Tick | None = None) -> None:
        if self._every(self.params.repeat_period_s, "lock"):
            self._send_lock()

    def _locked(self, ack: Ack) -> None:
        if ack.of != Lock.type:
            return
        assert self._rendezvous is not None
        self._cancel_other_offers()
        self._rendezvous.agree(ack.place, ack.in_s, self._now, self.situation.estimate)
        self._go(S.AWAITING_ALIGNED)

    def _approach(self, _tick: Tick) -> None:
        """It tells its driver now and then when it will be where they meet."""
        assert self._rendezvous is not None
        if self.meeting is None:
            return
        if reason := self._rendezvous.why_not(self._now):
            self._tell(Terminate(**self._to_driver(), reason=str(reason)))
            self._ask_again(reason)
        elif self._every(self.params.request_period_s, "lock"):
            self._send_lock()

    def _note_place(self, ack: Ack) -> None:
        assert self._rendezvous is not None
        self._rendezvous.hear(self._now)
        if ack.of == Lock.type:
            self._rendezvous.update(ack.place, ack.in_s, self._now)

    def _couple(self, aligned: Aligned) -> None:
        assert self._rendezvous is not None and self.offer is not None
        if not self._rendezvous.in_place(self.situation):
            self._rendezvous.hear(self._now)
            return  # the driver says so again
        self._cancel_other_offers()  # that it is aligned confirms the lock as well
        self._ride = Ride(self.params, self._camera, aligned.ahead or self.offer.rear_marker, self._now)
        self._go(S.COUPLING)

    def _offer_withdrawn(self, message: Deny | Terminate) -> None:
        self._ask_again(Ending.told(message.reason))

    def _watch_gap(self, _tick: Tick) -> None:
        assert self._ride is not None
        if self._ride.settled(self.situation, self._now):
            self._ride.begin(self._now)
            self._start_riding(Reason.NONE)

    def _watch_driver(self, _tick: Tick) -> None:
        assert self._ride is not None
        gap = self.gap_m()
        if gap is not None and self._ride.report is None and self._every(self.params.repeat_period_s, "coupled"):
            self._send_coupled(gap)
        if self._ride.silent(self._now):
            self._lose_driver(Reason.DRIVER_SILENT)
        elif self._ride.out_of_sight(self._now):
            self._go(S.SEEKING, Reason.OUT_OF_SIGHT)

    def _seek(self, _tick: Tick) -> None:
        assert self._ride is not None
        if self._ride.silent(self._now):
            self._lose_driver(Reason.DRIVER_SILENT)
        elif self.gap_m() is not None:
            self._start_riding(Reason.SEEN_AGAIN)

    def _locate(self, _tick: Tick) -> None:
        assert self._ride is not None
        if self._ride.silent(self._now):
            self._tell(Terminate(**self._to_driver(), reason=str(Reason.DRIVER_SILENT)))
            self._go(S.RELOCALIZING, Reason.DRIVER_SILENT)
        elif self._located():
            self._pursuit = Pursuit(self.params, self._camera, self.ride_id, self._pursuit_ways)
            self._go(S.CATCHING_UP, Reason.OUT_OF_SIGHT)

    def _catch_up(self, _tick: Tick) -> None:
        assert self._ride is not None and self._pursuit is not None
        if self._ride.silent(self._now):
            self._go_alone(Reason.DRIVER_SILENT)
        elif self._ride.within_reach(self.situation, self._now):
            self._ride.begin_to_settle()
            self._go(S.RECOUPLING, Reason.SEEN_AGAIN)
        elif not self._pursuit.aim(self._ride.told, self._ride.rear_marker, self.situation, self._now):
            self._go_alone(Reason.NOT_CAUGHT)

    def _recouple(self, _tick: Tick) -> None:
        assert self._ride is not None
        if self._ride.silent(self._now):
            self._go_alone(Reason.DRIVER_SILENT)
        elif self._ride.settled(self.situation, self._now):
            self._start_riding(Reason.SEEN_AGAIN)

    def _acknowledge(self, message: Driver) -> None:
        assert self._ride is not None
        self._ride.hear(message, self._now)
        self._ride.match(message, self.situation, self._now)
        seen, gap = self._ride.seen(self.situation, self._now), self.gap_m()
        self._send(
            Ack(
                **self._to_driver(),
                of=message.type,
                acknowledges=message.seq,
                following=self.state is S.RIDING and gap is not None,
                gap_m=gap,
                seen=None if seen is None else seen.pose,
                seen_sigma=None if seen is None else covariance_rows(seen.covariance),
            )
        )

    def _settle(self, message: Decouple) -> None:
        self._newer_pose(message)
        self._go(S.SETTLING)

    def _newer_pose(self, message: Decouple) -> None:
        assert self._ride is not None
        self._ride.hear(message, self._now)

    def _take_over(self, _tick: Tick) -> None:
        assert self._ride is not None
        seen = self._ride.seen(self.situation, self._now)
        standing = abs(self.situation.speed_mps) <= self.params.standstill_mps
        # The driver's pose and the marker's must be of one moment: both robots stand, and the marker was seen since.
        if standing and seen is not None and self.time_in_state() >= self.params.repeat_period_s:
            self._take_over_now()

    def _take_over_now(self) -> None:
        assert self._ride is not None
        seen, report = self._ride.seen(self.situation, self._now), self._ride.report
        if seen is None or report is None:
            self._lose_driver(Reason.DRIVER_LOST)
            return
        self._relocalize(self._ride.pose_behind_driver(seen, self.situation, self._now), Reason.NONE)
        self._handed_over = True
        self._answer_late(report)

    def _abandoned(self, message: Terminate) -> None:
        self._relocalize(self._rough_pose(), Ending.told(message.reason))

    def _left_behind(self, message: Terminate) -> None:
        self._part(Ending.told(message.reason))

    def _overtaken(self, message: Decouple) -> None:
        """The driver has come to the end of the ride without its rider."""
        self._newer_pose(message)
        self._tell(Terminate(**self._to_driver(), reason=str(Reason.DRIVER_LOST)))
        if self.state is S.LOCATING:
            self._go(S.RELOCALIZING, Reason.DRIVER_LOST)
        else:
            self._part(Reason.DRIVER_LOST)

    def _watch_localization(self, _tick: Tick) -> None:
        if not self._located():
            return
        restart, estimate = self._restart, self.situation.estimate
        if restart is not None and estimate is not None:
            self._note_driver(restart.driver_from(estimate.pose))
        end = self._finish if self._handed_over or self.goal is None else self._part
        end(self.ending)

    def _answer_late(self, message: Decouple | Driver | Aligned) -> None:
        """The driver still carries on with the ride that is over here: what it was told was lost."""
        to_driver: dict[str, Any] = {"robot_id": self.robot_id, "to": message.robot_id, "ride_id": message.ride_id}
        if not self._handed_over:
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
        """A hitchhiker that meets its driver from afar has a way to go first; T_hwait depends on the priority."""
        if name == "max_wait_s":
            return self.params.patience_s
        if name == "max_align_s" and self._rendezvous is not None:
            return self._rendezvous.patience_s
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

    def _look(self, situation: Situation, now: float) -> None:
        """What follows from the situation for what is known of the driver."""
        if self._ride is not None:
            self._ride.look(situation, now)
        elif self._rendezvous is not None and self.state is S.AWAITING_ALIGNED:
            self._rendezvous.go(situation, now, self._ready_in_s)

    def _concerns(self, message: Message) -> bool:
        if isinstance(message, Request):
            return message.to == self.robot_id
        if not self.ride_id or message.ride_id != self.ride_id:
            return False
        return self.offer is None or isinstance(message, Accept) or message.robot_id == self.offer.robot_id

    def _to_driver(self) -> dict[str, Any]:
        assert self.offer is not None
        return {"robot_id": self.robot_id, "to": self.offer.robot_id, "ride_id": self.ride_id}

    def _tell(self, end: Terminate | RequestCancel) -> None:
        self._send_last_word(end, self.params.repeat_period_s, self.params.confirm_timeout_s)

    def _send_coupled(self, gap: float) -> None:
        self._every(self.params.repeat_period_s, "coupled")
        self._send(Coupled(**self._to_driver(), gap_m=gap))

    def _new_request(self) -> None:
        self._rides, self._handed_over = self._rides + 1, False
        self.ride_id = f"{self.robot_id}-{self._rides}-{self._now:.1f}"
        self._asking = Asking(self.params, self._now, self._window_s, self._whom)

    def _ask_again(self, why: Ending | Reason) -> None:
        """Back to asking, as long as T_hwait of the first request allows."""
        self._report(why)
        self._cancel_offers()
        self.offer = self._rendezvous = self._ride = None
        self._new_request()
        self._go(S.REQUESTING, why)
        self._entered = self._asked_since

    def _finish(self, why: Ending | Reason) -> None:
        self._report(why or Reason.RIDE_COMPLETED)
        self._go(S.IDLE, why)
        self.offer = self._asking = self._rendezvous = self._ride = self._pursuit = self._restart = None

    def _go_alone(self, why: Ending | Reason) -> None:
        """The ride is over for one that knows where it is."""
        self._tell(Terminate(**self._to_driver(), reason=str(why)))
        self._part(why)

    def _part(self, why: Ending | Reason) -> None:
        """Both are near each other, and neither sees well to its back: one goes first."""
        self._go(S.PARTING, why)

    # In a network.

    def _decide(self, asking: Asking, here: Pose2D) -> None:
        """Take the best offer; go at once where none is good enough."""
        assert self.goal is not None
        meeting = asking.best(here, self.goal, self._ready_in_s, self._now, self._sites, self._metres)
        if meeting is not None:
            self._lock(asking.offers[meeting.driver][0], meeting)
        elif asking.offers:
            self._cancel_offers()
            self._finish(Reason.ALONE_IS_BETTER)
        else:
            self._driver_not_found()

    def _lock(self, offer: Accept, meeting: Meeting | None) -> None:
        self.offer = offer
        self._rendezvous = Rendezvous(self.params, self._sites, self.ride_id, meeting, self._now, self._ready_in_s)
        self._go(S.LOCKING)
        self._repeat_lock()

    def _send_lock(self) -> None:
        assert self._rendezvous is not None
        meeting = self._rendezvous.meeting
        if meeting is None:
            self._send(Lock(**self._to_driver(), rear_marker=self._own_rear_marker))
            return
        self._send(
            Lock(
                **self._to_driver(),
                aligning=meeting.point.aligning_pose,
                waiting=meeting.point.waiting_pose,
                leave=meeting.leave,
                in_s=self._rendezvous.arrives_in_s(self.situation, self._now, self._ready_in_s),
                rear_marker=self._own_rear_marker,
            )
        )

    def _cancel_other_offers(self) -> None:
        """Of all but the driver that is taken."""
        self._cancel_offers(but_of="" if self.offer is None else self.offer.robot_id)
        self._asking = None

    def _cancel_offers(self, but_of: str = "") -> None:
        """Nobody waits for a hitchhiker that has chosen otherwise."""
        for driver in () if self._asking is None else self._asking.drop_offers(but_of):
            self._send(RequestCancel(robot_id=self.robot_id, to=driver, ride_id=self.ride_id))

    def _start_riding(self, why: Ending | Reason) -> None:
        assert self._ride is not None
        self.rode = True
        self._pursuit = self._restart = None
        self._go(S.RIDING, why)
        gap = self.gap_m()
        assert gap is not None
        self._send_coupled(gap)

    def _located(self) -> bool:
        """Whether localization goes on from the pose that it was given."""
        return self._restart is not None and self._restart.taken(self.situation.estimate)

    def _rough_pose(self) -> PoseEstimate | None:
        assert self._ride is not None
        return self._ride.rough_pose(self.situation, self._now)

    def _lose_driver(self, why: Ending | Reason) -> None:
        self._tell(Terminate(**self._to_driver(), reason=str(why)))
        self._relocalize(self._rough_pose(), why)

    def _relocalize(self, pose: PoseEstimate | None, why: Ending | Reason) -> None:
        self._restart_from(pose)
        self._go(S.RELOCALIZING, why)

    def _restart_from(self, pose: PoseEstimate | None) -> None:
        """Localization and mapping take over from the ride."""
        assert self._ride is not None
        if pose is not None:
            driver = self._ride.driver_pose(pose.pose, self.situation, self._now)
            self._restart = Restart(pose, driver)
            self._note_driver(driver)
            self._effects.append(TakePose(pose))
        report = self._ride.report
        if report is not None and report.new_obstacles.obstacles:
            self._effects.append(TakeObstacles(report.new_obstacles.obstacles))

    def _note_driver(self, place: Pose2D | None) -> None:
        """The driver is where it is seen: what it said last may be metres old."""
        if place is not None and self.offer is not None:
            self._neighbours.saw(self.offer.robot_id, place, self._now)
