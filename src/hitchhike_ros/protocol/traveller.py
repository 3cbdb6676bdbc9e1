"""One robot in the protocol: it rides where it may, drives where it must, and tells its modules what is on."""

from __future__ import annotations

from dataclasses import replace

from hitchhike_ros.datatypes import Pose2D
from hitchhike_ros.errors import PlanningError
from hitchhike_ros.geometry import path_length
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.driver import ARRIVED, DriverMachine, DriverState, Planner
from hitchhike_ros.protocol.hitchhiker import HitchhikerMachine, HitchhikerState
from hitchhike_ros.protocol.machine import Effect, GoalCancelled, GoalGiven, Send, Situation, Tick
from hitchhike_ros.protocol.messages import Beacon, Message, PoseFields
from hitchhike_ros.protocol.parameters import TIME_CRITICAL_PRIORITY, HitchhikingParameters
from hitchhike_ros.protocol.status import KnownRobot, Status

# Radius of a robot whose beacon has not been heard yet (chosen).
_UNKNOWN_RADIUS_M = 0.4


class Traveller:
    """Owns the robot's goal and both machines; only one of them has it at a time.

    Raises TransitionError as the machines do.
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
    ) -> None:
        self.robot_id = robot_id
        self.params = params
        self.hitchhiker = HitchhikerMachine(robot_id, params, sites, camera)
        self.driver = DriverMachine(robot_id, params, sites, planner, marker_pose)
        self._planner, self._radius_m = planner, radius_m
        self._situation = Situation()
        self._pending: Pose2D | None = None
        self._robots: dict[str, tuple[KnownRobot, float]] = {}
        self._beacon_due = 0.0
        self._driver = ""  # of the newest ride

    @property
    def rides(self) -> bool:
        return self.hitchhiker.state is not HitchhikerState.IDLE

    @property
    def outcome(self) -> tuple[bool, str] | None:
        """Whether the last goal was reached, and why it ended; None while the robot is on its way to one."""
        if self._pending is not None or self.rides or self.driver.state is not DriverState.IDLE:
            return None
        return self.driver.reason == ARRIVED, self.driver.reason

    def step(self, event: object, now: float) -> list[Effect]:
        """Take a GoalGiven, GoalCancelled, Tick or network Message."""
        if isinstance(event, GoalGiven):
            effects = self._drop_goal(now)
            self._pending = event.goal
            return effects
        if isinstance(event, GoalCancelled):
            return self._drop_goal(now)
        if isinstance(event, Tick):
            return self._tick(event, now)
        assert isinstance(event, Message)
        self._remember(event, now)
        effects = self.hitchhiker.step(event, now)
        if not self.rides:
            effects += self.driver.step(event, now)
        return effects

    def status(self, now: float) -> Status:
        """What the modules have to do now."""
        machine = self.hitchhiker if self.rides else self.driver
        role = "hitchhiker" if self.rides else ("driver" if self.driver.offer is not None else "none")
        if self.hitchhiker.offer is not None:
            self._driver = self.hitchhiker.offer.robot_id
        robots = tuple(robot for name, (robot, heard) in self._robots.items() if now - heard <= self._memory_s(name))
        servo = machine.servo
        return Status(
            time_stamp=now,
            robot_id=self.robot_id,
            role=role,
            state=machine.state.value,
            reason=machine.reason,
            modules=machine.modules,
            goal=self.hitchhiker.way if self.rides else self.driver.goal,
            speed_limit_mps=self.driver.speed_limit_mps,
            servo=servo,
            following=self._situation.following if servo is not None and servo.task == "follow" else "",
            ride=machine.ride,
            robots=robots,
        )

    def _memory_s(self, robot_id: str) -> float:
        """How long a silent robot counts as being where it said: a driver without a rider stands there and waits."""
        return self.params.lost_timeout_s if robot_id == self._driver else self.params.robot_timeout_s

    def _tick(self, tick: Tick, now: float) -> list[Effect]:
        self._situation = tick.situation
        rode = self.rides
        left_at = self.hitchhiker.left_at
        effects = self.hitchhiker.step(tick, now) + self.driver.step(tick, now)
        self._note_driver(left_at, now)
        if rode and not self.rides and self.hitchhiker.goal is not None:
            effects += self.driver.step(GoalGiven(self.hitchhiker.goal), now)
            self.driver.reason = self.hitchhiker.reason  # why it goes on alone
        if self._pending is not None and not self.rides and tick.situation.estimate is not None:
            goal, self._pending = self._pending, None
            machine = self.hitchhiker if self._wants_ride(goal) else self.driver
            effects += machine.step(GoalGiven(goal), now)
        if now >= self._beacon_due:
            self._beacon_due = now + self.params.beacon_period_s
            effects.append(Send(self._beacon()))
        return effects

    def _note_driver(self, left_at: Pose2D | None, now: float) -> None:
        """A driver that is left is where it was seen then: what it said last may be metres old."""
        seen, known = self.hitchhiker.left_at, self._robots.get(self._driver)
        if seen is not None and seen != left_at and known is not None:
            self._robots[self._driver] = (replace(known[0], x=seen.x, y=seen.y), now)

    def _drop_goal(self, now: float) -> list[Effect]:
        self._pending = None
        return self.hitchhiker.step(GoalCancelled(), now) + self.driver.step(GoalCancelled(), now)

    def _wants_ride(self, goal: Pose2D) -> bool:
        estimate = self._situation.estimate
        if not self.params.may_ride or self.params.priority >= TIME_CRITICAL_PRIORITY or estimate is None:
            return False
        try:
            return path_length(self._planner(estimate.pose, goal)) >= self.params.min_ride_m
        except PlanningError:
            return False  # navigation will find out, and say why

    def _remember(self, message: Message, now: float) -> None:
        pose = message.pose if isinstance(message, Beacon | PoseFields) else None
        if pose is None:
            return
        known = self._robots.get(message.robot_id)
        radius = (
            message.radius_m if isinstance(message, Beacon) else (known[0].radius_m if known else _UNKNOWN_RADIUS_M)
        )
        self._robots[message.robot_id] = (KnownRobot(pose.x, pose.y, radius), now)

    def _beacon(self) -> Beacon:
        estimate = self._situation.estimate
        state = self.hitchhiker.state if self.rides else self.driver.state
        return Beacon(
            robot_id=self.robot_id,
            state=state.value,
            profile=self.params.profile,
            priority=self.params.priority,
            radius_m=self._radius_m,
            pose=None if estimate is None else estimate.pose,
            goal=self.hitchhiker.goal if self.rides else self.driver.own_goal,
        )
