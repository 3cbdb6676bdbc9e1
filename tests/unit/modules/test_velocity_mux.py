"""Who drives, when nobody does, and that the output is always one the base can follow."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flat_world import P3DX
from hitchhike_ros.core.datatypes import Twist2D
from hitchhike_ros.modules.inputs import NavigationCommand, ServoingCommand, TeleopCommand
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Health, Level, Refused
from hitchhike_ros.modules.velocity_mux import SOURCES, VelocityMux, VelocityMuxParameters
from hitchhike_ros.protocol.status import GoalCommand, Status

PARAMS = VelocityMuxParameters()
COMMANDS = {"teleop": TeleopCommand, "servoing": ServoingCommand, "navigation": NavigationCommand}
FORWARD, TURN, BACK = Twist2D(0.4, 0.0), Twist2D(0.0, 1.0), Twist2D(-0.3, 0.0)


def tell(mux: VelocityMux, source: str, twist: Twist2D, now: float) -> None:
    mux.sense(COMMANDS[source](twist), now)


def driver(mux: VelocityMux, now: float) -> object:
    """Who drives at ``now``."""
    return mux.step(now).health.counters["active"]


def run(mux: VelocityMux, start: float, duration: float) -> Twist2D:
    """Steps at 20 Hz, including both ends."""
    output = Twist2D()
    for i in range(round(duration / 0.05) + 1):
        output = mux.step(start + 0.05 * i).twist
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
        tell(mux, source, FORWARD, 10.0 - age)
    assert driver(mux, 10.0) == (active or "")


def test_timeouts_are_each_sources_own() -> None:
    mux = VelocityMux(VelocityMuxParameters(teleop_timeout_s=0.2, navigation_timeout_s=1.0), P3DX)
    tell(mux, "teleop", FORWARD, 0.0)
    tell(mux, "navigation", BACK, 0.0)
    assert driver(mux, 0.1) == "teleop"
    assert driver(mux, 0.3) == "navigation"


def test_nothing_moves_at_startup() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    assert run(mux, 100.0, 1.0) == Twist2D()
    tell(mux, "navigation", FORWARD, 101.0)
    assert mux.step(101.0).twist.v == 0.0 or mux.step(101.0).twist.v <= P3DX.max_acceleration_mps2 * PARAMS.max_period_s


def test_a_command_is_reached_and_left_at_the_allowed_rates() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    for i in range(1, 41):
        tell(mux, "teleop", FORWARD, 0.05 * i)
        output = mux.step(0.05 * i).twist
        assert output.v == pytest.approx(min(0.4, P3DX.max_acceleration_mps2 * 0.05 * i))
    for i in range(1, 11):  # still fresh
        output = mux.step(2.0 + 0.0499 * i).twist
        assert output.v == pytest.approx(0.4)
    speeds = [mux.step(2.5 + 0.05 * i).twist.v for i in range(10)]
    braking = PARAMS.deceleration_factor * P3DX.max_acceleration_mps2 * 0.05
    assert speeds[-1] == 0.0
    assert speeds[1] == pytest.approx(speeds[0] - braking)


def test_reversing_passes_through_a_stand() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    for i in range(1, 41):
        tell(mux, "teleop", FORWARD, 0.05 * i)
        mux.step(0.05 * i)
    speeds = []
    for i in range(41, 81):
        tell(mux, "teleop", BACK, 0.05 * i)
        speeds.append(mux.step(0.05 * i).twist.v)
    assert 0.0 in speeds
    assert speeds[-1] == pytest.approx(BACK.v)


@pytest.mark.parametrize("bad", [Twist2D(math.nan, 0.0), Twist2D(0.0, math.inf)])
def test_a_senseless_command_is_refused_counted_and_ends_the_one_before(bad: Twist2D) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    tell(mux, "servoing", FORWARD, 0.0)
    tell(mux, "servoing", bad, 0.1)
    health = mux.step(0.1).health
    assert health.level is Level.ERROR
    assert health.counters == {"active": "", "refused_servoing": 1}


def test_time_that_jumps_back_stops_the_robot_and_then_works_on() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(99.9)
    tell(mux, "navigation", FORWARD, 100.0)
    assert mux.step(100.0).twist.v > 0.0
    before = mux.step(100.1).twist.v
    outputs = mux.step(5.0)
    assert outputs.twist.v <= before
    assert outputs.health.counters["active"] == ""
    assert run(mux, 5.0, 1.0) == Twist2D()
    tell(mux, "navigation", FORWARD, 6.05)
    assert mux.step(6.05).twist.v > 0.0
    # The command of before the jump does not come back when its time does.
    assert run(mux, 6.1, 1.0) == Twist2D()
    assert driver(mux, 100.05) == ""


def test_a_long_pause_allows_no_leap() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    tell(mux, "teleop", Twist2D(1.0, 0.0), 60.0)
    assert mux.step(60.0).twist.v <= P3DX.max_acceleration_mps2 * PARAMS.max_period_s + 1e-12


def spoken(mux: VelocityMux, until: float, commands: Iterable[tuple[float, Twist2D]], start: float) -> list[float]:
    """When it speaks from ``start`` to ``until`` in s, as a host steps it, if navigation says these."""
    said, waiting, now = [], deque(commands), start
    while now <= until:
        while waiting and waiting[0][0] <= now:
            tell(mux, "navigation", waiting.popleft()[1], now)
        if mux.next_due(now) <= now:
            mux.step(now)
            said.append(now)
        now = min(max(mux.next_due(now), np.nextafter(now, np.inf)), waiting[0][0] if waiting else math.inf)
    return said


@given(st.lists(st.floats(0.01, 0.3), min_size=1, max_size=40))
def test_while_it_drives_it_is_silent_for_a_period_at_most(gaps: list[float]) -> None:
    commands = list(itertools.accumulate(gaps, initial=1000.0))
    end = commands[-1] + PARAMS.navigation_timeout_s  # until then navigation drives
    said = spoken(VelocityMux(PARAMS, P3DX), end, [(now, FORWARD) for now in commands], 999.95)
    assert set(commands) <= set(said)  # each at once
    assert max(np.diff([*said, end])) <= PARAMS.period_s + 1e-9


def test_commands_at_10_hz_are_all_it_says() -> None:
    commands = (1000.0 + 0.1 * np.arange(100)).tolist()
    assert spoken(VelocityMux(PARAMS, P3DX), 1009.95, [(now, FORWARD) for now in commands], 1000.0) == commands


def test_at_rest_it_speaks_once_a_second() -> None:
    said = spoken(VelocityMux(PARAMS, P3DX), 20.0, [], 0.0)
    assert said[0] == 0.0
    assert np.diff(said) == pytest.approx(PARAMS.rest_period_s)


def test_a_command_ends_the_rest_at_once_and_braking_is_told_at_each_period() -> None:
    commands = [(102.34 + 0.1 * i, FORWARD) for i in range(11)]  # until 103.34
    said = np.array(spoken(VelocityMux(PARAMS, P3DX), 110.0, commands, 100.0))
    assert said[:3] == pytest.approx([100.0, 101.0, 102.0])
    assert said[3] == commands[0][0]
    assert max(np.diff(said[(said > 103.3) & (said < 104.0)])) <= PARAMS.period_s + 1e-9
    assert np.diff(said[said > 104.5]) == pytest.approx(PARAMS.rest_period_s)


@pytest.mark.parametrize("drives", [False, True])
def test_after_time_has_jumped_back_it_speaks_at_once(drives: bool) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    spoken(mux, 101.9, [(101.88, FORWARD)] if drives else [], 100.0)
    assert mux.next_due(5.0) <= 5.0
    mux.step(5.0)
    assert np.diff(spoken(mux, 17.0, [], 7.0)) == pytest.approx(PARAMS.rest_period_s)


def status(mode: str) -> Status:
    goal = GoalCommand("g", 1.0, 0.0, 0.0)
    statuses = {
        "free": Status(0.0, "p3dx"),
        "guided": Status(0.0, "p3dx", role="driver", state="navigating", goal=goal),
        "off": Status(0.0, "p3dx", role="hitchhiker", state="riding"),
    }
    assert statuses[mode].teleop_mode == mode
    return statuses[mode]


@pytest.mark.parametrize(("mode", "active"), [("free", "teleop"), ("guided", ""), ("off", "")])
def test_a_human_drives_the_base_where_the_status_lets_him(mode: str, active: str) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.order(status(mode), 10.0)
    mux.step(10.0)
    tell(mux, "teleop", FORWARD, 10.1)
    assert driver(mux, 10.2) == active


@pytest.mark.parametrize(
    ("mode", "twist", "active"),
    [
        ("free", FORWARD, "teleop"),
        ("free", Twist2D(), "teleop"),
        ("guided", FORWARD, "navigation"),
        ("guided", Twist2D(), "navigation"),  # which stops gently when somebody rides
        ("off", FORWARD, "navigation"),
        ("off", Twist2D(), "teleop"),
    ],
)
def test_the_base_hears_the_human_where_the_protocol_allows_it(mode: str, twist: Twist2D, active: str) -> None:
    mux = VelocityMux(PARAMS, P3DX)
    tell(mux, "teleop", twist, 0.0)
    tell(mux, "navigation", TURN, 0.0)
    mux.order(status(mode), 0.0)
    assert driver(mux, 0.0) == active


def test_a_command_of_before_a_ride_ends_with_the_freedom() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.step(0.0)
    tell(mux, "teleop", FORWARD, 0.1)
    assert mux.step(0.1).twist.v > 0.0
    mux.order(status("off"), 0.15)
    before = mux.step(0.15)
    assert before.health.counters["active"] == ""
    assert mux.step(0.3).twist.v <= before.twist.v


def test_a_key_that_is_still_held_at_the_goal_does_not_drive_on() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.order(status("guided"), 0.0)
    tell(mux, "teleop", FORWARD, 0.0)
    mux.order(status("free"), 0.0)  # the robot is at its goal, and the human has not seen it yet
    for now in (0.1, 0.2):
        tell(mux, "teleop", FORWARD, now)
        assert driver(mux, now) == ""
    tell(mux, "teleop", FORWARD, 0.8)  # let go and pressed again
    assert driver(mux, 0.8) == "teleop"


def test_a_stop_lets_go_too() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.order(status("guided"), 0.0)
    tell(mux, "teleop", FORWARD, 0.0)
    mux.order(status("free"), 0.0)
    tell(mux, "teleop", Twist2D(), 0.1)
    tell(mux, "teleop", FORWARD, 0.2)
    assert driver(mux, 0.2) == "teleop"


def test_an_order_that_is_not_repeated_leaves_the_base_to_the_human() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    mux.order(status("off"), 10.0)
    tell(mux, "teleop", FORWARD, 9.9 + ORDER_MAX_AGE_S)
    assert driver(mux, 9.9 + ORDER_MAX_AGE_S) == ""
    tell(mux, "teleop", Twist2D(), 10.5 + ORDER_MAX_AGE_S)
    tell(mux, "teleop", FORWARD, 10.6 + ORDER_MAX_AGE_S)
    assert driver(mux, 10.6 + ORDER_MAX_AGE_S) == "teleop"


def test_a_message_that_could_not_be_read_ends_the_command_before_it() -> None:
    mux = VelocityMux(PARAMS, P3DX)
    tell(mux, "navigation", FORWARD, 1.0)
    mux.sense(Refused(NavigationCommand, "too short", "/x"), 1.1)
    outputs = mux.step(1.1)
    assert outputs.health == Health(
        Level.ERROR, "commands of navigation are not finite", {"active": "", "refused_navigation": 1}
    )


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
    before, newest = mux.step(now).twist, dict.fromkeys(SOURCES, -math.inf)
    for dt, command in events:
        now += dt
        if command is not None:
            source, twist = command
            tell(mux, source, twist, now)
            newest[source] = now if twist.is_finite() else -math.inf
        outputs = mux.step(now)
        output, active = outputs.twist, outputs.health.counters["active"]
        period = min(max(dt, 0.0), PARAMS.max_period_s) * PARAMS.deceleration_factor + 1e-9
        assert abs(output.v) <= P3DX.max_speed_mps
        assert abs(output.omega) <= P3DX.max_yaw_rate_rps
        assert abs(output.v - before.v) <= P3DX.max_acceleration_mps2 * period
        assert abs(output.omega - before.omega) <= P3DX.max_yaw_acceleration_rps2 * period
        if not active:
            assert abs(output.v) <= abs(before.v)
            assert abs(output.omega) <= abs(before.omega)
        else:
            assert 0.0 <= now - newest[active] < 0.5
        before = output
