"""State machines declared as tables of rows and stepped by ``(event, now)``; what they want done comes back as effects.

A row says in which states, on what, and under which guards an action is done, and to which one state it leads. Rows
stand in the order of their priority: of those for one event the first whose guards hold is taken. What a machine knows
are its facts; guards and deadlines are functions of them. The table is checked when the class is made.

Machines know no ROS, no clock and no thread, so nodes, simulations and tests step the same objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import cached_property
from inspect import signature
from typing import Any, ClassVar, Generic, TypeVar, cast

from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.protocol.events import Effect, Report, Send, Situation, Tick
from hitchhike_ros.protocol.messages import Message
from hitchhike_ros.protocol.phase import Phase, RoleState
from hitchhike_ros.protocol.reasons import NONE, Ending, Reason

S = TypeVar("S", bound=RoleState)
F = TypeVar("F", bound="Facts")

Guard = Callable[[Any], bool]
"""A named function of the facts; with a lambda the diagram could not say what leads there."""


@dataclass(eq=False)
class Facts:
    """What every machine knows. Machines add their own, those of single phases with :func:`of_phases`."""

    state: Any = None
    now: float = 0.0
    entered: float = 0.0  # when it came to the present state
    situation: Situation = field(default_factory=Situation)
    event: Any = None  # that is being taken, for guards

    @property
    def in_state_s(self) -> float:
        return self.now - self.entered


def of_phases(*phases: Phase | RoleState) -> Any:
    """A field of facts that exists in these phases, or single states, only.

    The action that leads into them sets it, the machine forgets it after the action that leads out of them, and reading
    it elsewhere is an AttributeError.
    """
    return field(init=False, repr=False, metadata={"phases": frozenset(phases)})


def entered(f: Facts) -> float:
    """When the machine came to its state."""
    return f.entered


@dataclass(frozen=True)
class Deadline:
    """What a row waits for: ``limit`` s have passed ``since`` then, by default since the state was begun."""

    limit: Callable[[Any], float]
    since: Callable[[Any], float] = entered

    @property
    def name(self) -> str:
        return self.limit.__name__

    def at(self, f: Facts) -> float:
        """When it is over; a tick at that very time finds it so."""
        return self.since(f) + self.limit(f)

    def is_over(self, f: Facts) -> bool:
        return f.now >= self.at(f)


@dataclass(frozen=True)
class Row:
    """In one of ``states``, ``on`` an event or a deadline, where all guards (``when``) hold: do ``action``, go ``to``.

    Actions are methods, by name and one after another, which take the event or nothing. They run in the state that the
    row leads to, and find the facts of the phase that is left. ``why`` becomes the machine's ending, where it is None
    the ending stays as it is; an action may say more. Rows without a target stay: time in the state runs on. With its
    own state as target a state begins anew.
    """

    states: tuple[Any, ...]
    on: type | Deadline
    action: str | tuple[str, ...] | None = None
    to: Any = None
    when: tuple[Guard, ...] = ()
    why: Reason | None = Reason.NONE

    @cached_property
    def actions(self) -> tuple[str, ...]:
        return (self.action,) if isinstance(self.action, str) else self.action or ()


@dataclass(frozen=True)
class Do:
    """At every tick in one of ``states``, where all guards hold: do ``action``, which takes nothing, and go on.

    It is done between the rows above and below it, and not at all where a row above leads elsewhere.
    """

    states: tuple[Any, ...]
    action: str
    when: tuple[Guard, ...] = ()

    @property
    def actions(self) -> tuple[str, ...]:
        return (self.action,)


class Table:
    """Rows as a machine looks them up, each kind in the order of the priority."""

    def __init__(self, rows: Iterable[Row | Do]) -> None:
        self.events: dict[tuple[Any, type], tuple[Row, ...]] = {}
        self.ticks: dict[Any, tuple[Row | Do, ...]] = {}
        self.deadlines: dict[Any, tuple[Row, ...]] = {}
        for row in rows:
            for state in row.states:
                if isinstance(row, Do) or row.on is Tick:
                    self.ticks[state] = (*self.ticks.get(state, ()), row)
                elif isinstance(row.on, Deadline):
                    self.deadlines[state] = (*self.deadlines.get(state, ()), row)
                else:
                    self.events[state, row.on] = (*self.events.get((state, row.on), ()), row)


class Machine(Generic[S, F]):
    """A table-driven machine. Subclasses declare ``INITIAL`` and ``ROWS`` and write the actions."""

    INITIAL: ClassVar[Any]
    ROWS: ClassVar[tuple[Row | Do, ...]]
    TABLE: ClassVar[Table]
    TAKE_EVENT: ClassVar[frozenset[str]]
    """Of the table's methods those that take the event."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Check and arrange the table.

        Raises:
            TypeError: the table names a method or a state that does not exist, a row that can never be taken, or a
                state that cannot be reached or left; it says which.
        """
        super().__init_subclass__(**kwargs)
        if "ROWS" in cls.__dict__:
            check(cls)
            cls.TABLE = Table(cls.ROWS)
            names = {name for row in cls.ROWS for name in row.actions}
            cls.TAKE_EVENT = frozenset(name for name in names if len(signature(getattr(cls, name)).parameters) > 1)

    def __init__(self, facts: F) -> None:
        self.ending = NONE  # why it is in its state
        self.facts = facts
        facts.state = self.INITIAL
        self.ignored = 0  # messages that arrived in a state that has no use for them
        self._effects: list[Effect] = []
        self._due: dict[str, float] = {}
        self._last_words: list[tuple[float, Message]] = []
        self._of_phases = {f.name: f.metadata["phases"] for f in fields(facts) if "phases" in f.metadata}

    @property
    def state(self) -> S:
        return cast(S, self.facts.state)

    def step(self, event: object, now: float) -> list[Effect]:
        """Take one event.

        Raises:
            TransitionError: a command that the state does not allow. Network messages never raise: one that the state
                has no use for is counted and ignored.
        """
        if isinstance(event, Message) and not self._concerns(event):
            self.ignored += 1
            return []
        facts = self.facts
        facts.now, facts.event, self._effects = now, event, []
        if isinstance(event, Tick):
            facts.situation = event.situation
            self._tick(event)
            return self._effects
        for row in self.TABLE.events.get((self.state, type(event)), ()):
            if not row.when or all(guard(facts) for guard in row.when):
                self._take(row, event)
                break
        else:
            if not isinstance(event, Message):
                raise TransitionError(self.state.value, type(event).__name__)
            self.ignored += 1
        return self._effects

    def next_deadline(self) -> float:
        """When the state's deadline is over or a last word is to be said again, in s; inf where there is neither."""
        rows = self.TABLE.deadlines.get(self.state)
        due = math.inf if rows is None else deadline(rows).at(self.facts)
        return min(due, self._last_words[0][0]) if self._last_words else due

    def _tick(self, tick: Tick) -> None:
        """Deadlines first, one after another; then what is repeated; then the rows of the state."""
        facts = self.facts
        while (expired := self._expired()) is not None:
            self._take(expired)
        while self._last_words and self._last_words[0][0] <= facts.now:
            self._send(self._last_words.pop(0)[1])
        for row in self.TABLE.ticks.get(self.state, ()):
            if not row.when or all(guard(facts) for guard in row.when):
                if isinstance(row, Row):
                    self._take(row, tick)
                    return
                getattr(self, row.action)()

    def _expired(self) -> Row | None:
        """What is to be done about the deadline of the state, when it is over."""
        rows = self.TABLE.deadlines.get(self.state)
        if rows is None or not deadline(rows).is_over(self.facts):
            return None
        return next(row for row in rows if all(guard(self.facts) for guard in row.when))

    def _take(self, row: Row, *event: object) -> None:
        if row.to is not None:
            self.facts.state, self.facts.entered, self._due = row.to, self.facts.now, {}
            self.ending = self.ending if row.why is None else Ending(row.why)
        for action in row.actions:
            getattr(self, action)(*event if action in self.TAKE_EVENT else ())
        if row.to is not None:
            for name, phases in self._of_phases.items():
                if row.to.phase not in phases and row.to not in phases:
                    self.facts.__dict__.pop(name, None)

    # For subclasses.

    def _concerns(self, _message: Message) -> bool:
        """Whether a message is for this machine at all."""
        return True

    def _send(self, message: Message) -> None:
        self._effects.append(Send(message))

    def _send_last_word(self, message: Message, period_s: float, duration_s: float) -> None:
        """Send what ends a ride; nobody stays to acknowledge it, so it is repeated for a while."""
        self._send(message)
        times = range(1, int(duration_s / period_s) + 1)
        self._last_words += [(self.facts.now + i * period_s, message) for i in times]
        self._last_words.sort(key=lambda word: word[0])

    def _take_back_last_words(self, ride_id: str) -> None:
        """The ride is on again."""
        self._last_words = [(due, word) for due, word in self._last_words if word.ride_id != ride_id]

    def _report(self, what: Ending | Reason | str, about: Reason = Reason.NONE) -> None:
        """Tell an operator."""
        reason = what if isinstance(what, Reason) else what.reason if isinstance(what, Ending) else about
        self._effects.append(Report(str(what), reason))

    def _every(self, period_s: float, what: str) -> bool:
        """Whether ``what`` is due again; true at once after a change of state."""
        now = self.facts.now
        if now < self._due.get(what, now):
            return False
        self._due[what] = now + period_s
        return True


def deadline(rows: tuple[Row, ...]) -> Deadline:
    """The one for which all these rows wait."""
    on = rows[0].on
    assert isinstance(on, Deadline)
    return on


def arrows(rows: Iterable[Row | Do]) -> Iterator[tuple[Any, Row]]:
    """Every state with every row that leads from it to a state."""
    for row in rows:
        if isinstance(row, Row) and row.to is not None:
            yield from ((state, row) for state in row.states)


def check(machine: type[Machine[Any, Any]]) -> None:
    """Raise TypeError where a table promises what the machine cannot do: see ``Machine.__init_subclass__``."""
    wrong = [*_senseless_rows(machine), *_dead_ends(machine.INITIAL, machine.ROWS)]
    if wrong:
        raise TypeError(f"{machine.__name__}: {'; '.join(wrong)}")


def _senseless_rows(machine: type[Machine[Any, Any]]) -> Iterator[str]:
    states: type[Enum] = type(machine.INITIAL)
    for row in machine.ROWS:
        yield from (f"there is no method {name}" for name in row.actions if not callable(getattr(machine, name, None)))
        if not row.actions and (isinstance(row, Do) or row.to is None):
            yield f"nothing is done in {row}"
        for state in (*row.states, *([row.to] if isinstance(row, Row) and row.to is not None else [])):
            if not isinstance(state, states):
                yield f"{state} is no {states.__name__}"
    table = Table(machine.ROWS)
    for state, on, rows in (
        *((state, event.__name__, rows) for (state, event), rows in table.events.items()),
        *((state, "tick", rows) for state, rows in table.ticks.items()),
        *((state, deadline(rows).name, rows) for state, rows in table.deadlines.items()),
    ):
        if any(isinstance(row, Row) and not row.when for row in rows[:-1]):
            yield f"{state.value} on {on}: a row stands below one without guards"
    for state, waits in table.deadlines.items():
        if waits[-1].when or len({row.on for row in waits}) > 1:
            yield f"{state.value}: expected one deadline, and at last a row without guards"


def _dead_ends(initial: Any, rows: Iterable[Row | Do]) -> Iterator[str]:
    ways = {(state, row.to) for state, row in arrows(rows)}
    reached, found = set[Any](), {initial}
    while found:
        reached |= found
        found = {to for state, to in ways if state in found} - reached
    for state in type(initial):
        if state not in reached:
            yield f"{state.value} cannot be reached"
        if all(to is state for begin, to in ways if begin is state):
            yield f"{state.value} cannot be left"
