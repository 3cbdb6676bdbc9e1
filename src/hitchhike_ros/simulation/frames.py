"""What the simulator does in each period of its clock: orders, physics, what is due, and the wait for the modules.

It knows neither ROS nor pybullet: the world is anything that steps, robots are anything that publishes.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol

import msgspec

from hitchhike_ros.core.datatypes import NonNegative, Positive
from hitchhike_ros.core.errors import HitchhikeError, ParameterError
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.lockstep import IMAGE, SCAN, Lockstep

Rate = Annotated[int, msgspec.Meta(ge=1)]

# While the simulator is paused it looks so often whether it is to go on, in s of wall time (chosen).
_PAUSE_S = 0.02
# A thread that waits for answers looks so often whether the node is to end, in s of wall time (chosen).
_LOOK_S = 0.05


@dataclass(frozen=True)
class FrameParameters:
    """Rates in simulated time. ``clock_rate_hz`` divides the physics rate and is a multiple of the others.

    ``max_real_time_factor`` 0 is as fast as possible; on the system's clock it does not count. The last three are wall
    time: how long lock-step waits for a module, for one that has not answered yet since it was switched on, and how
    often the real-time factor is printed.
    """

    clock_rate_hz: Rate = 10
    scan_rate_hz: Rate = 10
    image_rate_hz: Rate = 10
    depth_rate_hz: Rate = 5
    wheel_rate_hz: Rate = 5
    max_real_time_factor: NonNegative = 0.0
    answer_timeout_s: Positive = 5.0
    join_timeout_s: Positive = 0.5
    print_period_s: Positive = 30.0


class SubRates:
    """Which sensors are due at which tick of the clock."""

    def __init__(self, params: FrameParameters, physics_rate_hz: int, file: object = "simulator") -> None:
        """``file`` is where the parameters come from.

        Raises:
            ParameterError: one rate is no whole multiple of another.
        """
        clock = params.clock_rate_hz
        self.period_s = 1.0 / clock
        self.steps = _ratio("clock_rate_hz", physics_rate_hz, clock, file)
        """Of physics, in each period of the clock."""
        self._scan = _ratio("scan_rate_hz", clock, params.scan_rate_hz, file)
        self._image = _ratio("image_rate_hz", clock, params.image_rate_hz, file)
        self._depth = _ratio("depth_rate_hz", clock, params.depth_rate_hz, file)
        self._wheels = _ratio("wheel_rate_hz", clock, params.wheel_rate_hz, file)

    def due(self, tick: int) -> Due:
        """What is due at a tick; the first one is 1."""
        return Due(
            scan=tick % self._scan == 0,
            image=tick % self._image == 0,
            depth=tick % self._depth == 0,
            wheels=tick % self._wheels == 0,
        )


@dataclass(frozen=True)
class Due:
    """What is published at a tick of the clock, beside odometry."""

    scan: bool
    image: bool
    depth: bool
    wheels: bool


class Orders:
    """What is wanted from outside. Any thread puts it here, and the one that owns the world carries it out."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()

    def put(self, act: Callable[[], None]) -> None:
        """Have ``act()`` done between two periods of the clock."""
        self._waiting.append(act)

    def call(self, act: Callable[[], None], timeout_s: float = 5.0) -> bool:
        """Have it done, and wait for that; whether it was done within ``timeout_s`` of wall time."""
        done = threading.Event()

        def carry_out() -> None:
            act()
            done.set()

        self._waiting.append(carry_out)
        return done.wait(timeout_s)

    def carry_out(self) -> tuple[HitchhikeError, ...]:
        """Do all that were put here so far; the errors of those that could not be done."""
        refused = []
        for _ in range(len(self._waiting)):
            try:
                self._waiting.popleft()()
            except HitchhikeError as exc:
                refused.append(exc)
        return tuple(refused)


class Gate:
    """Lock-step between threads: time waits here until the modules have answered the newest frames."""

    def __init__(self, lockstep: Lockstep, wall: Callable[[], float] = time.monotonic) -> None:
        self._lockstep, self._wall = lockstep, wall
        self._changed = threading.Condition()

    @property
    def misses(self) -> Counter[tuple[str, str]]:
        """Answers that did not come in time, by robot and module."""
        with self._changed:
            return Counter(self._lockstep.misses)

    def sent(self, robot: str, sensor: str, stamp: float) -> None:
        """A frame is about to be sent: it is expected before, so that no answer can come too early."""
        with self._changed:
            self._lockstep.sent(robot, sensor, stamp)

    def take_status(self, robot: str, status: Status) -> None:
        """It says which of the robot's modules are on."""
        with self._changed:
            self._lockstep.set_modules(robot, status.modules)
            self._changed.notify_all()

    def answered(self, robot: str, module: str, stamp: float) -> None:
        """A module is done with the frame of that stamp."""
        with self._changed:
            self._lockstep.answered(robot, module, stamp)
            self._changed.notify_all()

    def wait(self, ended: Callable[[], bool]) -> tuple[tuple[str, str], ...]:
        """Until everybody has answered, or is waited for no longer, or the node has ended; who is late."""
        began = self._wall()
        with self._changed:
            while self._lockstep.waits(self._wall() - began) and not ended():
                self._changed.wait(_LOOK_S)
            return self._lockstep.give_up()


class SteppedWorld(Protocol):
    """Of a world, what the frames need."""

    @property
    def now(self) -> float: ...
    def step(self) -> None: ...
    def skip(self, seconds: float) -> None: ...


class Clock(Protocol):
    """:class:`hitchhike_ros.simulation.real_time.RealTime` or ``SystemTime``."""

    def restart(self, now: float) -> None: ...
    def hold(self, now: float) -> float: ...


class RobotPort(Protocol):
    """One robot's way in and out."""

    @property
    def name(self) -> str: ...
    def drive(self, now: float) -> None:
        """Give the robot the newest command, if one came since the last call."""

    def scan_wanted(self) -> bool:
        """Whether anybody takes a scan now; else none is made."""

    def image_wanted(self) -> bool:
        """Whether anybody takes an image now."""

    def publish_scan(self) -> None: ...
    def publish_image(self, now: float) -> None: ...
    def publish_depth(self, now: float) -> None: ...


@dataclass(frozen=True)
class Turn:
    """What went wrong in one period: orders that could not be done, robots and modules that did not answer in time."""

    refused: tuple[HitchhikeError, ...] = ()
    missed: tuple[tuple[str, str], ...] = ()


class Frames:
    """One period of the clock after the other."""

    def __init__(
        self,
        world: SteppedWorld,
        rates: SubRates,
        clock: Clock,
        robots: Sequence[RobotPort],
        publish_state: Callable[[float, bool], None],
        gate: Gate | None = None,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """``publish_state(now, wheels)`` publishes what is no frame; without a ``gate`` time waits for no module."""
        self.orders = Orders()
        self.paused = False
        self._world, self._rates, self._clock, self._robots = world, rates, clock, robots
        self._publish_state, self._gate, self._pause = publish_state, gate, pause
        self._tick = 0

    def turn(self, ended: Callable[[], bool] = lambda: False) -> Turn:
        """Carry out the orders; then, unless paused, one period of the clock: physics, what is due, the modules' turn.

        ``ended`` says whether the modules need not be waited for any more.
        """
        refused, world = self.orders.carry_out(), self._world
        if self.paused:
            self._pause(_PAUSE_S)
            self._clock.restart(world.now)
            return Turn(refused)
        if (jump_s := self._clock.hold(world.now + self._rates.period_s)) > 0.0:
            world.skip(jump_s)
        for robot in self._robots:
            robot.drive(world.now)
        for _ in range(self._rates.steps):
            world.step()
        self._tick += 1
        now, due = world.now, self._rates.due(self._tick)
        self._publish_state(now, due.wheels)
        if due.scan:
            for robot in self._robots:
                if robot.scan_wanted():
                    self._expect(robot, SCAN, now)
                    robot.publish_scan()
        # Rendering takes longest: meanwhile the modules work on the scans.
        for robot in self._robots:
            if due.image and robot.image_wanted():
                self._expect(robot, IMAGE, now)
                robot.publish_image(now)
            if due.depth:
                robot.publish_depth(now)
        return Turn(refused, self._gate.wait(ended) if self._gate is not None else ())

    def _expect(self, robot: RobotPort, sensor: str, now: float) -> None:
        if self._gate is not None:
            self._gate.sent(robot.name, sensor, now)


def _ratio(name: str, fast: int, slow: int, file: object) -> int:
    """How many periods of ``fast`` make one of ``slow``.

    Raises:
        ParameterError: not a whole number.
    """
    if fast % slow:
        raise ParameterError(file, f"~{name}", slow, f"a divisor of {fast}")
    return fast // slow
