"""Notices that a robot is told to move and its wheels stand: motors that are off, a stop button, wheels that block."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import Positive, Twist2D

STANDING = "told to move, but the wheels stand: motors off, or a stop button?"


@dataclass(frozen=True)
class WheelWatchParameters:
    """All values are chosen."""

    patience_s: Positive = 1.0
    """Longer than a base takes to obey: a Kobuki needs 0.2 s, and speeds grow from 0."""
    commanded_mps: Positive = 0.05
    commanded_rps: Positive = 0.1
    """A command is one to move from these speeds on; slower ones some bases do not obey."""
    still_mps: Positive = 0.005
    still_rps: Positive = 0.01
    """Wheels that are no faster than this stand."""


class WheelWatch:
    """Compares commands with what odometry says of the wheels.

    >>> watch = WheelWatch()
    >>> [bool(watch.problem(now, Twist2D(0.3), Twist2D())) for now in (0.0, 0.9, 1.0)]
    [False, False, True]
    """

    def __init__(self, params: WheelWatchParameters | None = None) -> None:
        self._params = params or WheelWatchParameters()
        self._since = math.inf

    def clear(self) -> None:
        """Begin anew, as for another goal."""
        self._since = math.inf

    def problem(self, now: float, command: Twist2D, twist: Twist2D) -> str:
        """What is wrong at ``now`` in s with wheels that turn at ``twist`` and are told ``command``; empty: nothing."""
        p = self._params
        told = abs(command.v) >= p.commanded_mps or abs(command.omega) >= p.commanded_rps
        stands = abs(twist.v) <= p.still_mps and abs(twist.omega) <= p.still_rps
        self._since = min(self._since, now) if told and stands else math.inf
        return STANDING if now - self._since >= p.patience_s else ""
