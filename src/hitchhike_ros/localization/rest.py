"""When a scan may be left alone: of a robot that stands and has nowhere to go, whose pose is known and stays so."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import Positive, Twist2D

# A robot stands when it is slower than this, in m/s and rad/s (chosen).
_STANDS = 1e-3


@dataclass
class Rest:
    """Steps: what odometry says, whether there is a goal, which scans gave a pose, and when a pose was told.

    The first scan after the robot has stopped is worked on, and then one in ``scan_period_s`` (chosen: what appears
    beside it goes into its map so much later). Between them its pose is told once in ``pose_period_s`` (chosen: nobody
    waits longer than a second for one).
    """

    scan_period_s: Positive = 2.4
    pose_period_s: Positive = 0.8
    has_goal: bool = True
    _stands: bool = False
    _settled: bool = False  # a scan of the robot as it stands gave a pose
    _worked_at: float = -math.inf
    _told_at: float = -math.inf

    def wake(self) -> None:
        """Something is new: the next scan counts."""
        self._settled = False

    def move(self, twist: Twist2D) -> None:
        """The newest odometry."""
        self._stands = max(abs(twist.v), abs(twist.omega)) <= _STANDS
        self._settled = self._settled and self._stands

    def worked(self, stamp: float) -> None:
        """A scan gave a pose."""
        self._settled, self._worked_at, self._told_at = self._stands, stamp, stamp

    def told(self, stamp: float) -> None:
        """The pose at a scan that was left out."""
        self._told_at = stamp

    def leaves_out(self, stamp: float) -> bool:
        """Whether a scan of this time may be left alone; not after time jumped back."""
        rests = self._settled and not self.has_goal
        return rests and 0.0 <= stamp - self._worked_at < self.scan_period_s - 1e-3

    def owes_pose(self, stamp: float) -> bool:
        """Whether the pose at a scan that is left out is to be told."""
        return stamp - self._told_at >= self.pose_period_s - 1e-3
