"""The grid simulator: any number of robots, each a real agent of the protocol, on one map and one clock (P18 §8.1).

It goes from event to event: a message that arrives, a robot that has come to the end of its path, whose beacon is due,
or that is engaged in a ride and looks again. Between events bodies move by formula, so a robot that drives or stands
alone costs next to nothing. No ROS, no physics: bodies pass through each other, turn and change speed at once, and what
a robot knows of itself is true but for a little noise.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hitchhike_ros.core.datatypes import Obstacle, Pose2D
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.agent import Agent
from hitchhike_ros.protocol.events import (
    Award,
    Effect,
    GoalCancelled,
    GoalGiven,
    Report,
    Send,
    TakeObstacles,
    TakePose,
    Tick,
)
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.messages import Beacon, Lock, Message, Request
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Ending, Reason
from hitchhike_ros.simulation.grid.air import Air
from hitchhike_ros.simulation.grid.body import Body
from hitchhike_ros.simulation.grid.inbox import ObjectInbox
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.paths import GridPaths
from hitchhike_ros.simulation.grid.robot import Errand, GridRobot
from hitchhike_ros.simulation.grid.schedule import Schedule
from hitchhike_ros.simulation.grid.stand_ins import StandIns
from hitchhike_ros.simulation.grid.trace import Observer, Trace
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters

# Two ticks of one robot are not nearer than this, or an arrival could cause itself.
_LEAST_STEP_S = 0.01


class GridWorld:
    """Robots on a grid, the network between them, and the time.

    ``observers`` are called after every event that an agent took with (time, robot, event, effects): the event is a
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
        self.params = params = params or GridWorldParameters()
        self.grid, self.sites, self.boxes = grid, sites, tuple(boxes)
        self.network = network or NetworkModel(NetworkParameters())
        self.paths = GridPaths(grid, params.radius_m + params.margin_m, boxes, params.clearance_weight)
        self.robots: dict[str, GridRobot] = {}
        self._by_marker: dict[int, GridRobot] = {}
        self._schedule = Schedule()
        self._trace = Trace(params.trace_events)
        self._air = Air(self.network, params, self._schedule, self._hear, self._hear_beacon)
        self._modules = StandIns(params, self.paths, self.boxes, self._by_marker, random.Random(params.seed))

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
            agent=self._agent(name, params),
            inbox=self._inbox(name),
            clock_offset_s=clock_offset_s,
            errands=deque(errands),
        )
        self.robots[name] = self._by_marker[params.marker_id] = robot
        self._air.join(robot)
        self._plan_tick_at(robot, max(begins_s, self.now))
        if robot.errands:
            self.at(max(robot.errands[0].at_s, begins_s, self.now), lambda: self._next_errand(robot))
        return robot

    def give_goal(self, name: str, goal: Pose2D | None) -> None:
        """Somebody wants the robot at ``goal``, or nowhere any more."""
        robot = self.robots[name]
        if not robot.alive:
            return
        if (trip := robot.trip) is not None:
            robot.end_trip(trip, self.now, Ending(Reason.GOAL_CHANGED))
        if goal is not None:
            robot.begin_trip(goal, self.now)
        self._step(robot, GoalCancelled() if goal is None else GoalGiven(goal))
        self._plan_tick_at(robot, self.now)

    def crash(self, name: str) -> None:
        """The robot stops where it is, and neither hears nor says anything until it is restarted."""
        robot = self.robots[name]
        if robot.alive:
            robot.fall_silent(self.now)
            self._trace.tell(self.now, name, "crash", ())

    def restart(self, name: str) -> None:
        """A new agent that remembers nothing but its map, and is given its goal anew; nothing where one runs."""
        robot = self.robots[name]
        if robot.alive:
            return
        robot.wake(self._agent(name, robot.params), self._inbox(name), self.now)
        self._trace.tell(self.now, name, "restart", ())
        self._plan_tick_at(robot, self.now)
        if (trip := robot.trip) is not None:
            self._step(robot, GoalGiven(trip.goal))
        elif robot.errands:
            self.at(max(self.now, robot.errands[0].at_s), lambda: self._next_errand(robot))

    def idle(self) -> bool:
        """Whether no robot has anything left to do."""
        return all(robot.idle for robot in self.robots.values())

    def pose(self, name: str) -> Pose2D:
        """Where the robot is now."""
        body = self.robots[name].body
        body.advance(self.now)
        return body.pose

    # Time.

    @property
    def now(self) -> float:
        """Simulated time in s."""
        return self._schedule.now

    @property
    def next_event_s(self) -> float:
        """When something happens next; inf when nothing does."""
        return self._schedule.next_event_s

    @property
    def events(self) -> int:
        """How many have happened."""
        return self._schedule.events

    def at(self, time: float, action: Callable[[], None]) -> None:
        """Call ``action()`` at ``time``: what a scenario or a fault wants."""
        self._schedule.at(time, action)

    def step(self) -> bool:
        """The next event; False when there is none."""
        return self._schedule.step()

    def run(self, until_s: float, stop: Callable[[], bool] | None = None) -> bool:
        """All events up to ``until_s``, or until ``stop()`` after one of them; whether it stopped."""
        return self._schedule.run(until_s, stop)

    # What is looked at from outside.

    @property
    def observers(self) -> list[Observer]:
        """They are told each event."""
        return self._trace.observers

    @property
    def messages(self) -> int:
        """How many were sent."""
        return self._air.messages

    @property
    def deliveries(self) -> int:
        """How many were heard."""
        return self._air.deliveries

    def mean_in_range(self) -> float:
        """How many others a robot can hear now, on average."""
        return self._air.mean_in_range()

    def trace(self) -> Iterator[str]:
        """The last events, a line each."""
        return self._trace.lines()

    # Events.

    def _plan_tick_at(self, robot: GridRobot, time: float) -> None:
        """The robot's next tick is not later than that; a later one that was planned before is void."""
        if time < robot.due:
            robot.due = time
            self._schedule.push(time, self._tick_due, (robot, time))

    def _tick_due(self, what: tuple[GridRobot, float]) -> None:
        robot, due = what
        if robot.due == due and robot.alive:
            robot.due = math.inf
            self._tick(robot)

    def _tick(self, robot: GridRobot) -> None:
        now = self._schedule.now
        robot.body.advance(now)
        if robot.body.odometer_m >= robot.perceives_at_m:
            self._modules.perceive(robot)
        self._step(robot, Tick(self._modules.situation(robot, now)))
        if (trip := robot.trip) is not None and (outcome := robot.agent.outcome) is not None:
            robot.end_trip(trip, now, outcome)
            if robot.errands:
                next_s = max(robot.errands[0].at_s, now + robot.errands[0].after_s)
                self.at(next_s, lambda: self._next_errand(robot))

    def _next_errand(self, robot: GridRobot) -> None:
        if robot.alive and robot.errands and robot.trip is None:
            self.give_goal(robot.name, robot.errands.popleft().goal)

    def _hear(self, robot: GridRobot, message: Message) -> None:
        if isinstance(message, (Request, Lock)) and not robot.engaged and robot.trip is not None:
            self._tick(robot)  # what it knew of itself may be old
        self._step(robot, message)

    def _hear_beacon(self, beacon: Beacon, robots: Sequence[GridRobot]) -> None:
        """It changes nothing but what is remembered, and is by far the most frequent, so the loop is kept short."""
        now, wanted = self._schedule.now, self._trace.wanted
        heard = (beacon, now)
        for robot in robots:
            if not robot.alive:
                continue
            offset = robot.clock_offset_s
            robot.agent.neighbours.put_away(beacon, (beacon, now + offset) if offset else heard)
            if wanted:
                self._trace.tell(now, robot.name, beacon, ())

    def _step(self, robot: GridRobot, event: object) -> None:
        """The agent takes the event; its modules do what it wants from then on."""
        now = self._schedule.now
        local = now + robot.clock_offset_s
        agent = robot.agent
        effects = agent.step(event, local)
        for effect in effects:
            self._carry_out(robot, effect, local)
        key = (agent.hitchhiker.state, agent.driver.state, agent.driver.facts.orders)
        told = isinstance(event, (GoalGiven, GoalCancelled)) or (robot.engaged and isinstance(event, Tick))
        news = told or key != robot.key
        if news:
            robot.key = key
            robot.body.advance(now)
            robot.take_status(agent.status(local, others=False), now)
            self._modules.obey(robot, now)
        if self._trace.wanted:
            self._trace.tell(now, robot.name, event, effects)
        if news or not isinstance(event, Message):  # else its next tick is planned already
            self._plan_tick(robot)

    def _plan_tick(self, robot: GridRobot) -> None:
        body, now = robot.body, self._schedule.now
        soonest = now + _LEAST_STEP_S
        due = min(robot.beacon_due, body.arrives)
        if robot.perceives_at_m < math.inf and body.speed_mps > 0.0:
            due = min(due, body.time + (robot.perceives_at_m - body.odometer_m) / body.speed_mps)
        if robot.news:
            due, robot.news = soonest, False
        local = now + robot.clock_offset_s
        # Of a robot that drives or stands alone all that it might notice is an event.
        looks = robot.engaged or robot.goal_error is not None
        wanted = robot.agent.next_due(local) if looks else robot.agent.next_deadline()
        due = min(due, wanted - robot.clock_offset_s)
        self._plan_tick_at(robot, max(due, soonest))

    def _carry_out(self, robot: GridRobot, effect: Effect, local: float) -> None:
        if isinstance(effect, Send):
            message = robot.outbox.stamp(effect.message, local)
            robot.sent[message.type] += 1
            if isinstance(message, Beacon):
                robot.beacon_due = self.now + robot.params.beacon_period_s
            self._air.transmit(robot, message)
        elif isinstance(effect, TakeObstacles):
            for box in effect.obstacles:
                self._modules.learn(robot, box)
        elif isinstance(effect, Award):
            robot.awards.append(effect)
        elif isinstance(effect, Report):
            robot.reports.append((self.now, effect))
        else:
            assert isinstance(effect, TakePose)  # localization is exact anyway

    # What a robot's computer begins with.

    def _agent(self, name: str, params: HitchhikingParameters) -> Agent:
        p = self.params
        return Agent(
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

    def _inbox(self, name: str) -> Inbox | ObjectInbox:
        return Inbox(name) if self.params.json_messages else ObjectInbox()
