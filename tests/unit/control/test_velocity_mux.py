"""Who drives, when nobody does, and that the output is always one the base can follow."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flat_world import P3DX
from hitchhike_ros.control.velocity_mux import SOURCES, VelocityMux, VelocityMuxParameters
from hitchhike_ros.core.datatypes import Twist2D

PARAMS = VelocityMuxParameters()
FORWARD, TURN, BACK = Twist2D(0.4, 0.0), Twist2D(0.0, 1.0), Twist2D(-0.3, 0.0)


def run(mux: VelocityMux, start: float, duration: float) -> Twist2D:
    """Steps at 20 Hz, including both ends."""
    output = Twist2D()
    for i in range(round(duration / 0.05) + 1):
        output = mux.step(start + 0.05 * i)
    return output


@pytest.mark.parametrize(
    ("ages", "active"),
    [
        ({}, None),
        ({"navigation": 0.1}, "navigation"),
        ({"navigation": 0.1, "servoing": 0.1}, "servoing"),
        ({"navigation": 0.1, "servoing": 0.1, "teleop": 0.1}, "teleop"),
        ({"navigation": 0.1, "teleop": 0.6}, "navigation"),
        ({"navigation": 0.6, "servoing": 0.7, "teleop": 0.8}, None),
        ({"servoing": 0.49}, "servoing"),
        ({"servoing": 0.5}, None),
        ({"navigation": -0.1}, None),  # stamped in the future
    ],
)
def test_the_most_important_fresh_source_drives(ages: dict, active: str | None) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    for source, age in ages.items():
        mux.command(source, FORWARD, 10.0 - age)
    mux.step(10.0)
    assert mux.active == active


def test_timeouts_are_each_sources_own() -> None:
    mux = VelocityMux(VelocityMuxParameters(teleop_timeout_s=0.2, navigation_timeout_s=1.0), P3DX)
    mux.command("teleop", FORWARD, 0.0)
    mux.command("navigation", BACK, 0.0)
    mux.step(0.1)
    assert mux.active == "teleop"
    mux.step(0.3)
    assert mux.active == "navigation"


def test_nothing_moves_at_startup() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    assert run(mux, 100.0, 1.0) == Twist2D()
    mux.command("navigation", FORWARD, 101.0)
    assert mux.step(101.0).v == 0.0 or mux.step(101.0).v <= P3DX.max_acceleration_mps2 * PARAMS.max_period_s


def test_a_command_is_reached_and_left_at_the_allowed_rates() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    for i in range(1, 41):
        mux.command("teleop", FORWARD, 0.05 * i)
        output = mux.step(0.05 * i)
        assert output.v == pytest.approx(min(0.4, P3DX.max_acceleration_mps2 * 0.05 * i))
    for i in range(1, 11):  # still fresh
        output = mux.step(2.0 + 0.0499 * i)
        assert output.v == pytest.approx(0.4)
    speeds = [mux.step(2.5 + 0.05 * i).v for i in range(10)]
    braking = PARAMS.deceleration_factor * P3DX.max_acceleration_mps2 * 0.05
    assert speeds[-1] == 0.0
    assert speeds[1] == pytest.approx(speeds[0] - braking)


def test_reversing_passes_through_a_stand() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    for i in range(1, 41):
        mux.command("teleop", FORWARD, 0.05 * i)
        mux.step(0.05 * i)
    speeds = []
    for i in range(41, 81):
        mux.command("teleop", BACK, 0.05 * i)
        speeds.append(mux.step(0.05 * i).v)
    assert 0.0 in speeds
    assert speeds[-1] == pytest.approx(BACK.v)


@pytest.mark.parametrize("bad", [Twist2D(math.nan, 0.0), Twist2D(0.0, math.inf)])
def test_a_senseless_command_is_refused_counted_and_ends_the_one_before(bad: Twist2D) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    assert mux.command("servoing", FORWARD, 0.0)
    assert not mux.command("servoing", bad, 0.1)
    mux.step(0.1)
    assert mux.active is None
    assert mux.refused == {"servoing": 1}


def test_time_that_jumps_back_stops_the_robot_and_then_works_on() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(99.9)
    mux.command("navigation", FORWARD, 100.0)
    assert mux.step(100.0).v > 0.0
    before = mux.step(100.1).v
    assert mux.step(5.0).v <= before
    assert mux.active is None
    assert run(mux, 5.0, 1.0) == Twist2D()
    mux.command("navigation", FORWARD, 6.05)
    assert mux.step(6.05).v > 0.0
    # The command of before the jump does not come back when its time does.
    assert run(mux, 6.1, 1.0) == Twist2D()
    mux.step(100.05)
    assert mux.active is None


def test_a_long_pause_allows_no_leap() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    mux.command("teleop", Twist2D(1.0, 0.0), 60.0)
    assert mux.step(60.0).v <= P3DX.max_acceleration_mps2 * PARAMS.max_period_s + 1e-12


def spoken(mux: VelocityMux, turns: Iterable[float], commands: Iterable[tuple[float, Twist2D]] = ()) -> list[float]:
    """When a node speaks whose timer has these turns, and to which navigation says these: in order, turns first."""
    said = []
    for now, twist in sorted([*((now, None) for now in turns), *commands], key=lambda event: event[0]):
        if twist is not None:
            mux.command("navigation", twist, now)
        if twist is not None or mux.takes_turn(now):
            mux.step(now)
            said.append(now)
    return said


@given(st.lists(st.floats(0.01, 0.3), min_size=1, max_size=40))
def test_while_it_drives_it_is_silent_for_a_turn_longer_than_a_hold_at_most(gaps: list[float]) -> None:
    commands = list(itertools.accumulate(gaps, initial=1000.0))
    end = commands[-1] + PARAMS.navigation_timeout_s  # until then navigation drives
    turns = [now for now in (999.95 + 0.1 * i for i in range(200)) if now < end]
    said = spoken(VelocityMux(PARAMS, P3DX), turns, [(now, FORWARD) for now in commands])
    assert set(commands) <= set(said)  # each at once
    assert max(np.diff([*said, end])) <= 0.3 + 1e-9


def test_what_the_robot_does_as_told_is_repeated_five_times_a_second_and_what_it_is_to_come_to_at_each_turn() -> None:
    turns = 1000.0 + 0.1 * np.arange(60)
    crawl, speed = Twist2D(0.01), Twist2D(0.4)  # reached at once, and after 1.3 s
    said = np.array(spoken(VelocityMux(PARAMS, P3DX), turns, [(1000.03 + 0.2 * i, crawl) for i in range(10)]))
    assert said[1:11] == pytest.approx(1000.03 + 0.2 * np.arange(10))  # each command, and nothing between
    commands = [(1000.03 + 0.4 * i, speed) for i in range(12)]
    said = np.array(spoken(VelocityMux(PARAMS, P3DX), turns, commands))
    assert max(np.diff(said[said < 1001.0])) <= 0.2  # while it speeds up: every turn without a command
    assert max(np.diff(said[said > 1002.5])) <= 0.3  # then as often as bases need it
    assert sum((said > 1003.0) & (said < 1004.0)) <= 5


def test_commands_in_time_with_the_turns_are_all_it_says() -> None:
    turns, commands = 1000.0 + 0.1 * np.arange(100), 1000.03 + 0.1 * np.arange(100)
    mux = VelocityMux(PARAMS, P3DX)
    assert spoken(mux, turns, [(now, FORWARD) for now in commands]) == [turns[0], *commands]


@pytest.mark.parametrize("rate", [10, 20])
@pytest.mark.parametrize("late_s", [0.0, 0.004])
def test_at_rest_it_speaks_once_a_second(rate: int, late_s: float) -> None:
    rng = np.random.default_rng(7)
    turns = [n / rate + late_s * rng.random() for n in range(1000 * rate)]
    said = spoken(VelocityMux(PARAMS, P3DX), turns)
    assert said[0] == turns[0]
    assert np.diff(said) == pytest.approx(1.0, abs=late_s + 1e-9)


def test_a_command_ends_the_rest_at_once_and_braking_is_told_at_each_turn() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    turns = 100.0 + 0.1 * np.arange(100)
    commands = [(102.34 + 0.1 * i, FORWARD) for i in range(11)]  # until 103.34
    said = np.array(spoken(mux, turns, commands))
    assert said[:3] == pytest.approx([100.0, 101.0, 102.0])
    assert said[3] == commands[0][0]
    assert said[(said > 103.35) & (said < 103.85)] == pytest.approx([103.6, 103.8])  # it is held until 103.84
    assert said[(said > 103.85) & (said < 104.15)] == pytest.approx([103.9, 104.0])  # until it stands
    assert np.diff(said[said > 104.5]) == pytest.approx(1.0)


@pytest.mark.parametrize("drives", [False, True])
def test_after_time_has_jumped_back_it_speaks_at_its_next_turn(drives: bool) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    spoken(mux, 100.0 + 0.1 * np.arange(20), [(101.88, FORWARD)] if drives else [])
    assert mux.takes_turn(5.0)
    mux.step(5.0)
    assert not spoken(mux, [5.1, 5.2, 5.3]) or drives  # which brakes
    assert mux.active is None
    assert np.diff(spoken(mux, 7.0 + 0.1 * np.arange(100))) == pytest.approx(1.0)


speeds = st.floats(-1e6, 1e6) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0])
events = st.lists(
    st.tuples(
        st.floats(-0.2, 0.7), st.none() | st.tuples(st.sampled_from(SOURCES), st.builds(Twist2D, speeds, speeds))
    ),
    max_size=60,
)


@given(events)
def test_output_is_always_finite_within_limits_and_driven_by_a_fresh_source(events: list) -> None:
    mux, now = VelocityMux(PARAMS, P3DX), 50.0
    before, newest = mux.step(now), dict.fromkeys(SOURCES, -math.inf)
    for dt, command in events:
        now += dt
        if command is not None:
            source, twist = command
            accepted = mux.command(source, twist, now)
            assert accepted == twist.is_finite()
            newest[source] = now if accepted else -math.inf
        output = mux.step(now)
        period = min(max(dt, 0.0), PARAMS.max_period_s) * PARAMS.deceleration_factor + 1e-9
        assert abs(output.v) <= P3DX.max_speed_mps
        assert abs(output.omega) <= P3DX.max_yaw_rate_rps
        assert abs(output.v - before.v) <= P3DX.max_acceleration_mps2 * period
        assert abs(output.omega - before.omega) <= P3DX.max_yaw_acceleration_rps2 * period
        if mux.active is None:
            assert abs(output.v) <= abs(before.v)
            assert abs(output.omega) <= abs(before.omega)
        else:
            assert 0.0 <= now - newest[mux.active] < 0.5
        before = output
