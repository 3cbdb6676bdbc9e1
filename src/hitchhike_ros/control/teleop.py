"""What a human's keys and joystick make of a robot: twists, for as long as the human keeps at it (P18 §7).

A terminal tells of keys that are pressed or repeat while they are held, never of keys that are let go. So a motion
lasts until the dead-man time is over without a key; the robot is then told for a moment to stand, and nothing after
that. A joystick drives while its dead-man button is held and its messages come.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec

from hitchhike_ros.core.datatypes import NonNegative, Positive, Twist2D

Key = Literal["forward", "back", "left", "right", "stop", "faster", "slower", "release", "quit"]
Rate = Annotated[float, msgspec.Meta(gt=0, le=100)]
Index = Annotated[int, msgspec.Meta(ge=0)]

_KEYS: dict[Key, str] = {
    "forward": "w",
    "back": "s",
    "left": "a",
    "right": "d",
    "stop": " ",
    "faster": "e+=",
    "slower": "q-",
    "release": "x",
    "quit": "\x04",
}
_LETTERS: dict[str, Key] = {letter: key for key, letters in _KEYS.items() for letter in letters}
_ARROWS: dict[str, Key] = {"A": "forward", "B": "back", "C": "right", "D": "left"}
_ESCAPE = "\x1b"

HELP = (
    "w/up: straight on   s/down: back     a/left, d/right: curve, on the spot where it stands",
    "e/+: faster         q/-: slower      space: stop",
    "x: let its own navigation drive      Ctrl-C: the same, and leave",
)


@dataclass(frozen=True)
class TeleopParameters:
    """Section ``teleop``; chosen. Axes and buttons are those of common game pads in joy's order."""

    speed_mps: Positive = 0.5
    speed_step_mps: Positive = 0.1
    min_speed_mps: Positive = 0.1
    max_speed_mps: Positive = 1.0  # a robot that can do less does less
    yaw_rate_rps: Positive = 0.5  # at speed_mps; slower and faster as the speed is
    max_yaw_rate_rps: Positive = 1.0
    dead_man_s: Positive = 0.8  # a key that is held repeats for the first time after up to 0.66 s (X11)
    joy_dead_man_s: Positive = 0.5  # autorepeat_rate of joy must be above 2 Hz
    rate: Rate = 10.0  # Hz: so often the robot is told while something is wanted
    stop_s: Positive = 0.3  # for so long the robot is told to stand
    joy_axis_linear: Index = 1  # left stick, forward is positive
    joy_axis_angular: Index = 0  # left stick, left is positive
    joy_button: Index = 4  # dead man, left shoulder
    joy_dead_zone: NonNegative = 0.05


class KeyReader:
    """Bytes of a terminal become keys; an arrow is three bytes, which may come apart."""

    def __init__(self) -> None:
        self._pending = ""

    def feed(self, data: bytes) -> list[Key]:
        """The keys in what has come; bytes that are no key of ours are left out."""
        text, self._pending = self._pending + data.decode("latin-1"), ""
        keys, i = [], 0
        while i < len(text):
            if text[i] != _ESCAPE:
                key = _LETTERS.get(text[i].lower())
                i += 1
            elif i + 1 == len(text) or (text[i + 1] in "[O" and i + 2 == len(text)):
                self._pending = text[i:]
                break
            elif text[i + 1] in "[O":
                end = i + 2
                while end < len(text) and text[end] in "0123456789;":  # as of an arrow with Shift, or of F5
                    end += 1
                if end == len(text):
                    self._pending = text[i:] if end - i < 16 else ""
                    break
                key = _ARROWS.get(text[end]) if end == i + 2 else None
                i = end + 1
            else:
                key, i = None, i + 1
            if key is not None:
                keys.append(key)
        return keys


class Teleop:
    """Keys and joystick set what the robot does; :meth:`step` says it for as long as it holds."""

    def __init__(self, params: TeleopParameters) -> None:
        self._params = params
        self.speed_mps = min(max(params.speed_mps, params.min_speed_mps), params.max_speed_mps)
        self.taken = False  # whether the human has the robot in hand
        self.source = ""  # keys or joystick, while one of them moves or stops the robot
        self._sense = (0, 0)  # of motion: forward, to the left
        self._stick: tuple[float, float] | None = None
        self._holds_until = self._stops_until = -math.inf
        self._stepped_at = -math.inf

    @property
    def yaw_rate_rps(self) -> float:
        """How fast it turns at the present speed."""
        return min(self._params.yaw_rate_rps * self.speed_mps / self._params.speed_mps, self._params.max_yaw_rate_rps)

    @property
    def until(self) -> float:
        """When what :meth:`step` said last ends by itself, in s; not after now where it said nothing."""
        return max(self._holds_until, self._stops_until)

    def press(self, key: Key, now: float) -> None:
        """A key is pressed, or repeats because it is held."""
        forward, _ = self._sense if now < self._holds_until and self._stick is None else (0, 0)
        if key in ("faster", "slower"):
            step = self._params.speed_step_mps if key == "faster" else -self._params.speed_step_mps
            speed = min(max(self.speed_mps + step, self._params.min_speed_mps), self._params.max_speed_mps)
            self.speed_mps = round(speed, 6)
        elif key == "stop":
            self._halt("keys", now)
        elif key in ("release", "quit"):
            self._halt("", now)
            self._stops_until, self.taken = -math.inf, False
        else:
            turns = {"forward": (1, 0), "back": (-1, 0), "left": (forward, 1), "right": (forward, -1)}
            self._sense, self._stick = turns[key], None
            self._hold("keys", now, self._params.dead_man_s)

    def joy(self, axes: Sequence[float], buttons: Sequence[int], now: float) -> bool:
        """What a joystick says; False when it has not got the axes and the button, or they are not finite."""
        p = self._params
        if max(p.joy_axis_linear, p.joy_axis_angular) >= len(axes) or p.joy_button >= len(buttons):
            return False
        linear, angular = axes[p.joy_axis_linear], axes[p.joy_axis_angular]
        if not (math.isfinite(linear) and math.isfinite(angular)):
            self._let_go(now)
            return False
        if buttons[p.joy_button]:
            self._stick = (_beyond(linear, p.joy_dead_zone), _beyond(angular, p.joy_dead_zone))
            self._hold("joystick", now, p.joy_dead_man_s)
        else:
            self._let_go(now)
        return True

    def step(self, now: float) -> Twist2D | None:
        """What to tell the robot at ``now`` in s; None is silence. Time that jumps back ends what was held."""
        if now < self._stepped_at:
            held = self._holds_until > -math.inf or self._stops_until > -math.inf
            self._holds_until = -math.inf
            self._stops_until = now + self._params.stop_s if held else -math.inf
        self._stepped_at = now
        if now < self._holds_until:
            forward, left = self._stick if self._stick is not None else self._sense
            return Twist2D(forward * self.speed_mps, left * self.yaw_rate_rps)
        if self._holds_until > -math.inf:  # the dead man
            self._halt(self.source, now)
        if now < self._stops_until:
            return Twist2D()
        self.source = ""
        return None

    def _hold(self, source: str, now: float, seconds: float) -> None:
        self.taken, self.source = True, source
        self._holds_until, self._stops_until = now + seconds, -math.inf

    def _halt(self, source: str, now: float) -> None:
        self.taken, self.source = True, source
        self._sense, self._stick = (0, 0), None
        self._holds_until, self._stops_until = -math.inf, now + self._params.stop_s

    def _let_go(self, now: float) -> None:
        """Of the joystick; it does not end what the keys say."""
        if self._stick is not None and self._holds_until > -math.inf:
            self._halt("joystick", now)


def _beyond(value: float, dead_zone: float) -> float:
    """An axis in [-1, 1], 0 around its middle."""
    return 0.0 if abs(value) <= dead_zone else min(max(value, -1.0), 1.0)
