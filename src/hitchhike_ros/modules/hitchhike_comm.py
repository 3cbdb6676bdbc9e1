"""Asks for rides, gives rides, and says what the other modules of its robot do (P17 Fig. 8, module COM)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import ClassVar

from hitchhike_ros.core.datatypes import FloatArray, Odometry, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import MessageError, PlanningError, SensorDataError
from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.localization.motion import carried_on
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.modules.inputs import FoundObstacles, HandedOverObstacles, InitialPose, NetworkText, PlanReport
from hitchhike_ros.modules.module import Fresh, Health, Level, Order, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.protocol.agent import Agent
from hitchhike_ros.protocol.events import (
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
)
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.messages import Ack, Beacon, Driver, Message, encode
from hitchhike_ros.protocol.observations import Observations
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import Status

# An estimate older than this is no longer the robot's pose (s).
_ESTIMATE_AGE_S = 1.0
# The status is repeated, since orders have an age (s).
_STATUS_PERIOD_S = 1.0
# Messages that come again and again wait for one another so long after a step (s, chosen).
_GATHER_S = 0.1
# A step that comes this much early will do, or a clock with ticks would make each one late (s). What that step finds
# not yet due waits as long for another.
_EARLY_S = 1e-3
# Refused messages of one sender are reported once in so long (s).
_REPORT_PERIOD_S = 10.0
# These come again and again; all others are answered at once.
_REPEATED = (Ack, Beacon, Driver)


@dataclass(frozen=True)
class Outcome:
    """How the goal ended."""

    reached: bool
    text: str


@dataclass(frozen=True, kw_only=True)
class HitchhikeCommOutputs(Outputs):
    """What the robot says to others, to its modules and to whoever gave the goal.

    ``messages`` are JSON for the network; ``status`` is there when it has changed or is to be repeated; ``outcome`` is
    there at each step from the end of a goal until the next one; ``pose`` is a new estimate, for the action's feedback.
    """

    messages: tuple[str, ...] = ()
    status: Status | None = None
    initial_pose: InitialPose | None = None
    handed_over: HandedOverObstacles | None = None
    awards: tuple[Award, ...] = ()
    reports: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    outcome: Outcome | None = None
    pose: PoseEstimate | None = None


class HitchhikeComm:
    """Steps the robot's agent with what arrives, and says what it wants."""

    name: ClassVar[str] = "hitchhike_comm"
    inputs: ClassVar[frozenset[type]] = frozenset(
        {
            *(NetworkText, PoseEstimate, Odometry, OccupancyGrid, FoundObstacles),
            *(NavigationReport, PlanReport, Observations),
        }
    )
    patient: ClassVar[frozenset[type]] = inputs - {NetworkText}

    def __init__(
        self,
        robot_id: str,
        params: HitchhikingParameters,
        sites: Sites,
        planner: GlobalPlanner,
        marker_pose: Pose2D,
        camera: Pose2D,
        radius_m: float,
        first_seq: int = 0,
    ) -> None:
        """``marker_pose`` and ``camera`` are in base_footprint; ``radius_m`` is the robot's; ``first_seq`` must be
        greater than any number of an earlier start, or others take what it says for a replay."""
        self.robot_id = robot_id
        self._planner = planner
        self._agent = Agent(robot_id, params, sites, self._plan, marker_pose, (camera.x, camera.y), radius_m)
        self._inbox = Inbox(robot_id)
        self._outbox = Outbox(first_seq)
        self._events: deque[tuple[object, float]] = deque()  # and when they arrived
        self._answer_now = False
        self._grid: OccupancyGrid | None = None
        self._no_map = "no map received"
        self._estimate: Fresh[PoseEstimate] = Fresh("pose", _ESTIMATE_AGE_S)
        self._told: PoseEstimate | None = None  # as feedback
        self._odometry = PoseBuffer()
        self._speed_mps = self._yaw_rate_rps = 0.0
        self._obstacles = FoundObstacles(())
        self._navigation = NavigationReport("", "idle")
        self._planning = PlanReport("", "idle")
        self._observations = Observations()
        self._published: Status | None = None
        self._stepped_at = math.inf
        self._warned_at: dict[str, float] = {}
        self._warnings: list[str] = []
        self._refused = 0

    @classmethod
    def build(cls, files: RobotFiles) -> HitchhikeComm:
        """That of the robot that ``files`` describe."""
        limits = files.load(RobotLimits, "robot")
        return cls(
            files.robot_id,
            files.load(HitchhikingParameters, "hitchhiking").within(limits.max_speed_mps),
            files.sites,
            GlobalPlanner(files.load(GlobalPlannerParameters, "global_planner"), limits),
            marker_pose=pose_from_matrix(files.mount("marker")),
            camera=pose_from_matrix(files.mount("camera")),
            radius_m=limits.circumscribed_m,
            first_seq=files.first_seq,
        )

    def listens(self) -> frozenset[type]:
        """All of its inputs, always."""
        return self.inputs

    def sense(self, x: object, now: float) -> None:
        """Store an input; a message that is not repeated by its sender makes a step due at once, as does servoing that
        begins or ceases to follow."""
        match x:
            case NetworkText():
                self._hear(x, now)
            case PoseEstimate():
                self._estimate.put(x, x.stamp)
            case Odometry():
                self._take_odometry(x)
            case OccupancyGrid():
                self._grid = x
            case FoundObstacles():
                self._obstacles = x
            case NavigationReport():
                self._navigation = x
            case PlanReport():
                self._planning = x
            case Observations():
                self._answer_now |= x.following != self._observations.following
                self._observations = x
            case Refused():
                self._refuse(x.sender, x.reason, now)
                if x.what is Odometry:
                    self._lose_odometry()
                elif x.what is OccupancyGrid:
                    self._no_map = f"no map received, only one that was refused: {x.reason}"

    def order(self, order: Order, now: float) -> None:
        """Somebody wants this robot at a goal, or no longer."""
        if isinstance(order, (GoalGiven, GoalCancelled)):
            self._events.append((order, now))
            self._answer_now = True

    def next_due(self, now: float) -> float:
        """At once for what wants an answer, soon for what has arrived, else when the agent wants it."""
        if self._answer_now or now < self._stepped_at:  # never stepped, or time jumped back
            return now
        due = self._agent.next_due(now)
        if self._events:
            due = min(due, self._stepped_at + _GATHER_S)
        return max(due - _EARLY_S, self._stepped_at + _EARLY_S)

    def step(self, now: float) -> HitchhikeCommOutputs:
        """Take all events and the passing of time."""
        self._stepped_at, self._answer_now = now, False
        arrived, self._events = self._events, deque()
        events = [x.aged(now - at) if isinstance(x, Message) else x for x, at in arrived]
        effects: list[Effect] = []
        for event in [*events, Tick(self._situation(now))]:
            effects += self._agent.step(event, now)
        taken = next((InitialPose(e.estimate) for e in effects if isinstance(e, TakePose)), None)
        if taken is not None:
            self._estimate.clear()  # what localization said before it starts anew
        status = self._agent.status(now)
        outcome = self._agent.outcome
        estimate = self._estimate.get(now)
        new_pose = estimate if estimate is not self._told else None
        self._told = estimate
        warnings, self._warnings = tuple(self._warnings), []
        return HitchhikeCommOutputs(
            health=self._health(status),
            messages=tuple(self._sent(effect, now) for effect in effects if isinstance(effect, Send)),
            status=self._to_publish(status),
            initial_pose=taken,
            handed_over=next((HandedOverObstacles(e.obstacles) for e in effects if isinstance(e, TakeObstacles)), None),
            awards=tuple(effect for effect in effects if isinstance(effect, Award)),
            reports=tuple(effect.text for effect in effects if isinstance(effect, Report)),
            warnings=warnings,
            outcome=None if outcome is None else Outcome(outcome.reached, str(outcome)),
            pose=new_pose,
        )

    def _take_odometry(self, odometry: Odometry) -> None:
        try:
            knew = self._odometry.twistless
            self._odometry.add(odometry)
            twist = self._odometry.newest.twist
            self._speed_mps, self._yaw_rate_rps = twist.v, twist.omega
            if self._odometry.twistless and not knew:
                self._warnings.append("odom: no twist in it though the pose moves; it is derived from the poses")
        except SensorDataError:
            self._lose_odometry()

    def _lose_odometry(self) -> None:
        """An unknown speed is not zero; the modules that drive stop by themselves."""
        self._odometry.clear()
        self._speed_mps = self._yaw_rate_rps = math.inf

    def _hear(self, heard: NetworkText, now: float) -> None:
        try:
            message = self._inbox.receive(heard.text)
        except MessageError as exc:
            self._refuse(heard.sender, f"network message dropped: {exc}", now)
            return
        if message is not None:
            self._events.append((message, now))
            self._answer_now |= not isinstance(message, _REPEATED)

    def _refuse(self, sender: str, text: str, now: float) -> None:
        """Count a bad message, and report it once per sender and period; time may have jumped back."""
        self._refused += 1
        if not 0.0 <= now - self._warned_at.get(sender, -math.inf) < _REPORT_PERIOD_S:
            self._warned_at[sender] = now
            self._warnings.append(f"from {sender}: {text}")

    def _situation(self, now: float) -> Situation:
        servo = None if self._published is None else self._published.servo
        markers = self._observations.markers
        seen = next((o for o in markers if servo is not None and o.marker_id == servo.marker_id), None)
        # Without a plan there is nothing to say of driving along it.
        failed = self._planning.state == "failed"
        plan = self._planning
        return Situation(
            estimate=self._estimate_now(now),
            speed_mps=self._speed_mps,
            obstacles=self._obstacles.obstacles,
            navigation=NavigationReport(plan.goal_id, plan.state, plan.reason) if failed else self._navigation,
            observation=seen,
            seen_from=self._odometry.get(seen.stamp) if seen is not None else None,
            odom_pose=self._odometry.get(now),
            following=self._observations.following,
            yaw_rate_rps=self._yaw_rate_rps,
        )

    def _estimate_now(self, now: float) -> PoseEstimate | None:
        """The estimate, which is of the time of a scan, carried by the wheels to the time of all else."""
        estimate = self._estimate.get(now)
        if estimate is None:
            return None
        return carried_on(estimate, self._odometry.get(estimate.stamp), self._odometry.get(now), now)

    def _sent(self, effect: Send, now: float) -> str:
        message = self._outbox.stamp(effect.message, now)
        self._inbox.sent(message)  # it comes back on a topic that all share
        return encode(message)

    def _to_publish(self, status: Status) -> Status | None:
        """The status, if it is new or is to be repeated."""
        last = self._published
        repeats = last is None or not 0.0 <= status.time_stamp - last.time_stamp < _STATUS_PERIOD_S - _EARLY_S
        if last is not None and not repeats and replace(last, time_stamp=status.time_stamp) == status:
            return None
        self._published = status
        return status

    def _health(self, status: Status) -> Health:
        counters = {
            "reason": status.reason,
            "role": status.role,
            "dropped": self._refused,
            **{f"dropped_{cause}": count for cause, count in self._inbox.dropped.items()},
        }
        if self._grid is None:
            return Health(Level.ERROR, self._no_map, counters)
        return Health(Level.OK, status.state, counters)

    def _plan(self, start: Pose2D, goal: Pose2D) -> FloatArray:
        if self._grid is None:
            raise PlanningError(self._no_map)
        return self._planner.plan(self._grid, start, goal)
