"""What the simulator says of itself: each touch once, its diagnosis each second, and at times a line for the log."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from hitchhike_ros.simulation.real_time import Every, Seconds

C = TypeVar("C")

REPORT_PERIOD_S = 1.0
"""Of wall time, as all of /diagnostics."""


@dataclass(frozen=True)
class Diagnosis:
    """Whether all is well, what to say of it, and the values for /diagnostics; ``line`` is for the log."""

    well: bool
    text: str
    values: Mapping[str, object]
    line: str = ""


class SimulatorReport:
    """Keeps what has been said already; ``wall`` is a monotonic clock in s."""

    def __init__(self, print_period_s: float, wall: Seconds = time.monotonic) -> None:
        self._reports, self._prints = Every(REPORT_PERIOD_S, wall), Every(print_period_s, wall)
        self._contacts = 0

    def touches(self, contacts: Sequence[C]) -> Sequence[C]:
        """Those of all contacts so far, by time, that are new since the last call."""
        new = contacts[self._contacts :]
        self._contacts = len(contacts)
        return new

    def restart(self) -> None:
        """The world was put back to its start, and its contacts are forgotten."""
        self._contacts = 0

    def due(
        self, elapsed_s: float, factor: float, misses: Mapping[tuple[str, str], int], counts: Mapping[str, float]
    ) -> Diagnosis | None:
        """The diagnosis, when it is time for one.

        Args:
            elapsed_s: time simulated so far.
            factor: the real-time factor.
            misses: answers missed, by robot and module.
            counts: what the clock counts.
        """
        if not self._reports.over():
            return None
        values: dict[str, object] = {
            "real_time_factor": f"{factor:.2f}",
            "contacts": self._contacts,
            "lockstep_misses": sum(misses.values()),
            **{f"lockstep_misses_{robot}_{module}": count for (robot, module), count in misses.items()},
            **counts,
        }
        line = ""
        if self._prints.over():
            line = f"{elapsed_s:.0f} s simulated, " + ", ".join(f"{name} {value}" for name, value in values.items())
        text = f"{self._contacts} contacts" if self._contacts else "running"
        return Diagnosis(not self._contacts, text, values, line)
