"""When a timer calls back on a simulated clock, and which of its ticks a node hears."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
import rospy
from hypothesis import given
from hypothesis import strategies as st
from rosgraph_msgs.msg import Clock

from hitchhike_ros.ros_io.timer import ClockEar, Timer


class SimulatedClock:
    """Stands in for the connection to /clock: what is subscribed is called with each time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.callbacks = 0.0, []
        monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: False)
        monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time.from_sec(self.now))
        monkeypatch.setattr(rospy, "Subscriber", self.subscribe)

    def subscribe(self, topic: str, _cls: type, callback: Callable[[Clock], None], queue_size: int) -> SimulatedClock:
        assert (topic, queue_size) == ("/clock", 1)
        self.callbacks.append(callback)
        return self

    def unregister(self) -> None:
        self.callbacks.clear()

    def tick(self, now: float) -> None:
        self.now = now
        for callback in list(self.callbacks):
            callback(Clock(rospy.Time.from_sec(now)))


@pytest.fixture
def clock(monkeypatch) -> SimulatedClock:
    return SimulatedClock(monkeypatch)


def calls(clock: SimulatedClock, period_s: float, times: list[float]) -> list[float]:
    """Those of ``times`` at which a timer that is made now calls back."""
    called: list[float] = []
    Timer(period_s, lambda: called.append(clock.now))
    for now in times:
        clock.tick(now)
    return called


TENTHS = [round(0.1 * i, 1) for i in range(1, 11)]


def test_it_calls_once_a_period(clock):
    assert calls(clock, 0.1, TENTHS) == TENTHS
    assert calls(clock, 0.5, [1.0 + t for t in TENTHS]) == [1.5, 2.0]


def test_it_keeps_a_rate_that_is_no_multiple_of_the_clocks(clock):
    assert calls(clock, 0.25, TENTHS) == [0.3, 0.5, 0.8, 1.0]


def test_missed_turns_are_not_made_up_for(clock):
    assert calls(clock, 0.2, [0.2, 1.3, 1.4, 1.5, 1.6]) == [0.2, 1.3, 1.5]


def test_it_goes_on_where_time_has_jumped_back(clock):
    clock.now = 50.0
    assert calls(clock, 0.2, [50.2, 0.1, 0.2, 0.3, 0.4, 0.5]) == [50.2, 0.1, 0.3, 0.5]


def test_who_was_shut_down_calls_no_more(clock):
    called: list[float] = []
    timer = Timer(0.1, lambda: called.append(clock.now))
    clock.tick(0.1)
    timer.shutdown()
    clock.tick(0.2)
    assert called == [0.1]


@given(st.lists(st.integers(1, 40), min_size=1, max_size=60), st.integers(1, 30))
def test_between_two_calls_pass_no_more_than_a_period_and_a_tick(steps, period):
    with pytest.MonkeyPatch.context() as monkeypatch:
        clock = SimulatedClock(monkeypatch)
        times = [sum(steps[: i + 1]) / 100.0 for i in range(len(steps))]
        called = calls(clock, period / 100.0, times)
    for before, now in zip([0.0, *times], times, strict=False):
        last = max((t for t in called if t <= before), default=0.0)
        assert now in called or now - last < period / 100.0 + 1e-6
    assert len(called) <= times[-1] / (period / 100.0) + 1e-6


class Connection:
    """As rospy reads /clock: a thread that takes the newest tick there is, and comes back for more when all is done."""

    def __init__(self, ear: ClockEar) -> None:
        self.sent = self.now = 0
        self.heard: list[int] = []
        self._ear, self._closed = ear, False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._closed:
            if self.sent == self.now:
                time.sleep(1e-4)
                continue
            self.now = self.sent
            self.heard.append(self.now)
            self._ear._on_tick(Clock())

    def send(self, ticks: int) -> float:
        """For how many seconds."""
        begun = time.monotonic()
        for _ in range(ticks):
            self.sent += 1
            time.sleep(1e-3)
        return time.monotonic() - begun

    def close(self) -> None:
        self._closed = True
        self._thread.join(5.0)


@pytest.fixture
def dozing(monkeypatch) -> Iterator[tuple[ClockEar, Connection]]:
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: False)
    monkeypatch.setattr(rospy, "Subscriber", lambda *_args, **_options: object())
    monkeypatch.setattr("hitchhike_ros.ros_io.timer._WAKE_S", 30.0)  # however slow the machine is
    ear = ClockEar()
    ear.doze()
    connection = Connection(ear)
    yield ear, connection
    connection.close()


def test_who_dozes_hears_few_ticks_and_who_needs_them_all_of_them(dozing):
    ear, connection = dozing
    took_s = connection.send(100)
    assert len(connection.heard) <= 2 + took_s / 0.25
    ear.need()
    for _ in range(50):
        connection.send(1)
        deadline = time.monotonic() + 10.0
        while connection.now != connection.sent and time.monotonic() < deadline:
            time.sleep(1e-4)
    assert connection.heard[-50:] == list(range(connection.sent - 49, connection.sent + 1))
    ear.release()
    before = len(connection.heard)
    took_s = connection.send(100)
    assert len(connection.heard) - before <= 2 + took_s / 0.25


def test_who_wakes_knows_the_time(dozing):
    ear, connection = dozing
    for _ in range(5):
        connection.send(20)
        ear.need()
        assert connection.now == connection.sent
        ear.release()


def test_without_ticks_nobody_waits_for_long(dozing, monkeypatch):
    monkeypatch.setattr("hitchhike_ros.ros_io.timer._WAKE_S", 0.01)
    ear, _ = dozing
    ear.need()  # returns, or the test would hang
    ear.release()


def test_who_does_not_doze_waits_for_nothing(monkeypatch):
    ear = ClockEar()
    monkeypatch.setattr(ear, "_changed", threading.Condition())
    monkeypatch.setattr(ear._changed, "wait_for", lambda *_args: pytest.fail("it waits"))
    ear.need()
    ear.release()
