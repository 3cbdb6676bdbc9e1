"""Times as ROS carries them."""

from __future__ import annotations

import math

import pytest
import rospy
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.stamps import carried, split


@given(st.floats(0.0, 4e9))
def test_a_carried_time_is_what_a_message_says_and_stays_so(seconds: float) -> None:
    once = carried(seconds)
    assert abs(once - seconds) <= max(0.5e-9, math.ulp(seconds)) * 1.001
    assert rospy.Time(*split(seconds)).to_sec() == once
    assert carried(once) == once


@pytest.mark.parametrize(
    ("seconds", "parts"),
    [(0.0, (0, 0)), (0.9999999996, (1, 0)), (2.5, (2, 500_000_000)), (1452189953.25, (1452189953, 250_000_000))],
)
def test_whole_seconds_and_nanoseconds(seconds: float, parts: tuple[int, int]) -> None:
    assert split(seconds) == parts


@given(st.integers(0, 10**8), st.sampled_from([60, 240, 1000]))
def test_steps_of_a_clock_are_apart_and_in_order(step: int, rate: int) -> None:
    assert carried((step + 1) / rate) - carried(step / rate) == pytest.approx(1.0 / rate, abs=2e-8)
