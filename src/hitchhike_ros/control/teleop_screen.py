"""Lines of a terminal that change in place, as text with control sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import Positive


@dataclass(frozen=True)
class TerminalParameters:
    """Section ``teleop_terminal``; chosen. Times are s of wall time."""

    keyboard: bool = True
    look_s: Positive = 0.02  # a key waits for so long at most
    draw_period_s: Positive = 0.2  # a screen that changes more often cannot be read
    leave_s: Positive = 0.3  # the last words are on their way by then, and topics are closed


class Screen:
    """Draws lines over those that it drew before, not more often than once in ``period_s``."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._drawn: list[str] = []
        self._draw_at = 0.0

    def draw(self, lines: Sequence[str], columns: int, wall_s: float) -> str:
        """What to write to a terminal of that width at ``wall_s``: nothing where nothing is new or it is too early.

        A terminal that says that it has no ``columns`` is taken to have 80.
        """
        if list(lines) == self._drawn or (self._drawn and wall_s < self._draw_at):
            return ""
        up = f"\x1b[{len(self._drawn)}A" if self._drawn else ""
        self._drawn, self._draw_at = list(lines), wall_s + self._period_s
        return up + "".join(f"\r\x1b[K{line[: (columns or 80) - 1]}\n" for line in lines)
