"""One command for the base out of several sources: the most important fresh one, within the robot's limits."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import msgspec

from hitchhike_ros.core.datatypes import Positive, TeleopMode, Twist2D
from hitchhike_ros.core.robot_model import RobotLimits

Source = Literal["teleop", "servoing", "navigation"]
SOURCES: tuple[Source, ...] = get_args(Source)  # most important first

# How often a robot that stands, and that nobody drives, is told to stand, and one that does what it was told to go on:
# bases stop by themselves half a second after the last command. A timer's turn that comes this much early will do, or
# the next one would be late (chosen).
_REST_PERIOD_S, _HOLD_PERIOD_S, _EARLY_S = 1.0, 0.2, 0.02


@dataclass(frozen=True)
class VelocityMuxParameters:
    """Section ``velocity_mux``; chosen."""

    teleop_timeout_s: Positive = 0.5
    servoing_timeout_s: Positive = 0.5
    navigation_timeout_s: Positive = 0.5
    deceleration_factor: Annotated[float, msgspec.Meta(ge=1)] = 5.0  # braking may be this much harder than speeding up
    max_period_s: Positive = 0.1  # a longer pause between steps does not allow a larger change of speed


class VelocityMux:
    """Keeps the newest command of each source; :meth:`step` gives what the base should do now.

    It is stepped on each command, and by a timer when that :meth:`takes_turn`.
    """

    def __init__(self, params: VelocityMuxParameters, limits: RobotLimits) -> None:
        self._params, self._limits = params, limits
        self._timeouts: dict[Source, float] = {
            "teleop": params.teleop_timeout_s,
            "servoing": params.servoing_timeout_s,
            "navigation": params.navigation_timeout_s,
        }
        self._commands: dict[Source, tuple[float, Twist2D]] = {}
        self._output, self._stepped_at = Twist2D(), math.inf
        self.active: Source | None = None
        self.teleop_mode: TeleopMode = "free"  # guided: obstacle avoidance takes up what teleop says
        self.refused: Counter[Source] = Counter()
        self._let_go = True  # of the keys, since the robot was last guided
        self._commanded = False  # since the timer's last turn

    def command(self, source: Source, twist: Twist2D, now: float) -> bool:
        """Take a command; False when it is refused and counted because it is not finite.

        A refused command also ends the one before it: a source that talks nonsense does not drive.
        """
        self._commanded = True
        if not twist.is_finite():
            self.refused[source] += 1
            self._commands.pop(source, None)
            return False
        if source == "teleop":
            self._note_key(twist, now)
        self._commands[source] = (now, twist)
        return True

    def _note_key(self, twist: Twist2D, now: float) -> None:
        """A key that was pressed on the way does not drive on from the goal, before it was let go."""
        at, _ = self._commands.get("teleop", (-math.inf, Twist2D()))
        if twist == Twist2D() or not 0.0 <= now - at < self._timeouts["teleop"]:
            self._let_go = True
        if twist != Twist2D() and self.teleop_mode != "free":
            self._let_go = False

    def takes_turn(self, now: float) -> bool:
        """Whether the timer steps the mux at its turn at ``now`` in s, to be asked once a turn.

        Not where a command did since its last turn, five times a second while the robot does what it was told, and once
        a second while nobody drives and it stands.
        """
        commanded, self._commanded = self._commanded, False
        return not commanded and not 0.0 <= now - self._stepped_at < self._period_s(now) - _EARLY_S

    def _period_s(self, now: float) -> float:
        """How often what the base does is to be said again."""
        if self.active is None:
            return _REST_PERIOD_S if self._output == Twist2D() else 0.0
        _, twist = self._commands.get(self.active, (math.inf, None))
        return _HOLD_PERIOD_S if self._output == twist and self._drives(self.active, now) else 0.0

    def step(self, now: float) -> Twist2D:
        """The command at ``now`` in s; towards a stand when no source is fresh, as after time jumped back."""
        if now < self._stepped_at:
            if math.isfinite(self._stepped_at):
                self._commands = {s: (at, twist) for s, (at, twist) in self._commands.items() if at <= now}
            self._stepped_at = now
        dt = min(now - self._stepped_at, self._params.max_period_s)
        self._stepped_at = now
        fresh = [s for s in SOURCES if self._drives(s, now)]
        self.active = fresh[0] if fresh else None
        target = self._commands[self.active][1] if self.active else Twist2D()
        limits, brake = self._limits, self._params.deceleration_factor
        self._output = Twist2D(
            _approach(self._output.v, target.v, limits.max_speed_mps, limits.max_acceleration_mps2 * dt, brake),
            _approach(
                self._output.omega, target.omega, limits.max_yaw_rate_rps, limits.max_yaw_acceleration_rps2 * dt, brake
            ),
        )
        return self._output

    def _drives(self, source: Source, now: float) -> bool:
        """Whether a source has a fresh command that it may give."""
        at, twist = self._commands.get(source, (math.inf, Twist2D()))
        stops = self.teleop_mode == "off" and twist == Twist2D()
        may = source != "teleop" or (self.teleop_mode == "free" and self._let_go) or stops
        return may and 0.0 <= now - at < self._timeouts[source]


def _approach(value: float, target: float, limit: float, change: float, brake: float) -> float:
    """``value`` moved towards ``target`` by ``change``, or ``brake`` times that where it slows down."""
    target = min(max(target, -limit), limit)
    if value * target < 0.0:
        target = 0.0  # first to a stand
    if abs(target) < abs(value):
        change *= brake
    return value + min(max(target - value, -change), change)
