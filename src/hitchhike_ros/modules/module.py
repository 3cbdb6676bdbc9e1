"""What all modules of a robot share: how a host steps them, and what they say of themselves.

A module is pure: it reads no clock, waits for nothing and knows no ROS. Its host, which is a node, the node ``robot``
or the composed simulation, hands it what arrives (``sense``, ``order``), steps it when it is due, and publishes what
comes out. The host decides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, Generic, Protocol, TypeVar

from hitchhike_ros.core.errors import StaleInputError
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven
from hitchhike_ros.protocol.status import Status

T = TypeVar("T")

ORDER_MAX_AGE_S = 3.5
"""An order that has not been repeated for so long no longer counts: the status comes at 1 Hz, so three of them were
lost (chosen)."""


class Level(IntEnum):
    """As in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Health:
    """What a module says of itself; ``counters`` are names and values for /diagnostics."""

    level: Level = Level.OK
    reason: str = ""
    counters: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Refused:
    """A message that could not be converted into ``what``; it is sensed like any input.

    ``stamp`` is that of its header in s, where it has one: a frame that is refused is answered too.
    """

    what: type
    reason: str
    sender: str = ""
    stamp: float | None = None


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """What a step gives. None or empty in a field of a subclass: nothing new to publish.

    ``answered`` is the stamp of the newest sensor frame that the module has taken into account, for lock-step.
    """

    health: Health
    answered: float | None = None


O_co = TypeVar("O_co", bound=Outputs, covariant=True)
Order = Status | GoalGiven | GoalCancelled
"""Goals are for hitchhike_comm, the status is for all others."""


class Module(Protocol[O_co]):
    """A module as its host sees it; times are s on the host's clock."""

    name: ClassVar[str]
    inputs: ClassVar[frozenset[type]]
    """Every type that it may ever take: one type a meaning."""
    patient: ClassVar[frozenset[type]]
    """Of these, what never makes it due: a host may keep it until something else does, and then hands on all of it."""

    def listens(self) -> frozenset[type]:
        """The inputs that it takes now; a host subscribes to no others and converts no others."""

    def sense(self, x: object, now: float) -> None:
        """Store an input that arrived at ``now``: one of ``inputs``, or a :class:`Refused` one."""

    def order(self, order: Order, now: float) -> None:
        """Store an order that arrived at ``now``."""

    def next_due(self, now: float) -> float:
        """When it wants its next step: not after ``now`` means at once, infinity means not before something arrives."""

    def step(self, now: float) -> O_co:
        """Decide."""


class Fresh(Generic[T]):
    """The newest value of an input, with the greatest age at which it counts.

    >>> pose = Fresh[float]("pose", 1.0)
    >>> pose.put(3.0, stamp=10.0)
    >>> pose.at(10.5)
    3.0
    """

    def __init__(self, what: str, max_age_s: float) -> None:
        """``what`` names the input in the error."""
        self._what, self._max_age_s = what, max_age_s
        self._value: T | None = None
        self.stamp = -math.inf

    def put(self, value: T, stamp: float) -> None:
        """Store ``value`` of time ``stamp`` in s."""
        self._value, self.stamp = value, stamp

    @property
    def newest(self) -> T | None:
        """The newest value, however old."""
        return self._value

    def expires(self) -> float:
        """When the value stops counting, in s; infinity without one."""
        return math.inf if self._value is None else self.stamp + self._max_age_s

    def clear(self) -> None:
        """Forget the value, as when the module is switched on."""
        self._value, self.stamp = None, -math.inf

    def at(self, now: float) -> T:
        """The value, if it counts at ``now`` in s.

        Raises:
            StaleInputError: none has come, or it has expired, or it is of a later time than ``now`` by more than
                ``max_age_s``, as after the clock was set back.
        """
        if self._value is None:
            raise StaleInputError(f"no {self._what}")
        if not self._counts(now):
            raise StaleInputError(f"no {self._what} for {abs(now - self.stamp):.1f} s")
        return self._value

    def get(self, now: float) -> T | None:
        """As :meth:`at`; None where that raises."""
        return self._value if self._counts(now) else None

    def _counts(self, now: float) -> bool:
        """At ``expires()`` no more: a module that is stepped then must find that it has."""
        return self.stamp - self._max_age_s <= now < self.expires()


class Orders:
    """The newest status, which says whether a module is on and what it is to do.

    ``standing`` is an order for a module that works alone: it holds for ever, and nothing else is obeyed.
    """

    def __init__(self, standing: Status | None = None) -> None:
        self._standing = standing
        self._status: Fresh[Status] = Fresh("status", ORDER_MAX_AGE_S)

    def put(self, order: Order, now: float) -> None:
        """Store a status that arrived at ``now`` in s; goals are for hitchhike_comm."""
        if isinstance(order, Status):
            self._status.put(order, now)

    def newest(self) -> Status | None:
        """The newest status, however old: a module stays on or off when orders cease."""
        return self._standing or self._status.newest

    def at(self, now: float) -> Status:
        """The status that counts at ``now`` in s.

        Raises:
            StaleInputError: none has come, or the newest is too old; the module stands.
        """
        return self._standing or self._status.at(now)

    def get(self, now: float) -> Status | None:
        """As :meth:`at`; None where that raises."""
        return self._standing or self._status.get(now)

    def expires(self) -> float:
        """When the newest status stops counting, in s; infinity where that never happens or has nothing to end."""
        return math.inf if self._standing is not None else self._status.expires()
