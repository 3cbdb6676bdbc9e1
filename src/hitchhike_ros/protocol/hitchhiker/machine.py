"""The hitchhiker: what it does, row by row of its table."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from scipy.spatial.distance import cdist

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.localization.motion import carried_on
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.itinerary import SoloMetres
from hitchhike_ros.protocol.announcement import asked_path
from hitchhike_ros.protocol.events import Effect, GoalGiven, TakeObstacles, TakePose
from hitchhike_ros.protocol.hitchhiker.asking import Asking, Choice
from hitchhike_ros.protocol.hitchhiker.facts import BEHIND_DRIVER, HitchhikerFacts
from hitchhike_ros.protocol.hitchhiker.meeting import Rendezvous
from hitchhike_ros.protocol.hitchhiker.pursuit import Pursuit
from hitchhike_ros.protocol.hitchhiker.ride import Restart, Ride
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.hitchhiker.table import ROWS
from hitchhike_ros.protocol.machine import Machine
from hitchhike_ros.protocol.matching import Meeting, Planner
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
    PathPoints,
    RearMarker,
    Request,
    RequestCancel,
    Terminate,
    covariance_rows,
)
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.reasons import LOCALIZATION_SILENT, Ending, Reason
from hitchhike_ros.protocol.status import GoalCommand, ModuleSwitches, RideStatus, ServoCommand

S = HitchhikerState
# P17 Table 3: in these phases the driver does what the modules of the hitchhiker would do.
_LED = (Phase.COUPLED, Phase.HANDING_OVER)
_FOLLOWING = (*S.of(Phase.COUPLING, *_LED), S.RECOUPLING)


class HitchhikerMachine(Machine[HitchhikerState, HitchhikerFacts]):
    """Rides towards a goal. Back in IDLE, ``ending`` says how the ride ended, and the robot goes on alone."""

    INITIAL = S.IDLE
    ROWS = ROWS

    def __init__(
        self,
        robot_id: str,
        params: HitchhikingParameters,
        sites: Sites,
        camera: tuple[float, float],
        rear_marker: RearMarker | None = None,
        neighbours: Neighbours | None = None,
        metres: SoloMetres = cdist,
        planner: Planner | None = None,
    ) -> None:
        """A hitchhiker without a goal.

        Args:
            robot_id: this robot's name.
            params: what it asks for and waits for.
            sites: the hitchhiking points of the world.
            camera: position of the camera in ``base_footprint``, m; gaps are measured from there.
            rear_marker: this robot's own.
            neighbours: the robots in reach; the hitchhiker adds where it has seen the robot ahead of it.
            metres: the ways of driving alone, for choosing among rides.
            planner: the path between two poses, which drivers are told; without it they plan it themselves.
        """
        known = neighbours or Neighbours()
        super().__init__(HitchhikerFacts(params=params, neighbours=known, window_s=params.offer_window_s))
        self.robot_id = robot_id
        self.params = params
        self._sites, self._camera, self._rear_marker, self._metres = sites, camera, rear_marker, metres
        self._planner = planner
        self._requests, self._pursuit_ways = itertools.count(1), itertools.count(1)

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
        self.facts.whom, self.facts.ready_in_s = whom, ready_in_s
        self.facts.window_s = self.params.offer_window_s if window_s is None else window_s
        return self.step(GoalGiven(goal), now)

    def can_start_in(self, seconds: float) -> None:
        """The ride before the one that is asked for will be over in so long."""
        self.facts.ready_in_s = seconds

    # What others may know.

    @property
    def goal(self) -> Pose2D | None:
        """Where it wants to be, None once that is taken back."""
        return self.facts.goal

    @property
    def rode(self) -> bool:
        """Whether it has ridden since it was given the goal."""
        return self.facts.rode

    @property
    def ride_id(self) -> str:
        """The name of the newest ride that it asked for."""
        return self.facts.ride_id

    @property
    def driver(self) -> str:
        """The robot that drives it, or was the last to be asked to; "" before the first offer is taken."""
        return self.facts.driver

    @property
    def modules(self) -> ModuleSwitches:
        """P17 Table 3: while coupled only communication and servoing are on."""
        alone = self.state.phase not in _LED
        return ModuleSwitches(PP=alone, OBS=alone, LZN=alone, MAP=alone, COM=True, VS=self.servo is not None)

    @property
    def servo(self) -> ServoCommand | None:
        """What the camera is for: the marker ahead, to follow it or to look for it."""
        if self.state not in (*_FOLLOWING, S.CATCHING_UP):
            return None
        marker = self.facts.ride.rear_marker
        if self.state is S.CATCHING_UP:
            return ServoCommand("observe", marker.marker_id, marker.marker_size_m)
        return ServoCommand(
            "follow",
            marker.marker_id,
            marker.marker_size_m,
            self.params.gap_m,
            self.facts.ride.speed_mps(self.facts.now),
            self.facts.ride.told_at,
            marker.marker_pose,
        )

    @property
    def way(self) -> GoalCommand | None:
        """Where it drives to by itself: to where it meets its driver and into line, or up behind one that it lost."""
        if self.state is S.AWAITING_ALIGNED:
            return self.facts.rendezvous.way
        return self.facts.pursuit.way if self.state is S.CATCHING_UP else None

    @property
    def offer(self) -> Accept | None:
        """The offer that it has taken."""
        return None if self.state in (S.IDLE, S.REQUESTING) else self.facts.choice.offer

    @property
    def meeting(self) -> Meeting | None:
        """The ride that it has chosen in a network."""
        return None if self.state in (S.IDLE, S.REQUESTING) else self.facts.choice.meeting

    @property
    def ridden_m(self) -> float:
        """Metres of the present ride."""
        return self.facts.ride.ridden_m if self.state.phase in BEHIND_DRIVER else 0.0

    @property
    def ride(self) -> RideStatus | None:
        """The ride for the status, in whole metres, as every change of the status wakes all modules."""
        if self.offer is None:
            return None
        ridden_m = math.floor(self.ridden_m)
        return RideStatus(self.ride_id, self.offer.robot_id, self.robot_id, self.facts.choice.ride_m, ridden_m)

    def gap_m(self) -> float | None:
        """Distance from the own camera to the marker ahead, None when it is not in view."""
        if self.state.phase not in BEHIND_DRIVER:
            return None
        return self.facts.ride.gap_m(self.facts.situation, self.facts.now)

    def ride_ends_in_s(self) -> float:
        """How long until the present ride ends, as far as can be told."""
        if self.meeting is None or self.state.phase is Phase.PARTING:
            return 0.0
        if self.state in (*S.of(*_LED), *S.of(Phase.RETURNING)):
            return (
                max(0.0, self.facts.choice.ride_m - self.ridden_m) / self.params.ride_speed_mps + self.params.decouple_s
            )
        return self.facts.rendezvous.ride_ends_in_s(self.facts.now)

    # Asking.

    def _take_goal(self, event: GoalGiven) -> None:
        self.facts.goal, self.facts.asked_since, self.facts.rode = event.goal, self.facts.now, False

    def _request_anew(self) -> None:
        facts = self.facts
        facts.ride_id = f"{self.robot_id}-{next(self._requests)}-{facts.now:.1f}"
        facts.handed_over, facts.path = False, None
        facts.asking = Asking(self.params, facts.now, facts.window_s, facts.whom, self.ending)

    def _repeat_request(self) -> None:
        estimate, goal = self.facts.situation.estimate, self.facts.goal
        if estimate is None or not self._every(self.params.request_period_s, "request"):
            return
        assert goal is not None
        self._send(
            Request(
                robot_id=self.robot_id,
                to=self.facts.whom,
                ride_id=self.ride_id,
                x=estimate.pose.x,
                y=estimate.pose.y,
                theta=estimate.pose.theta,
                goal=goal,
                profile=self.params.profile,
                priority=self.params.priority,
                in_s=self.facts.ready_in_s,
                rear_marker=self._rear_marker,
                path=self._asked_path(estimate.pose, goal),
            )
        )

    def _note_offer(self, offer: Accept) -> None:
        self.facts.asking.note_offer(offer, self.facts.now)

    def _note_denial(self, denial: Deny) -> None:
        told = Ending.told(denial.reason)
        if told.reason is Reason.DRIVES_NOWHERE and self.ending:
            told = self.ending  # that a robot is no driver is worth less than what a driver said
        if told != self.ending:
            self._report(f"{denial.robot_id} denies: {told}", told.reason)
        self.ending = told
        self.facts.asking.note_denial(denial.robot_id, told)

    def _note_question(self, request: Request) -> None:
        self.facts.asking.note_question(request.robot_id)

    def _choose(self) -> None:
        facts, estimate, goal = self.facts, self.facts.situation.estimate, self.facts.goal
        assert estimate is not None and goal is not None
        facts.asking.choose(estimate.pose, goal, facts.ready_in_s, facts.now, self._sites, self._metres)

    def _take_offer(self, offer: Accept) -> None:
        self._choose_offer(Choice(offer))

    def _take_best_offer(self) -> None:
        assert self.facts.asking.choice is not None
        self._choose_offer(self.facts.asking.choice)

    def _add_denial(self) -> None:
        """A driver that was asked may have said why it does not come."""
        self.ending = self.ending.adding(str(self.facts.asking.told))

    def _refuse_offer(self, offer: Accept) -> None:
        self._send(RequestCancel(robot_id=self.robot_id, to=offer.robot_id, ride_id=self.ride_id))

    def _cancel_offers(self) -> None:
        """No driver waits for a hitchhiker that has chosen otherwise."""
        self._cancel(self.facts.asking.drop_offers())

    def _cancel_other_offers(self) -> None:
        self._cancel(self.facts.asking.drop_offers(but_of=self.facts.choice.offer.robot_id))

    # Meeting.

    def _repeat_lock(self) -> None:
        if self._every(self.params.repeat_period_s, "lock"):
            self._send_lock()

    def _asked_path(self, start: Pose2D, goal: Pose2D) -> PathPoints:
        """The way of the present request, planned once; none where there is none."""
        facts = self.facts
        if facts.path is None and self._planner is not None:
            try:
                facts.path = asked_path(self._planner(start, goal))
            except PlanningError:
                facts.path = ()
        return facts.path or ()

    def _agree(self, ack: Ack) -> None:
        if ack.ride_m > 0.0:
            self.facts.choice = replace(self.facts.choice, agreed_m=ack.ride_m)
        self.facts.rendezvous.agree(ack.place, ack.in_s, self.facts.now, self.facts.situation.estimate)

    def _go_to_meet(self) -> None:
        self.facts.rendezvous.go(self.facts.situation, self.facts.now, self.facts.ready_in_s)

    def _say_when(self) -> None:
        if self._every(self.params.request_period_s, "lock"):
            self._send_lock()

    def _note_contact(self) -> None:
        self.facts.rendezvous.hear(self.facts.now)

    def _note_place(self, ack: Ack) -> None:
        self.facts.rendezvous.update(ack.place, ack.in_s, self.facts.now)

    def _couple(self, aligned: Aligned) -> None:
        marker = aligned.ahead or self.facts.choice.offer.rear_marker
        self.facts.ride = Ride(self.params, self._camera, marker, self.facts.now, aligned.place)

    def _take_request_back(self) -> None:
        self._tell(RequestCancel(**self._to_driver()))

    # Riding.

    def _look(self) -> None:
        self.facts.ride.look(self.facts.situation, self.facts.now)

    def _begin_ride(self) -> None:
        self.facts.ride.begin(self.facts.now)

    def _ride(self) -> None:
        self.facts.rode = True
        self._repeat_coupled()

    def _repeat_coupled(self) -> None:
        gap = self.gap_m()
        assert gap is not None
        if self._every(self.params.repeat_period_s, "coupled"):
            self._send(Coupled(**self._to_driver(), gap_m=gap))

    def _hear(self, message: Driver | Decouple) -> None:
        self.facts.ride.hear(message, self.facts.now)

    def _match(self, message: Driver) -> None:
        self.facts.ride.match(message, self.facts.situation, self.facts.now)

    def _acknowledge(self, message: Driver) -> None:
        seen, gap = self.facts.ride.seen(self.facts.situation, self.facts.now), self.gap_m()
        self._send(
            Ack(
                **self._to_driver(),
                of=message.type,
                acknowledges=message.seq,
                following=self.state is S.RIDING and gap is not None,
                gap_m=gap,
                seen=None if seen is None else seen.pose,
                seen_sigma=None if seen is None else covariance_rows(seen.covariance),
                seen_age_s=0.0 if seen is None else max(0.0, self.facts.now - seen.stamp),
            )
        )

    # Returning to a driver that is lost from sight.

    def _localize(self) -> None:
        """Localization goes on without the marker."""
        self._restart(self.facts.ride.rough_pose(self.facts.situation, self.facts.now), self.facts.situation.odom_pose)

    def _pursue(self) -> None:
        self.facts.pursuit = Pursuit(self.params, self._camera, self.ride_id, self._pursuit_ways)

    def _aim(self) -> None:
        ride = self.facts.ride
        self.facts.pursuit.aim(ride.told, ride.rear_marker, self.facts.situation, self.facts.now)

    def _settle_anew(self) -> None:
        self.facts.ride.begin_to_settle()

    # The ride ends.

    def _take_reason(self, message: Deny | Terminate) -> None:
        self.ending = Ending.told(message.reason)

    def _add_silence(self) -> None:
        self.ending = self.ending.adding(LOCALIZATION_SILENT)

    def _tell_driver(self) -> None:
        self._tell(Terminate(**self._to_driver(), reason=str(self.ending)))

    def _report_ending(self) -> None:
        self._report(self.ending)

    def _take_over(self) -> None:
        facts = self.facts
        seen, report = facts.ride.seen(facts.situation, facts.now), facts.ride.report
        assert seen is not None and isinstance(report, Decouple)
        self._restart(facts.ride.pose_behind_driver(seen, facts.situation, facts.now), facts.situation.seen_from)
        facts.handed_over = True
        self._acknowledge_handover(report)

    def _acknowledge_handover(self, message: Decouple) -> None:
        self._send(Ack(**self._to(message), of=message.type, acknowledges=message.seq, gap_m=self.gap_m()))

    def _say_it_is_over(self, message: Decouple | Driver | Aligned) -> None:
        """The driver still carries on with a ride that is over here: what it was told was lost."""
        self._send(Terminate(**self._to(message), reason=str(self.ending)))

    def _place_ahead(self) -> None:
        """The robot stands as it did when it saw the one ahead, and now knows better where that is."""
        restart, estimate = self.facts.restart, self.facts.situation.estimate
        assert restart is not None and estimate is not None
        self._note_ahead(restart.ahead_from(estimate.pose, self.facts.situation.odom_pose))

    def _finish(self) -> None:
        self._report(self.ending or Reason.RIDE_COMPLETED)

    def _forget_goal(self) -> None:
        self.facts.goal = None

    # What several actions do.

    def _concerns(self, message: Message) -> bool:
        """Whether a message is of the newest ride and its driver, or a question to this robot alone."""
        if isinstance(message, Request):
            return message.to == self.robot_id
        if not self.ride_id or message.ride_id != self.ride_id:
            return False
        offer = self.offer
        return offer is None or isinstance(message, Accept) or message.robot_id == offer.robot_id

    def _cancel(self, drivers: Iterable[str]) -> None:
        for driver in drivers:
            self._send(RequestCancel(robot_id=self.robot_id, to=driver, ride_id=self.ride_id))

    def _choose_offer(self, choice: Choice) -> None:
        facts = self.facts
        facts.choice, facts.driver = choice, choice.offer.robot_id
        facts.rendezvous = Rendezvous(
            self.params, self._sites, self.ride_id, choice.meeting, facts.now, facts.ready_in_s
        )

    def _send_lock(self) -> None:
        facts, meeting = self.facts, self.facts.choice.meeting
        if meeting is None:
            self._send(Lock(**self._to_driver(), rear_marker=self._rear_marker))
            return
        self._send(
            Lock(
                **self._to_driver(),
                aligning=meeting.point.aligning_pose,
                waiting=meeting.point.waiting_pose,
                leave=meeting.leave,
                ride_m=meeting.ride_m,
                in_s=facts.rendezvous.arrives_in_s(facts.situation, facts.now, facts.ready_in_s),
                rear_marker=self._rear_marker,
            )
        )

    def _to_driver(self) -> dict[str, Any]:
        return {"robot_id": self.robot_id, "to": self.facts.choice.offer.robot_id, "ride_id": self.ride_id}

    def _to(self, message: Message) -> dict[str, Any]:
        """Who answers whom, about which ride."""
        return {"robot_id": self.robot_id, "to": message.robot_id, "ride_id": message.ride_id}

    def _tell(self, end: Terminate | RequestCancel) -> None:
        self._send_last_word(end, self.params.repeat_period_s, self.params.confirm_timeout_s)

    def _restart(self, pose: PoseEstimate | None, then: Pose2D | None) -> None:
        """Localization and mapping take over from the ride: from the ``pose`` that the robot had when it was at
        ``then`` in ``odom``, carried on by its wheels to now, as nobody else has heard them."""
        facts, report, situation = self.facts, self.facts.ride.report, self.facts.situation
        facts.restart = None
        if pose is not None:
            start = carried_on(pose, then, situation.odom_pose, facts.now)
            seen_from = facts.ride.place_when_seen(start.pose, situation)
            facts.restart = Restart(start, facts.ride.pose_ahead(seen_from, situation, facts.now), situation.odom_pose)
            self._note_ahead(facts.restart.ahead)
            self._effects.append(TakePose(start))
        if report is not None and report.new_obstacles.obstacles:
            self._effects.append(TakeObstacles(report.new_obstacles.obstacles))

    def _note_ahead(self, place: Pose2D | None) -> None:
        """The robot ahead is where it is seen: what the driver said last of it may be metres old."""
        if place is None:
            return
        neighbours, driver = self.facts.neighbours, self.facts.choice.offer.robot_id
        saw = neighbours.saw_driver if self.facts.ride.place == 1 else neighbours.saw_ahead
        saw(driver, place, self.facts.now)
