"""Which scans of a standing robot are left alone."""

from __future__ import annotations

from hitchhike_ros.core.datatypes import Twist2D
from hitchhike_ros.localization.rest import Rest


def standing(*, has_goal: bool = False) -> Rest:
    """A robot that stands since t = 1, of which no scan has been worked on since."""
    rest = Rest(has_goal=has_goal)
    rest.move(Twist2D(0.4))
    rest.worked(0.9)
    rest.move(Twist2D())
    return rest


def worked_on(rest: Rest, times: list[float], without_pose: tuple[float, ...] = ()) -> list[float]:
    """Of scans at these times those that are worked on; some of them give no pose."""
    found = []
    for time in times:
        if not rest.leaves_out(time):
            found.append(time)
            if time not in without_pose:
                rest.worked(time)
    return found


TENTHS = [round(1.0 + 0.1 * i, 1) for i in range(30)]


def test_the_first_scan_of_a_robot_that_stopped_counts_and_then_one_in_a_while():
    assert worked_on(standing(), TENTHS) == [1.0, 3.4]


def test_a_scan_that_gave_no_pose_is_none():
    assert worked_on(standing(), TENTHS, without_pose=(3.4,)) == [1.0, 3.4, 3.5]


def test_between_them_the_pose_is_told_before_a_second_has_passed():
    rest, told = standing(), []
    for time in TENTHS:
        if not rest.leaves_out(time):
            rest.worked(time)
        elif rest.owes_pose(time):
            rest.told(time)
            told.append(time)
    assert told == [1.8, 2.6]


def test_who_moves_or_has_a_goal_does_not_rest():
    assert worked_on(standing(has_goal=True), TENTHS) == TENTHS
    rest = standing()
    worked_on(rest, TENTHS[:3])
    rest.move(Twist2D(0.0, 0.1))
    assert worked_on(rest, TENTHS[3:6]) == TENTHS[3:6]


def test_a_goal_or_a_new_pose_ends_the_rest():
    rest = standing()
    worked_on(rest, TENTHS[:2])
    rest.wake()
    assert worked_on(rest, TENTHS[2:5]) == [1.2]
    rest.has_goal = True
    assert worked_on(rest, TENTHS[5:7]) == [1.5, 1.6]


def test_a_clock_that_went_back_leaves_nothing_out():
    rest = standing()
    worked_on(rest, TENTHS)
    assert not rest.leaves_out(0.2)
