"""What teleop tells the robot and shows the human: keys and joystick in, commands and lines of a screen out (P18 §7).

A command is repeated while it is wanted, then there is silence. That the robot is in hand is repeated too, as who does
not hear it any more drives by itself again.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import ClassVar

from hitchhike_ros.control.teleop import Key, Teleop, TeleopParameters
from hitchhike_ros.core.datatypes import TeleopMode, Twist2D
from hitchhike_ros.modules.inputs import Joystick, TeleopActive, TeleopCommand
from hitchhike_ros.modules.module import Health, Level, Order, Outputs, Refused
from hitchhike_ros.protocol.status import Status

ACTIVE_PERIOD_S = 0.5
"""That the robot is in hand is repeated so often; ``TeleopAuthorityParameters.active_timeout_s`` is four times that."""
# A command that comes early by this share of its period is in time: simulated time goes on in ticks.
_EARLY = 0.01
_MODES: dict[TeleopMode, str] = {
    "free": "it has no goal: you drive it directly",
    "guided": "you drive it, within its limits",
    "off": "it acts by itself: only space works",
}
_COUNTERS: dict[type, str] = {Joystick: "bad_joy", Status: "bad_status"}


@dataclass(frozen=True)
class KeysPressed:
    """Keys that were pressed, or repeat because they are held, in their order."""

    keys: tuple[Key, ...]


@dataclass(frozen=True)
class HumanLeaves:
    """The human has gone: the robot is its own again."""


@dataclass(frozen=True, kw_only=True)
class TeleopOutputs(Outputs):
    """What the robot is told now, and the newest lines for the screen."""

    command: TeleopCommand | None = None
    active: TeleopActive | None = None
    lines: tuple[str, ...]


class Teleoperation:
    """Takes keys and joystick; :meth:`step` gives what is said now.

    Args:
        params: of the human's commands.
        status_topic: where the robot says what it does, for the screen.
    """

    name: ClassVar[str] = "teleop"
    inputs: ClassVar[frozenset[type]] = frozenset({Joystick, KeysPressed, HumanLeaves})
    patient: ClassVar[frozenset[type]] = frozenset()

    def __init__(self, params: TeleopParameters, status_topic: str) -> None:
        self._human, self._status_topic = Teleop(params), status_topic
        self._period_s = 1.0 / params.rate
        self._status: Status | None = None
        self._wanted: Twist2D | None = None
        self._in_hand = self._left = False
        self._repeat_at = self._active_at = self._stepped_at = -math.inf
        self._news = True
        self._joystick_usable = True
        self._refused: Counter[str] = Counter()

    def listens(self) -> frozenset[type]:
        """The joystick; keys come from the terminal."""
        return frozenset({Joystick})

    def sense(self, x: object, now: float) -> None:
        """Take what the human does at ``now`` in s; nothing any more when the human has gone."""
        if self._left:
            return
        self._news = True
        match x:
            case KeysPressed(keys):
                for key in keys:
                    self._human.press(key, now)
            case Joystick(axes, buttons):
                self._joystick_usable = self._human.joy(axes, buttons, now)
                self._refused[_COUNTERS[Joystick]] += not self._joystick_usable
            case HumanLeaves():
                self._human.press("release", now)
                self._left = True
            case Refused(what):
                self._refused[_COUNTERS[what]] += 1

    def order(self, order: Order, now: float) -> None:
        """The status is for the screen, which shows the newest, however old."""
        if isinstance(order, Status):
            self._status, self._news = order, True

    def next_due(self, now: float) -> float:
        """At once when something came, else when something is to be repeated or ends."""
        if self._news or now < self._stepped_at:
            return now
        command_at = math.inf if self._wanted is None else min(self._repeat_at, self._human.until)
        return min(command_at, self._active_at if self._in_hand else math.inf)

    def step(self, now: float) -> TeleopOutputs:
        """What is said at ``now`` in s. When time has jumped back, what is repeated is repeated at once."""
        if now < self._stepped_at:
            self._repeat_at = self._active_at = now
        self._stepped_at, self._news = now, False
        leaves = self._left and self._in_hand
        command, active = self._command(now), self._active(now)
        return TeleopOutputs(
            health=self._health(),
            command=TeleopCommand(Twist2D()) if leaves else command,
            active=active,
            lines=self._lines(),
        )

    def _command(self, now: float) -> TeleopCommand | None:
        """A command that is new or has to be repeated."""
        before, self._wanted = self._wanted, self._human.step(now)
        if self._wanted is None or (self._wanted == before and now < self._repeat_at):
            return None
        # The rate holds on average: what comes late by less than a period does not shift all that follows.
        in_time = self._wanted == before and now < self._repeat_at + self._period_s
        self._repeat_at = self._period_s + (self._repeat_at if in_time else now - _EARLY * self._period_s)
        return TeleopCommand(self._wanted)

    def _active(self, now: float) -> TeleopActive | None:
        """Whether the robot is in hand, when that is new or has to be repeated."""
        before, self._in_hand = self._in_hand, self._human.taken
        if self._in_hand == before and not (self._in_hand and now >= self._active_at):
            return None
        self._active_at = now + ACTIVE_PERIOD_S
        return TeleopActive(self._in_hand)

    def _health(self) -> Health:
        counters = {name: count for name, count in self._refused.items() if count}
        if self._joystick_usable:
            return Health(Level.OK, "ready", counters)
        return Health(Level.WARN, "joystick without the axes and the button of the parameters", counters)

    def _lines(self) -> tuple[str, str, str]:
        human, wanted, status = self._human, self._wanted, self._status
        says = "nothing" if wanted is None else f"{wanted.v:+.2f} m/s {wanted.omega:+.2f} rad/s"
        hand = f"in your hand ({human.source or 'no key'})" if human.taken else "not in your hand"
        speed = f"speed {human.speed_mps:.1f} m/s, {human.yaw_rate_rps:.2f} rad/s"
        first = f"{speed}   {hand}   says: {says}"
        if status is None:
            return first, f"{self._status_topic}: nothing yet", ""
        reason = f" ({status.reason})" if status.reason else ""
        limit = f", at most {status.speed_limit_mps:.2f} m/s" if status.speed_limit_mps and status.goal else ""
        riders = f", with {', '.join(status.convoy)}" if status.convoy else ""
        return first, f"{status.robot_id}: {status.state}{reason}{riders}{limit}", _MODES[status.teleop_mode]
