"""A corridor, messages and a bench for the tests of the protocol."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hitchhike_ros.core.datatypes import (
    FloatArray,
    HitchhikingPoint,
    Marker,
    MarkerObservation,
    Obstacle,
    Pose2D,
    PoseEstimate,
)
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import Effect, GoalGiven, NavigationReport, Send, Situation, Tick
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.matching import Planner
from hitchhike_ros.protocol.messages import (
    Accept,
    Ack,
    Aligned,
    Beacon,
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
)
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import GoalCommand

RIDER, DRIVER = "turtlebot", "p3dx"
SIGMA = ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.001))
WEST = HitchhikingPoint(
    "west",
    ((1.0, 4.6), (6.0, 4.6), (6.0, 6.84), (1.0, 6.84)),
    aligning_pose=Pose2D(3.0, 5.72, 0.0),
    waiting_pose=Pose2D(1.8, 5.72, 0.0),
    marker=10,
)
SITES = Sites((Marker(10, 5.2, 6.62, 0.3, math.pi),), (WEST,))
DRIVER_GOAL, RIDER_GOAL = Pose2D(25.0, 9.5, math.pi / 2), Pose2D(25.0, 2.5, -math.pi / 2)
CAMERA = (0.15, 0.0)
MARKER_POSE = Pose2D(-0.25, 0.0, math.pi)  # on the driver's back
REAR_MARKER = RearMarker(marker_id=1, marker_size_m=0.16, marker_pose=MARKER_POSE)  # on the rider's
PATH = ((3.0, 5.72, 0.0), (25.0, 5.72, 40.0), (25.0, 9.5, 47.0))  # the driver's
BOXES = (
    Obstacle("obs1", 9.24, 6.08, 0.28, 0.16),
    Obstacle("obs2", 12.32, 5.16, 0.40, 0.44),
    Obstacle("obs3", 15.04, 6.00, 0.44, 0.28),
)


def corridor_path(start: Pose2D, goal: Pose2D) -> FloatArray:
    """Along x, then along y: the plan of a world without walls."""
    return np.array([(start.x, start.y), (goal.x, start.y), (goal.x, goal.y)])


def messages(robot_id: str = DRIVER, to: str = RIDER, ride_id: str = "ride") -> dict[type[Message], Message]:
    """One message of every type."""
    head: dict[str, Any] = {"robot_id": robot_id, "to": to, "ride_id": ride_id}
    pose = {"x": 3.0, "y": 5.72, "theta": 0.0}
    end = (23.0, 5.72)
    boxes = NewObstacles(obstacles=BOXES)
    every: tuple[Message, ...] = (
        Beacon(
            **head,
            state="idle",
            profile=50.0,
            priority=10,
            pose=Pose2D(1.0, 2.0, 3.0),
            goal=DRIVER_GOAL,
            path=PATH,
            free_places=1,
        ),
        Request(
            **head,
            x=1.8,
            y=5.72,
            theta=0.0,
            goal=RIDER_GOAL,
            profile=50.0,
            rear_marker=REAR_MARKER,
            path=((1.8, 5.72), (25.0, 5.72), (25.0, 2.5)),
        ),
        Accept(
            **head,
            **pose,
            profile=50.0,
            ride_m=20.4,
            decouple_point=end,
            marker_id=0,
            marker_size_m=0.16,
            marker_pose=MARKER_POSE,
            path=PATH,
        ),
        Deny(**head, reason="Path too short"),
        Lock(**head),
        RequestCancel(**head),
        Aligned(**head, **pose, decouple_point=end),
        Coupled(**head, gap_m=0.8),
        Driver(**head, **pose, sigma=SIGMA, new_obstacles=boxes, v=0.5, ridden_m=1.0),
        Ack(**head, of="driver", acknowledges=7, gap_m=0.8, seen=Pose2D(0.95, 0.0, math.pi), seen_sigma=SIGMA),
        Decouple(**head, **pose, sigma=SIGMA, new_obstacles=boxes, ridden_m=20.4),
        Terminate(**head, reason="Driver lost"),
    )
    return {type(message): message for message in every}


@dataclass
class Bench:
    """A machine, the time, and what the robot's modules say; ``effects`` gathers what the machine wants."""

    machine: Any
    now: float = 1000.0
    pose: Pose2D | None = WEST.aligning_pose
    speed: float = 0.0
    yaw_rate: float = 0.0
    gap: float | None = None  # from the camera to the driver's marker, None: not in view
    navigation: str | None = None  # what obstacle avoidance says of the present goal
    obstacles: tuple[Obstacle, ...] = ()
    effects: list[Effect] = field(default_factory=list)

    def step(self, event: object) -> None:
        self.effects += self.machine.step(event, self.now)

    def wait(self, seconds: float = 0.1) -> None:
        """Tick at 10 Hz."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.step(Tick(self.situation()))

    def ride(self, metres: float) -> None:
        """A driver has gone on with its rider, whatever it does now."""
        for rider in self.machine.rides:
            rider.ridden_m = metres

    def lose_driver(self, then: HitchhikerState) -> None:
        """A rider that has come to the step before ``then`` comes to it."""
        if then is HitchhikerState.SEEKING:
            self.gap = None
        elif then is HitchhikerState.CATCHING_UP:
            self.pose = Pose2D(1.7, 5.72)
        elif then is HitchhikerState.RECOUPLING:
            self.gap = 1.3
        elif then is HitchhikerState.PARTING:
            self.hear(Terminate)
        while self.machine.state is not then and self.now < 1100.0:
            self.wait()
            if then is not HitchhikerState.SEEKING and round(self.now * 10) % 5 == 0:
                self.hear(Driver)

    def hear(self, cls: type[Message], **changes: Any) -> None:
        """A message of the present ride from the other robot."""
        machine = self.machine
        if isinstance(machine, DriverMachine):
            ride_id = machine.offer.ride_id if machine.offer is not None else "ride"
            message = messages(RIDER, DRIVER, ride_id)[cls]
        else:
            message = messages(DRIVER, RIDER, machine.ride_id)[cls]
        self.step(replace(message, **changes))

    def situation(self) -> Situation:
        goal = self.machine.goal
        report = (
            NavigationReport(goal.id, self.navigation) if self.navigation and isinstance(goal, GoalCommand) else None
        )
        seen = None
        if self.gap is not None:
            seen = MarkerObservation(self.now, 0, Pose2D(CAMERA[0] + self.gap, 0.0, math.pi), np.array(SIGMA))
        estimate = None if self.pose is None else PoseEstimate(self.now, self.pose, np.array(SIGMA))
        return Situation(estimate, self.speed, self.obstacles, report, seen, yaw_rate_rps=self.yaw_rate)

    def take(self, cls: type | tuple[type, ...]) -> list[Any]:
        """The effects, or the messages sent, of these types since the last ``take`` or ``clear``, which forget all."""
        found = [e.message if isinstance(e, Send) else e for e in self.effects]
        self.clear()
        return [e for e in found if isinstance(e, cls)]

    def clear(self) -> None:
        self.effects = []


def driver_in(state: DriverState, planner: Planner = corridor_path, **params: Any) -> Bench:
    """A driver that has come to ``state`` on the usual way."""
    S = DriverState
    bench = Bench(DriverMachine(DRIVER, HitchhikingParameters(**params), SITES, planner, MARKER_POSE))
    machine = bench.machine
    bench.wait()
    if state is not S.IDLE:
        bench.step(GoalGiven(DRIVER_GOAL))
        bench.wait()
    if state is S.YIELDING:
        goal = Pose2D(7.0, 5.72)
        machine.facts.said = Beacon(robot_id=DRIVER, state="navigating", profile=50.0, priority=10, goal=goal)
        parked = Beacon(robot_id="parked", state="idle", profile=50.0, priority=10, pose=goal)
        machine.facts.neighbours.hear(parked, bench.now)
        bench.step(GoalGiven(goal))
        bench.wait()
        return _arrived(bench, machine, state)
    if state not in (S.IDLE, S.NAVIGATING):
        bench.hear(Request)
    if state not in (S.IDLE, S.NAVIGATING, S.OFFERING):
        bench.hear(Lock)
    if state not in (S.IDLE, S.NAVIGATING, S.OFFERING, S.ALIGNING):
        bench.navigation = "arrived"
        bench.wait()
        bench.navigation = None
    if state in (S.DRIVING, S.WAITING_FOR_RIDER, S.DECOUPLING):
        bench.hear(Coupled)
    if state is S.WAITING_FOR_RIDER:
        bench.wait(machine.params.ack_timeout_s + 0.2)
    if state is S.DECOUPLING:
        bench.navigation = "arrived"
        bench.wait()
        bench.navigation = None
    return _arrived(bench, machine, state)


def rider_in(
    state: HitchhikerState, sites: Sites = SITES, neighbours: Neighbours | None = None, **params: Any
) -> Bench:
    """A hitchhiker that has come to ``state`` on the usual way."""
    S = HitchhikerState
    way = [S.IDLE, S.REQUESTING, S.LOCKING, S.AWAITING_ALIGNED, S.COUPLING, S.RIDING]
    lost = [S.SEEKING, S.LOCATING, S.CATCHING_UP, S.RECOUPLING, S.PARTING]
    reached = way.index(state) if state in way else len(way)
    bench = Bench(
        HitchhikerMachine(RIDER, HitchhikingParameters(**params), sites, CAMERA, neighbours=neighbours),
        pose=WEST.waiting_pose,
    )
    machine = bench.machine
    bench.wait()
    if state is not S.IDLE:
        bench.step(GoalGiven(RIDER_GOAL))
        bench.wait()
    for cls, then in ((Accept, S.LOCKING), (Ack, S.AWAITING_ALIGNED), (Aligned, S.COUPLING)):
        if reached >= way.index(then):
            bench.hear(cls, **({"of": Lock.type} if cls is Ack else {}))
            if machine.params.mode == "network" and cls is not Aligned:  # then it chooses, or is sent off
                bench.wait()
    if reached >= way.index(S.RIDING):
        bench.gap = machine.params.gap_m
        bench.wait(machine.params.repeat_period_s + 0.2)
        bench.pose = None  # localization is off
        bench.hear(Driver)
        bench.wait()
    for then in lost[: lost.index(state) + 1] if state in lost else ():
        bench.lose_driver(then)
    if state in (S.SETTLING, S.RELOCALIZING):
        bench.hear(Decouple)
    if state is S.RELOCALIZING:
        bench.wait(machine.params.repeat_period_s + 0.2)
    return _arrived(bench, machine, state)


def _arrived(bench: Bench, machine: Any, state: object) -> Bench:
    assert machine.state is state, f"{machine.state} instead of {state}"
    bench.clear()
    return bench
