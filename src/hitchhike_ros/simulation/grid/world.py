"""The grid simulator: any number of robots, each a real traveller of the protocol, on one map and one clock (P18 §8.1).

It goes from event to event: a message that arrives, a robot that has come to the end of its path, whose beacon is due,
or that is engaged in a ride and looks again. Between events bodies move by formula, so a robot that drives or stands
alone costs next to nothing. No ROS, no physics: bodies pass through each other, turn and change speed at once, and what
a robot knows of itself is true but for a little noise.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from hitchhike_ros.core.datatypes import (
    MarkerObservation,
    NonNegative,
    Obstacle,
    Pose2D,
    PoseEstimate,
    Positive,
)
from hitchhike_ros.core.errors import MessageError, PlanningError
from hitchhike_ros.core.geometry import between, compose
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.agent import Traveller
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.machine import (
    Award,
    Effect,
    GoalCancelled,
    GoalGiven,
    NavigationReport,
    Report,
    Send,
    Situation,
    TakeObstacles,
    TakePose,
    Tick,
    stamped,
)
from hitchhike_ros.protocol.messages import EVERYBODY, Beacon, Lock, Message, Request, encode
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.grid.body import Body
from hitchhike_ros.simulation.grid.paths import GridPaths, Known, corners, distance_to_box
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters

# A robot in one of these states drives or stands by itself, and nothing happens that no event tells of.
QUIET_STATES = frozenset({"idle", "navigating"})
# States of a rider whose metres are ridden.
COUPLED_STATES = frozenset({"riding", "seeking", "settling"})
# Of one that looks for a ride, and goes to where it begins.
ASKING_STATES = frozenset({"requesting", "locking", "awaiting_aligned", "coupling"})

# Of a ride on which nothing happens; who arrives somewhere, or hears something, looks at once.
_CRUISING_STATES = frozenset({"aligning", "awaiting_aligned", "driving", "riding"})

# Two events of one robot are not nearer than this, or an arrival could cause itself.
_LEAST_STEP_S = 0.01

Observer = Callable[[float, str, object, Sequence[Effect]], None]


@dataclass(frozen=True)
class GridWorldParameters:
    """What is the same for all robots; all values are chosen, where the papers name none."""

    radius_m: Positive = 0.2
    margin_m: NonNegative = 0.05  # free room beside a robot under way
    clearance_weight: NonNegative = 0.0  # above 0, paths keep to the middle of passages
    perception_m: Positive = 3.0  # new boxes are seen from so far
    position_sigma_m: NonNegative = 0.02  # noise and covariance of what localization says
    heading_sigma_rad: NonNegative = 0.01
    camera_x_m: float = 0.15
    camera_range_m: Positive = 4.0
    camera_nearest_m: NonNegative = 0.2
    camera_view_rad: Positive = 1.05
    marker_view_rad: Positive = 1.3  # a marker seen from farther to the side is not read
    marker_x_m: float = -0.2  # the rear marker, which faces backwards
    marker_sigma_m: NonNegative = 0.005
    marker_sigma_rad: NonNegative = 0.01
    # A follower that lags behind catches up by this much faster than rides are driven.
    follow_factor: Positive = 1.3
    # Who is engaged looks again after this share of the shortest of its own periods.
    tick_share: Positive = 0.5
    # The same for those who only drive, with a rider, behind a driver or to where they meet.
    cruise_share: Positive = 0.5
    # Positions for the radio are not older than this; 0: they are those of now.
    radio_refresh_s: NonNegative = 0.0
    json_messages: bool = True  # as text through the robots' inboxes, or as objects past them
    trace_events: int = 500  # so many of the last events are kept
    seed: int = 0

    @property
    def marker_pose(self) -> Pose2D:
        return Pose2D(self.marker_x_m, 0.0, math.pi)


@dataclass(frozen=True)
class Errand:
    """A goal, and when it is given: at a time, or so long after the errand before has ended, whichever is later."""

    goal: Pose2D
    at_s: NonNegative = 0.0
    after_s: NonNegative = 0.0


@dataclass
class Trip:
    """What became of an errand. Times are the world's, metres the body's."""

    goal: Pose2D
    began_s: float
    ended_s: float | None = None
    reached: bool = False
    reason: str = ""
    driven_m: float = 0.0
    ridden_m: float = 0.0
    coupled_s: float = 0.0  # with its own modules off
    asked_s: float = 0.0  # in the states before a ride


class _Objects:
    """As :class:`Inbox`, for messages that come as objects."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self._newest: dict[str, tuple[float, int]] = {}
        self._newest_beacon: dict[str, tuple[float, int]] = {}

    def receive(self, message: Message) -> Message | None:
        """Of all but beacons."""
        return message if self._is_new(self._newest, message.robot_id, (message.time_stamp, message.seq)) else None

    def is_new(self, sender: str, order: tuple[float, int]) -> bool:
        """Whether a beacon is."""
        return self._is_new(self._newest_beacon, sender, order)

    def _is_new(self, known: dict[str, tuple[float, int]], sender: str, order: tuple[float, int]) -> bool:
        newest = known.get(sender)
        if newest is not None and order <= newest:
            self.dropped["replayed"] += 1
            return False
        known[sender] = order
        return True


@dataclass(eq=False)
class GridRobot:
    """One robot: its traveller, its body, and what its modules know."""

    name: str
    index: int
    params: HitchhikingParameters
    start: Pose2D
    body: Body
    traveller: Traveller
    clock_offset_s: float = 0.0
    safe_speed_mps: float = math.inf  # of the body, whatever it is told
    errands: deque[Errand] = field(default_factory=deque)
    trips: list[Trip] = field(default_factory=list)
    known: dict[str, Obstacle] = field(default_factory=dict)  # the boxes in its map
    awards: list[Award] = field(default_factory=list)
    reports: list[tuple[float, str]] = field(default_factory=list)
    history: list[tuple[float, str, str]] = field(default_factory=list)  # when it came to which state, and why
    state_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    sent: Counter[str] = field(default_factory=Counter)
    ridden_m: float = 0.0
    coupled_s: float = 0.0
    asked_s: float = 0.0
    alive: bool = True
    # Of the event loop.
    shortest_s: float = 1.0  # of its own periods
    inbox: Any = None
    status: Status = field(default_factory=lambda: Status(0.0, ""))
    seq: int = 0
    due: float = math.inf  # of its next tick
    beacon_due: float = 0.0
    engaged: bool = False
    lingers_until: float = -math.inf
    goal_id: str = ""
    goal_error: str | None = None
    news: bool = False  # its navigation has something to say
    perceives_at_m: float = math.inf  # by its odometer
    followed: tuple[str, int] | None = None
    since: float = 0.0
    metres_at: float = 0.0
    key: tuple[object, object] = (None, None)
    known_ids: Known = ()
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def trip(self) -> Trip | None:
        """The one under way."""
        return self.trips[-1] if self.trips and self.trips[-1].ended_s is None else None

    @property
    def idle(self) -> bool:
        """Whether nothing is asked of it any more."""
        return self.trip is None and not self.errands


class GridWorld:
    """Robots on a grid, the network between them, and the time.

    ``observers`` are called after every event that a traveller took with (time, robot, event, effects): the event is a
    Tick, a Message, a GoalGiven or a GoalCancelled; a crash and a restart are told as the strings ``"crash"`` and
    ``"restart"``. ``boxes`` stand in the world, but not in the map that robots begin with.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        sites: Sites,
        network: NetworkModel | None = None,
        params: GridWorldParameters | None = None,
        boxes: Sequence[Obstacle] = (),
    ) -> None:
        self.params = params or GridWorldParameters()
        self.grid, self.sites, self.boxes = grid, sites, tuple(boxes)
        self.network = network or NetworkModel(NetworkParameters())
        self.paths = GridPaths(grid, self.params.radius_m + self.params.margin_m, boxes, self.params.clearance_weight)
        self.robots: dict[str, GridRobot] = {}
        self.observers: list[Observer] = []
        self.now = 0.0
        self.events = 0
        self.messages = 0  # that were sent
        self.deliveries = 0
        self._heap: list[tuple[float, int, Callable[..., None], Any]] = []
        self._serial = 0
        self._trace: deque[tuple[float, str, object, Sequence[Effect]]] = deque(maxlen=self.params.trace_events)
        self._random = random.Random(self.params.seed)
        self._by_marker: dict[int, GridRobot] = {}
        self._list: list[GridRobot] = []
        self._radio: tuple[float, np.ndarray, cKDTree] | None = None
        n = self.network.params
        # Whoever is in range hears everything after the same time.
        self._plain = n.loss == n.duplication == n.reordering == n.jitter_s == 0.0 and not n.partitions
        p = self.params
        self._covariance = np.diag(np.square([p.position_sigma_m, p.position_sigma_m, p.heading_sigma_rad]))
        self._marker_covariance = np.diag(np.square([p.marker_sigma_m, p.marker_sigma_m, p.marker_sigma_rad]))

    # Robots.

    def add_robot(
        self,
        name: str,
        start: Pose2D,
        params: HitchhikingParameters,
        errands: Sequence[Errand] = (),
        clock_offset_s: float = 0.0,
        begins_s: float = 0.0,
    ) -> GridRobot:
        """A robot that stands at ``start`` and wakes up at ``begins_s``.

        Raises:
            ValueError: there is a robot of that name, or one with the same marker.
        """
        if name in self.robots:
            raise ValueError(f"robot {name} is there already")
        if params.marker_id in self._by_marker:
            raise ValueError(f"{name}: {self._by_marker[params.marker_id].name} has marker {params.marker_id}")
        robot = GridRobot(
            name=name,
            index=len(self.robots),
            params=params,
            start=start,
            body=Body(start, self.now),
            traveller=self._traveller(name, params),
            clock_offset_s=clock_offset_s,
            errands=deque(errands),
            shortest_s=min(params.update_period_s, params.repeat_period_s, params.request_period_s),
        )
        robot.inbox = self._inbox(robot)
        robot.since = robot.metres_at = 0.0
        self.robots[name] = self._by_marker[params.marker_id] = robot
        self._list.append(robot)
        self._radio = None
        self._schedule(robot, max(begins_s, self.now))
        if robot.errands:
            self.at(max(robot.errands[0].at_s, begins_s, self.now), lambda: self._next_errand(robot))
        return robot

    def give_goal(self, name: str, goal: Pose2D | None) -> None:
        """Somebody wants the robot at ``goal``, or nowhere any more."""
        robot = self.robots[name]
        if not robot.alive:
            return
        if (trip := robot.trip) is not None:
            self._end_trip(robot, trip, False, "Goal changed")
        if goal is not None:
            robot.body.advance(self.now)
            self._account(robot)
            trip = Trip(goal, self.now)
            trip.driven_m, trip.ridden_m = -robot.body.odometer_m, -robot.ridden_m
            trip.coupled_s, trip.asked_s = -robot.coupled_s, -robot.asked_s
            robot.trips.append(trip)
        self._step(robot, GoalCancelled() if goal is None else GoalGiven(goal))
        self._schedule(robot, self.now)

    def crash(self, name: str) -> None:
        """The robot stops where it is, and neither hears nor says anything until it is restarted."""
        robot = self.robots[name]
        if not robot.alive:
            return
        robot.body.advance(self.now)
        self._account(robot)
        robot.body.stop()
        robot.alive, robot.due, robot.engaged, robot.followed, robot.goal_id = False, math.inf, False, None, ""
        self._tell(robot, "crash", ())

    def restart(self, name: str) -> None:
        """A new traveller that remembers nothing but its map, and is given its goal anew; nothing where one runs."""
        robot = self.robots[name]
        if robot.alive:
            return
        robot.traveller, robot.inbox, robot.seq = self._traveller(name, robot.params), self._inbox(robot), 0
        robot.alive, robot.key, robot.lingers_until = True, (None, None), -math.inf
        robot.status, robot.since = robot.traveller.status(self.now + robot.clock_offset_s, others=False), self.now
        self._tell(robot, "restart", ())
        self._schedule(robot, self.now)
        if (trip := robot.trip) is not None:
            self._step(robot, GoalGiven(trip.goal))
        elif robot.errands:
            self.at(max(self.now, robot.errands[0].at_s), lambda: self._next_errand(robot))

    def at(self, time: float, action: Callable[[], None]) -> None:
        """Do this then: what a scenario or a fault wants."""
        self._push(time, self._act, action)

    # Time.

    @property
    def next_event_s(self) -> float:
        """When something happens next; never, when nothing does."""
        return self._heap[0][0] if self._heap else math.inf

    def step(self) -> bool:
        """The next event; False when there is none."""
        if not self._heap:
            return False
        time, _, act, what = heapq.heappop(self._heap)
        self.now = time
        self.events += 1
        act(what)
        return True

    def run(self, until_s: float, stop: Callable[[], bool] | None = None) -> bool:
        """All events up to ``until_s``, or until ``stop()`` after one of them; whether it stopped."""
        heap = self._heap  # which stays the same one: looking at it here is what every event pays
        while heap and heap[0][0] <= until_s:
            self.step()
            if stop is not None and stop():
                return True
        self.now = max(self.now, until_s)
        return False

    def idle(self) -> bool:
        """Whether no robot has anything left to do."""
        return all(robot.idle for robot in self._list)

    def pose(self, name: str) -> Pose2D:
        """Where the robot is now."""
        body = self.robots[name].body
        body.advance(self.now)
        return body.pose

    def mean_in_range(self) -> float:
        """How many others a robot can hear now, on average."""
        reach, robots = self.network.params.range_m, len(self._list)
        if math.isinf(reach):
            return robots - 1.0
        tree = self._places()[1]
        return (tree.count_neighbors(tree, reach) - robots) / max(robots, 1)

    def trace(self) -> Iterator[str]:
        """The last events, a line each."""
        for time, name, event, effects in self._trace:
            wanted = "; ".join(_described(effect) for effect in effects)
            yield f"{time:10.3f} {name:<10} {_described(event)}" + (f" -> {wanted}" if wanted else "")

    # Events.

    def _push(self, time: float, act: Callable[..., None], what: Any) -> None:
        self._serial += 1
        heapq.heappush(self._heap, (time, self._serial, act, what))

    def _act(self, action: Callable[[], None]) -> None:
        action()

    def _schedule(self, robot: GridRobot, time: float) -> None:
        """The robot's next tick; the one that was planned before is void if it is later."""
        if time < robot.due:
            robot.due = time
            self._push(time, self._tick_due, (robot, time))

    def _tick_due(self, what: tuple[GridRobot, float]) -> None:
        robot, due = what
        if robot.due == due and robot.alive:
            robot.due = math.inf
            self._tick(robot)

    def _tick(self, robot: GridRobot) -> None:
        robot.body.advance(self.now)
        if robot.body.odometer_m >= robot.perceives_at_m:
            self._perceive(robot)
        self._step(robot, Tick(self._situation(robot)))
        if (trip := robot.trip) is not None and (outcome := robot.traveller.outcome) is not None:
            self._end_trip(robot, trip, *outcome)
            if robot.errands:
                self.at(
                    max(robot.errands[0].at_s, self.now + robot.errands[0].after_s), lambda: self._next_errand(robot)
                )

    def _next_errand(self, robot: GridRobot) -> None:
        if robot.alive and robot.errands and robot.trip is None:
            self.give_goal(robot.name, robot.errands.popleft().goal)

    def _arrive(self, what: tuple[Message | str, list[GridRobot]]) -> None:
        """A message comes to all who hear it at the same moment."""
        sent, robots = what
        if isinstance(sent, Beacon):
            self._arrive_beacon(sent, robots)
            return
        for robot in robots:
            if not robot.alive:
                continue
            try:
                message = robot.inbox.receive(sent)
            except MessageError:
                continue
            if message is None:
                continue
            self.deliveries += 1
            if isinstance(message, (Request, Lock)) and not robot.engaged and robot.trip is not None:
                self._tick(robot)  # what it knew of itself may be old
            self._step(robot, message)

    def _arrive_beacon(self, beacon: Beacon, robots: Sequence[GridRobot]) -> None:
        """By far the most frequent: it changes nothing but what is remembered, so the loop is kept short."""
        now, sender, order = self.now, beacon.robot_id, (beacon.time_stamp, beacon.seq)
        watched, plain, heard = bool(self.observers or self.params.trace_events), self._plain, (beacon, self.now)
        for robot in robots:
            # Of a plain network messages come once, and in order.
            if robot.alive and (plain or robot.inbox.is_new(sender, order)):
                offset = robot.clock_offset_s
                robot.traveller.neighbours.put_away(beacon, (beacon, now + offset) if offset else heard)
                if watched:
                    self._tell(robot, beacon, ())
        self.deliveries += len(robots)

    def _step(self, robot: GridRobot, event: object) -> None:
        """The traveller takes the event; its modules do what it wants from then on."""
        local = self.now + robot.clock_offset_s
        traveller = robot.traveller
        effects = traveller.step(event, local)
        for effect in effects:
            self._carry_out(robot, effect, local)
        key = (traveller.hitchhiker.state, traveller.driver.state)
        told = isinstance(event, (GoalGiven, GoalCancelled)) or (robot.engaged and isinstance(event, Tick))
        news = told or key != robot.key
        if news:
            robot.key = key
            self._obey(robot, traveller.status(local, others=False))
        if self.observers or self.params.trace_events:
            self._tell(robot, event, effects)
        if news or not isinstance(event, Message):  # else its next tick is planned already
            self._plan_tick(robot)

    def _tell(self, robot: GridRobot, event: object, effects: Sequence[Effect]) -> None:
        if self.params.trace_events:
            self._trace.append((self.now, robot.name, event, effects))
        for observer in self.observers:
            observer(self.now, robot.name, event, effects)

    def _plan_tick(self, robot: GridRobot) -> None:
        body, soonest = robot.body, self.now + _LEAST_STEP_S
        due = min(robot.beacon_due, body.arrives)
        if robot.perceives_at_m < math.inf and body.speed_mps > 0.0:
            due = min(due, body.time + (robot.perceives_at_m - body.odometer_m) / body.speed_mps)
        if robot.news:
            due, robot.news = soonest, False
        if robot.engaged or robot.goal_error is not None or self.now < robot.lingers_until:
            due = min(due, self.now + self._period(robot))
        self._schedule(robot, max(due, soonest))

    def _period(self, robot: GridRobot) -> float:
        cruises = robot.status.state in _CRUISING_STATES
        return robot.shortest_s * (self.params.cruise_share if cruises else self.params.tick_share)

    # Effects.

    def _carry_out(self, robot: GridRobot, effect: Effect, local: float) -> None:
        if isinstance(effect, Send):
            robot.seq += 1
            message = stamped(effect.message, robot.seq, local)
            robot.sent[message.type] += 1
            if isinstance(message, Beacon):
                robot.beacon_due = self.now + robot.params.beacon_period_s
            self._transmit(robot, message)
        elif isinstance(effect, TakeObstacles):
            for box in effect.obstacles:
                self._learn(robot, box)
        elif isinstance(effect, Award):
            robot.awards.append(effect)
        elif isinstance(effect, Report):
            robot.reports.append((self.now, effect.text))
        else:
            assert isinstance(effect, TakePose)  # localization is exact anyway

    def _transmit(self, sender: GridRobot, message: Message) -> None:
        """On the air: to all in range, or to the one that does not drop it."""
        self.messages += 1
        now, name = self.now, sender.name
        sent: Message | str = encode(message) if self.params.json_messages else message
        if message.to != EVERYBODY:
            robot = self.robots.get(message.to)
            if robot is not None and robot is not sender:
                body, other = sender.body, robot.body
                other.advance(now)
                body.advance(now)
                apart = math.hypot(other.x - body.x, other.y - body.y)
                for time in self.network.deliveries(now, name, robot.name, apart):
                    self._push(max(time, now), self._arrive, (sent, [robot]))
            return
        robots = self._in_range(sender)
        if self._plain:
            if robots:
                self._push(now + self.network.params.delay_s, self._arrive, (sent, robots))
            return
        arrivals: dict[float, list[GridRobot]] = {}
        places, _ = self._places()
        here = places[sender.index]
        for robot in robots:
            apart = float(np.hypot(*(places[robot.index] - here)))
            for time in self.network.deliveries(now, name, robot.name, apart):
                arrivals.setdefault(time, []).append(robot)
        for time, those in arrivals.items():
            self._push(max(time, now), self._arrive, (sent, those))

    def _in_range(self, sender: GridRobot) -> list[GridRobot]:
        """Who may hear the robot, in the order in which they were added."""
        reach, robots, own = self.network.params.range_m, self._list, sender.index
        if math.isinf(reach):
            return [robot for robot in robots if robot is not sender]
        places, tree = self._places()
        return [robots[k] for k in tree.query_ball_point(places[own], reach, return_sorted=True) if k != own]

    def _places(self) -> tuple[np.ndarray, cKDTree]:
        """Where all robots are, as the radio sees it."""
        radio = self._radio
        if radio is None or self.now - radio[0] > self.params.radio_refresh_s:
            for robot in self._list:
                if robot.body.moves:
                    robot.body.advance(self.now)
            flat = [value for robot in self._list for value in (robot.body.x, robot.body.y)]
            places = np.array(flat).reshape(-1, 2)
            radio = self._radio = self.now, places, cKDTree(places)
        return radio[1:]

    # What its modules do.

    def _obey(self, robot: GridRobot, status: Status) -> None:
        before = robot.status
        robot.body.advance(self.now)
        if (status.state, status.reason, status.role) != (before.state, before.reason, before.role):
            self._account(robot)
            robot.history.append((self.now, status.state, status.reason))
        robot.status = status
        quiet = status.state in QUIET_STATES and status.role == "none"
        if robot.engaged and quiet:
            p = robot.params  # its last words are repeated
            robot.lingers_until = self.now + p.confirm_timeout_s + p.repeat_period_s
        robot.engaged = not quiet
        servo, goal, body = status.servo, status.goal, robot.body
        if servo is not None and servo.task == "follow":
            leader = self._by_marker.get(servo.marker_id)
            order = servo.task, servo.marker_id
            if leader is not None and leader is not robot and robot.followed != order:
                leader.body.advance(self.now)
                lag = self.params.camera_x_m + servo.gap_m - self.params.marker_x_m
                body.follow(leader.body, lag, self.params.follow_factor * robot.params.ride_speed_mps)
                robot.followed, robot.goal_id, robot.goal_error = order, "", None
                self._look(robot, leader)
            return
        robot.followed = None
        if goal is None or not (status.modules.PP and status.modules.OBS):
            if body.leader is not None or body.speed_mps > 0.0 or robot.goal_id:
                body.stop()
            robot.goal_id, robot.goal_error, robot.perceives_at_m = "", None, math.inf
            return
        speed = min(status.speed_limit_mps or robot.params.cruise_speed_mps, robot.safe_speed_mps)
        if robot.goal_id != goal.id:
            robot.goal_id = goal.id
            if goal.along_wall:
                body.turn(goal.theta)
                robot.goal_error, robot.news = None, True
            else:
                self._drive(robot, speed)
        elif body.speed_mps not in (0.0, speed):
            body.set_speed(speed)

    def _drive(self, robot: GridRobot, speed: float) -> None:
        """To the goal of its status, by a path around what it knows."""
        goal, body = robot.status.goal, robot.body
        assert goal is not None
        end = goal.theta if goal.tolerance_rad < math.pi else None
        if math.hypot(goal.x - body.x, goal.y - body.y) <= 0.5 * goal.tolerance_m:
            body.turn(body.theta if end is None else end)
            robot.goal_error, robot.news = None, True
            return
        try:
            path = self.paths.plan((body.x, body.y), (goal.x, goal.y), robot.known_ids)
        except PlanningError as exc:
            body.stop()
            robot.goal_error, robot.news = str(exc), True
            return
        robot.goal_error = None
        body.drive(corners(path), speed, end)
        self._watch_for_boxes(robot, path)

    def _watch_for_boxes(self, robot: GridRobot, path: np.ndarray) -> None:
        """Where on its path the robot comes to see a box that it does not know."""
        robot.perceives_at_m = math.inf
        if not self.boxes or not robot.status.modules.MAP:
            return
        unknown = [box for box in self.boxes if box.id not in robot.known]
        if not unknown:
            return
        driven = robot.body.odometer_m + np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        reach = self.params.perception_m
        for box in unknown:
            low, high = np.array([box.x, box.y]), np.array([box.x + box.w, box.y + box.b])
            apart = np.hypot(*np.maximum(np.maximum(low - path, path - high), 0.0).T)
            for k in np.flatnonzero(apart <= reach):
                if driven[k] >= robot.perceives_at_m:
                    break
                if self.paths.sees_box((float(path[k, 0]), float(path[k, 1])), box):
                    robot.perceives_at_m = float(driven[k])
                    break

    def _perceive(self, robot: GridRobot) -> None:
        """New boxes around come into its map, and its path leads around them."""
        robot.perceives_at_m = math.inf
        body, status = robot.body, robot.status
        if not (status.modules.MAP and status.modules.LZN):
            return
        for box in self.boxes:
            near = distance_to_box((body.x, body.y), box) <= self.params.perception_m + 0.5
            if near and box.id not in robot.known and self.paths.sees_box((body.x, body.y), box):
                self._learn(robot, box)
        if robot.goal_id and status.goal is not None and not status.goal.along_wall and body.remaining_m > 0.0:
            self._drive(robot, body.speed_mps)

    def _learn(self, robot: GridRobot, box: Obstacle) -> None:
        if box.id not in robot.known:
            self.paths.add_box(box)
            robot.known[box.id] = box
            robot.known_ids = tuple(sorted(robot.known))
            robot.obstacles = tuple(robot.known[name] for name in robot.known_ids)

    def _situation(self, robot: GridRobot) -> Situation:
        local, status, body = self.now + robot.clock_offset_s, robot.status, robot.body
        estimate = self._estimate(body, local) if status.modules.LZN else None
        if not robot.engaged:
            return Situation(estimate, body.speed_mps, robot.obstacles, self._report(robot))
        seen, following = None, ""
        if status.servo is not None:
            leader = self._by_marker.get(status.servo.marker_id)
            sees = leader is not None and leader is not robot and self._look(robot, leader)
            seen = self._observation(robot, leader, local) if sees and leader is not None else None
            following = "following" if sees else "coasting"
        odom = between(robot.start, body.pose)
        return Situation(
            estimate,
            body.speed_mps,
            robot.obstacles,
            self._report(robot),
            seen,
            odom if seen else None,
            odom,
            following,
        )

    def _estimate(self, body: Body, local: float) -> PoseEstimate:
        p, gauss = self.params, self._random.gauss
        x, y, theta = body.x, body.y, body.theta
        if p.position_sigma_m:
            x, y = x + gauss(0.0, p.position_sigma_m), y + gauss(0.0, p.position_sigma_m)
        if p.heading_sigma_rad:
            theta += gauss(0.0, p.heading_sigma_rad)
        return PoseEstimate(local, Pose2D(x, y, theta), self._covariance)

    def _report(self, robot: GridRobot) -> NavigationReport | None:
        if not robot.goal_id:
            return None
        if robot.goal_error is not None:
            return NavigationReport(robot.goal_id, "failed", robot.goal_error)
        arrived = robot.body.remaining_m <= 1e-6
        return NavigationReport(robot.goal_id, "arrived" if arrived else "driving")

    def _look(self, robot: GridRobot, leader: GridRobot) -> bool:
        """Whether the robot's camera sees the rear marker of the other; who follows keeps turning to what it sees."""
        body, p = robot.body, self.params
        leader.body.advance(self.now)
        marker = compose(leader.body.pose, p.marker_pose)
        here = body.pose
        if body.leader is leader.body and body.sees:
            here = Pose2D(here.x, here.y, math.atan2(leader.body.y - here.y, leader.body.x - here.x))
        eye = compose(here, Pose2D(p.camera_x_m, 0.0, 0.0))
        apart = math.hypot(marker.x - eye.x, marker.y - eye.y)
        sees = p.camera_nearest_m <= apart <= p.camera_range_m
        if sees:
            bearing = math.atan2(marker.y - eye.y, marker.x - eye.x)
            ahead = abs(math.remainder(bearing - here.theta, 2.0 * math.pi))
            aside = abs(math.remainder(bearing + math.pi - marker.theta, 2.0 * math.pi))
            sees = ahead <= p.camera_view_rad / 2 and aside <= p.marker_view_rad
            sees = sees and self.paths.sees((eye.x, eye.y), (marker.x, marker.y))
        if body.leader is leader.body:
            body.look(sees)
        return sees

    def _observation(self, robot: GridRobot, leader: GridRobot, local: float) -> MarkerObservation:
        p, gauss = self.params, self._random.gauss
        true = between(robot.body.pose, compose(leader.body.pose, p.marker_pose))
        seen = Pose2D(
            true.x + gauss(0.0, p.marker_sigma_m),
            true.y + gauss(0.0, p.marker_sigma_m),
            true.theta + gauss(0.0, p.marker_sigma_rad),
        )
        return MarkerObservation(local, leader.params.marker_id, seen, self._marker_covariance)

    # Bookkeeping.

    def _account(self, robot: GridRobot) -> None:
        """Time and metres since the last change of state belong to the state that ends."""
        state = robot.status.state
        passed, metres = self.now - robot.since, robot.body.odometer_m - robot.metres_at
        robot.state_s[state] += passed
        if state in COUPLED_STATES:
            robot.ridden_m += metres
            robot.coupled_s += passed
        elif state in ASKING_STATES:
            robot.asked_s += passed
        robot.since, robot.metres_at = self.now, robot.body.odometer_m

    def _end_trip(self, robot: GridRobot, trip: Trip, reached: bool, reason: str) -> None:
        self._account(robot)
        trip.ended_s, trip.reached, trip.reason = self.now, reached, reason
        trip.driven_m += robot.body.odometer_m
        trip.ridden_m += robot.ridden_m
        trip.coupled_s += robot.coupled_s
        trip.asked_s += robot.asked_s

    def _traveller(self, name: str, params: HitchhikingParameters) -> Traveller:
        p = self.params
        return Traveller(
            name,
            params,
            self.sites,
            lambda start, goal: self._plan_for(name, start, goal),
            p.marker_pose,
            (p.camera_x_m, 0.0),
            p.radius_m,
            lambda sources, targets: self.paths.all_metres(sources, targets, self.robots[name].known_ids),
        )

    def _plan_for(self, name: str, start: Pose2D, goal: Pose2D) -> np.ndarray:
        return self.paths.plan((start.x, start.y), (goal.x, goal.y), self.robots[name].known_ids)

    def _inbox(self, robot: GridRobot) -> Inbox | _Objects:
        return Inbox(robot.name) if self.params.json_messages else _Objects()


def _described(event: object) -> str:
    """A word or two for the trace."""
    if isinstance(event, Tick):
        report = event.situation.navigation
        return "tick" + (f" [{report.state}]" if report is not None else "")
    if isinstance(event, Send):
        return f"send {_described(event.message)}"
    if isinstance(event, Message):
        reason = getattr(event, "reason", "") or getattr(event, "of", "")
        return f"{event.type} {event.robot_id}>{event.to} {event.ride_id}" + (f" ({reason})" if reason else "")
    if isinstance(event, GoalGiven):
        return f"goal ({event.goal.x:.2f}, {event.goal.y:.2f})"
    if isinstance(event, Report):
        return f"report {event.text!r}"
    if isinstance(event, Award):
        return f"award {event.ride_m:.1f} m of {event.ride_id}"
    return event if isinstance(event, str) else type(event).__name__
