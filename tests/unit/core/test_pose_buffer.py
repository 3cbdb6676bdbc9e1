"""Poses between, and just beyond, the readings of a robot that drives; and which readings are refused."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import compose, distance, move, wrap_angle
from hitchhike_ros.core.pose_buffer import PoseBuffer, PoseBufferParameters

PARAMS = PoseBufferParameters()
STARTS = st.builds(Pose2D, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
TWISTS = st.builds(Twist2D, st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))


def driven(
    start: Pose2D, twist: Twist2D, began: float = 10.0, readings: int = 21, period_s: float = 0.05
) -> PoseBuffer:
    """Readings of a robot at a constant twist since ``began``."""
    buffer = PoseBuffer()
    for k in range(readings):
        buffer.add(Odometry(began + period_s * k, move(start, twist, period_s * k), twist))
    return buffer


def assert_same_pose(a: Pose2D, b: Pose2D, tolerance: float = 1e-9) -> None:
    assert distance(a, b) < tolerance
    assert abs(wrap_angle(a.theta - b.theta)) < tolerance


@given(STARTS, TWISTS, st.floats(-0.2, 1.2))
def test_the_pose_of_a_robot_at_constant_twist(start: Pose2D, twist: Twist2D, after_s: float) -> None:
    buffer = driven(start, twist)
    assert buffer.covers(10.0 + after_s)
    assert_same_pose(buffer.at(10.0 + after_s), move(start, twist, after_s))


@given(STARTS, TWISTS, st.floats(0.0, 1.2), st.floats(0.0, 1.2))
def test_motion_is_the_way_from_one_time_to_another(start: Pose2D, twist: Twist2D, since: float, until: float) -> None:
    moved = driven(start, twist).motion(10.0 + since, 10.0 + until)
    assert_same_pose(moved, move(Pose2D(), twist, until - since))
    assert_same_pose(compose(move(start, twist, since), moved), move(start, twist, until))


@given(st.lists(st.builds(Pose2D, st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.4, 0.4)), min_size=2))
def test_each_reading_is_the_pose_at_its_stamp_and_nothing_jumps_between(poses: list[Pose2D]) -> None:
    """Also where a pose slides sideways, as that of a robot that corrects itself."""
    buffer = PoseBuffer(PoseBufferParameters(history_s=1e3))
    for k, pose in enumerate(poses):
        buffer.add(Odometry(0.1 * k, pose, Twist2D()))
    for k, (before, after) in enumerate(itertools.pairwise(poses)):
        assert_same_pose(buffer.at(0.1 * k), before)
        assert_same_pose(buffer.at(0.1 * (k + 1) - 1e-9), after, tolerance=1e-6)


@given(st.lists(st.tuples(st.floats(0.01, 0.3), TWISTS), min_size=1, max_size=20))
def test_a_filter_that_adds_up_what_is_returned_comes_to_the_same_place(steps: list[tuple[float, Twist2D]]) -> None:
    buffer, pose, stamp, counted = PoseBuffer(), Pose2D(), 0.0, Pose2D()
    assert buffer.add(Odometry(stamp, pose, Twist2D())) is None
    for dt_s, twist in steps:
        pose, stamp = move(pose, twist, dt_s), stamp + dt_s
        moved = buffer.add(Odometry(stamp, pose, twist))
        assert moved is not None
        counted = move(counted, *moved)
    assert_same_pose(counted, pose, tolerance=1e-6)


def test_another_reading_with_the_same_stamp_is_left_out_and_no_motion_is_lost() -> None:
    buffer = PoseBuffer()
    buffer.add(Odometry(1.0, Pose2D(0.0), Twist2D(0.5)))
    assert buffer.add(Odometry(1.0, Pose2D(0.02), Twist2D(0.5))) is None
    assert buffer.newest.pose == Pose2D(0.0)
    assert buffer.add(Odometry(1.1, Pose2D(0.05), Twist2D(0.5))) == (
        Twist2D(pytest.approx(0.5), 0.0),  # type: ignore[arg-type]
        pytest.approx(0.1),
    )


@pytest.mark.parametrize("stamp", [9.79, 11.21, math.nan, math.inf])
def test_too_old_and_too_new_is_refused(stamp: float) -> None:
    buffer = driven(Pose2D(), Twist2D(0.5))
    assert not buffer.covers(stamp)
    with pytest.raises(SensorDataError, match=r"^scan at .* s, but odometry from 10.00 s to 11.00 s$"):
        buffer.at(stamp, "scan")


def test_what_is_older_than_the_history_is_forgotten() -> None:
    buffer = driven(Pose2D(), Twist2D(0.5), readings=61)
    assert (buffer.oldest.stamp, buffer.newest.stamp) == (pytest.approx(11.0), pytest.approx(13.0))
    assert not buffer.covers(10.7)
    assert buffer.covers(10.9)


def test_without_readings_nothing_is_known() -> None:
    buffer = PoseBuffer()
    assert not buffer
    assert not buffer.covers(0.0)
    with pytest.raises(SensorDataError, match=r"^no odometry yet for the image at 0.00 s$"):
        buffer.at(0.0, "image")
    buffer = driven(Pose2D(), Twist2D())
    assert buffer
    buffer.clear()
    assert not buffer


@pytest.mark.parametrize(
    "reading",
    [
        Odometry(math.nan, Pose2D(), Twist2D()),
        Odometry(1.1, Pose2D(math.nan), Twist2D()),
        Odometry(1.1, Pose2D(), Twist2D(0.0, math.inf)),
    ],
)
def test_a_reading_that_is_not_finite_changes_nothing(reading: Odometry) -> None:
    buffer = driven(Pose2D(), Twist2D(0.5), began=0.0)
    before = buffer.newest
    with pytest.raises(SensorDataError, match="not finite"):
        buffer.add(reading)
    assert buffer.newest == before
    assert buffer.covers(0.5)


@pytest.mark.parametrize(
    ("reading", "word"),
    [
        (Odometry(0.9, Pose2D(0.45), Twist2D(0.5)), "odometry went back in time from 1.00 s to 0.90 s"),
        (Odometry(1.1, Pose2D(0.81), Twist2D(0.5)), r"odometry jumped to \(0.81, 0.00, 0.00\) within 0.10 s"),
        (Odometry(1.1, Pose2D(0.5, -0.31), Twist2D(0.5)), "jumped"),
        (Odometry(1.1, Pose2D(0.5, 0.0, -1.01), Twist2D(0.5)), "jumped"),
    ],
)
def test_after_a_jump_everything_counts_from_there(reading: Odometry, word: str) -> None:
    buffer = driven(Pose2D(), Twist2D(0.5), began=0.0)
    with pytest.raises(SensorDataError, match=word):
        buffer.add(reading)
    assert (buffer.oldest, buffer.newest) == (reading, reading)
    moved = buffer.add(Odometry(reading.stamp + 0.1, compose(reading.pose, Pose2D(0.05)), Twist2D(0.5)))
    assert moved is not None
    assert moved[0].v == pytest.approx(0.5)


@pytest.mark.parametrize("pose", [Pose2D(0.79), Pose2D(0.5, 0.29), Pose2D(0.5, 0.0, 0.99)])
def test_as_fast_as_a_robot_may_be_is_no_jump(pose: Pose2D) -> None:
    buffer = driven(Pose2D(), Twist2D(0.5), began=0.0)
    assert buffer.add(Odometry(1.1, pose, Twist2D())) is not None


def test_beyond_its_ends_the_pose_moves_on_at_their_twists() -> None:
    buffer = PoseBuffer()
    buffer.add(Odometry(1.0, Pose2D(), Twist2D(1.0)))
    buffer.add(Odometry(2.0, Pose2D(0.5), Twist2D(0.2, 0.3)))
    assert buffer.at(0.9) == Pose2D(pytest.approx(-0.1))  # type: ignore[arg-type]
    assert buffer.at(2.0) == Pose2D(0.5)
    assert_same_pose(buffer.at(2.1), move(Pose2D(0.5), Twist2D(0.2, 0.3), 0.1))


MOVES = Twist2D(0.5, 0.4)


def twists(told: list[Twist2D], dt_s: float = 0.1, moves: Twist2D = MOVES) -> list[Twist2D]:
    """What is kept of readings that tell ``told`` while the robot moves at ``moves``."""
    buffer, pose, kept = PoseBuffer(), Pose2D(), []
    for k, twist in enumerate(told):
        buffer.add(Odometry(k * dt_s, pose, twist))
        kept.append(buffer.newest.twist)
        pose = move(pose, moves, dt_s)
    return kept


@pytest.mark.parametrize(
    "told", [Twist2D(), Twist2D(0.5, 0.0), Twist2D(0.0, 0.4)], ids=["no twist", "no yaw rate", "no speed"]
)
@pytest.mark.parametrize("dt_s", [0.02, 0.1])
def test_a_twist_that_a_driver_leaves_out_is_that_of_the_poses(told: Twist2D, dt_s: float) -> None:
    kept = twists([told] * 8, dt_s)
    assert kept[:3] == [told] * 3, "a robot that stops tells 0 once while its pose has moved"
    for twist in kept[3:]:
        assert (twist.v, twist.omega) == pytest.approx((0.5, 0.4), rel=1e-3)


def test_a_robot_that_stops_is_believed() -> None:
    moving, stopped = Twist2D(0.5, 0.0), Twist2D()
    told = [moving, moving, stopped, moving, stopped, stopped, moving]
    assert twists(told, moves=moving) == told


def test_poses_that_hardly_move_are_of_a_robot_that_stands() -> None:
    assert twists([Twist2D()] * 20, moves=Twist2D(0.015, -0.015)) == [Twist2D()] * 20


def test_a_driver_that_tells_a_twist_after_all_is_believed_again() -> None:
    buffer = PoseBuffer()
    for k in range(6):
        buffer.add(Odometry(0.1 * k, Pose2D(0.05 * k), Twist2D()))
    assert buffer.twistless
    buffer.clear()
    assert buffer.twistless, "it is about the driver, not about its readings"
    buffer.add(Odometry(1.0, Pose2D(), Twist2D()))
    buffer.add(Odometry(1.1, Pose2D(0.05), Twist2D(0.4, 0.0)))
    assert not buffer.twistless
    assert buffer.newest.twist == Twist2D(0.4, 0.0)
