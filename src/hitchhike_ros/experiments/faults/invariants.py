"""What must hold after every event in a fleet, whatever its network and its robots suffer.

It is the referee's view: the machines of all robots and the bodies at once, which no robot has. Bounds follow from the
robots' own parameters; the slack is for the period in which they look again and for messages under way.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hitchhike_ros.protocol.driver.convoy import Rider
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import Award, Effect, GoalGiven, Report, Send
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.messages import (
    Accept,
    Ack,
    Beacon,
    Decouple,
    Deny,
    Driver,
    Lock,
    Message,
    RequestCancel,
    Terminate,
)
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.simulation.grid.robot import GridRobot
from hitchhike_ros.simulation.grid.world import GridWorld

# A driver has its riders behind it, and a hitchhiker is on its ride.
_WITH_RIDER = (Phase.COUPLED, Phase.HANDING_OVER)
_ON_THE_RIDE = (Phase.COUPLED, Phase.RETURNING, Phase.HANDING_OVER)
_MAY_END = (Reason.GOAL_CHANGED, Reason.GOAL_STAYS_TAKEN)
# Around what appears on the way, and back to a corridor that it has left, a robot drives so many times the way at most.
_DETOUR = 2.0
# The states in which a robot asks for a ride, and those in which it is asked for one: each begins a new one.
_ASKS, _IS_ASKED = ("requesting",), ("offering", "aligning")
# Ways that a driver counts and its rider does not: it stops a little after it lost the rider, and localizes with noise.
_METRES, _METRES_SHARE = 3.0, 0.06
# Metres by which bodies may fall short of a ride that is completed: what is left for coupling, stopping, and noise.
_SHORT_M, _SHORT_SHARE = 1.5, 0.03
# Of a ride apart from its duration: questions, answers, last words, and as much again for luck.
_MESSAGES_A_RIDE = 120


class BrokenInvariantError(Exception):
    """An invariant does not hold: which, when, and for whom."""


@dataclass
class _Ride:
    """What the referee counts of a ride."""

    began: float
    last: float
    messages: int = 0
    awards: int = 0
    award_m: float = 0.0
    completed: bool = False
    told_m: float | None = None
    ridden_from: float | None = None
    ridden_m: float = 0.0
    crashed: bool = False


class Referee:
    """Observes a world; every event may raise BrokenInvariantError."""

    def __init__(self, world: GridWorld, slack_s: float) -> None:
        """``slack_s`` covers a period of the robots and the longest delay of the network."""
        self._world, self._slack_s = world, slack_s
        self._rides: dict[str, _Ride] = {}
        self._since: dict[tuple[str, ...], float] = {}
        self._offers: dict[tuple[str, str, str], float] = {}
        self._answered: set[tuple[str, str, str]] = set()
        self._owed: dict[str, set[str]] = defaultdict(set)  # boxes that a robot has acknowledged
        self._heard: dict[tuple[str, str, int], frozenset[str]] = {}
        self._goals: dict[str, tuple[float, float]] = {}  # since when a robot has its goal, and how far away that was
        self._ends_by: dict[str, float] = {}
        world.observers.append(self.see)

    def see(self, now: float, name: str, event: object, effects: Sequence[Effect]) -> None:
        """One event of one robot."""
        robot = self._world.robots[name]
        if event == "crash":
            self._forget(name)
            return
        self._note_goal(now, robot, event)
        if isinstance(event, Beacon):
            return  # changes nothing but what is remembered
        self._note(now, robot, event, effects)
        self._check_driver(now, robot)
        self._check_hitchhiker(now, robot)
        self._check_bounds(now)

    def end(self, limit_s: float) -> None:
        """When the run is over: everybody is there, boxes are in the maps, awards are right."""
        for name, robot in self._world.robots.items():
            if not robot.alive:
                continue
            if not robot.idle:
                self._fail(f"{name} has not come to its goal, nor said why, in {limit_s:.0f} s: {robot.status.state}")
            missing = self._owed[name] - set(robot.known)
            if missing:
                self._fail(f"{name} has acknowledged {', '.join(sorted(missing))}, which its map does not have")
            for trip in robot.trips:
                # Every place of the world can be reached, but for one that another robot has.
                if not trip.reached and trip.reason.reason not in _MAY_END:
                    self._fail(f"{name} gave up a goal: {trip.reason}")
        for ride_id, ride in self._rides.items():
            if ride.completed and ride.awards != 1:
                self._fail(f"{ride_id} was completed and credited {ride.awards} times")

    # What is noted.

    def _note(self, now: float, robot: GridRobot, event: object, effects: Sequence[Effect]) -> None:
        if isinstance(event, Accept):
            current = {machine.ride_id for machine in _hitchhikers(robot)}
            offer = (robot.name, event.robot_id, event.ride_id)
            if event.ride_id in current and offer not in self._answered:
                self._offers.setdefault(offer, now)
        elif isinstance(event, Deny):
            self._offers.pop((robot.name, event.robot_id, event.ride_id), None)  # taken back
        elif isinstance(event, Driver | Decouple):
            boxes = frozenset(box.id for box in event.new_obstacles.obstacles)
            self._heard[robot.name, event.robot_id, event.seq] = boxes
        elif isinstance(event, Terminate | RequestCancel):
            rider = robot.agent.driver.rider(event.robot_id)
            if rider is not None and rider.offer.ride_id == event.ride_id:
                self._fail(f"{robot.name} keeps {rider.offer.hitchhiker}, who has ended {event.ride_id}")
        for effect in effects:
            if isinstance(effect, Send):
                self._note_sent(now, robot, effect.message)
            elif isinstance(effect, Award):
                self._note_award(robot, effect)
            elif isinstance(effect, Report) and effect.reason is Reason.RIDE_COMPLETED:
                self._note_completed(robot, effects)

    def _note_goal(self, now: float, robot: GridRobot, event: object) -> None:
        """By when the goal under way has to end, by the timeouts of the robot itself."""
        trip = robot.trip
        if trip is None:
            self._goals.pop(robot.name, None)
            self._ends_by.pop(robot.name, None)
            return
        if event == "restart" or isinstance(event, GoalGiven) or robot.name not in self._goals:
            here = (robot.body.x, robot.body.y)
            way_m = self._world.paths.metres(here, (trip.goal.x, trip.goal.y), robot.known_ids)
            self._goals[robot.name] = now, way_m
        since, way_m = self._goals[robot.name]
        states = [state for time, state, _ in robot.history if time >= since]
        asks, asked = (sum(states.count(state) for state in of) for of in (_ASKS, _IS_ASKED))
        ends_s = self._alone_s(robot, way_m) + asks * self._ride_s(robot, way_m) + asked * self._carry_s(robot, way_m)
        self._ends_by[robot.name] = since + ends_s + self._slack_s

    def _note_sent(self, now: float, robot: GridRobot, message: Message) -> None:
        if isinstance(message, Beacon):
            return
        ride = self._rides.setdefault(message.ride_id, _Ride(now, now))
        ride.messages, ride.last = ride.messages + 1, now
        self._check_messages(message.ride_id, ride, robot)
        if isinstance(message, Ack) and message.of == Lock.type:
            if ride.ridden_from is not None and message.ride_m != ride.told_m:
                self._fail(f"{message.ride_id} is {message.ride_m:.1f} m now that it is ridden, not {ride.told_m} m")
            ride.told_m = message.ride_m
        if isinstance(message, Lock | RequestCancel | Terminate):
            self._offers.pop((robot.name, message.to, message.ride_id), None)
            self._answered.add((robot.name, message.to, message.ride_id))
        if isinstance(message, Ack) and message.of in (Driver.type, Decouple.type):
            self._owed[robot.name] |= self._heard.pop((robot.name, message.to, message.acknowledges), frozenset())

    def _note_award(self, robot: GridRobot, award: Award) -> None:
        ride = self._rides[award.ride_id]
        ride.awards, ride.award_m = ride.awards + 1, award.ride_m
        if ride.awards > 1:
            self._fail(f"{award.ride_id} is credited {ride.awards} times")
        hitchhiker = self._world.robots[award.hitchhiker]
        if ride.crashed or not hitchhiker.alive or ride.ridden_from is None:
            return
        ridden = ride.ridden_m
        # A rider that was lost stood while its driver went on for as long as it takes to notice.
        lost_m = robot.params.ride_speed_mps * (robot.params.ack_timeout_s + self._slack_s)
        if abs(award.ride_m - ridden) > _METRES + _METRES_SHARE * ridden + lost_m:
            self._fail(f"{award.ride_id}: {award.ride_m:.1f} m are credited, {ridden:.1f} m were ridden")
        params = robot.params
        if not math.isclose(award.points, params.award_rate * award.ride_m):
            self._fail(f"{award.ride_id}: {award.points} points for {award.ride_m:.1f} m")

    def _note_completed(self, robot: GridRobot, effects: Sequence[Effect]) -> None:
        early = any(isinstance(effect, Report) and effect.text != str(effect.reason) for effect in effects)
        for effect in effects:
            if isinstance(effect, Award):
                self._rides[effect.ride_id].completed = True
                if not early:  # nor said why
                    self._check_length(effect)
        if not any(isinstance(effect, Award) for effect in effects) and robot.status.role == "driver":
            self._fail(f"{robot.name} completes a ride that nobody credits")

    # What must hold.

    def _check_length(self, award: Award) -> None:
        """A ride that is completed is as long as was told when it was locked; how much longer, the award bounds."""
        ride = self._rides[award.ride_id]
        if ride.told_m is None or ride.crashed:
            return
        if not math.isclose(award.ride_m, ride.told_m, abs_tol=1e-6):
            self._fail(f"{award.ride_id}: {ride.told_m:.1f} m were told, {award.ride_m:.1f} m are credited")
        if not self._world.robots[award.hitchhiker].alive or ride.ridden_from is None:
            return
        if ride.ridden_m < ride.told_m - _SHORT_M - _SHORT_SHARE * ride.told_m:
            self._fail(f"{award.ride_id}: {ride.told_m:.1f} m were told, {ride.ridden_m:.1f} m were ridden")

    def _check_driver(self, now: float, robot: GridRobot) -> None:
        machine = robot.agent.driver
        riders = machine.rides
        if not riders:
            return
        names = [rider.offer.hitchhiker for rider in riders]
        if len(names) > robot.params.places or len(set(names)) < len(names):
            self._fail(f"{robot.name} has {robot.params.places} places and gives them to {names}")
        if machine.state.phase in _WITH_RIDER and machine.speed_limit_mps > robot.params.ride_speed_mps + 1e-9:
            self._fail(f"{robot.name} may go {machine.speed_limit_mps} m/s with a rider")
        for rider in riders:
            if rider.coupled:
                self._track_metres(rider)
                lost = machine.state is not DriverState.ALIGNED and not self._rider_knows(rider)
                self._lasts(now, lost, self._lost_s(robot), "driver", robot.name, rider.offer.ride_id)
        for rider in (rider for rider in riders if rider.coupled):
            hitchhiker = rider.offer.hitchhiker
            others = (other.agent.driver.rider(hitchhiker) for other in self._alive() if other is not robot)
            twice = any(other is not None and other.coupled for other in others)
            self._lasts(now, twice, self._lost_s(robot), "two drivers", hitchhiker)

    def _check_hitchhiker(self, now: float, robot: GridRobot) -> None:
        machine = robot.agent.hitchhiker
        if machine.state.phase in _ON_THE_RIDE and machine.offer is not None:
            driver = self._world.robots.get(machine.offer.robot_id)
            ride = self._rides.get(machine.ride_id)
            if ride is not None and ride.ridden_from is not None:
                robot.body.advance(now)
                ride.ridden_m = robot.body.odometer_m - ride.ridden_from
            rider = None if driver is None or not driver.alive else driver.agent.driver.rider(robot.name)
            knows = rider is not None and rider.offer.ride_id == machine.ride_id
            self._lasts(now, not knows, self._silent_s(robot), "rider", robot.name, machine.ride_id)

    def _check_bounds(self, now: float) -> None:
        for (name, driver, ride_id), since in list(self._offers.items()):
            robot = self._world.robots[name]
            if not robot.alive:
                del self._offers[name, driver, ride_id]
            elif now - since > 2.0 * robot.params.offer_window_s + robot.params.confirm_timeout_s + self._slack_s:
                self._fail(f"{name} has neither taken nor refused the offer of {driver} for {ride_id}")

        for name, ends_by in self._ends_by.items():
            robot = self._world.robots[name]
            if now > ends_by and robot.alive and robot.trip is not None:
                since, way_m = self._goals[name]
                self._fail(f"{name} is {robot.status.state} {now - since:.0f} s after it got a goal {way_m:.0f} m away")

    def _check_messages(self, ride_id: str, ride: _Ride, robot: GridRobot) -> None:
        p = robot.params
        a_second = 2.0 / p.update_period_s + 3.0 / p.request_period_s + 2.0 / p.repeat_period_s
        # Every robot that receives a question may answer it.
        answers = 1.0 + 0.3 * len(self._world.robots)
        bound = answers * (_MESSAGES_A_RIDE + 1.2 * a_second * (ride.last - ride.began))
        if ride.messages > bound:
            self._fail(f"{ride_id} has taken {ride.messages} messages in {ride.last - ride.began:.0f} s")

    # What that needs.

    def _lasts(self, now: float, wrong: bool, bound_s: float, *what: str) -> None:
        """What is wrong may be so for a while."""
        if not wrong:
            self._since.pop(what, None)
            return
        since = self._since.setdefault(what, now)
        if now - since > bound_s + self._slack_s:
            self._fail(f"{' '.join(what)}: not of one mind for {now - since:.1f} s")

    def _lost_s(self, robot: GridRobot) -> float:
        """So long may a driver under way take to notice that it has lost its rider."""
        p = robot.params
        # It may be waiting for another one that is lost, and then for this one.
        return p.ack_timeout_s + 2.0 * p.lost_timeout_s + p.decouple_timeout_s

    def _silent_s(self, robot: GridRobot) -> float:
        """So long may a rider take to notice that its driver is gone."""
        return robot.params.message_timeout_s + robot.params.settle_timeout_s

    def _alone_s(self, robot: GridRobot, way_m: float) -> float:
        """So long may a robot that drives alone take to its goal, or to say why it does not come there."""
        p = robot.params
        drive_s = _DETOUR * way_m / min(p.cruise_speed_mps, p.ride_speed_mps)
        return drive_s + p.progress_timeout_s + (p.exact_goal_wait_s if p.exact_goal else 0.0)

    def _ride_s(self, robot: GridRobot, way_m: float) -> float:
        """And so much longer with each ride that it asks for, waiting and meeting, riding and returning."""
        p = robot.params
        meet_s = p.patience_s + p.confirm_timeout_s + self._alone_s(robot, way_m) + p.max_align_s + p.max_couple_s
        return_s = p.seek_timeout_s + p.catch_up_timeout_s + 2.0 * p.localize_timeout_s + p.max_couple_s + p.part_s
        wait_s = p.lost_timeout_s + p.decouple_timeout_s + p.settle_timeout_s
        return p.patience_s + meet_s + _DETOUR * way_m / p.ride_speed_mps + return_s + wait_s

    def _carry_s(self, robot: GridRobot, way_m: float) -> float:
        """And with each that it is asked for: its riders may be lost one after another."""
        p = robot.params
        board_s = p.confirm_timeout_s + p.patience_s + self._alone_s(robot, way_m) + p.max_align_s
        couple_s = p.places * (p.patience_s + p.max_couple_s)
        return board_s + couple_s + _DETOUR * way_m / p.ride_speed_mps + p.places * self._lost_s(robot)

    def _rider_knows(self, rider: Rider) -> bool:
        robot = self._world.robots[rider.offer.hitchhiker]
        machine = robot.agent.hitchhiker
        return robot.alive and machine.ride_id == rider.offer.ride_id and machine.offer is not None

    def _track_metres(self, rider: Rider) -> None:
        robot = self._world.robots[rider.offer.hitchhiker]
        ride = self._rides.get(rider.offer.ride_id)
        if ride is not None and ride.ridden_from is None:
            ride.ridden_from = robot.body.odometer_m

    def _alive(self) -> Iterator[GridRobot]:
        return (robot for robot in self._world.robots.values() if robot.alive)

    def _forget(self, name: str) -> None:
        """A robot that crashes forgets everything but its map, and owes nobody anything."""
        self._offers = {key: since for key, since in self._offers.items() if name not in key[:2]}
        self._owed.pop(name, None)
        self._ends_by.pop(name, None)
        self._since = {what: since for what, since in self._since.items() if name not in what}
        for robot in self._world.robots.values():
            for rider in robot.agent.driver.rides:
                if name in (robot.name, rider.offer.hitchhiker) and rider.offer.ride_id in self._rides:
                    self._rides[rider.offer.ride_id].crashed = True

    def _fail(self, what: str) -> None:
        raise BrokenInvariantError(f"at {self._world.now:.2f} s: {what}")


def _hitchhikers(robot: GridRobot) -> Iterator[HitchhikerMachine]:
    yield robot.agent.hitchhiker
    if robot.agent.booking is not None:
        yield robot.agent.booking
