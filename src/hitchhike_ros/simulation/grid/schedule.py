"""The events of the grid simulator in order of time, and the clock that they set."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from typing import Any


class Schedule:
    """A queue of events. Two events of the same time happen in the order in which they were pushed.

    ``now`` is the time of the newest event in s, ``events`` how many there have been.
    """

    def __init__(self) -> None:
        self.now = 0.0
        self.events = 0
        self._heap: list[tuple[float, int, Callable[[Any], None], Any]] = []
        self._pushed = 0

    @property
    def next_event_s(self) -> float:
        """When the next event happens; inf when there is none."""
        return self._heap[0][0] if self._heap else math.inf

    def push(self, time: float, act: Callable[[Any], None], what: Any) -> None:
        """Call ``act(what)`` at ``time``."""
        self._pushed += 1
        heapq.heappush(self._heap, (time, self._pushed, act, what))

    def at(self, time: float, action: Callable[[], None]) -> None:
        """Call ``action()`` at ``time``."""
        self.push(time, _call, action)

    def step(self) -> bool:
        """Let the next event happen; False when there is none."""
        if not self._heap:
            return False
        time, _, act, what = heapq.heappop(self._heap)
        self.now = time
        self.events += 1
        act(what)
        return True

    def run(self, until_s: float, stop: Callable[[], bool] | None = None) -> bool:
        """Let all events up to ``until_s`` happen, or until ``stop()`` after one of them; whether it stopped."""
        heap = self._heap
        while heap and heap[0][0] <= until_s:
            self.step()
            if stop is not None and stop():
                return True
        self.now = max(self.now, until_s)
        return False


def _call(action: Callable[[], None]) -> None:
    action()
