"""What a blocked robot tries: a table of steps, each for a bounded time, from the top again until the way is open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters

Action = Literal["wait", "clear", "turn", "withdraw", "replan"]


@dataclass(frozen=True)
class RecoveryStep:
    """``action`` for ``duration_s``; ``says`` is what operators read meanwhile."""

    action: Action
    duration_s: float
    says: str


def recovery_steps(params: LocalPlannerParameters) -> tuple[RecoveryStep, ...]:
    """The table: a person who stands in the way has often gone while the robot waits, so that comes first."""
    return (
        RecoveryStep("wait", params.recovery_wait_s, "waiting"),
        RecoveryStep("clear", params.recovery_clear_s, "forgetting obstacles out of view"),
        RecoveryStep("turn", params.recovery_turn_s, "turning to look"),
        RecoveryStep("replan", params.recovery_replan_s, "waiting for another plan"),
        RecoveryStep("withdraw", params.recovery_withdraw_s, "making room"),
    )


class Recovery:
    """Steps through the table while the way is blocked; starts over once it has been open for ``calm_s``."""

    def __init__(self, table: Sequence[RecoveryStep], calm_s: float) -> None:
        self._table, self._calm_s = tuple(table), calm_s
        self.reset()

    def reset(self) -> None:
        """The next block is a new one."""
        self._since: float | None = None
        self._blocked_at = 0.0

    def step(self, now: float, blocked: bool) -> RecoveryStep | None:
        """What to do at ``now`` in s; None while the way is open."""
        if self._since is not None and not 0.0 <= now - self._blocked_at <= self._calm_s:
            self.reset()
        if not blocked:
            return None
        self._blocked_at = now
        if self._since is None:
            self._since = now
        spent = (now - self._since) % sum(step.duration_s for step in self._table)
        for step in self._table:
            if spent < step.duration_s:
                return step
            spent -= step.duration_s
        return self._table[-1]  # by rounding
