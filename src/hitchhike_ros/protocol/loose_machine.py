"""The machine whose rows have several targets and whose guards are in its actions; :mod:`.machine` takes its place."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar

from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.protocol.events import Effect, Report, Send, Situation, Tick
from hitchhike_ros.protocol.messages import Message
from hitchhike_ros.protocol.reasons import NONE, Ending, Reason

S = TypeVar("S", bound=Enum)


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
        self.ending = NONE
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
            raise TransitionError(self.state.value, type(event).__name__)
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

    def _go(self, state: S, why: Ending | Reason = Reason.NONE) -> None:
        if state not in self._allowed:
            raise TransitionError(self.state.value, f"going to {state.value}")
        self.state, self._entered = state, self._now
        self.ending = Ending(why) if isinstance(why, Reason) else why
        self._due = {}

    def _send(self, message: Message) -> None:
        self._effects.append(Send(message))

    def _send_last_word(self, message: Message, period_s: float, duration_s: float) -> None:
        """Send what ends a ride; nobody stays to acknowledge it, so it is repeated for a while."""
        self._send(message)
        times = range(1, int(duration_s / period_s) + 1)
        self._last_words += [(self._now + i * period_s, message) for i in times]
        self._last_words.sort(key=lambda word: word[0])

    def _report(self, what: Ending | Reason | str, about: Reason = Reason.NONE) -> None:
        reason = what if isinstance(what, Reason) else what.reason if isinstance(what, Ending) else about
        self._effects.append(Report(str(what), reason))

    def _every(self, period_s: float, what: str) -> bool:
        """Whether ``what`` is due again; true at once after a change of state."""
        if self._now < self._due.get(what, self._now):
            return False
        self._due[what] = self._now + period_s
        return True
