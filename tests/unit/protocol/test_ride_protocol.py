"""Two agents on a network that loses, doubles and delays: whatever happens, both reach their goals."""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import FloatArray, MarkerObservation, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import MessageError, UnreachableError
from hitchhike_ros.core.geometry import between, compose, distance, wrap_angle
from hitchhike_ros.protocol.agent import Agent
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import (
    Award,
    GoalCancelled,
    GoalGiven,
    NavigationReport,
    Report,
    Send,
    Situation,
    TakeObstacles,
    TakePose,
    Tick,
)
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.matching import Planner
from hitchhike_ros.protocol.messages import (
    MESSAGE_TYPES,
    Accept,
    Ack,
    Aligned,
    Beacon,
    Coupled,
    Decouple,
    Driver,
    Lock,
    Message,
    Request,
    encode,
)
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.protocol.status import GoalCommand, KnownRobot, ModuleSwitches, Status, decode_status, encode_status
from protocol_helpers import (
    BOXES,
    CAMERA,
    DRIVER,
    DRIVER_GOAL,
    MARKER_POSE,
    RIDER,
    RIDER_GOAL,
    SIGMA,
    SITES,
    WEST,
    corridor_path,
    messages,
)

DT = 0.2
Filter = Callable[[float, Message], bool]


@dataclass
class Robot:
    """A point that drives along the corridor by itself, or behind the marker, as its status says."""

    agent: Agent
    pose: Pose2D
    inbox: Inbox = field(init=False)
    estimate: Pose2D = field(init=False)
    map: set[Obstacle] = field(default_factory=set)
    speed: float = 0.0
    outbox: Outbox = field(default_factory=Outbox)
    report: NavigationReport | None = None
    path: list[tuple[float, float]] = field(default_factory=list)
    awards: list[Award] = field(default_factory=list)
    reports: list[str] = field(default_factory=list)
    statuses: list[Status] = field(default_factory=list)
    unlocalized: bool = False
    blind: bool = False

    def __post_init__(self) -> None:
        self.inbox, self.estimate = Inbox(self.agent.robot_id), self.pose

    def drive(self, status: Status, leader: Robot) -> None:
        """One step of motion; localization is dead reckoning without error, from whatever pose it was given."""
        old, ahead = self.pose, between(self.pose, compose(leader.pose, MARKER_POSE))
        if status.servo is not None and status.servo.task == "follow":
            gap = ahead.x - CAMERA[0]
            v = status.servo.feed_forward_mps + 1.5 * (gap - status.servo.gap_m) if self.sees(leader) else 0.0
            self._move(math.atan2(ahead.y, ahead.x), max(0.0, min(v, 0.65)) * DT)
        elif status.goal is not None and status.modules.PP and status.modules.OBS:
            self._navigate(status.goal, status.speed_limit_mps or 0.5)
        self.speed = distance(old, self.pose) / DT
        self.unlocalized = not status.modules.LZN
        if status.modules.LZN:
            self.estimate = compose(self.estimate, between(old, self.pose))
        if status.modules.MAP:
            self.map |= {box for box in BOXES if abs(box.x - self.pose.x) < 2.0}

    def _navigate(self, goal: GoalCommand, speed: float) -> None:
        if self.report is None or self.report.goal_id != goal.id:
            self.path = [(float(x), float(y)) for x, y in corridor_path(self.pose, goal.pose)[1:]]
        while self.path and math.dist(self.path[0], (self.pose.x, self.pose.y)) < 0.05:
            self.path.pop(0)
        self.report = NavigationReport(goal.id, "driving" if self.path else "arrived")
        if self.path:
            x, y = self.path[0][0] - self.pose.x, self.path[0][1] - self.pose.y
            self._move(wrap_angle(math.atan2(y, x) - self.pose.theta), min(speed * DT, math.hypot(x, y)))

    def _move(self, turn: float, metres: float) -> None:
        turn = max(-0.2, min(turn, 0.2))
        self.pose = compose(self.pose, Pose2D(theta=turn))
        if abs(turn) < 0.2:
            self.pose = compose(self.pose, Pose2D(x=metres))

    def sees(self, leader: Robot) -> bool:
        marker = between(compose(self.pose, Pose2D(*CAMERA)), compose(leader.pose, MARKER_POSE))
        in_view = abs(math.atan2(marker.y, marker.x)) < math.radians(30)
        return in_view and 0.2 < math.hypot(marker.x, marker.y) < 4.0 and not self.blind

    def situation(self, now: float, leader: Robot) -> Situation:
        seen = None
        if self.sees(leader):
            marker = between(self.pose, compose(leader.pose, MARKER_POSE))
            seen = MarkerObservation(now, 0, marker, np.array(SIGMA) / 100)
        estimate = None if self.unlocalized else PoseEstimate(now, self.estimate, np.array(SIGMA))
        boxes = tuple(sorted(self.map, key=lambda box: box.id))
        return Situation(estimate, self.speed, boxes, self.report, seen)


@dataclass
class World:
    """Both robots, the time, and the network between them."""

    seed: int = 0
    loss: float = 0.0
    double: float = 0.0
    delay_s: float = 0.0
    passes: Filter = lambda _now, _message: True
    now: float = 500.0
    until: float = math.inf
    lost_timeout_s: float = 40.0
    sent: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.flying: list[tuple[float, str]] = []

        def robot(name: str, start: Pose2D, goal: Pose2D, **params: Any) -> Robot:
            settings = HitchhikingParameters(**params, lost_timeout_s=self.lost_timeout_s)
            agent = Agent(name, settings, SITES, corridor_path, MARKER_POSE, CAMERA, 0.3)
            agent.step(GoalGiven(goal), self.now)
            return Robot(agent, start)

        self.rider = robot(RIDER, WEST.waiting_pose, RIDER_GOAL, profile=40.0)
        self.driver = robot(DRIVER, Pose2D(-3.0, 5.72), DRIVER_GOAL, profile=80.0, may_ride=False)
        self.robots = (self.rider, self.driver)

    def run(self, seconds: float = 250.0, until: Callable[[], bool] = lambda: False) -> World:
        """On until something, or for so long."""
        end = self.now + seconds
        while self.now < end and not until():
            self.now += DT
            arrived = [text for due, text in self.flying if due <= self.now]
            self.flying = [(due, text) for due, text in self.flying if due > self.now]
            for robot, other in (self.robots, self.robots[::-1]):
                for text in arrived:
                    try:
                        message = robot.inbox.receive(text)
                    except MessageError:
                        continue
                    if message is not None:
                        self.step(robot, message)
                self.step(robot, Tick(robot.situation(self.now, other)))
                robot.statuses.append(robot.agent.status(self.now))
            for robot, other in (self.robots, self.robots[::-1]):
                robot.drive(robot.statuses[-1], other)
        return self

    def step(self, robot: Robot, event: object) -> None:
        for effect in robot.agent.step(event, self.now):
            match effect:
                case Send(message):
                    self.transmit(robot.outbox.stamp(message, self.now))
                case TakePose(estimate):
                    robot.estimate = estimate.pose
                case TakeObstacles(boxes):
                    robot.map |= set(boxes)
                case Award():
                    robot.awards.append(effect)
                case Report(text):
                    robot.reports.append(text)

    def transmit(self, message: Message) -> None:
        self.sent[message.type] += 1
        for _ in range(2 if self.random.random() < self.double else 1):
            if self.random.random() >= self.loss and self.passes(self.now, message):
                self.flying.append((self.now + self.random.uniform(0.0, self.delay_s), encode(message)))

    @property
    def completed(self) -> bool:
        return all("Ride completed" in robot.reports for robot in self.robots)

    def come_to_an_end(self, rider_goal: Pose2D | None = RIDER_GOAL, driver_goal: Pose2D | None = DRIVER_GOAL) -> World:
        """Both robots stop by themselves, at their goals, agreed on the ride, and the metres are credited once."""

        def stopped() -> bool:
            return all(robot.statuses and robot.statuses[-1].state == "idle" for robot in self.robots)

        self.run(1.0).run(until=stopped)
        assert stopped(), [robot.statuses[-1] for robot in self.robots]
        for robot, goal in ((self.rider, rider_goal), (self.driver, driver_goal)):
            last = robot.statuses[-1]
            assert (last.role, last.ride, last.servo, last.modules) == ("none", None, None, ModuleSwitches())
            assert goal is None or distance(robot.pose, goal) < 0.1, robot.reports
            assert distance(robot.estimate, robot.pose) < (0.1 if self.completed else 3.0), robot.reports
        assert "Ride completed" in self.rider.reports or "Ride completed" not in self.driver.reports
        assert len({award.ride_id for award in self.driver.awards}) == len(self.driver.awards)
        assert sum(award.ride_m for award in self.driver.awards) < 22.5
        assert self.rider.awards == []
        assert sum(self.sent.values()) < 12 * (self.now - 500.0), self.sent
        return self


def _states(robot: Robot) -> list[str]:
    """The states in order, each once where it follows itself."""
    states = [status.state for status in robot.statuses]
    return [state for before, state in zip(["", *states], states, strict=False) if state != before]


def test_a_ride() -> None:
    world = World().come_to_an_end()
    assert world.completed
    assert _states(world.rider) == [
        *("requesting", "locking", "awaiting_aligned", "coupling", "riding", "settling", "relocalizing"),
        *("navigating", "idle"),
    ]
    assert _states(world.driver) == [
        *("navigating", "offering", "aligning", "aligned", "driving", "decoupling", "navigating", "idle")
    ]
    assert f"{DRIVER} denies: Invalid HH place" in world.rider.reports  # until the driver was there
    assert world.rider.map == set(BOXES)  # none of which it saw itself
    (award,) = world.driver.awards
    ride = next(status.ride for status in world.driver.statuses if status.ride is not None)
    assert ride.ride_m > 20.0
    assert award.ride_m == pytest.approx(ride.ride_m, abs=0.3)
    assert award.points == pytest.approx(0.4 * award.ride_m)
    riding = [status for status in world.rider.statuses if status.state == "riding"]
    assert {status.modules for status in riding} == {ModuleSwitches(False, False, False, False, True, True)}
    assert all(status.goal is None and status.role == "hitchhiker" for status in riding)
    for status in (*riding[-1:], *world.driver.statuses[-1:]):
        assert decode_status(encode_status(status)) == status


@pytest.mark.parametrize("seed", range(4))
def test_a_ride_on_a_network_that_loses_doubles_and_delays(seed: int) -> None:
    world = World(seed, loss=0.2, double=0.2, delay_s=0.4).come_to_an_end()
    assert world.completed
    assert world.rider.map == set(BOXES)
    assert world.driver.awards[-1].ride_m == pytest.approx(22.0, abs=0.5)


@pytest.mark.parametrize("loss", [0.5, 0.7, 1.0])
def test_on_a_bad_network_both_arrive_even_without_a_ride(loss: float) -> None:
    World(7, loss=loss, double=0.3, delay_s=1.0).come_to_an_end()


@pytest.mark.parametrize("kind", MESSAGE_TYPES)
def test_the_ride_survives_the_loss_of_the_first_three_messages_of_a_kind(kind: str) -> None:
    lost = 3

    def passes(_now: float, message: Message) -> bool:
        nonlocal lost
        lost -= message.type == kind
        return message.type != kind or lost < 0

    assert World(passes=passes).come_to_an_end().completed


@pytest.mark.parametrize("silent", [{RIDER, DRIVER}, {RIDER}, {DRIVER}])
@pytest.mark.parametrize("state", ["locking", "awaiting_aligned", "coupling", "riding", "settling"])
def test_silence_from_any_state_on_leaves_nobody_waiting(state: str, silent: set[str]) -> None:
    world = World(passes=lambda now, message: now < world.until or message.robot_id not in silent)
    world.run(until=lambda: world.rider.statuses != [] and world.rider.statuses[-1].state == state)
    world.until = world.now
    world.come_to_an_end()


def test_a_driver_that_hears_again_of_a_ride_that_was_given_up_goes_on_at_once() -> None:
    world = World(passes=lambda now, _message: not 520.0 < now < 530.0)
    world.come_to_an_end()
    assert "No message from the driver" in world.rider.reports
    waits = [s.time_stamp for s in world.driver.statuses if s.state == "waiting_for_rider"]
    assert waits[-1] == pytest.approx(530.0, abs=1.0)


@pytest.mark.parametrize(
    ("blind_s", "through"),
    [
        (1.0, ["seeking", "riding"]),
        (5.0, ["seeking", "riding"]),
        (10.0, ["seeking", "locating", "catching_up", "recoupling", "riding"]),
        (200.0, ["seeking", "locating", "catching_up", "parting", "navigating"]),
    ],
)
def test_a_rider_that_loses_sight_of_its_driver(blind_s: float, through: list[str]) -> None:
    world = World()
    world.run(until=lambda: world.driver.pose.x > 10.0)
    world.rider.blind = True
    before = len(world.rider.statuses)
    world.run(blind_s, until=lambda: "navigating" in _states(world.rider))
    world.rider.blind = False
    world.come_to_an_end()
    lost = _states(world.rider)[_states(world.rider).index("riding") + 1 :]
    assert lost[: len(through)] == through
    assert world.completed == (through[-1] == "riding")
    reasons = {status.reason for status in world.rider.statuses[before:]}
    assert "Driver out of sight" in reasons  # every step is seen from outside
    assert ("Driver not caught up with" in reasons) == (through[-1] != "riding")
    waited = [status for status in world.driver.statuses if status.state == "waiting_for_rider"]
    assert {status.reason for status in waited} == {"Hitchhiker does not follow"}


def test_a_driver_that_has_waited_long_enough_goes_on_and_says_so() -> None:
    world = World(lost_timeout_s=5.0)
    world.run(until=lambda: world.driver.pose.x > 10.0)
    world.rider.blind = True
    world.come_to_an_end()
    assert "Hitchhiker lost" in world.driver.reports
    assert "Hitchhiker lost" in world.rider.reports
    waits = [s.time_stamp for s in world.driver.statuses if s.state == "waiting_for_rider"]
    assert waits[-1] - waits[0] == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize("who", ["rider", "driver"])
@pytest.mark.parametrize("event", [GoalCancelled(), GoalGiven(Pose2D(15.0, 5.72))])
@pytest.mark.parametrize("state", ["requesting", "coupling", "riding", "relocalizing"])
def test_the_goal_changes_at_any_time(state: str, event: GoalCancelled | GoalGiven, who: str) -> None:
    world = World()
    world.run(until=lambda: world.rider.statuses != [] and world.rider.statuses[-1].state == state)
    world.step(getattr(world, who), event)
    goal = event.goal if isinstance(event, GoalGiven) else None
    world.come_to_an_end(**{f"{who}_goal": goal})


def test_why_a_robot_goes_on_alone_stays_in_its_status() -> None:
    world = World(passes=lambda _now, message: message.robot_id != RIDER)
    world.run(until=lambda: "navigating" in _states(world.rider))
    assert world.rider.statuses[-1].reason == "Driver not found"


# What one agent decides by itself.


def test_the_status_says_how_the_driver_is_followed() -> None:
    world = World()
    world.run(until=lambda: world.rider.agent.status(world.now).state == "riding")
    for robot, other, said in ((world.rider, world.driver, "coasting"), (world.driver, world.rider, "")):
        situation = replace(robot.situation(world.now, other), following="coasting")
        robot.agent.step(Tick(situation), world.now)
        assert robot.agent.status(world.now).following == said


def _agent(planner: Planner = corridor_path, **params: Any) -> Agent:
    return Agent(RIDER, HitchhikingParameters(**params), SITES, planner, MARKER_POSE, CAMERA, 0.3)


def _here(now: float) -> Tick:
    return Tick(Situation(estimate=PoseEstimate(now, WEST.waiting_pose, np.array(SIGMA))))


def _walled(_start: Pose2D, _goal: Pose2D) -> FloatArray:
    raise UnreachableError("no way")


@pytest.mark.parametrize("may_ride", [True, False])
def test_the_outcome_of_a_goal_is_known_when_its_way_ends_and_not_before(may_ride: bool) -> None:
    agent = _agent(may_ride=may_ride)
    assert str(agent.outcome) == ""
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    assert agent.outcome is None  # not even begun
    for now in (1.0, 1.1):
        agent.step(_here(now), now)
    assert agent.outcome is None
    assert agent.rides is may_ride
    if may_ride:
        agent.step(_here(70.0), 70.0)  # nobody has come
        assert not agent.rides
        assert agent.outcome is None
    goal = agent.status(70.0).goal
    assert goal is not None
    report = NavigationReport(goal.id, "arrived")
    agent.step(Tick(replace(_here(71.0).situation, navigation=report)), 71.0)
    assert str(agent.outcome) == "Goal reached"
    agent.step(GoalGiven(RIDER_GOAL), 72.0)
    assert agent.outcome is None
    agent.step(GoalCancelled(), 73.0)
    assert str(agent.outcome) == "Goal cancelled"


def _lost(now: float) -> tuple[Tick, float]:
    return Tick(Situation()), now


def test_a_goal_of_a_robot_that_does_not_know_where_it_is_is_refused_after_a_while() -> None:
    agent = _agent(may_ride=False)
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    for now in (1.0, 5.9):
        assert agent.step(*_lost(now)) is not None
        assert agent.outcome is None
    effects = agent.step(*_lost(6.0))
    assert [e.reason for e in effects if isinstance(e, Report)] == [Reason.NOT_LOCALIZED]
    assert agent.outcome == Ending(Reason.NOT_LOCALIZED, "no pose for 5 s")
    assert str(agent.outcome) == agent.status(6.0).reason == "Not localized: no pose for 5 s"
    agent.step(_here(7.0), 7.0)
    assert agent.outcome is not None, "a pose that comes later begins nothing"
    agent.step(GoalGiven(RIDER_GOAL), 8.0)
    assert agent.outcome is None
    agent.step(_here(8.0), 8.0)
    assert agent.goal == RIDER_GOAL
    assert agent.status(8.0).reason == ""


def test_a_pose_that_comes_in_time_sets_the_robot_going() -> None:
    agent = _agent(may_ride=False)
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    agent.step(*_lost(1.0))
    agent.step(*_lost(5.9))
    agent.step(_here(5.95), 5.95)
    assert agent.goal == RIDER_GOAL


def test_a_clock_that_goes_back_does_not_make_the_wait_for_a_pose_longer() -> None:
    agent = _agent(may_ride=False)
    agent.step(GoalGiven(RIDER_GOAL), 400.0)
    agent.step(*_lost(400.0))
    agent.step(*_lost(100.0))
    assert agent.outcome is None
    agent.step(*_lost(105.0))
    assert agent.outcome == Ending(Reason.NOT_LOCALIZED, "no pose for 5 s")


def test_a_robot_that_is_stuck_gives_up_and_says_why() -> None:
    agent = _agent(may_ride=False)
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    agent.step(_here(1.0), 1.0)
    goal = agent.status(1.0).goal
    assert goal is not None
    for now in (1.1, 2.0, 30.9, 31.2):
        assert agent.outcome is None
        report = NavigationReport(goal.id, "blocked", "no way past an obstacle")
        agent.step(Tick(replace(_here(now).situation, navigation=report)), now)
    assert str(agent.outcome) == "Navigation failed: no way past an obstacle"


@pytest.mark.parametrize(
    ("params", "planner", "goal", "rides"),
    [
        ({}, corridor_path, RIDER_GOAL, True),
        ({"priority": 15}, corridor_path, RIDER_GOAL, True),
        ({"priority": 16}, corridor_path, RIDER_GOAL, False),
        ({"may_ride": False}, corridor_path, RIDER_GOAL, False),
        ({}, corridor_path, Pose2D(21.7, 5.72), False),  # 19.9 m
        ({}, _walled, RIDER_GOAL, False),
    ],
)
def test_when_it_asks_for_a_ride(params: dict[str, Any], planner: Planner, goal: Pose2D, rides: bool) -> None:
    agent = _agent(planner, **params)
    agent.step(GoalGiven(goal), 1.0)
    agent.step(Tick(Situation()), 1.1)
    assert agent.status(1.1).state == "idle"  # it does not know yet where it is
    agent.step(_here(1.2), 1.2)
    assert agent.rides is rides
    assert agent.status(1.2).state == ("requesting" if rides else "navigating")


def test_a_goal_that_is_cancelled_before_the_robot_knows_its_place_is_forgotten() -> None:
    agent = _agent()
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    agent.step(GoalCancelled(), 1.1)
    agent.step(_here(1.2), 1.2)
    assert agent.status(1.2).state == "idle"


def test_a_goal_given_during_a_ride_waits_until_the_robot_knows_its_place_again() -> None:
    world = World()
    world.run(until=lambda: world.rider.pose.x > 10.0)
    agent = world.rider.agent
    world.step(world.rider, GoalGiven(RIDER_GOAL))
    world.step(world.rider, _here(world.now))  # localization still says what it knew before the ride
    assert agent.status(world.now).state == "relocalizing"
    world.come_to_an_end()


def test_others_are_known_where_they_say_they_are_as_long_as_they_speak() -> None:
    agent = _agent()
    heard = messages(DRIVER, "*", "")
    agent.step(heard[Request], 10.0)
    assert [(r.x, r.y) for r in agent.status(10.0).robots] == [(1.8, 5.72)]
    agent.step(replace(heard[Beacon], radius_m=0.27), 11.0)
    assert agent.status(13.9).robots == (KnownRobot(1.0, 2.0, 0.27),)
    agent.step(heard[Driver], 13.9)
    assert agent.status(14.1).robots == (KnownRobot(3.0, 5.72, 0.27),)
    assert agent.status(17.0).robots == ()


def test_a_driver_tells_the_second_of_its_riders_where_the_first_is_and_not_itself() -> None:
    agent = _agent()
    heard = messages(DRIVER, RIDER, "")
    agent.step(replace(heard[Beacon], radius_m=0.27), 11.0)
    agent.step(replace(heard[Driver], place=2), 12.0)
    driver, ahead = KnownRobot(1.0, 2.0, 0.27), KnownRobot(3.0, 5.72, 0.4)
    assert agent.status(12.1).robots == (driver, ahead)
    assert agent.status(14.5).robots == (ahead,)
    assert agent.status(17.0).robots == ()


def test_who_looks_for_no_robots_is_told_of_none_and_of_all_as_soon_as_it_looks() -> None:
    world = World()
    rider = world.rider

    def looks() -> bool:
        modules = rider.statuses[-1].modules
        return modules.OBS or modules.MAP

    world.run(1.0).run(until=lambda: not looks())
    assert len(rider.statuses[-2].robots) == 1
    begin = len(rider.statuses) - 1
    world.run(until=looks)
    ride = rider.statuses[begin:-1]
    assert {status.state for status in ride} == {"riding", "settling"}
    assert {status.robots for status in ride} == {()}
    (driver,) = rider.statuses[-1].robots
    assert distance(Pose2D(driver.x, driver.y), world.driver.pose) < 0.1
    world.come_to_an_end()
    assert world.completed


def test_a_driver_that_falls_silent_on_a_ride_counts_as_waiting_where_it_was() -> None:
    world = World(passes=lambda now, _message: now < world.until)
    world.run(until=lambda: world.rider.pose.x > 10.0)
    world.until = world.now
    world.run(20.0)
    (known,) = world.rider.statuses[-1].robots
    # Relative to itself it is right, however far off its own estimate is.
    rider = world.rider
    assert distance(between(rider.estimate, Pose2D(known.x, known.y)), between(rider.pose, world.driver.pose)) < 0.1
    world.run(25.0)
    assert world.rider.statuses[-1].robots == ()


@pytest.mark.parametrize(
    ("who", "state", "following", "period_s"),
    [
        ("rider", "requesting", "", 0.2),
        ("rider", "awaiting_aligned", "", 0.1),
        ("rider", "coupling", "following", 0.1),
        ("rider", "riding", "following", 0.3),
        *(("rider", "riding", how, 0.1) for how in ("", "coasting", "looking", "turning", "searching", "stopped")),
        ("rider", "settling", "following", 0.1),
        ("rider", "navigating", "", 0.1),
        ("rider", "idle", "", 0.2),
        ("driver", "navigating", "", 0.1),
        ("driver", "offering", "", 0.2),
        ("driver", "aligned", "", 0.1),
        ("driver", "driving", "following", 0.1),
        ("driver", "idle", "", 0.2),
    ],
)
def test_it_looks_less_often_where_there_is_less_to_notice(
    who: str, state: str, following: str, period_s: float
) -> None:
    world = World()
    robot, other = (world.rider, world.driver) if who == "rider" else (world.driver, world.rider)
    world.run(1.0).run(until=lambda: robot.statuses[-1].state == state)
    situation = replace(robot.situation(world.now, other), following=following)
    robot.agent.step(Tick(situation), world.now)
    assert robot.agent.status(world.now).state == state
    assert robot.agent.next_due(world.now) - world.now == pytest.approx(period_s, abs=1e-6)


def test_it_looks_at_once_when_it_is_new_and_after_time_jumped_back_and_often_until_it_knows_where_it_is() -> None:
    agent = _agent()
    assert agent.next_due(5.0) <= 5.0
    agent.step(Tick(Situation()), 5.0)
    assert agent.next_due(5.0) == pytest.approx(5.2)
    assert agent.next_due(4.0) <= 4.0
    agent.step(GoalGiven(RIDER_GOAL), 5.0)
    agent.step(Tick(Situation()), 5.0)
    assert agent.next_due(5.0) == pytest.approx(5.1)


def test_it_looks_when_a_deadline_is_over_and_then_it_is() -> None:
    agent = _agent(max_wait_s=10.0)
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    agent.step(_here(1.0), 1.0)
    assert agent.next_deadline() == 11.0
    agent.step(_here(10.9), 10.9)
    assert agent.next_due(10.9) == 11.0
    agent.step(_here(11.0), 11.0)
    assert not agent.rides
    assert agent.next_deadline() == math.inf


@pytest.mark.parametrize("asked", [True, False])
def test_the_driver_of_an_offer_is_remembered_whether_or_not_anybody_asks_for_the_status(asked: bool) -> None:
    agent = _agent()
    agent.step(GoalGiven(RIDER_GOAL), 1.0)
    agent.step(_here(1.0), 1.0)
    agent.step(messages(ride_id=agent.hitchhiker.ride_id)[Accept], 1.1)
    assert agent.hitchhiker.offer is not None
    if asked:
        agent.status(1.1)
    agent.step(GoalCancelled(), 1.2)
    assert len(agent.status(1.2 + agent.params.robot_timeout_s).robots) == 1
    assert len(agent.status(1.0 + agent.params.lost_timeout_s).robots) == 1
    assert agent.status(1.2 + agent.params.lost_timeout_s).robots == ()


# Anything, in any order.

_USUAL: dict[str, tuple[type[Message], ...]] = {
    "requesting": (Accept,),
    "locking": (Ack,),
    "awaiting_aligned": (Aligned,),
    "riding": (Driver, Decouple),
    "seeking": (Driver,),
    "locating": (Driver,),
    "catching_up": (Driver,),
    "recoupling": (Driver,),
    "navigating": (Request,),
    "offering": (Lock,),
    "aligned": (Coupled,),
}


def _walk(seed: int, steps: int) -> set[str]:
    """An agent to whom everything happens, what is usual more often than the rest; the states that it saw."""
    rng = random.Random(seed)
    near = Pose2D(WEST.waiting_pose.x + 3.0, WEST.waiting_pose.y)
    parked = Beacon(robot_id="parked", state="idle", profile=50.0, priority=10, pose=near)
    agent = _agent(min_ride_m=5.0, may_ride=seed % 2 == 0, seek_timeout_s=0.5)
    now = 0.0
    visited: set[str] = set()

    def tick(duration: float, localized: bool = True, seen: bool = False, arrived: bool = False) -> None:
        nonlocal now
        for _ in range(5):
            now += duration / 5
            goal = agent.driver.goal
            marker = MarkerObservation(now, 0, Pose2D(CAMERA[0] + 0.8, 0.0, math.pi), np.array(SIGMA))
            situation = Situation(
                estimate=PoseEstimate(now, WEST.waiting_pose, np.array(SIGMA)) if localized else None,
                navigation=NavigationReport(goal.id, "arrived" if arrived else "driving") if goal else None,
                observation=marker if seen else None,
            )
            agent.step(Tick(situation), now)
            visited.add(f"{'rider' if agent.rides else 'driver'} {agent.status(now).state}")

    for _ in range(steps):
        match rng.choices(("goal", "message", "time"), (1, 20, 15))[0]:
            case "goal":
                agent.step(parked, now)
                agent.step(
                    rng.choice((GoalCancelled(), GoalGiven(RIDER_GOAL), GoalGiven(DRIVER_GOAL), GoalGiven(near))), now
                )
            case "message":
                usual = _USUAL.get(agent.status(now).state, (Driver, Ack))
                kinds = usual if rng.random() < 0.6 else tuple(MESSAGE_TYPES.values())
                offer = agent.driver.offer
                ride_id = offer.ride_id if offer is not None else agent.hitchhiker.ride_id
                message = messages(DRIVER, RIDER, ride_id)[rng.choice(kinds)]
                if isinstance(message, Ack):
                    of, following = rng.choice(("lock", "driver", "decouple")), rng.random() < 0.7
                    message = replace(message, of=of, following=following)
                agent.step(message, now)
            case "time":
                duration = rng.choice((0.2, 0.2, 0.5, 1.0, 1.0, 2.0, 2.0, 20.0))
                tick(duration, rng.random() < 0.95, rng.random() < 0.8, rng.random() < 0.3)
        status = agent.status(now)
        visited.add(f"{'rider' if agent.rides else 'driver'} {status.state}")
        assert decode_status(encode_status(status)) == status
    for _ in range(40):
        tick(5.0)
    assert agent.status(now).state in ("idle", "navigating")  # left alone, it does not wait for anybody
    return visited


def test_no_order_of_events_breaks_an_agent_or_keeps_it_waiting() -> None:
    visited = set().union(*(_walk(seed, 150) for seed in range(20)))
    riding = {f"rider {state.value}" for state in HitchhikerState if state is not HitchhikerState.IDLE}
    assert visited == riding | {f"driver {state.value}" for state in DriverState}
