"""Simulated time beside wall time: as fast as it may run, or together with the clock of the system."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

Seconds = Callable[[], float]
Sleep = Callable[[float], None]

# The real-time factor is measured over so many s of wall time (chosen).
_MEASURED_S = 1.0
# On the system's clock a step that begins so much after its time is late (chosen: more than timers are off).
_LATE_S = 0.02
# And when simulated time lags behind by more than this, it jumps instead of catching up (chosen: modules take scans
# that are older than that for stale).
_MOST_LAG_S = 0.2


class RealTime:
    """Holds simulated time back to ``most`` times wall time, and measures the real-time factor.

    ``most`` 0 is as fast as possible. ``wall`` and ``sleep`` are a monotonic clock and how to wait on it, in s.
    """

    start_s = 0.0
    """Simulated time at the start."""

    def __init__(self, most: float = 0.0, wall: Seconds = time.monotonic, sleep: Sleep = time.sleep) -> None:
        self.factor = math.nan
        """Over the last second or so."""
        self._most, self._wall, self._sleep = most, wall, sleep
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Hold back and measure from simulated time ``now`` on, as after a pause."""
        self._began_wall, self._began = self._wall(), now

    def hold(self, now: float) -> float:
        """Wait until simulated time may be ``now``; how much it has to jump, which is 0."""
        if self._most > 0.0:
            ahead = (now - self._began) / self._most - (self._wall() - self._began_wall)
            if ahead > 0.0:
                self._sleep(ahead)
        elapsed = self._wall() - self._began_wall
        if elapsed >= _MEASURED_S:
            self.factor = (now - self._began) / elapsed
            self.restart(now)
        return 0.0

    def counts(self) -> dict[str, float]:
        """What diagnostics say beside the real-time factor: nothing."""
        return {}


class SystemTime:
    """Keeps simulated time at that of the system's clock, and counts the steps that begin too late for it.

    ``start_s`` is the time of the system's clock at the start. From then on time is taken from ``wall``, which is
    monotonic, so that a system's clock that is set makes nobody wait.
    """

    factor = 1.0

    def __init__(self, start_s: float, wall: Seconds = time.monotonic, sleep: Sleep = time.sleep) -> None:
        self.start_s = start_s
        self.steps = self.late = 0
        self.lost_s = 0.0
        """By how much simulated time has jumped, as steps were late."""
        self._wall, self._sleep = wall, sleep
        self._offset_s = start_s - wall()
        self._catches_up = True

    def restart(self, _now: float) -> None:
        """The system's clock goes on in a pause; the next step jumps to it, and is not late."""
        self._catches_up = True

    def hold(self, now: float) -> float:
        """Wait until the system's clock says ``now``; by how much simulated time has to jump, as it is too late."""
        late_s = self._wall() + self._offset_s - now
        if late_s < 0.0:
            self._sleep(-late_s)
        if self._catches_up:
            self._catches_up = False
            return max(late_s, 0.0)
        self.steps += 1
        self.late += late_s > _LATE_S
        if late_s <= _MOST_LAG_S:
            return 0.0
        self.lost_s += late_s
        return late_s

    def counts(self) -> dict[str, float]:
        """What diagnostics say: steps, those that were late, and their share; and how much time was lost, in s."""
        share = self.late / self.steps if self.steps else 0.0
        return {
            "steps": self.steps,
            "late_steps": self.late,
            "late_share": round(share, 5),
            "lost_s": round(self.lost_s, 3),
        }


class Every:
    """Says once in each ``period_s`` of wall time that it is over."""

    def __init__(self, period_s: float, wall: Seconds = time.monotonic) -> None:
        self._period_s, self._wall = period_s, wall
        self._began = wall()

    def over(self) -> bool:
        """Whether a period is over; then the next one begins."""
        over = self._wall() - self._began >= self._period_s
        if over:
            self._began = self._wall()
        return over
