"""Keys and joystick: what they make of the robot, and that it stops when nobody is there."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.control.teleop import Key, KeyReader, Teleop, TeleopParameters
from hitchhike_ros.core.datatypes import Twist2D

PARAMS = TeleopParameters()
V, W = PARAMS.speed_mps, PARAMS.yaw_rate_rps
AHEAD = {"axes": [0.0, 1.0], "buttons": [0, 0, 0, 0, 1]}
KEYS: tuple[Key, ...] = get_args(Key)


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b"w", ["forward"]),
        (b"WaSd", ["forward", "left", "back", "right"]),
        (b" e+=q-x", ["stop", "faster", "faster", "faster", "slower", "slower", "release"]),
        (b"\x1b[A\x1b[B\x1b[C\x1b[D", ["forward", "back", "right", "left"]),
        (b"\x1bOA", ["forward"]),  # a terminal in application mode
        (b"\x04", ["quit"]),
        (b"jk\xff\x00", []),
        (b"\x1b[1;2Aw", ["forward"]),  # Shift and an arrow is none of ours, nor is its last letter
        (b"\x1b[15~w", ["forward"]),  # F5
        (b"\x1bw", ["forward"]),
    ],
)
def test_keys_are_read(data: bytes, keys: list[str]) -> None:
    assert KeyReader().feed(data) == keys


pieces = st.lists(
    st.sampled_from([b"w", b"a", b" ", b"\x1b[A", b"\x1bOD", b"\x1b[1;2A", b"z", b"\x1b[15~"]), max_size=9
)


@given(pieces, st.lists(st.integers(0, 40)))
def test_it_does_not_matter_where_bytes_come_apart(sent: list[bytes], cuts: list[int]) -> None:
    data = b"".join(sent)
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    reader = KeyReader()
    apart = [key for i in range(len(edges) - 1) for key in reader.feed(data[edges[i] : edges[i + 1]])]
    assert apart == KeyReader().feed(data)


@given(st.lists(st.binary(max_size=40)))
def test_no_bytes_are_too_odd(data: list[bytes]) -> None:
    reader = KeyReader()
    for piece in data:
        assert set(reader.feed(piece)) <= set(KEYS)
    reader.feed(b"~~")  # whatever was pending ends
    assert "forward" in reader.feed(b"ww")


@pytest.mark.parametrize(
    ("keys", "twist"),
    [
        (["forward"], Twist2D(V, 0.0)),
        (["back"], Twist2D(-V, 0.0)),
        (["left"], Twist2D(0.0, W)),
        (["right"], Twist2D(0.0, -W)),
        (["forward", "left"], Twist2D(V, W)),
        (["back", "right"], Twist2D(-V, -W)),
        (["forward", "left", "right"], Twist2D(V, -W)),
        (["forward", "left", "forward"], Twist2D(V, 0.0)),
        (["forward", "stop"], Twist2D()),
        (["forward", "stop", "left"], Twist2D(0.0, W)),
        (["forward", "faster"], Twist2D(V + 0.1, 0.0)),
        (["slower", "left"], Twist2D(0.0, W * (V - 0.1) / V)),
        (["forward", "release"], None),
        (["faster"], None),
        ([], None),
    ],
)
def test_what_keys_mean(keys: list[Key], twist: Twist2D | None) -> None:
    teleop = Teleop(PARAMS)
    for key in keys:
        teleop.press(key, 10.0)
    said = teleop.step(10.0)
    assert (said is None) == (twist is None)
    if said is not None and twist is not None:
        assert (said.v, said.omega) == pytest.approx((twist.v, twist.omega))


def test_the_dead_man_stops_and_falls_silent() -> None:
    teleop = Teleop(PARAMS)
    teleop.press("forward", 0.0)
    assert teleop.step(PARAMS.dead_man_s - 0.01) == Twist2D(V, 0.0)
    over = PARAMS.dead_man_s + 0.01
    assert teleop.step(over) == Twist2D()
    assert teleop.step(over + PARAMS.stop_s - 0.01) == Twist2D()
    assert teleop.step(over + PARAMS.stop_s + 0.01) is None
    assert teleop.taken  # silence does not give it back
    teleop.press("left", over + 10.0)
    assert teleop.step(over + 10.0) == Twist2D(0.0, W), "what it did before is over"


def test_a_key_that_is_held_goes_on() -> None:
    teleop = Teleop(PARAMS)
    for now in (0.0, 0.66, 1.3, 1.9):
        teleop.press("forward", now)
        assert teleop.step(now + 0.6) == Twist2D(V, 0.0)


def test_speed_stays_in_its_range() -> None:
    teleop = Teleop(PARAMS)
    for _ in range(30):
        teleop.press("faster", 0.0)
    assert (teleop.speed_mps, teleop.yaw_rate_rps) == (PARAMS.max_speed_mps, PARAMS.max_yaw_rate_rps)
    for _ in range(30):
        teleop.press("slower", 0.0)
    assert teleop.speed_mps == PARAMS.min_speed_mps


def test_only_what_moves_or_stops_takes_the_robot() -> None:
    for key in KEYS:
        teleop = Teleop(PARAMS)
        teleop.press(key, 0.0)
        assert teleop.taken == (key in ("forward", "back", "left", "right", "stop")), key


def test_a_joystick_drives_while_its_button_is_held() -> None:
    teleop = Teleop(PARAMS)
    assert teleop.joy([0.5, 1.0], [0, 0, 0, 0, 0], 0.0)
    assert (teleop.step(0.0), teleop.taken) == (None, False)
    assert teleop.joy([0.5, 1.0], [0, 0, 0, 0, 1], 0.1)
    assert teleop.step(0.1) == Twist2D(V, 0.5 * W)
    assert teleop.joy([0.5, 1.0], [0, 0, 0, 0, 0], 0.2)
    assert teleop.step(0.2) == Twist2D()
    assert teleop.step(0.3 + PARAMS.stop_s) is None


def test_a_joystick_that_is_silent_stops_the_robot() -> None:
    teleop = Teleop(PARAMS)
    teleop.joy(**AHEAD, now=0.0)
    assert teleop.step(PARAMS.joy_dead_man_s + 0.01) == Twist2D()


def test_a_joystick_that_lies_idle_does_not_disturb_the_keys() -> None:
    teleop = Teleop(PARAMS)
    teleop.press("forward", 0.0)
    assert teleop.joy([0.0, 0.0], [0] * 5, 0.1)
    assert teleop.step(0.1) == Twist2D(V, 0.0)


@pytest.mark.parametrize(
    ("axes", "buttons"),
    [([], []), ([0.0], [0] * 5), ([0.0, 1.0], [1] * 4), ([0.0, math.nan], [1] * 5), ([math.inf, 0.0], [1] * 5)],
)
def test_a_senseless_joystick_is_refused(axes: list[float], buttons: list[int]) -> None:
    teleop = Teleop(PARAMS)
    assert not teleop.joy(axes, buttons, 0.0)
    assert teleop.step(0.0) is None


def test_a_stick_near_its_middle_is_in_the_middle() -> None:
    teleop = Teleop(replace(PARAMS, joy_dead_zone=0.1))
    teleop.joy([0.1, 0.5], [1] * 5, 0.0)
    assert teleop.step(0.0) == Twist2D(0.5 * V, 0.0)


def test_time_that_jumps_back_stops() -> None:
    teleop = Teleop(PARAMS)
    teleop.press("forward", 100.0)
    teleop.step(100.0)
    assert teleop.step(5.0) == Twist2D()
    assert teleop.step(5.1 + PARAMS.stop_s) is None
    assert teleop.step(100.1) is None


number = st.floats(-2.0, 2.0) | st.sampled_from([math.nan, math.inf])
inputs = st.lists(
    st.tuples(
        st.floats(-0.3, 1.5),
        st.none() | st.sampled_from(KEYS) | st.tuples(st.lists(number, max_size=3), st.lists(st.integers(0, 1))),
    ),
    max_size=40,
)


@given(inputs)
def test_it_is_always_within_its_speeds_and_nothing_outlasts_the_human(events: list) -> None:
    teleop, now, heard = Teleop(PARAMS), 20.0, -math.inf
    for dt, event in events:
        now += dt
        if isinstance(event, str):
            teleop.press(event, now)
            heard = now
        elif event is not None:
            teleop.joy(*event, now)
            heard = now
        twist = teleop.step(now)
        if twist is None:
            continue
        assert abs(twist.v) <= PARAMS.max_speed_mps
        assert abs(twist.omega) <= PARAMS.max_yaw_rate_rps
        assert teleop.taken
        if twist != Twist2D():
            assert 0.0 <= now - heard < max(PARAMS.dead_man_s, PARAMS.joy_dead_man_s)
    assert teleop.step(now + 10.0) in (None, Twist2D())
    assert teleop.step(now + 20.0) is None
