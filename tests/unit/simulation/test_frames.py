"""One period of the simulator's clock after the other: orders, physics, what is due, and who is waited for."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace

import pytest

from hitchhike_ros.core.errors import ParameterError, WorldFileError
from hitchhike_ros.protocol.status import ModuleSwitches, Status
from hitchhike_ros.simulation.frames import FrameParameters, Frames, Gate, Orders, SubRates, Turn
from hitchhike_ros.simulation.lockstep import Lockstep

PARAMS = FrameParameters(clock_rate_hz=10, scan_rate_hz=5, image_rate_hz=2, depth_rate_hz=1, wheel_rate_hz=5)
LOCALIZING = Status(0.0, "", modules=ModuleSwitches(PP=False, OBS=False, LZN=True, MAP=False))


class World:
    """Counts its steps of 10 ms."""

    def __init__(self) -> None:
        self.now, self.skipped = 0.0, 0.0

    def step(self) -> None:
        self.now = round(self.now + 0.01, 6)

    def skip(self, seconds: float) -> None:
        self.now, self.skipped = self.now + seconds, self.skipped + seconds


@dataclass
class Clock:
    """Never waits; ``jumps`` are the answers to the next calls."""

    jumps: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)
    restarts: int = 0

    def restart(self, now: float) -> None:
        self.restarts += 1

    def hold(self, now: float) -> float:
        self.held.append(round(now, 6))
        return self.jumps.pop(0) if self.jumps else 0.0


class Robot:
    """Notes what is published of it."""

    name = "r"

    def __init__(self, done: list[str], *, scan: bool = True, image: bool = True) -> None:
        self._done, self._scan, self._image = done, scan, image

    def drive(self, now: float) -> None:
        self._done.append(f"drive {now:.1f}")

    def scan_wanted(self) -> bool:
        return self._scan

    def image_wanted(self) -> bool:
        return self._image

    def publish_scan(self) -> None:
        self._done.append("scan")

    def publish_image(self, now: float) -> None:
        self._done.append(f"image {now:.1f}")

    def publish_depth(self, now: float) -> None:
        self._done.append(f"depth {now:.1f}")


@dataclass
class Loop:
    """Frames of a world with one robot."""

    gate: Gate | None = None
    scan: bool = True
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        self.done: list[str] = []
        self.world = World()
        self.pauses: list[float] = []
        self.frames = Frames(
            self.world,
            SubRates(PARAMS, 100),
            self.clock,
            [Robot(self.done, scan=self.scan)],
            lambda now, wheels: self.done.append(f"state {now:.1f}{' wheels' if wheels else ''}"),
            self.gate,
            self.pauses.append,
        )


def test_a_period_is_commands_then_physics_then_what_is_due() -> None:
    loop = Loop()
    for _ in range(10):
        assert loop.frames.turn() == Turn()
    assert loop.done[:9] == [
        *("drive 0.0", "state 0.1"),
        *("drive 0.1", "state 0.2 wheels", "scan"),
        *("drive 0.2", "state 0.3", "drive 0.3", "state 0.4 wheels"),
    ]
    assert loop.done[-4:] == ["state 1.0 wheels", "scan", "image 1.0", "depth 1.0"]
    assert [each for each in loop.done if each.startswith("image")] == ["image 0.5", "image 1.0"]
    assert loop.clock.held == [round(0.1 * k, 6) for k in range(1, 11)]


def test_what_nobody_wants_is_not_made() -> None:
    loop = Loop(scan=False)
    for _ in range(10):
        loop.frames.turn()
    assert "scan" not in loop.done


@pytest.mark.parametrize("name", ["clock_rate_hz", "scan_rate_hz", "image_rate_hz", "depth_rate_hz", "wheel_rate_hz"])
def test_rates_are_multiples(name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        SubRates(replace(PARAMS, **{name: 7}), 100, "robot.yaml")


def test_a_jump_of_the_clock_skips_time() -> None:
    loop = Loop(clock=Clock(jumps=[0.0, 0.7]))
    loop.frames.turn()
    loop.frames.turn()
    assert (loop.world.skipped, loop.done[-3]) == (0.7, "drive 0.8")


def test_orders_are_carried_out_between_periods_and_while_paused() -> None:
    loop = Loop()
    bad = WorldFileError("add_box", "id", "b", "an id that no box has")

    def refuse() -> None:
        raise bad

    loop.frames.orders.put(lambda: loop.done.append("order"))
    loop.frames.orders.put(refuse)
    assert loop.frames.turn() == Turn(refused=(bad,))
    assert loop.done == ["order", "drive 0.0", "state 0.1"]
    loop.frames.paused = True
    loop.frames.orders.put(lambda: loop.done.append("later"))
    assert loop.frames.turn() == Turn()
    assert (loop.done[-1], loop.world.now, loop.clock.restarts, len(loop.pauses)) == ("later", 0.1, 1, 1)
    loop.frames.paused = False
    loop.frames.turn()
    assert loop.world.now == 0.2


def test_who_orders_may_wait_for_it() -> None:
    orders, done = Orders(), []
    assert not orders.call(lambda: done.append(1), timeout_s=0.0)
    orders.carry_out()
    assert done == [1]  # it comes all the same
    answers: list[bool] = []
    waiting = threading.Thread(target=lambda: answers.append(orders.call(lambda: done.append(2), timeout_s=30.0)))
    waiting.start()
    while waiting.is_alive():
        orders.carry_out()
    waiting.join(30.0)
    assert (answers, done) == ([True], [1, 2])


def test_an_order_may_order() -> None:
    orders, done = Orders(), []
    orders.put(lambda: orders.put(lambda: done.append(1)))
    orders.carry_out()
    assert done == []
    orders.carry_out()
    assert done == [1]


def test_time_waits_for_an_answer() -> None:
    gate = Gate(Lockstep(timeout_s=30.0, join_timeout_s=30.0))
    gate.take_status("r", LOCALIZING)
    loop = Loop(gate)
    loop.frames.turn()  # no scan is due
    turns: list[Turn] = []
    thread = threading.Thread(target=lambda: turns.append(loop.frames.turn()))
    thread.start()
    gate.answered("r", "slam", 0.1)  # to none, or to an older frame
    while "scan" not in loop.done:
        assert thread.is_alive()
    assert turns == []
    gate.answered("r", "slam", 0.2)
    thread.join(30.0)
    assert turns == [Turn()]
    assert not gate.misses


def test_who_does_not_answer_in_time_is_told() -> None:
    times = iter([0.0, 0.1, 0.6])
    gate = Gate(Lockstep(timeout_s=5.0, join_timeout_s=0.5), lambda: next(times))
    gate.take_status("r", LOCALIZING)
    gate.sent("r", "scan", 0.2)
    assert gate.wait(lambda: False) == (("r", "slam"),)
    assert gate.misses == {("r", "slam"): 1}


def test_nobody_waits_when_the_node_ends() -> None:
    gate = Gate(Lockstep(timeout_s=1e9, join_timeout_s=1e9))
    gate.take_status("r", LOCALIZING)
    gate.sent("r", "scan", 0.2)
    assert gate.wait(lambda: True) == (("r", "slam"),)
