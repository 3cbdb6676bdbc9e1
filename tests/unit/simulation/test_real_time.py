"""Simulated time beside wall time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.simulation.real_time import Every, RealTime, SystemTime


class Wall:
    """Wall time that passes when somebody sleeps or works."""

    def __init__(self, now: float = 100.0) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.now += seconds


@pytest.mark.parametrize(("most", "work_s", "factor"), [(2.0, 0.01, 2.0), (0.0, 0.02, 5.0), (3.0, 0.1, 1.0)])
def test_it_runs_as_fast_as_it_may_or_can(most: float, work_s: float, factor: float) -> None:
    wall = Wall()
    time = RealTime(most, wall, wall.sleep)
    assert math.isnan(time.factor)
    for k in range(1, 101):
        assert time.hold(0.1 * k) == 0.0
        wall.now += work_s
    assert time.factor == pytest.approx(factor, rel=0.05)


def test_a_pause_is_not_made_up_for() -> None:
    wall = Wall()
    time = RealTime(1.0, wall, wall.sleep)
    time.hold(0.1)
    wall.now += 50.0
    time.restart(0.1)
    began = wall.now
    for k in range(2, 12):
        time.hold(0.1 * k)
    assert wall.now - began == pytest.approx(1.0)


def test_on_the_systems_clock_a_step_begins_when_its_time_has_come() -> None:
    wall = Wall()
    time = SystemTime(1_000.0, wall, wall.sleep)
    wall.now += 3.0  # the world is built
    assert time.hold(1_000.1) == pytest.approx(2.9)
    for k in range(1, 21):
        assert time.hold(1_003.0 + 0.1 * k) == 0.0
        assert wall.now == pytest.approx(103.0 + 0.1 * k)
        wall.now += 0.09
    assert time.counts() == {"steps": 20, "late_steps": 0, "late_share": 0.0, "lost_s": 0.0}


def test_late_steps_are_counted_and_caught_up_with() -> None:
    wall = Wall()
    time = SystemTime(0.0, wall, wall.sleep)
    time.hold(0.1)
    wall.now += 0.25  # the step of 0.2 begins at 0.35, and that of 0.3 at once
    assert [time.hold(0.1 * k) for k in (2, 3, 4)] == [0.0, 0.0, 0.0]
    assert wall.now == pytest.approx(100.4)
    assert time.counts() == {"steps": 3, "late_steps": 2, "late_share": 0.66667, "lost_s": 0.0}


def test_time_jumps_when_it_is_far_behind() -> None:
    wall = Wall()
    time = SystemTime(0.0, wall, wall.sleep)
    time.hold(0.1)
    wall.now += 1.1  # the step of 0.2 comes at 1.2
    jump = time.hold(0.2)
    assert jump == pytest.approx(1.0)
    assert time.hold(0.3 + jump) == 0.0
    assert (time.late, time.lost_s) == (1, pytest.approx(1.0))


def test_a_pause_on_the_systems_clock_is_a_jump_and_no_late_step() -> None:
    wall = Wall()
    time = SystemTime(0.0, wall, wall.sleep)
    time.hold(0.1)
    wall.now += 60.0
    time.restart(0.1)
    assert time.hold(0.2) == pytest.approx(59.9)
    assert time.counts()["steps"] == 0


@given(st.lists(st.floats(0.0, 0.6), min_size=1, max_size=40))
def test_stamps_are_never_ahead_of_the_system_nor_far_behind(works: list[float]) -> None:
    wall = Wall()
    time, now = SystemTime(0.0, wall, wall.sleep), 0.0
    for work_s in works:
        now += 0.1
        now += time.hold(now)
        system = wall.now - 100.0
        assert -0.2 - 1e-9 <= now - system <= 1e-9
        wall.now += work_s


def test_every_period_is_over_once() -> None:
    wall = Wall()
    every, over = Every(1.0, wall), 0
    for _ in range(100):
        wall.now += 0.0999
        over += every.over()
        assert not every.over()
    assert over == 9
