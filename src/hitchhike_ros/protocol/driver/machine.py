"""The driver of P17 Algorithm 1: check, offer, align, drive with riders, hand over; and drive alone. Its actions.

In a network (P18 §4) it answers requests from afar. Such an answer binds nobody until the hitchhiker locks it. Then the
driver goes to where they meet, faster than usual where the hitchhiker would wait otherwise, and waits there for a while
itself. With several places it takes whoever asks before it has left (convoy).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, ClassVar

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.driver.convoy import Convoy, Odometer, Offer, Rider
from hitchhike_ros.protocol.driver.facts import ENGAGED, Boarding, DriverFacts
from hitchhike_ros.protocol.driver.offers import RIDE_TOLERANCE_M, Refusal, answer, promise, verdict
from hitchhike_ros.protocol.driver.route import Route
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.driver.table import (
    ROWS,
    asker,
    behind,
    late,
    leaving,
    sender,
    silent,
    stands_before_goal,
)
from hitchhike_ros.protocol.events import Award, GoalGiven
from hitchhike_ros.protocol.machine import Machine
from hitchhike_ros.protocol.matching import Planner
from hitchhike_ros.protocol.messages import (
    Accept,
    Ack,
    Aligned,
    Coupled,
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
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.protocol.status import ANY_MARKER, GoalCommand, ModuleSwitches, RideStatus, ServoCommand

# The driver aligns this well, so that the hitchhiker finds the marker in front of it (chosen).
_ALIGN_TOLERANCE_M, _ALIGN_TOLERANCE_RAD = 0.08, 0.06
# Where it stops before a goal does not matter more exactly (chosen).
_STOP_TOLERANCE_M = 0.2
# Who has the goal is looked at so often (s, chosen: twice a beacon).
_SETTLE_S = 0.5

S = DriverState


class DriverMachine(Machine[DriverState, DriverFacts]):
    """Drives to the robot's own goal and takes hitchhikers along where that is allowed.

    ``planner`` gives the path (N, 2) in ``map`` between two poses and raises PlanningError where there is none;
    ``marker_pose`` is the marker on the own back in base_footprint; ``radius_m`` is the robot's; ``neighbours`` are the
    robots in reach.
    """

    INITIAL: ClassVar = S.IDLE
    ROWS: ClassVar = ROWS

    def __init__(
        self,
        robot_id: str,
        params: HitchhikingParameters,
        sites: Sites,
        planner: Planner,
        marker_pose: Pose2D,
        radius_m: float = 0.3,
        neighbours: Neighbours | None = None,
    ) -> None:
        rear_marker = RearMarker(
            marker_id=params.marker_id, marker_size_m=params.marker_size_m, marker_pose=marker_pose
        )
        super().__init__(
            DriverFacts(
                robot_id=robot_id,
                params=params,
                sites=sites,
                planner=planner,
                rear_marker=rear_marker,
                neighbours=neighbours or Neighbours(),
                radius_m=radius_m,
            )
        )
        self.robot_id = robot_id
        self.params = params
        self.refused = 0  # locks of offers that were not made, or no longer hold
        self._goals = 0

    # What its modules and others are told.

    @property
    def offer(self) -> Offer | None:
        """The ride of the first hitchhiker."""
        return None if self.facts.first is None else self.facts.first.offer

    @property
    def rides(self) -> tuple[Rider, ...]:
        """The rides that are on or about to be, in the order of the riders' places."""
        return self.facts.riders

    def rider(self, hitchhiker: str) -> Rider | None:
        """How the ride with this hitchhiker fares, where there is one."""
        return next((rider for rider in self.rides if rider.offer.hitchhiker == hitchhiker), None)

    @property
    def riders(self) -> tuple[str, ...]:
        """Who rides or is about to, in the order of their places."""
        return tuple(rider.offer.hitchhiker for rider in self.facts.riders)

    @property
    def goal(self) -> GoalCommand | None:
        """Where navigation has to go now; None is standing still."""
        f = self.facts
        if f.state is S.NAVIGATING and f.route is not None:
            g = f.route.goal
            return GoalCommand(f.route.order, g.x, g.y, g.theta)
        if f.state is S.YIELDING and f.route is not None and f.yields is not None and not stands_before_goal(f):
            p = f.yields.place.pose
            return GoalCommand(f"{f.route.order}-{f.orders}", p.x, p.y, p.theta, _STOP_TOLERANCE_M, math.pi)
        if f.state is S.ALIGNING and self.offer is not None:
            p = self.offer.point.aligning_pose
            order = f"{self.offer.ride_id}-align"
            return GoalCommand(order, p.x, p.y, p.theta, _ALIGN_TOLERANCE_M, _ALIGN_TOLERANCE_RAD)
        if f.state is S.DRIVING and (leaves := f.convoy.next_to_leave) is not None:
            order, p = f"{leaves.offer.ride_id}-ride", leaves.offer.decouple_pose
            if f.yields is not None:
                order, p = f"{order}-{f.orders}", f.yields.place.pose
            return GoalCommand(order, p.x, p.y, p.theta, RIDE_TOLERANCE_M, math.pi)
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
        marker = self.facts.sites.marker(self.offer.point.marker)
        return None if marker is None else ServoCommand("observe", marker.id, marker.size_m)

    @property
    def speed_limit_mps(self) -> float:
        return self.facts.speed_limit_mps

    @property
    def ride(self) -> RideStatus | None:
        rider = self.facts.first
        if rider is None:
            return None
        offer = rider.offer
        return RideStatus(offer.ride_id, self.robot_id, offer.hitchhiker, offer.ride_m, rider.ridden_m)

    @property
    def free_places(self) -> int:
        return self.facts.free_places

    @property
    def stops_at(self) -> Pose2D | None:
        """Where it will stand: at its goal, or before it; None without one."""
        f = self.facts
        if f.state is S.YIELDING and f.yields is not None:
            return f.yields.place.pose
        return None if f.route is None else f.route.goal

    @property
    def left_m(self) -> float | None:
        """How long the way to the goal is; None where it does not drive there now, or does not know."""
        f, left_m = self.facts, self.facts.navigation.left_m
        if left_m is None or f.route is None or f.state not in (S.NAVIGATING, S.YIELDING, S.DRIVING):
            return None
        towards = self._towards()  # the end of a ride may be on the way
        return left_m if towards is None else left_m + distance(towards, f.route.goal)

    def announced(self) -> tuple[Waypoint, ...]:
        """The way on which it would take a hitchhiker along, and when."""
        return self.facts.announced()

    # Goals.

    def _start(self, event: GoalGiven) -> None:
        f = self.facts
        f.navigation.forget()
        f.set_down, f.stands_since = event.set_down, math.inf
        self._order(event.goal)
        self.ending = event.why

    def _set_out(self) -> None:
        """To the own goal again."""
        assert self.facts.route is not None
        self._order(self.facts.route.goal)

    def _order(self, goal: Pose2D) -> None:
        """A new order to navigation, with an id that no earlier one had, not even one of before a restart."""
        f = self.facts
        self._goals += 1
        f.settled = f.yields = None
        f.route = Route(goal, self._order_id(), f.planner, f.sites, f.params)

    def _order_id(self) -> str:
        return f"{self.robot_id}-{self._goals}-{self.facts.now:.1f}"

    def _forget_goal(self) -> None:
        self.facts.route = self.facts.settled = self.facts.yields = None

    def _watch_navigation(self) -> None:
        f, goal, towards = self.facts, self.goal, self._towards()
        if goal is None or towards is None:
            f.navigation.pause()
        else:
            f.navigation.note(f.situation.navigation, goal.id, towards, f.estimate, f.now)

    def _pause_watch(self) -> None:
        self.facts.navigation.pause()

    def _note_outcome(self) -> None:
        """What comes next is new."""
        assert self.facts.navigation.ending is not None
        self.ending = self.facts.navigation.ending
        self.facts.navigation.forget()

    def _towards(self) -> Pose2D | None:
        """Where navigation is to bring it in the end, wherever it stops on the way."""
        f = self.facts
        if f.state in (S.NAVIGATING, S.YIELDING):
            return None if f.route is None else f.route.goal
        if f.state is S.DRIVING:
            leaves = f.convoy.next_to_leave
            return None if leaves is None else leaves.offer.decouple_pose
        return None if self.offer is None else self.offer.point.aligning_pose

    # A goal that another robot has.

    def _settle(self) -> None:
        towards = self._towards()
        if towards is not None and self._every(_SETTLE_S, "settle"):
            self.facts.settled = self.facts.settlement(towards)

    def _yield(self) -> None:
        f = self.facts
        f.yields, f.orders = f.settled, f.orders + 1

    def _stand(self) -> None:
        self.facts.stands_since = min(self.facts.stands_since, self.facts.now)

    def _go_to_goal(self) -> None:
        """It has become free: an order of its own, under which navigation has not been blocked yet."""
        f = self.facts
        assert f.route is not None
        self._goals += 1
        f.yields, f.route.order = None, self._order_id()

    def _note_taken(self) -> None:
        f = self.facts
        yields = f.settled or f.yields
        assert yields is not None and f.route is not None
        if f.estimate is not None:
            place = replace(yields.place, before_m=distance(f.estimate.pose, f.route.goal))
            yields = replace(yields, place=place)
        self.ending = Ending(self.ending.reason, yields.says())

    def _tell(self) -> None:
        self._report(self.ending)

    # Offers.

    def _offer(self) -> None:
        """P17 Algorithm 1, lines 5 to 12."""
        f, offer = self.facts, verdict(self.facts)
        assert isinstance(offer, Offer)
        f.convoy = Convoy(f.rear_marker)
        f.convoy.add(Rider(offer, f.event.rear_marker))
        # The same request may be offered a ride again after the first offer has expired.
        self._take_back_last_words(offer.ride_id)
        self._report(f"Offering {offer.hitchhiker} a ride of {offer.ride_m:.1f} m")
        self._repeat_accept()

    def _answer(self, request: Request) -> None:
        try:
            offer, waypoints = answer(self.facts, request)
        except Refusal as no:
            self._deny(request, no.reason)
            return
        promise(self.facts, offer)
        self._send_accept(offer, waypoints)

    def _refuse_later(self, request: Request) -> None:
        self._deny(request, Reason.ALREADY_DRIVING)

    def _repeat_accept(self) -> None:
        if self._every(self.params.repeat_period_s, "accept"):
            self._accept()

    def _accept(self) -> None:
        assert self.offer is not None
        self._send_accept(self.offer)

    def _send_accept(self, offer: Offer, path: tuple[Waypoint, ...] = ()) -> None:
        f = self.facts
        pose = f.estimate.pose if f.estimate is not None else offer.point.aligning_pose
        last = f.riders[-1] if f.riders else None
        ahead = last.rear_marker if last is not None and last.offer is not offer else None
        rear_marker = ahead or f.rear_marker
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
                goal=None if f.route is None else f.route.goal,
            )
        )

    def _deny(self, message: Request | Lock, reason: Reason) -> None:
        self._send(Deny(robot_id=self.robot_id, to=message.robot_id, ride_id=message.ride_id, reason=str(reason)))

    # Locks.

    def _board_here(self) -> None:
        self.facts.boarding = Boarding()

    def _board_there(self, lock: Lock) -> None:
        """A hitchhiker that was answered from afar says where they meet (P18 §4)."""
        f, offer = self.facts, verdict(self.facts)
        assert isinstance(offer, Offer)
        f.boarding = Boarding(offer.stretch.begin_m)
        within_s = self.params.patience_s + 2.0 * f.to_board_m() / self.params.cruise_speed_mps
        f.boarding = Boarding(offer.stretch.begin_m, within_s)
        f.convoy = Convoy(f.rear_marker)
        self._take_along(lock)

    def _take_along(self, lock: Lock) -> None:
        f, offer = self.facts, verdict(self.facts)
        assert isinstance(offer, Offer)
        f.promised.pop((lock.robot_id, lock.ride_id), None)
        may_pass = f.state is not S.ALIGNED  # there one may be coupling already
        f.convoy.add(Rider(offer, lock.rear_marker, f.now + lock.in_s), may_pass)
        self._take_back_last_words(offer.ride_id)
        self._report(f"Meeting {offer.hitchhiker} for a ride of {offer.ride_m:.1f} m")

    def _confirm_lock(self, lock: Lock) -> None:
        """Also of one that says anew when it will be there."""
        f, rider = self.facts, self._rider(lock)
        rider.due, rider.heard_at = f.now + lock.in_s, f.now
        place, in_s = f.convoy.place(rider), f.to_board_s()
        ride_m = rider.offer.ride_m
        self._send(Ack(**self._to(rider), of=lock.type, acknowledges=lock.seq, place=place, in_s=in_s, ride_m=ride_m))

    def _refuse_lock(self, lock: Lock) -> None:
        no = verdict(self.facts)
        assert isinstance(no, Refusal)
        self.refused += 1
        self._deny(lock, no.reason)

    # Coupling.

    def _invite(self) -> None:
        f = self.facts
        rider, estimate = f.convoy.next_to_couple, f.estimate
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
                place=f.convoy.place(rider),
                ahead=f.convoy.ahead_of(rider),
            )
        )

    def _couple(self, coupled: Coupled) -> None:
        rider = self._rider(coupled)
        rider.coupled, rider.gap_m, rider.acked_at, rider.following = True, coupled.gap_m, self.facts.now, True

    def _pull_away(self) -> None:
        self.facts.navigation.forget()
        stretch = self.facts.riders[0].offer.stretch
        self.facts.odometer = Odometer(stretch.line, stretch.begin_m)

    # The ride.

    def _inform(self, coupled: Coupled) -> None:
        """The message of every δ seconds also answers a *Coupling successful* that is repeated."""
        self._inform_one(self._rider(coupled))

    def _inform_all(self) -> None:
        """The message of every δ seconds (P17 §4); those that leave are told another."""
        if self._every(self.params.update_period_s, "driver"):
            for rider in self.facts.convoy.coupled:
                if not rider.leaving:
                    self._inform_one(rider)

    def _inform_one(self, rider: Rider) -> None:
        situation = self.facts.situation
        if situation.estimate is None:
            return
        self._every(self.params.update_period_s, "driver")
        speed_mps = situation.speed_mps if math.isfinite(situation.speed_mps) else 0.0
        self._send(Driver(**self._to(rider), **self._state_fields(rider), v=speed_mps))

    def _hear(self, ack: Ack) -> None:
        self._rider(ack).hear(ack, self.facts.now)

    def _count_metres(self) -> None:
        f = self.facts
        if f.estimate is not None:
            f.convoy.note(f.estimate)
            f.convoy.credit(f.odometer.step(f.estimate.pose))

    def _wait(self) -> None:
        self.facts.convoy.waits_since = self.facts.now

    # Its end.

    def _let_leave(self) -> None:
        """At the end of the ride all of it has been ridden, but for what navigation's tolerance left."""
        f = self.facts
        if f.estimate is not None:
            f.convoy.credit(f.odometer.step(f.estimate.pose, last=True))
        f.convoy.let_leave()
        for rider in f.convoy.leaving:
            if rider.left_m <= 2.0 * RIDE_TOLERANCE_M:
                rider.ridden_m = rider.offer.ride_m

    def _hand_over(self) -> None:
        self._inform_all()
        f = self.facts
        if f.estimate is not None:
            f.convoy.note(f.estimate)
        standing = f.situation.stands(self.params.standstill_mps, self.params.standstill_rps)
        if standing and f.estimate is not None and self._every(self.params.repeat_period_s, "decouple"):
            for rider in f.convoy.leaving:
                self._send(Decouple(**self._to(rider), **self._state_fields(rider)))

    def _complete(self) -> None:
        """A ride that ends early, as another robot stands where it was to end, says so."""
        f, ending = self.facts, Ending(Reason.RIDE_COMPLETED)
        if f.yields is not None and any(rider.left_m > 0.0 for rider in sender(f)):
            ending = ending.adding(str(Ending(Reason.GOAL_TAKEN, f.yields.says())))
        self._finish(sender(f), ending, tell=False)

    def _end_rides(self) -> None:
        """Whatever the machine's ending says."""
        self._finish(self.facts.convoy, self.ending)

    def _drop_silent(self) -> None:
        self._finish(silent(self.facts), Ending(Reason.RIDER_GONE))

    def _drop_late(self) -> None:
        self._finish(late(self.facts), Ending(Reason.LARGE_COUPLE_TIME))

    def _drop_lost(self) -> None:
        self._finish(behind(self.facts), Ending(Reason.RIDER_LOST))

    def _drop_leaving(self) -> None:
        self._finish(leaving(self.facts), Ending(Reason.NO_HANDOVER))

    def _drop_asker(self) -> None:
        self._finish(asker(self.facts), Ending(Reason.ASKED_ANEW), tell=False)

    def _drop_sender(self, message: RequestCancel | Terminate) -> None:
        self._finish(sender(self.facts), _why(message), tell=False)

    def _note_why(self, message: RequestCancel | Terminate) -> None:
        self.ending = _why(message)

    # What several actions do.

    def _concerns(self, message: Message) -> bool:
        """While engaged only hitchhikers of the present rides are heard."""
        if isinstance(message, Request | Lock):
            return True
        return self.state in ENGAGED and self.facts.convoy.find(message) is not None

    def _rider(self, message: Message) -> Rider:
        rider = self.facts.convoy.find(message)
        assert rider is not None
        return rider

    def _to(self, rider: Rider) -> dict[str, Any]:
        return {"robot_id": self.robot_id, "to": rider.offer.hitchhiker, "ride_id": rider.offer.ride_id}

    def _state_fields(self, rider: Rider) -> dict[str, Any]:
        f = self.facts
        assert f.estimate is not None
        f.convoy.note(f.estimate)
        estimate = f.convoy.pose_ahead_of(rider, f.estimate, self.params.mounting)
        return {
            "x": estimate.pose.x,
            "y": estimate.pose.y,
            "theta": estimate.pose.theta,
            "sigma": covariance_rows(estimate.covariance),
            "new_obstacles": NewObstacles(obstacles=f.situation.obstacles),
            "ridden_m": rider.ridden_m,
            "place": f.convoy.place(rider),
            "ahead": f.convoy.ahead_of(rider),
            "age_s": max(0.0, f.now - estimate.stamp),
        }

    def _finish(self, riders: Iterable[Rider], ending: Ending, tell: bool = True) -> None:
        """The ride is over for some, whatever the cause; κ · metres ridden are credited once (P17 §5)."""
        for rider in riders:
            if tell:
                end = Terminate(**self._to(rider), reason=str(ending))
                self._send_last_word(end, self.params.repeat_period_s, self.params.confirm_timeout_s)
            if rider.ridden_m > 0.0:
                offer, points = rider.offer, self.params.award_rate * rider.ridden_m
                self._effects.append(Award(offer.ride_id, offer.hitchhiker, rider.ridden_m, points))
            self._report(ending)
            self.facts.convoy.remove(rider)


def _why(message: RequestCancel | Terminate) -> Ending:
    if isinstance(message, Terminate):
        return Ending.told(message.reason)
    return Ending(Reason.REQUEST_CANCELLED)
