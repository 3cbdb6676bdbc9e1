"""A person at the keys, as a rule: watches where the robot is on the map and its route, and holds keys (P18 §8.3.4)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive
from hitchhike_ros.core.geometry import between
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.protocol.status import Status

_STOP = " "
# A route leads to a goal when it ends so near to it (chosen).
_SAME_PLACE_M = 0.3


@dataclass(frozen=True)
class HumanParameters:
    """Section ``human``; chosen."""

    look_ahead_m: Positive = 1.2  # on the route, what the person steers for
    correct_rad: Positive = 0.1  # off by more than this, the person steers
    turn_rad: Positive = 0.8  # off by more than this, the person stops and turns on the spot
    turned_rad: Positive = 0.25
    park_m: Positive = 1.0  # nearer to the end than this the robot parks while the person says go
    repeat_s: Positive = 0.1  # a key that is held


class ScriptedHuman:
    """The keys for one robot along one route after another."""

    def __init__(self, params: HumanParameters) -> None:
        self._params = params
        self._turning = False
        self._due_at = 0.0

    def keys(self, pose: Pose2D, route: FloatArray, now: float) -> str:
        """What is typed at ``now``, often nothing; ``pose`` and ``route`` (N, 2) in ``map``."""
        repeat_s = self._params.repeat_s
        if 0.0 < self._due_at - now <= repeat_s:
            return ""
        on_time = 0.0 <= now - self._due_at < repeat_s
        self._due_at = (self._due_at if on_time else now) + repeat_s
        path = Polyline(route)
        s, _ = path.project(pose.x, pose.y)
        if path.end_m - s < self._params.park_m:
            return "w"
        ahead = between(pose, Pose2D(*path.point(s + self._params.look_ahead_m)))
        off = math.atan2(ahead.y, ahead.x)
        side = "a" if off > 0.0 else "d"
        if abs(off) > (self._params.turned_rad if self._turning else self._params.turn_rad):
            stop = "" if self._turning else " "
            self._turning = True
            return stop + side
        self._turning = False
        return side if abs(off) > self._params.correct_rad else "w"


@dataclass(frozen=True)
class OperatorParameters:
    """How often the person looks, and how patiently leaves, in wall time (chosen)."""

    look_s: Positive = 0.01  # while driving: keys are held for longer
    wait_s: Positive = 0.2  # while nothing can be driven yet
    leave_s: Positive = 10.0  # that a terminal has to end in


class DrivenRobot:
    """One robot in the person's hands: what the person sees of it and types, and what that comes to."""

    def __init__(self, params: HumanParameters) -> None:
        self._human = ScriptedHuman(params)
        self._pose: Pose2D | None = None
        self._route: FloatArray | None = None
        self._status: Status | None = None
        self.counts: dict[str, Counter[str]] = {}
        """Keys, commands and bytes of both, by the state that the robot was in."""

    @property
    def in_hand(self) -> bool:
        """Whether a command of its teleop has been sent."""
        return any(counts["commands"] for counts in self.counts.values())

    def pose(self, pose: Pose2D) -> None:
        """Where the robot is on the map."""
        self._pose = pose

    def route(self, route: FloatArray | None) -> None:
        """The robot's route (N, 2) in ``map``, None where it has none."""
        self._route = route

    def status(self, status: Status) -> None:
        """What the robot reports."""
        self._status = status

    def take(self) -> str:
        """The keys that take the robot in hand: they stop it."""
        return "" if self.in_hand else self._typed(_STOP)

    def keys(self, now: float) -> str:
        """What is typed at ``now`` to drive the robot to its goal, often nothing."""
        status, pose, route = self._status, self._pose, self._route
        if status is None or status.teleop_mode != "guided" or status.goal is None or pose is None or route is None:
            return ""
        if math.dist(route[-1], (status.goal.x, status.goal.y)) >= _SAME_PLACE_M:
            return ""  # it is the route to a goal before
        return self._typed(self._human.keys(pose, route, now))

    def sent(self, size: int) -> None:
        """A command of so many bytes went to the robot."""
        self._count(commands=1, bytes=size)

    def _typed(self, keys: str) -> str:
        if keys:
            self._count(keys=len(keys), bytes=len(keys))
        return keys

    def _count(self, **what: int) -> None:
        state = self._status.state if self._status is not None else "idle"
        self.counts.setdefault(state, Counter()).update(what)


class OperatorScript:
    """Whom the person drives: one robot after another, each to its goal. At the end the other robots are waited for.

    Args:
        drives: the robots that are driven, in this order.
        wanted: all robots that have a goal.
    """

    def __init__(self, drives: Sequence[str], wanted: Sequence[str], params: HumanParameters) -> None:
        self.driven = {name: DrivenRobot(params) for name in drives}
        self._newest: dict[str, Status] = {}
        self._goal_at: dict[str, float] = {}
        self._order = [*drives, *(name for name in wanted if name not in drives)]

    def status(self, name: str, status: Status) -> None:
        """What a robot reports."""
        self._newest[name] = status
        if status.state != "idle":
            self._goal_at.setdefault(name, status.time_stamp)
        if name in self.driven:
            self.driven[name].status(status)

    @property
    def in_hand(self) -> bool:
        """Whether every robot that is to be driven has been taken in hand."""
        return all(robot.in_hand for robot in self.driven.values())

    @property
    def turn(self) -> str | None:
        """The robot that is driven or waited for now; None when all have come to their end."""
        return next((name for name in self._order if not self._ended(name)), None)

    @property
    def completed(self) -> bool:
        """Whether every robot has come to its goal."""
        return self.turn is None and all(self._newest[name].ending.reached for name in self._order)

    @property
    def waits_for(self) -> str:
        """What has to come next, in words."""
        for name, robot in self.driven.items():
            if not robot.in_hand:
                return f"{name} is in hand"
        waiting = [name for name in self._order if name not in self._goal_at]
        return f"{', '.join(waiting)} has a goal" if waiting else f"{self.turn} is at its goal"

    def keys(self, now: float) -> tuple[str, str] | None:
        """Which robot's teleop gets which keys at ``now``; None: none does."""
        name = self.turn
        if name not in self.driven or any(other not in self._goal_at for other in self._order):
            return None
        keys = self.driven[name].keys(now)
        return (name, keys) if keys else None

    def report(self, now: float) -> dict[str, object]:
        """The counts: in all, of each robot that is driven, and by the state that robots were in."""
        robots = {name: _sum(robot.counts.values()) for name, robot in self.driven.items()}
        states: dict[str, Counter[str]] = {}
        for robot in self.driven.values():
            for state, counts in robot.counts.items():
                states.setdefault(state, Counter()).update(counts)
        begins = self._goal_at.values()
        return {
            "completed": self.completed,
            **Counter(keys=0, commands=0, bytes=0),
            **_sum(robots.values()),
            "seconds": round(now - min(begins), 2) if begins else None,
            "robots": robots,
            "states": states,
        }

    def _ended(self, name: str) -> bool:
        return name in self._goal_at and self._newest[name].state == "idle"


def _sum(every: Iterable[Counter[str]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for counts in every:
        total.update(counts)
    return total
