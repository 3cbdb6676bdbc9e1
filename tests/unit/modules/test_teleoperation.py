"""When a robot is told what, and when it is told that it is in hand; what the screen says."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.control.teleop import Key, TeleopParameters
from hitchhike_ros.core.datatypes import Twist2D
from hitchhike_ros.modules.inputs import Joystick, TeleopActive, TeleopCommand
from hitchhike_ros.modules.module import Level, Refused
from hitchhike_ros.modules.teleoperation import ACTIVE_PERIOD_S, HumanLeaves, KeysPressed, Teleoperation, TeleopOutputs
from hitchhike_ros.protocol.status import GoalCommand, Status

PARAMS = TeleopParameters()
AHEAD, STAND = Twist2D(PARAMS.speed_mps, 0.0), Twist2D()
HALF_LEFT = Joystick((0.5, 1.0), (0, 0, 0, 0, 1))
GOAL = GoalCommand("1", 5.0, 0.0, 0.0)


def teleop(params: TeleopParameters = PARAMS) -> Teleoperation:
    return Teleoperation(params, "/p3dx/hhike_msg/status")


def press(module: Teleoperation, now: float, *keys: Key) -> TeleopOutputs:
    module.sense(KeysPressed(keys), now)
    return module.step(now)


def run(module: Teleoperation, begin: float, end: float, look_s: float = 0.02) -> list[tuple[float, TeleopOutputs]]:
    """As the node does: it looks every ``look_s``, and steps when something is due."""
    said = []
    for k in range(round((end - begin) / look_s)):
        now = begin + k * look_s
        while module.next_due(now) <= now:
            said.append((now, module.step(now)))
    return said


def commands(said: list[tuple[float, TeleopOutputs]]) -> list[tuple[float, Twist2D]]:
    return [(now, outputs.command.twist) for now, outputs in said if outputs.command is not None]


def active(said: list[tuple[float, TeleopOutputs]]) -> list[tuple[float, bool]]:
    return [(now, outputs.active.active) for now, outputs in said if outputs.active is not None]


def test_nothing_is_said_before_a_key() -> None:
    module = teleop()
    said = run(module, 0.0, 3.0)
    assert (commands(said), active(said), len(said)) == ([], [], 1)
    assert module.next_due(3.0) == math.inf


@pytest.mark.parametrize("rate", [2.0, 10.0, 25.0])
def test_a_command_is_repeated_at_the_rate(rate: float) -> None:
    module = teleop(replace(PARAMS, rate=rate, dead_man_s=100.0))
    module.sense(KeysPressed(("forward",)), 50.0)
    said = commands(run(module, 50.0, 60.0))
    assert {twist for _, twist in said} == {AHEAD}
    assert len(said) == pytest.approx(10.0 * rate, abs=1.0)
    for k, (now, _) in enumerate(said):
        assert now == pytest.approx(50.0 + k / rate, abs=0.021)


@pytest.mark.parametrize("tick_s", [0.02, 0.05, 0.1])
def test_a_tick_of_simulated_time_is_in_time(tick_s: float) -> None:
    module = teleop(replace(PARAMS, dead_man_s=100.0))
    module.sense(KeysPressed(("forward",)), 0.0)
    times = [now for now, _ in commands(run(module, 0.0, 20.0, tick_s))]
    assert times == pytest.approx([0.1 * k for k in range(200)])


def test_a_late_command_does_not_bring_two() -> None:
    module = teleop(replace(PARAMS, dead_man_s=100.0))
    press(module, 0.0, "forward")
    assert module.step(0.15).command == TeleopCommand(AHEAD)
    assert module.step(0.19).command is None
    assert module.step(0.2).command == TeleopCommand(AHEAD), "the rate holds on average"
    assert module.step(5.0).command == TeleopCommand(AHEAD)
    assert module.step(5.05).command is None, "what was left out is not made up for"
    assert module.next_due(5.05) == pytest.approx(5.1, abs=0.002)


def test_a_new_command_is_said_at_once() -> None:
    module = teleop()
    assert press(module, 0.0, "forward").command == TeleopCommand(AHEAD)
    assert press(module, 0.02, "forward").command is None
    assert press(module, 0.04, "back").command == TeleopCommand(Twist2D(-AHEAD.v, 0.0))
    assert press(module, 0.05, "stop").command == TeleopCommand(STAND)


def test_a_stand_follows_the_last_key_and_then_silence() -> None:
    module = teleop()
    module.sense(KeysPressed(("forward",)), 0.0)
    said = run(module, 0.0, 5.0)
    over = [now for now, twist in commands(said) if twist == STAND]
    assert over[0] == pytest.approx(PARAMS.dead_man_s, abs=0.021)
    assert over[-1] - over[0] <= PARAMS.stop_s
    assert len(over) == 3
    assert [twist for _, twist in commands(said)] == [AHEAD] * 8 + [STAND] * 3
    assert [value for _, value in active(said)] == [True] * 10, "silence does not give it back"


def test_that_it_is_in_hand_is_repeated_and_ends_once() -> None:
    module = teleop()
    module.sense(KeysPressed(("stop",)), 0.0)
    said = active(run(module, 0.0, 3.0))
    assert {value for _, value in said} == {True}
    assert [now for now, _ in said] == pytest.approx([k * ACTIVE_PERIOD_S for k in range(6)], abs=0.041)
    given_back = press(module, 3.0, "release")
    assert (given_back.active, given_back.command) == (TeleopActive(False), None)
    later = run(module, 3.02, 6.0)
    assert (active(later), commands(later)) == ([], [])
    assert press(module, 7.0, "release").active is None
    assert press(module, 8.0, "left").active == TeleopActive(True)


def test_at_the_end_the_robot_stands_and_is_its_own_again() -> None:
    module = teleop()
    press(module, 0.0, "forward")
    module.sense(HumanLeaves(), 0.01)
    assert module.next_due(0.01) == 0.01
    last = module.step(0.01)
    assert (last.command, last.active) == (TeleopCommand(STAND), TeleopActive(False))
    module.sense(HumanLeaves(), 0.02)
    module.sense(KeysPressed(("forward",)), 0.02)
    module.sense(HALF_LEFT, 0.02)
    said = run(module, 0.02, 2.0)
    assert (commands(said), active(said)) == ([], [])


@pytest.mark.parametrize("before", [(), ("faster",), ("forward", "release")])
def test_who_leaves_without_the_robot_in_hand_says_nothing(before: tuple[Key, ...]) -> None:
    module = teleop()
    press(module, 0.0, *before)
    module.sense(HumanLeaves(), 1.0)
    last = module.step(1.0)
    assert (last.command, last.active) == (None, None)


def test_time_that_jumps_back_stops_the_robot_and_repeats_at_once() -> None:
    module = teleop()
    press(module, 100.0, "forward")
    assert module.next_due(5.0) == 5.0
    jumped = module.step(5.0)
    assert (jumped.command, jumped.active) == (TeleopCommand(STAND), TeleopActive(True))
    said = run(module, 5.02, 8.0)
    assert [twist for _, twist in commands(said)] == [STAND] * 2
    assert [value for _, value in active(said)] == [True] * 5


def test_a_joystick_drives_and_a_senseless_one_is_counted() -> None:
    module = teleop()
    module.sense(HALF_LEFT, 0.0)
    assert module.step(0.0).command == TeleopCommand(Twist2D(PARAMS.speed_mps, 0.5 * PARAMS.yaw_rate_rps))
    module.sense(Joystick((0.5,), ()), 0.1)
    bad = module.step(0.1)
    assert bad.health.level is Level.WARN
    assert "joystick" in bad.health.reason
    assert bad.health.counters == {"bad_joy": 1}
    module.sense(HALF_LEFT, 0.2)
    assert (module.step(0.2).health.level, module.step(0.2).health.counters) == (Level.OK, {"bad_joy": 1})


def test_a_status_that_is_none_is_counted_and_not_shown() -> None:
    module = teleop()
    module.sense(Refused(Status, "hhike_msg/status: no JSON", "/someone"), 0.0)
    outputs = module.step(0.0)
    assert outputs.health.counters == {"bad_status": 1}
    assert outputs.lines[1] == "/p3dx/hhike_msg/status: nothing yet"


@pytest.mark.parametrize(
    ("status", "lines"),
    [
        (None, ("/p3dx/hhike_msg/status: nothing yet", "")),
        (Status(0.0, "p3dx"), ("p3dx: idle", "it has no goal: you drive it directly")),
        (
            Status(
                0.0, "p3dx", "driver", "driving", "Riders move up", goal=GOAL, speed_limit_mps=0.45, convoy=("a", "b")
            ),
            ("p3dx: driving (Riders move up), with a, b, at most 0.45 m/s", "you drive it, within its limits"),
        ),
        (
            Status(0.0, "p3dx", "driver", "aligning", goal=GOAL),
            ("p3dx: aligning", "it acts by itself: only space works"),
        ),
        (
            Status(0.0, "p3dx", "driver", "waiting_for_rider", speed_limit_mps=0.45),
            ("p3dx: waiting_for_rider", "it acts by itself: only space works"),
        ),
    ],
)
def test_the_screen_says_what_the_robot_does(status: Status | None, lines: tuple[str, str]) -> None:
    module = teleop()
    module.step(0.0)
    if status is not None:
        module.order(status, 0.1)
        assert module.next_due(0.1) == 0.1
    assert module.step(0.1).lines[1:] == lines


def test_the_screen_says_what_the_human_does() -> None:
    module = teleop()
    idle = "speed 0.5 m/s, 0.50 rad/s   not in your hand   says: nothing"
    assert module.step(0.0).lines[0] == idle
    slow = "speed 0.4 m/s, 0.40 rad/s   in your hand (keys)   says: +0.40 m/s +0.00 rad/s"
    assert press(module, 0.0, "slower", "forward").lines[0] == slow
    silent = run(module, 0.02, 3.0)[-1][1]
    assert silent.lines[0] == "speed 0.4 m/s, 0.40 rad/s   in your hand (no key)   says: nothing"
    module.sense(HALF_LEFT, 3.0)
    assert "in your hand (joystick)   says: +0.40 m/s +0.20 rad/s" in module.step(3.0).lines[0]


def test_it_takes_the_joystick_from_a_topic_and_keys_from_its_node() -> None:
    assert teleop().listens() == {Joystick}
    assert Teleoperation.inputs == {Joystick, KeysPressed, HumanLeaves}


events = st.lists(
    st.tuples(
        st.floats(-0.3, 1.5),
        st.none()
        | st.sampled_from(get_args(Key)).map(lambda key: KeysPressed((key,)))
        | st.just(HALF_LEFT)
        | st.just(Joystick((0.0, 0.0), (0,) * 5)),
    ),
    max_size=40,
)


@given(events, st.sampled_from([0.1, 10.0, 100.0]), st.sampled_from([0.0, 1.8e9]))
def test_it_comes_to_rest_and_says_true_before_every_false(
    inputs: list[tuple[float, object]], rate: float, start: float
) -> None:
    module, now, taken = teleop(replace(PARAMS, rate=rate)), start, False
    for dt, x in [*inputs, (0.1, HumanLeaves()), (0.1, None)]:
        now += dt
        if x is not None:
            module.sense(x, now)
        steps = 0
        while module.next_due(now) <= now:
            outputs = module.step(now)
            steps += 1
            assert steps == 1, "a step leaves nothing due"
            if outputs.active is not None:
                assert outputs.active.active or taken
                taken = outputs.active.active
            assert outputs.command is None or taken or outputs.command.twist == STAND
    assert not taken
    assert module.next_due(now) == math.inf
