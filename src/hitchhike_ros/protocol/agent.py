"""One robot in the protocol: it rides where it may, drives where it must, and tells its modules what is on.

In a network (P18) it may ride several times on the way to one goal. The next driver is booked while the present ride is
still on, by a second hitchhiker machine that asks from where that ride will end; whoever comes first waits (P18 §6).
"""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.itinerary import SoloMetres
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.common_goal import same_place
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import Effect, GoalCancelled, GoalGiven, Report, Send, Situation, Tick
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.matching import Planner, shared_stretch, solo_metres, way_of
from hitchhike_ros.protocol.messages import Beacon, Message, RearMarker, Request
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import TIME_CRITICAL_PRIORITY, HitchhikingParameters
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.protocol.status import Status

# In these phases of a ride it looks for the driver of the next one.
_BOOKS = (Phase.MEETING, Phase.COUPLED, Phase.HANDING_OVER)
# Who has asked the better profile for a ride gives it so many windows to become a driver (chosen).
_REVERSAL_WINDOWS = 3.0


class Agent:
    """Owns the robot's goal and the machines of both roles, of which one at a time brings the robot to it.

    ``metres`` of driving alone are what itineraries are planned with; by default every way is planned.
    """

    def __init__(
        self,
        robot_id: str,
        params: HitchhikingParameters,
        sites: Sites,
        planner: Planner,
        marker_pose: Pose2D,
        camera: tuple[float, float],
        radius_m: float,
        metres: SoloMetres | None = None,
    ) -> None:
        self.robot_id = robot_id
        self.params = params
        self._sites, self._camera = sites, camera
        self._planner, self._radius_m = planner, radius_m
        self._metres = metres or solo_metres(planner)
        self._rear_marker = RearMarker(
            marker_id=params.marker_id, marker_size_m=params.marker_size_m, marker_pose=marker_pose
        )
        self.neighbours = Neighbours()
        self.hitchhiker = self._new_hitchhiker()
        self.booking: HitchhikerMachine | None = None  # of the ride after this one
        self.driver = DriverMachine(robot_id, params, sites, planner, marker_pose, radius_m, self.neighbours)
        self._situation = Situation()
        self._goal: Pose2D | None = None  # the newest that was given, and not withdrawn
        self._waits = False  # with the goal, until it knows where it is and no ride is on
        self._waits_since = math.inf  # for its pose
        self._refused: Ending | None = None  # why it did not set out for the newest goal
        self._asks = 0  # on the way to the present goal
        self._driven_by = ""  # on the way to the present goal
        self._told_of = ""  # the newest ride of which it was told that both have one goal
        self._reversed_at = -math.inf
        self._booked_for = ""  # the ride after which another one was looked for
        self._beacon_due = self._forget_due = 0.0
        self._ticked_at = math.inf

    @property
    def rides(self) -> bool:
        """Whether it is a hitchhiker, from its request on."""
        return self.hitchhiker.state is not HitchhikerState.IDLE

    @property
    def goal(self) -> Pose2D | None:
        """Where it is on its way to; None where it is at rest, or has not set out yet."""
        return self._goal if self._set_out else None

    @property
    def _set_out(self) -> bool:
        return not self._waits and (self.rides or self.driver.state is not DriverState.IDLE)

    @property
    def outcome(self) -> Ending | None:
        """How the last goal ended; None while the robot is on its way to one."""
        return None if self._waits or self._set_out else self._refused or self.driver.ending

    def step(self, event: object, now: float) -> list[Effect]:
        """Take a GoalGiven, GoalCancelled, Tick or network Message, and say what is to be done."""
        if isinstance(event, Beacon):  # first, as by far the most frequent
            self.neighbours.hear(event, now)
            return []
        if isinstance(event, GoalGiven):
            effects = self._drop_goal(now)
            self._goal, self._waits, self._asks = event.goal, True, 0
            return effects
        if isinstance(event, GoalCancelled):
            return self._drop_goal(now)
        if isinstance(event, Tick):
            return self._tick(event, now)
        assert isinstance(event, Message)
        return self._hear(event, now)

    def next_due(self, now: float) -> float:
        """When it wants its next Tick while nothing arrives, in s; ``now`` or earlier: at once.

        That is when it looks at its situation again, and never later than :meth:`next_deadline`.
        """
        if now < self._ticked_at:  # never ticked, or time jumped back
            return now
        return min(self._ticked_at + self._look_period_s(), self.next_deadline())

    def next_deadline(self) -> float:
        """When it has to do something even if nothing changes around it, but for its beacon, in s; inf: never."""
        return min(self.hitchhiker.next_deadline(), self.driver.next_deadline())

    def status(self, now: float, others: bool = True) -> Status:
        """What the modules have to do now; ``others``: those that are on are told where other robots are."""
        machine = self.hitchhiker if self.rides else self.driver
        role = "hitchhiker" if self.rides else ("driver" if self.driver.offer is not None else "none")
        # A driver without a rider stands there and waits, so it is remembered for as long.
        p, servo, driver = self.params, machine.servo, self.hitchhiker.driver
        asked = others and (machine.modules.OBS or machine.modules.MAP)
        robots = self.neighbours.robots(now, p.robot_timeout_s, driver, p.lost_timeout_s) if asked else ()
        return Status(
            time_stamp=now,
            robot_id=self.robot_id,
            role=role,
            state=machine.state.value,
            reason=str(self._refused or machine.ending),
            modules=machine.modules,
            goal=self.hitchhiker.way if self.rides else self.driver.goal,
            speed_limit_mps=self.driver.speed_limit_mps,
            servo=servo,
            following=self._situation.following if servo is not None and servo.task == "follow" else "",
            ride=machine.ride,
            convoy=self.driver.riders,
            robots=robots,
        )

    def _hear(self, message: Message, now: float) -> list[Effect]:
        self.neighbours.hear(message, now)
        effects = self.hitchhiker.step(message, now)
        if self.booking is not None:
            effects += self.booking.step(message, now)
        if isinstance(message, Request) and self._rather_rides(message, now):
            return effects + self._reverse_roles(message, now)
        if not self.rides:
            effects += self.driver.step(message, now)
        return effects

    def _look_period_s(self) -> float:
        p, phase = self.params, (self.hitchhiker if self.rides else self.driver).state.phase
        if self.rides and phase is Phase.COUPLED and self._situation.following == "following":
            return p.riding_look_period_s
        return p.idle_look_period_s if self.outcome is not None or phase is Phase.ASKING else p.look_period_s

    def _tick(self, tick: Tick, now: float) -> list[Effect]:
        self._situation, self._ticked_at = tick.situation, now
        rode = self.rides
        effects = self.hitchhiker.step(tick, now) + self.driver.step(tick, now)
        effects += self._book(now)
        if rode and not self.rides and self._goal is not None and not self._waits:
            effects += self._go_on(self._goal, now)
        if self._waits and self._goal is not None and not self.rides:
            effects += self._set_out_for(self._goal, now)
        effects += self._tell_common_goal()
        if now >= self._forget_due:
            longest_s = max(self.params.robot_timeout_s, self.params.lost_timeout_s)
            self._forget_due = now + longest_s
            self.neighbours.forget(now - longest_s)
        beacon = self._beacon() if now >= self._beacon_due or self._goal_is_news() else None
        if beacon is not None:
            self._beacon_due = now + self.params.beacon_period_s
            self.driver.facts.said = beacon
            effects.append(Send(beacon))
        return effects

    def _goal_is_news(self) -> bool:
        """Whether others, who may want to stand there too, have been told of another goal, or of none."""
        said = self.driver.facts.said
        return said is not None and said.goal != self._stops_at

    def _new_hitchhiker(self) -> HitchhikerMachine:
        return HitchhikerMachine(
            self.robot_id,
            self.params,
            self._sites,
            self._camera,
            self._rear_marker,
            self.neighbours,
            self._metres,
            self._planner,
        )

    def _set_out_for(self, goal: Pose2D, now: float) -> list[Effect]:
        """Begin, once the robot knows where it is; a pose is awaited for a while, as after a start."""
        if self._situation.estimate is not None:
            self._waits = False
            return self._begin(goal, now)
        self._waits_since = min(self._waits_since, now)
        if now - self._waits_since < self.params.localize_timeout_s:
            return []
        self._goal, self._waits = None, False
        self._refused = Ending(Reason.NOT_LOCALIZED, f"no pose for {self.params.localize_timeout_s:g} s")
        return [Report(str(self._refused), self._refused.reason)]

    def _begin(self, goal: Pose2D, now: float) -> list[Effect]:
        return self._ask(goal, now) if self._wants_ride(goal) else self.driver.step(GoalGiven(goal), now)

    def _ask(self, goal: Pose2D, now: float) -> list[Effect]:
        self._asks += 1
        return self.hitchhiker.ask(goal, now)

    def _go_on(self, goal: Pose2D, now: float) -> list[Effect]:
        """After a ride, or after none: with the next driver, with one that is asked now, or alone."""
        booked, self.booking = self.booking, None
        if booked is not None and booked.state is HitchhikerState.AWAITING_ALIGNED:
            booked.can_start_in(0.0)
            self.hitchhiker = booked
            return []
        effects = [] if booked is None else booked.step(GoalCancelled(), now)
        rode = self.hitchhiker.rode
        self._driven_by = self.hitchhiker.driver if rode else ""
        if rode and self.params.mode == "network" and self._asks < self.params.max_asks and self._wants_ride(goal):
            return effects + self._ask(goal, now)
        effects += self.driver.step(GoalGiven(goal, self.hitchhiker.ending, set_down=rode), now)
        # At once: where its driver stands on the goal nothing is driven any more.
        return effects + self.driver.step(Tick(self._situation), now)

    @property
    def _stops_at(self) -> Pose2D | None:
        """Where it will stand; None where it is at rest, or has not set out yet."""
        return self.goal if self.rides or self.goal is None else self.driver.stops_at

    def _tell_common_goal(self) -> list[Effect]:
        """Before a ride to a goal that both have, both know who will stand there."""
        offer, goal = self.hitchhiker.offer, self.goal
        if offer is not None:
            pair = offer.robot_id, self.robot_id, offer.ride_id
            its_goal = offer.goal
        elif (rider := next(iter(reversed(self.driver.rides)), None)) is not None:
            pair = self.robot_id, rider.offer.hitchhiker, rider.offer.ride_id
            its_goal = None
        else:
            return []
        driver, hitchhiker, ride_id = pair
        if goal is None or ride_id == self._told_of:
            return []
        other = self.neighbours.beacon(driver if self.rides else hitchhiker)
        if its_goal is None and other is not None:
            its_goal = other.goal
        other_radius_m = self._radius_m if other is None else other.radius_m
        if not same_place(goal, self._radius_m, its_goal, other_radius_m):
            return []
        self._told_of = ride_id
        ending = Ending(Reason.SAME_GOAL, f"{driver} keeps it, {hitchhiker} ends behind it")
        return [Report(str(ending), ending.reason)]

    def _book(self, now: float) -> list[Effect]:
        """Look for the driver after this one in time, where the itinerary has another ride."""
        current = self.hitchhiker
        meeting, booking = current.meeting, self.booking
        if meeting is None or self.goal is None:
            return []
        ready_in_s = max(current.ride_ends_in_s(), 1e-3)
        there = PoseEstimate(now, Pose2D(*meeting.leave), np.zeros((3, 3)))
        tick = Tick(Situation(estimate=there))
        if booking is None and meeting.more and current.state.phase in _BOOKS and self._booked_for != current.ride_id:
            self._booked_for = current.ride_id
            self.booking = booking = self._new_hitchhiker()
            return booking.step(tick, now) + booking.ask(self.goal, now, ready_in_s=ready_in_s)
        if booking is None:
            return []
        booking.can_start_in(ready_in_s)
        effects = booking.step(tick, now)
        if booking.state is HitchhikerState.IDLE:
            self.booking = None
        return effects

    def _rather_rides(self, request: Request, now: float) -> bool:
        """Whether it asks the one that asks for a ride instead: that one has the better profile (role reversal)."""
        own, goal, here = self.params, self.goal, self._situation.estimate
        willing = own.mode == "network" and own.role_reversal and own.may_ride and self._asks < own.max_asks
        if not willing or self.rides or self.driver.state is not DriverState.NAVIGATING:
            return False
        if goal is None or here is None or request.profile <= own.profile or request.in_s > 0.0:
            return False
        if max(own.priority, request.priority) >= TIME_CRITICAL_PRIORITY or now < self._reversed_at + own.patience_s:
            return False
        try:
            theirs, way = OwnPath(way_of(request, self._planner)), self._planner(here.pose, goal)
        except PlanningError:
            return False  # then one of them goes nowhere
        self._reversed_at = now  # it does not look at that again for a while
        return shared_stretch(theirs, way, self._sites, own) is not None

    def _reverse_roles(self, request: Request, now: float) -> list[Effect]:
        """It asks that one alone, and gives it the time to give up its own question."""
        goal = self._goal
        assert goal is not None
        effects: list[Effect] = [Report(str(Reason.ROLES_REVERSED), Reason.ROLES_REVERSED)]
        effects += self.driver.step(GoalCancelled(), now)
        self._asks += 1
        window_s = _REVERSAL_WINDOWS * self.params.offer_window_s
        return effects + self.hitchhiker.ask(goal, now, request.robot_id, window_s)

    def _drop_goal(self, now: float) -> list[Effect]:
        self._goal, self._waits, self._waits_since, self._refused = None, False, math.inf, None
        self._driven_by = ""
        effects = self.hitchhiker.step(GoalCancelled(), now) + self.driver.step(GoalCancelled(), now)
        if self.booking is not None:
            booking, self.booking = self.booking, None
            effects += booking.step(GoalCancelled(), now)
        return effects

    def _wants_ride(self, goal: Pose2D) -> bool:
        estimate = self._situation.estimate
        if not self.params.may_ride or self.params.priority >= TIME_CRITICAL_PRIORITY or estimate is None:
            return False
        try:
            return path_length(self._planner(estimate.pose, goal)) >= self.params.min_ride_m
        except PlanningError:
            return False  # navigation will find out, and say why

    def _beacon(self) -> Beacon:
        estimate = self._situation.estimate
        state = self.hitchhiker.state if self.rides else self.driver.state
        in_network = self.params.mode == "network" and not self.rides
        return Beacon(
            robot_id=self.robot_id,
            state=state.value,
            profile=self.params.profile,
            priority=self.params.priority,
            radius_m=self._radius_m,
            pose=None if estimate is None else estimate.pose,
            goal=self._stops_at,
            path=self.driver.announced() if in_network else (),
            free_places=self.driver.free_places if in_network and self.goal is not None else 0,
            safe_speed_mps=self.params.safe_speed_mps,
            left_m=None if self.rides else self.driver.left_m,
            driver=self.hitchhiker.driver if self.rides and self.hitchhiker.rode else self._driven_by,
        )
