"""State machines declared as tables and stepped by ``(event, now)``; what they want done comes back as effects.

They know no ROS, no clock and no thread, so nodes, simulations and tests step the same objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar

from hitchhike_ros.core.datatypes import MarkerObservation, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.protocol.messages import Message

S = TypeVar("S", bound=Enum)


# Events, beside the network messages themselves.


@dataclass(frozen=True)
class GoalGiven:
    """Somebody wants this robot at ``goal`` in ``map``."""

    goal: Pose2D


@dataclass(frozen=True)
class GoalCancelled:
    """The goal is withdrawn: stop."""


@dataclass(frozen=True)
class NavigationReport:
    """What obstacle avoidance says of the goal it was given."""

    goal_id: str
    state: str  # idle, driving, arrived, blocked, failed
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Situation:
    """What the robot's own modules know now; None where a module is off or has not spoken."""

    estimate: PoseEstimate | None = None
    speed_mps: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    navigation: NavigationReport | None = None
    observation: MarkerObservation | None = None
    seen_from: Pose2D | None = None  # own pose in ``odom`` when that observation was made
    odom_pose: Pose2D | None = None  # own pose in ``odom`` now
    following: str = ""  # what servoing does with the driver, in its words


@dataclass(frozen=True, eq=False)
class Tick:
    """Time has passed; the situation is this."""

    situation: Situation


# Effects.


@dataclass(frozen=True)
class Send:
    """Broadcast this message; the node adds sender, sequence number and time."""

    message: Message


@dataclass(frozen=True, eq=False)
class TakePose:
    """Localization starts from this estimate."""

    estimate: PoseEstimate


@dataclass(frozen=True)
class TakeObstacles:
    """Mapping adds these boxes to the robot's own map."""

    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True)
class Award:
    """The driver earned points for a ride (P17 §5)."""

    ride_id: str
    hitchhiker: str
    ride_m: float
    points: float


@dataclass(frozen=True)
class Report:
    """Something an operator wants to read."""

    text: str


Effect = Send | TakePose | TakeObstacles | Award | Report


@dataclass(frozen=True)
class Row:
    """In one of ``states``, ``event`` calls the method ``action``, which stays or goes to one of ``targets``."""

    states: tuple[Any, ...]
    event: type
    action: str
    targets: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Timeout:
    """After the parameter ``limit`` in ``state``, the method ``action`` goes to one of ``targets``."""

    state: Any
    limit: str
    action: str
    targets: tuple[Any, ...]


class Machine(Generic[S]):
    """A table-driven machine. Subclasses declare ``ROWS`` and ``TIMEOUTS`` and write the actions."""

    ROWS: ClassVar[tuple[Row, ...]]
    TIMEOUTS: ClassVar[tuple[Timeout, ...]]

    def __init__(self, initial: S, params: object) -> None:
        self.state = initial
        self.reason = ""
        self.situation = Situation()
        self.ignored = 0  # messages that arrived in a state that has no use for them
        self._params = params
        self._now = 0.0
        self._entered = 0.0
        self._effects: list[Effect] = []
        self._rows = {(state, row.event): row for row in self.ROWS for state in row.states}
        self._timeouts = {timeout.state: timeout for timeout in self.TIMEOUTS}
        self._allowed: tuple[Any, ...] = ()
        self._due: dict[str, float] = {}
        self._last_words: list[tuple[float, Message]] = []

    def step(self, event: object, now: float) -> list[Effect]:
        """Take one event.

        Raises:
            TransitionError: a command that the state does not allow, or an action that left its row's targets.
                Network messages never raise: one that the state has no use for is counted and ignored.
        """
        self._now, self._effects = now, []
        if isinstance(event, Tick):
            self.situation = event.situation
            while (timeout := self._expired()) is not None:
                self._run(timeout.action, timeout.targets)
            while self._last_words and self._last_words[0][0] <= now:
                self._send(self._last_words.pop(0)[1])
        row = self._rows.get((self.state, type(event)))
        if row is not None:
            self._run(row.action, row.targets, event)
        elif isinstance(event, Message):
            self.ignored += 1
        elif not isinstance(event, Tick):
            raise TransitionError(f"{type(self).__name__}: {type(event).__name__} is not allowed in {self.state.value}")
        return self._effects

    def time_in_state(self) -> float:
        return self._now - self._entered

    def _expired(self) -> Timeout | None:
        timeout = self._timeouts.get(self.state)
        if timeout is None or self._now - self._entered <= self._limit_s(timeout.limit):
            return None
        return timeout

    def _limit_s(self, name: str) -> float:
        """How long a state with this limit may last now."""
        return float(getattr(self._params, name))

    def _run(self, action: str, targets: tuple[Any, ...], *event: object) -> None:
        self._allowed = targets
        getattr(self, action)(*event)

    def _go(self, state: S, reason: str = "") -> None:
        if state not in self._allowed:
            raise TransitionError(f"{type(self).__name__}: no way from {self.state.value} to {state.value}")
        self.state, self.reason, self._entered = state, reason, self._now
        self._due = {}

    def _send(self, message: Message) -> None:
        self._effects.append(Send(message))

    def _send_last_word(self, message: Message, period_s: float, duration_s: float) -> None:
        """Send what ends a ride; nobody stays to acknowledge it, so it is repeated for a while."""
        self._send(message)
        times = range(1, int(duration_s / period_s) + 1)
        self._last_words += [(self._now + i * period_s, message) for i in times]
        self._last_words.sort(key=lambda word: word[0])

    def _report(self, text: str) -> None:
        self._effects.append(Report(text))

    def _every(self, period_s: float, what: str) -> bool:
        """Whether ``what`` is due again; true at once after a change of state."""
        if self._now < self._due.get(what, self._now):
            return False
        self._due[what] = self._now + period_s
        return True


def stamped(message: Message, seq: int, now: float) -> Message:
    """``message`` with its place in the sender's sequence and its time."""
    sent = object.__new__(type(message))  # a quarter of the time of dataclasses.replace, and every message pays it
    sent.__dict__.update(message.__dict__, seq=seq, time_stamp=now)
    return sent
