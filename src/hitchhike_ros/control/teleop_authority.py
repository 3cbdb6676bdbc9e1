"""What the human who drives a robot wants of it now: the newest command while it is fresh, else that it stands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import Pose2D, Positive, Twist2D
from hitchhike_ros.core.errors import TeleopError
from hitchhike_ros.core.geometry import distance


@dataclass(frozen=True)
class TeleopAuthorityParameters:
    """Section ``teleop_authority``; chosen."""

    command_timeout_s: Positive = 0.5  # as of velocity_mux
    active_timeout_s: Positive = 2.0  # teleop says four times as often that a human has the robot in hand
    # With a rider hhike_msg/status counts every 0.2 m; who hears nothing of that for so far knows nothing of the rider.
    unheard_m: Positive = 1.0


class TeleopAuthority:
    """Whether a human has the robot in hand, and what that one wants."""

    def __init__(self, params: TeleopAuthorityParameters) -> None:
        self._params = params
        self._commanded_at, self._twist = -math.inf, Twist2D()
        self._taken_at: float | None = None
        self._heard_from: Pose2D | None = None  # where the robot was when the status was new

    def command(self, twist: Twist2D, now: float) -> bool:
        """Take a command; False when it is refused because it is not finite, which ends the one before it too."""
        usable = twist.is_finite()
        self._commanded_at, self._twist = (now, twist) if usable else (-math.inf, Twist2D())
        return usable

    def take(self, active: bool, now: float) -> None:
        """The human has the robot in hand, or gives it back to its own navigation."""
        self._taken_at = now if active else None
        if not active:
            self._commanded_at = -math.inf

    def hear_status(self) -> None:
        """A new status has come."""
        self._heard_from = None

    def wanted(self, pose: Pose2D, with_rider: bool, now: float) -> Twist2D | None:
        """What the human wants; a stand without a fresh command, None when nobody has the robot in hand.

        Raises:
            TeleopError: the human is out of reach, or nothing is known of the rider any more.
        """
        fresh = 0.0 <= now - self._commanded_at < self._params.command_timeout_s
        if self._taken_at is None and not fresh:
            return None
        if not fresh and self._taken_at is not None and abs(now - self._taken_at) > self._params.active_timeout_s:
            raise TeleopError("the human who drives is out of reach")
        twist = self._twist if fresh else Twist2D()
        if self._heard_from is None:
            self._heard_from = pose
        if with_rider and twist != Twist2D() and distance(self._heard_from, pose) > self._params.unheard_m:
            raise TeleopError("hhike_msg/status does not tell of the rider")
        return twist
