"""Lines that change in place."""

from __future__ import annotations

from hitchhike_ros.control.teleop_screen import Screen

LINES = ["speed 0.5 m/s", "p3dx: idle"]


def test_the_first_lines_are_drawn_at_once_below_what_is_there() -> None:
    assert Screen(0.2).draw(LINES, 80, 0.0) == "\r\x1b[Kspeed 0.5 m/s\n\r\x1b[Kp3dx: idle\n"


def test_lines_that_are_the_same_are_not_drawn_again() -> None:
    screen = Screen(0.2)
    screen.draw(LINES, 80, 0.0)
    assert screen.draw(LINES, 80, 10.0) == ""


def test_new_lines_are_drawn_over_the_old_when_it_is_time() -> None:
    screen = Screen(0.2)
    screen.draw(LINES, 80, 5.0)
    assert screen.draw(["a", "b"], 80, 5.1) == ""
    assert screen.draw(["a", "c"], 80, 5.25) == "\x1b[2A\r\x1b[Ka\n\r\x1b[Kc\n"
    assert screen.draw(["a", "d"], 80, 5.4) == ""


def test_a_line_never_wraps() -> None:
    assert Screen(0.2).draw(["x" * 30], 10, 0.0) == "\r\x1b[K" + "x" * 9 + "\n"
    assert Screen(0.2).draw(["x" * 100], 0, 0.0) == "\r\x1b[K" + "x" * 79 + "\n"
