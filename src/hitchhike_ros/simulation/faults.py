"""What goes wrong on a composed ride, and when."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hitchhike_ros.core.datatypes import Twist2D

# Something covers the lens; no images come; no message is sent or heard; somebody steers by joystick.
FaultKind = Literal["camera_covered", "camera_silent", "messages_lost", "steered"]


@dataclass(frozen=True)
class Fault:
    """A fault of ``robot`` from ``start_s`` until before ``end_s`` of simulated time."""

    kind: FaultKind
    robot: str
    start_s: float
    end_s: float = math.inf
    twist: Twist2D | None = None
    """What the joystick says; None: stand."""

    def acts(self, now: float) -> bool:
        """Whether the fault is there at ``now``."""
        return self.start_s <= now < self.end_s
