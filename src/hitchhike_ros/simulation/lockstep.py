"""Who has answered the newest sensor frames: the bookkeeping by which simulated time does not outrun the modules."""

from __future__ import annotations

from collections import Counter

from hitchhike_ros.protocol.status import ModuleSwitches

SCAN, IMAGE = "scan", "image"

# For each module the frame that it answers, and the switches of P17 Table 3 of which one keeps it on.
_ANSWERS = {
    "slam": (SCAN, ("LZN", "MAP")),
    "obstacle_avoidance": (SCAN, ("OBS",)),
    "visual_servoing": (IMAGE, ("VS",)),
}


class Lockstep:
    """Frames that were sent and not yet answered, of all robots.

    Time waits long for a module that has answered since it was switched on, so that a loaded machine makes a run slower
    and not different. It waits shortly for one that has not: that may still be subscribing, or not be there at all. It
    does not wait for a module that has missed ``patience`` frames in a row, until that answers again.
    """

    def __init__(self, timeout_s: float = 5.0, join_timeout_s: float = 0.5, patience: int = 3) -> None:
        """The timeouts are wall time."""
        self._timeout_s, self._join_timeout_s, self._patience = timeout_s, join_timeout_s, patience
        self._on: dict[str, set[str]] = {}
        self._joined: set[tuple[str, str]] = set()
        self._awaited: dict[tuple[str, str], float] = {}
        self._missed_in_a_row: Counter[tuple[str, str]] = Counter()
        self.misses: Counter[tuple[str, str]] = Counter()

    @property
    def waiting_for(self) -> tuple[tuple[str, str], ...]:
        """Robot and module of each answer that is owed."""
        return tuple(self._awaited)

    def waits(self, elapsed_s: float) -> bool:
        """Whether an answer is still worth waiting for, ``elapsed_s`` of wall time after the last frame was sent."""
        return any(
            elapsed_s < (self._timeout_s if key in self._joined else self._join_timeout_s) for key in self._awaited
        )

    def set_modules(self, robot: str, modules: ModuleSwitches) -> None:
        """Take which modules are on.

        One that is switched on gets the patience of a new one, and one that is off owes nothing.
        """
        on = {name for name, (_, switches) in _ANSWERS.items() if any(getattr(modules, s) for s in switches)}
        for module in on - self._on.get(robot, set()):
            self._missed_in_a_row.pop((robot, module), None)
        self._on[robot] = on
        self._joined = {key for key in self._joined if key[0] != robot or key[1] in on}
        for key in [key for key in self._awaited if key[0] == robot and key[1] not in on]:
            del self._awaited[key]

    def sent(self, robot: str, sensor: str, stamp: float) -> None:
        """A frame has been sent to those modules of the robot that are on."""
        for module in self._on.get(robot, ()):
            if _ANSWERS[module][0] == sensor and self._missed_in_a_row[robot, module] < self._patience:
                self._awaited[robot, module] = stamp

    def answered(self, robot: str, module: str, stamp: float) -> None:
        """A module is done with the frame of that stamp, and so with all before it."""
        key = (robot, module)
        self._missed_in_a_row.pop(key, None)
        if module in self._on.get(robot, ()):
            self._joined.add(key)
        if key in self._awaited and stamp > self._awaited[key] - 1e-6:
            del self._awaited[key]

    def give_up(self) -> tuple[tuple[str, str], ...]:
        """Wait no longer; robot and module of each answer that was still owed, and now counts as missed."""
        late = self.waiting_for
        self._awaited.clear()
        self._missed_in_a_row.update(late)
        self.misses.update(late)
        return late
