"""What goes wrong on a composed ride, and when."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hitchhike_ros.core.datatypes import Twist2D

# Something is held before the lens; images stay away; nothing is sent and nothing heard; somebody steers by joystick.
FaultKind = Literal["camera_covered", "camera_silent", "messages_lost", "steered"]


@dataclass(frozen=True)
class Fault:
    """``kind`` happens to ``robot`` from ``start_s`` until before ``end_s`` of simulated time."""

    kind: FaultKind
    robot: str
    start_s: float
    end_s: float = math.inf
    twist: Twist2D | None = None
    """What is steered; None: a stand."""

    def acts(self, now: float) -> bool:
        """Whether it is there at ``now``."""
        return self.start_s <= now < self.end_s
