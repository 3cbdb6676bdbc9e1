"""One command for the base out of several sources: the most important fresh one, within the robot's limits.

A human drives the base through it while the robot has no goal and no ride, or while nobody gives orders. On the way to
a goal, alone or with riders, obstacle avoidance takes up what the human says; in all other states only a stop passes.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, get_args

import msgspec

from hitchhike_ros.core.datatypes import Positive, TeleopMode, Twist2D
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.modules.inputs import NavigationCommand, ServoingCommand, TeleopCommand
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Fresh, Health, Level, Order, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.protocol.status import Status

Source = Literal["teleop", "servoing", "navigation"]
SOURCES: tuple[Source, ...] = get_args(Source)  # most important first
_SOURCE_OF: dict[type, Source] = {
    TeleopCommand: "teleop",
    ServoingCommand: "servoing",
    NavigationCommand: "navigation",
}


@dataclass(frozen=True)
class VelocityMuxParameters:
    """Section ``velocity_mux``; chosen."""

    teleop_timeout_s: Positive = 0.5
    servoing_timeout_s: Positive = 0.5
    navigation_timeout_s: Positive = 0.5
    deceleration_factor: Annotated[float, msgspec.Meta(ge=1)] = 5.0  # braking may be this much harder than speeding up
    max_period_s: Positive = 0.15  # a longer pause between steps does not allow a larger change of speed
    period_s: Positive = 0.15
    """The base is told what to do at least so often while somebody drives or it still moves; commands that come at
    10 Hz are all that it is told."""
    rest_period_s: Positive = 1.0
    """The base is told so often to stand while nobody drives and it stands."""


@dataclass(frozen=True, kw_only=True)
class VelocityMuxOutputs(Outputs):
    """What the base does now."""

    twist: Twist2D


class VelocityMux:
    """Keeps the newest command of each source; :meth:`step` gives what the base does now."""

    name: ClassVar[str] = "velocity_mux"
    inputs: ClassVar[frozenset[type]] = frozenset(_SOURCE_OF)
    patient: ClassVar[frozenset[type]] = frozenset()

    def __init__(self, params: VelocityMuxParameters, limits: RobotLimits) -> None:
        self._params, self._limits = params, limits
        self._timeouts: dict[Source, float] = {
            "teleop": params.teleop_timeout_s,
            "servoing": params.servoing_timeout_s,
            "navigation": params.navigation_timeout_s,
        }
        self._commands: dict[Source, tuple[float, Twist2D]] = {}
        self._orders: Fresh[Status] = Fresh("status", ORDER_MAX_AGE_S)
        self._output, self._stepped_at = Twist2D(), math.inf
        self._commanded = False  # since the last step
        self._let_go = True  # of the keys, since the robot was last guided
        self._senseless: set[Source] = set()  # sources whose newest command was refused
        self._refused: Counter[Source] = Counter()

    @classmethod
    def build(cls, files: RobotFiles) -> VelocityMux:
        """The mux of the robot that ``files`` describe."""
        return cls(files.load(VelocityMuxParameters, "velocity_mux"), files.load(RobotLimits, "robot"))

    def listens(self) -> frozenset[type]:
        """All of its inputs, always."""
        return self.inputs

    def sense(self, x: object, now: float) -> None:
        """Take a command. One that is not finite is counted, and ends the command before it: a source that talks
        nonsense does not drive."""
        if isinstance(x, Refused):
            self._refuse(_SOURCE_OF[x.what])
        elif isinstance(x, (TeleopCommand, ServoingCommand, NavigationCommand)):
            source = _SOURCE_OF[type(x)]
            if x.twist.is_finite():
                self._take(source, x.twist, now)
            else:
                self._refuse(source)

    def order(self, order: Order, now: float) -> None:
        """The status says whether a human may drive the base."""
        if isinstance(order, Status):
            self._orders.put(order, now)

    def next_due(self, now: float) -> float:
        """At once on a command, and after a period in which none came."""
        if self._commanded or now < self._stepped_at:  # never stepped, or time jumped back
            return now
        stands = self._output == Twist2D() and self._driver(now) is None
        return self._stepped_at + (self._params.rest_period_s if stands else self._params.period_s)

    def step(self, now: float) -> VelocityMuxOutputs:
        """The command at ``now`` in s; towards a stand when no source is fresh, as after time jumped back."""
        if now < self._stepped_at:
            if math.isfinite(self._stepped_at):
                self._commands = {s: (at, twist) for s, (at, twist) in self._commands.items() if at <= now}
            self._stepped_at = now
        dt = min(now - self._stepped_at, self._params.max_period_s)
        self._stepped_at, self._commanded = now, False
        active = self._driver(now)
        target = Twist2D() if active is None else self._commands[active][1]
        limits, brake = self._limits, self._params.deceleration_factor
        self._output = Twist2D(
            _approach(self._output.v, target.v, limits.max_speed_mps, limits.max_acceleration_mps2 * dt, brake),
            _approach(
                self._output.omega, target.omega, limits.max_yaw_rate_rps, limits.max_yaw_acceleration_rps2 * dt, brake
            ),
        )
        return VelocityMuxOutputs(health=self._health(active), twist=self._output)

    def _take(self, source: Source, twist: Twist2D, now: float) -> None:
        if source == "teleop":
            self._note_key(twist, now)
        self._commands[source], self._commanded = (now, twist), True
        self._senseless.discard(source)

    def _refuse(self, source: Source) -> None:
        self._refused[source] += 1
        self._senseless.add(source)
        self._commands.pop(source, None)
        self._commanded = True

    def _note_key(self, twist: Twist2D, now: float) -> None:
        """A key that was pressed on the way does not drive on from the goal before it was let go."""
        at, _ = self._commands.get("teleop", (-math.inf, Twist2D()))
        if twist == Twist2D() or not 0.0 <= now - at < self._timeouts["teleop"]:
            self._let_go = True
        if twist != Twist2D() and self._teleop_mode(now) != "free":
            self._let_go = False

    def _teleop_mode(self, now: float) -> TeleopMode:
        status = self._orders.get(now)
        return "free" if status is None else status.teleop_mode

    def _driver(self, now: float) -> Source | None:
        """The most important source with a fresh command that it may give."""
        return next((s for s in SOURCES if self._drives(s, now)), None)

    def _drives(self, source: Source, now: float) -> bool:
        at, twist = self._commands.get(source, (math.inf, Twist2D()))
        mode = self._teleop_mode(now)
        stops = mode == "off" and twist == Twist2D()
        may = source != "teleop" or (mode == "free" and self._let_go) or stops
        return may and 0.0 <= now - at < self._timeouts[source]

    def _health(self, active: Source | None) -> Health:
        refused = {f"refused_{source}": count for source, count in self._refused.items()}
        counters = {"active": active or "", **refused}
        if self._senseless:
            return Health(Level.ERROR, f"commands of {', '.join(sorted(self._senseless))} are not finite", counters)
        return Health(Level.OK, active or "nobody drives", counters)


def _approach(value: float, target: float, limit: float, change: float, brake: float) -> float:
    """``value`` moved towards ``target`` by ``change``, or ``brake`` times that where it slows down."""
    target = min(max(target, -limit), limit)
    if value * target < 0.0:
        target = 0.0  # first to a stand
    if abs(target) < abs(value):
        change *= brake
    return value + min(max(target - value, -change), change)
