"""What happened in a grid world: the last events in words, and the observers that are told each of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from hitchhike_ros.protocol.events import Award, Effect, GoalGiven, Report, Send, Tick
from hitchhike_ros.protocol.messages import Message

Observer = Callable[[float, str, object, Sequence[Effect]], None]
"""Takes time, robot, event and effects."""


class Trace:
    """Keeps the last events and calls ``observers`` with each of them."""

    def __init__(self, length: int) -> None:
        """``length`` is how many events are kept; with 0 and no observers nothing is to be told."""
        self.observers: list[Observer] = []
        self._last: deque[tuple[float, str, object, Sequence[Effect]]] = deque(maxlen=length)
        self._keeps = length > 0

    @property
    def wanted(self) -> bool:
        """Whether anybody takes what is told."""
        return self._keeps or bool(self.observers)

    def tell(self, time: float, robot: str, event: object, effects: Sequence[Effect]) -> None:
        """One event of one robot, and what it made the robot do."""
        if self._keeps:
            self._last.append((time, robot, event, effects))
        for observer in self.observers:
            observer(time, robot, event, effects)

    def lines(self) -> Iterator[str]:
        """The last events, a line each."""
        for time, name, event, effects in self._last:
            wanted = "; ".join(described(effect) for effect in effects)
            yield f"{time:10.3f} {name:<10} {described(event)}" + (f" -> {wanted}" if wanted else "")


def described(event: object) -> str:
    """An event or an effect in a word or two."""
    if isinstance(event, Tick):
        report = event.situation.navigation
        return "tick" + (f" [{report.state}]" if report is not None else "")
    if isinstance(event, Send):
        return f"send {described(event.message)}"
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
