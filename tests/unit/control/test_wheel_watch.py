"""A robot that is told to move and does not."""

from __future__ import annotations

import pytest

from hitchhike_ros.control.wheel_watch import STANDING, WheelWatch
from hitchhike_ros.core.datatypes import Twist2D

STILL = Twist2D()
TENTHS = [0.1 * k for k in range(31)]


def problems(command: Twist2D, twist: Twist2D) -> list[str]:
    watch = WheelWatch()
    return [watch.problem(now, command, twist) for now in TENTHS]


@pytest.mark.parametrize("command", [Twist2D(0.3), Twist2D(-0.1), Twist2D(0.0, 0.5), Twist2D(0.05, -0.1)])
@pytest.mark.parametrize("twist", [STILL, Twist2D(0.004, -0.009)])
def test_wheels_that_stand_against_the_command_are_noticed_within_a_second(command: Twist2D, twist: Twist2D) -> None:
    said = problems(command, twist)
    assert said[:10] == [""] * 10
    assert said[10:] == [STANDING] * 21


@pytest.mark.parametrize(
    ("command", "twist"),
    [
        (STILL, STILL),
        (Twist2D(0.04, 0.09), STILL),
        (Twist2D(0.3), Twist2D(0.01)),
        (Twist2D(0.3), Twist2D(0.0, 0.02)),
        (Twist2D(0.0, 0.5), Twist2D(0.0, 0.1)),
    ],
)
def test_a_robot_that_is_to_stand_or_moves_at_all_has_no_problem(command: Twist2D, twist: Twist2D) -> None:
    assert set(problems(command, twist)) == {""}


def test_a_stand_on_the_way_counts_anew() -> None:
    watch = WheelWatch()
    assert watch.problem(0.0, Twist2D(0.3), STILL) == ""
    assert watch.problem(0.9, STILL, STILL) == ""
    assert watch.problem(1.0, Twist2D(0.3), STILL) == ""
    assert watch.problem(1.9, Twist2D(0.3), STILL) == ""
    watch.clear()
    assert watch.problem(2.1, Twist2D(0.3), STILL) == ""
    assert watch.problem(3.1, Twist2D(0.3), STILL) == STANDING


def test_a_clock_that_goes_back_does_not_make_the_wait_longer() -> None:
    watch = WheelWatch()
    watch.problem(500.0, Twist2D(0.3), STILL)
    assert watch.problem(100.0, Twist2D(0.3), STILL) == ""
    assert watch.problem(101.0, Twist2D(0.3), STILL) == STANDING
