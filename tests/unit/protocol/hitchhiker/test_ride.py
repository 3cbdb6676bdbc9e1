"""A rider behind its driver: what it sees, what it is told, and where it takes itself to be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import between, compose, distance, inverse, wrap_angle
from hitchhike_ros.localization.ekf import mahalanobis_squared, pose_error
from hitchhike_ros.protocol.events import Situation
from hitchhike_ros.protocol.hitchhiker.ride import Restart, Ride
from hitchhike_ros.protocol.hitchhiker.sightings import Sightings
from hitchhike_ros.protocol.messages import Decouple, Driver, RearMarker, covariance_rows
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from protocol_helpers import BOXES, CAMERA, MARKER_POSE, SIGMA, messages

PARAMS = HitchhikingParameters(
    gap_m=0.8,
    gap_tolerance_m=0.10,
    repeat_period_s=0.5,
    message_timeout_s=5.0,
    ack_timeout_s=1.5,
    ride_speed_mps=0.6,
)
MARKER = RearMarker(marker_id=0, marker_size_m=0.16, marker_pose=MARKER_POSE)
AHEAD = RearMarker(marker_id=7, marker_size_m=0.2, marker_pose=Pose2D(-0.3, 0.1, math.pi))


def _ride(now: float = 0.0, **params: Any) -> Ride:
    return Ride(replace(PARAMS, **params), CAMERA, MARKER, now)


def _view(gap: float | None, now: float, speed: float = 0.0, marker_id: int = 0, **more: Any) -> Situation:
    """The marker straight ahead in an image of ``now``."""
    seen = None
    if gap is not None:
        seen = MarkerObservation(now, marker_id, Pose2D(CAMERA[0] + gap, 0.0, math.pi), np.array(SIGMA))
    return Situation(observation=seen, speed_mps=speed, **more)


def _told(x: float = 3.0, **changes: Any) -> Driver:
    message = replace(messages()[Driver], x=x, **changes)
    assert isinstance(message, Driver)
    return message


# What it sees.


@pytest.mark.parametrize(("age", "in_view"), [(0.0, True), (0.5, True), (0.51, False)])
def test_an_image_counts_for_as_long_as_something_is_repeated(age: float, in_view: bool) -> None:
    ride, view = _ride(), _view(0.8, 10.0)
    assert (ride.seen(view, 10.0 + age) is not None) is in_view
    gap = ride.gap_m(view, 10.0 + age)
    assert gap == (pytest.approx(0.8) if in_view else None)


def test_only_the_marker_of_the_robot_ahead_counts() -> None:
    ride = _ride()
    assert ride.seen(_view(0.8, 10.0, marker_id=7), 10.0) is None
    ride.hear(_told(ahead=AHEAD), 10.0)
    assert ride.seen(_view(0.8, 10.0, marker_id=7), 10.0) is not None
    assert ride.seen(_view(0.8, 10.0), 10.0) is None


def _settles(gap: float, speed: float = 0.0, seconds: float = 1.0) -> bool:
    ride = _ride()
    settled = False
    for i in range(round(seconds * 20) + 1):
        view, now = _view(gap, 10.0 + 0.05 * i, speed), 10.0 + 0.05 * i
        ride.look(view, now)
        settled = settled or ride.settled(view, now)
    return settled


@pytest.mark.parametrize(
    ("gap", "settled"), [(0.49, False), (0.51, True), (0.8, True), (0.89, True), (0.91, False), (2.0, False)]
)
def test_it_settles_in_the_gap_or_a_little_nearer_as_it_does_not_back_up(gap: float, settled: bool) -> None:
    assert _settles(gap) is settled


@pytest.mark.parametrize(("speed", "settled"), [(0.09, True), (-0.09, True), (0.11, False), (-0.11, False)])
def test_it_does_not_settle_while_it_moves(speed: float, settled: bool) -> None:
    assert _settles(0.8, speed) is settled


@pytest.mark.parametrize(("seconds", "settled"), [(0.2, False), (0.25, True)])
def test_images_of_a_while_are_needed_to_settle(seconds: float, settled: bool) -> None:
    assert _settles(0.8, seconds=seconds) is settled


@pytest.mark.parametrize("between_them", [None, 1.5])
def test_the_while_begins_anew_when_the_gap_was_lost(between_them: float | None) -> None:
    ride = _ride()
    for now, gap in ((10.0, 0.8), (10.2, between_them), (10.4, 0.8), (10.6, 0.8)):
        view = _view(gap, now)
        ride.look(view, now)
        assert not ride.settled(view, now)
    ride.look(_view(0.8, 10.65), 10.65)
    assert ride.settled(_view(0.8, 10.65), 10.65)


def test_the_same_image_again_shows_nothing_new() -> None:
    ride, view = _ride(), _view(0.8, 10.0)
    for now in (10.0, 10.2, 10.4):
        ride.look(view, now)
        assert not ride.settled(view, now)


def test_images_from_before_the_marker_was_found_again_do_not_count() -> None:
    ride = _ride()
    for now in (10.0, 10.3):
        ride.look(_view(0.8, now), now)
    assert ride.settled(_view(0.8, 10.3), 10.3)
    ride.begin_to_settle()
    assert not ride.settled(_view(0.8, 10.3), 10.3)


@pytest.mark.parametrize(("gap", "near"), [(None, False), (0.3, True), (1.99, True), (2.01, False)])
def test_a_marker_that_is_far_away_is_out_of_reach(gap: float | None, near: bool) -> None:
    assert _ride().within_reach(_view(gap, 10.0), 10.0) is near


def test_a_marker_is_out_of_sight_after_a_while_without_an_image() -> None:
    ride = _ride()
    ride.look(_view(0.8, 10.0), 10.0)
    ride.look(_view(None, 10.5), 10.5)
    assert not ride.out_of_sight(10.5)
    ride.look(_view(None, 10.6), 10.6)
    assert ride.out_of_sight(10.6)
    ride.look(_view(3.0, 10.7), 10.7)  # wherever it is
    assert not ride.out_of_sight(10.7)


# What it is told.


def test_the_driver_is_silent_when_it_has_said_nothing_since_the_ride_began() -> None:
    ride = _ride(0.0)
    ride.begin(10.0)
    assert (ride.silent(15.0), ride.silent(15.1)) == (False, True)
    ride.hear(_told(), 15.1)
    assert (ride.silent(20.0), ride.silent(20.2)) == (False, True)


def test_the_speed_of_the_driver_counts_while_it_is_fresh() -> None:
    ride = _ride()
    assert ride.speed_mps(0.0) == 0.0
    ride.hear(_told(v=0.48), 10.0)
    assert ride.speed_mps(11.5) == pytest.approx(0.5)
    assert ride.speed_mps(11.6) == 0.0
    decouple = messages()[Decouple]
    assert isinstance(decouple, Decouple)
    ride.hear(decouple, 12.0)
    assert ride.speed_mps(12.0) == 0.0  # it stands


def test_metres_are_those_that_the_driver_counts() -> None:
    ride = _ride()
    assert ride.ridden_m == 0.0
    ride.hear(_told(ridden_m=7.25), 10.0)
    assert ride.ridden_m == 7.25


@given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), min_size=1, max_size=60))
def test_of_the_drivers_way_the_last_metres_are_kept_in_steps(steps: list[tuple[float, float]]) -> None:
    ride, x, y = _ride(), 0.0, 0.0
    way = []
    for i, (dx, dy) in enumerate(steps):
        x, y = x + dx, y + dy
        way.append(Pose2D(x, y, 0.1 * i))
        ride.hear(_told(x=x, y=y, theta=0.1 * i), float(i))
        kept = list(ride.told)
        assert all(distance(a, b) >= 0.2 for a, b in pairwise(kept))
        assert distance(kept[0], way[-1]) <= 4.0
        assert distance(kept[-1], way[-1]) < 0.2
        assert all(pose in way for pose in kept)


def test_the_drivers_way_is_known_as_far_back_as_four_metres() -> None:
    ride = _ride()
    for i in range(101):
        ride.hear(_told(x=0.125 * i, y=0.0), float(i))
    assert [pose.x for pose in ride.told] == np.arange(8.5, 12.6, 0.25).tolist()


def test_one_that_moves_up_knows_nothing_of_the_way_of_the_robot_ahead() -> None:
    ride = _ride()
    for i in range(10):
        ride.hear(_told(x=0.25 * i), float(i))
    ride.hear(_told(x=2.5, ahead=MARKER), 10.0)
    assert len(ride.told) > 1  # it follows that one already
    ride.hear(_told(x=3.0, ahead=AHEAD), 11.0)
    assert (ride.rear_marker, [pose.x for pose in ride.told]) == (AHEAD, [3.0])


# Where it takes itself to be.


T_MAP_ODOM = Pose2D(5.0, -2.0, 0.7)
"""Of the rider in these tests."""


def _drive(
    ride: Ride, metres: float, turn: float = 0.0, error: Pose2D | None = None, sigma: Any = SIGMA
) -> tuple[Pose2D, Pose2D]:
    """The rider follows in the gap; where the driver and it stand in the end, in ``map``."""
    driver = Pose2D(1.0, 2.0, 0.3)
    to_rider = compose(MARKER_POSE, inverse(Pose2D(CAMERA[0] + 0.8, 0.0, math.pi)))
    for i in range(round(metres / 0.1) + 1):
        own = compose(driver, to_rider)
        odom = between(T_MAP_ODOM, own)
        now = 10.0 + 0.2 * i
        wrong = error or Pose2D()
        told = Pose2D(driver.x + wrong.x, driver.y + wrong.y, driver.theta + wrong.theta)
        message = _told(x=told.x, y=told.y, theta=told.theta, sigma=sigma)
        ride.hear(message, now)
        ride.match(message, _view(0.8, now, seen_from=odom), now)
        driver = compose(driver, Pose2D(0.1, 0.0, turn * 0.1))
    return compose(driver, Pose2D(-0.1)), own


def test_the_own_pose_follows_from_the_drivers_and_the_marker() -> None:
    ride = _ride()
    assert ride.pose_behind_driver(_view(0.8, 10.0).observation, Situation(), 10.0) is None
    driver, own = _drive(ride, 0.0)
    seen = MarkerObservation(10.1, 0, between(own, compose(driver, MARKER_POSE)), np.array(SIGMA))
    pose = ride.pose_behind_driver(seen, Situation(), 10.1)
    assert pose is not None
    assert (pose.pose.x, pose.pose.y, pose.pose.theta) == pytest.approx((own.x, own.y, own.theta))
    assert pose.stamp == 10.1


def test_the_way_that_was_ridden_tells_the_heading_better_than_one_look_at_the_marker() -> None:
    ride = _ride()
    driver, own = _drive(ride, 3.0)
    seen = between(own, compose(driver, MARKER_POSE))
    skewed = MarkerObservation(30.0, 0, replace(seen, theta=seen.theta + 0.15), np.diag([1e-4, 1e-4, 0.15**2]))
    headings = [
        ride.pose_behind_driver(skewed, Situation(seen_from=odom), 30.0).pose.theta - own.theta
        for odom in (None, between(T_MAP_ODOM, own))
    ]
    assert abs(wrap_angle(headings[0])) == pytest.approx(0.15, abs=0.01)
    assert abs(wrap_angle(headings[1])) < 0.02


def test_without_the_marker_the_way_and_the_own_wheels_tell_where_it_is() -> None:
    ride = _ride()
    _, own = _drive(ride, 3.0)
    gone = compose(own, Pose2D(0.5, 0.1, 0.2))  # by its wheels
    pose = ride.rough_pose(Situation(odom_pose=between(T_MAP_ODOM, gone)), 30.0)
    assert pose is not None
    assert distance(pose.pose, gone) < 0.02
    assert abs(wrap_angle(pose.pose.theta - gone.theta)) < 0.02
    assert np.sqrt(pose.covariance[0, 0]) < 0.3


@pytest.mark.parametrize("odom", [None, Pose2D()])
def test_without_a_way_the_last_message_tells_roughly_where_it_is(odom: Pose2D | None) -> None:
    """In the gap behind the driver; both may have gone on since, as far as they ride in that time."""
    ride = _ride()
    _, own = _drive(ride, 0.0)
    for silent_s in (0.0, 4.0):
        pose = ride.rough_pose(Situation(odom_pose=odom), 10.0 + silent_s)
        assert pose is not None
        assert distance(pose.pose, own) < 0.01
        place, heading = 0.5 + 0.6 * silent_s, 0.3
        sigma = np.sqrt(np.diag(pose.covariance))
        assert np.all(sigma <= [place + 0.6, place + 0.6, heading + 0.1])
        assert np.all(sigma >= [place, place, heading])


def test_before_the_driver_has_said_anything_the_own_estimate_still_holds() -> None:
    estimate = PoseEstimate(9.9, Pose2D(1.0, 2.0, 3.0), np.eye(3))
    assert _ride().rough_pose(Situation(estimate=estimate), 10.0) is estimate
    assert _ride().rough_pose(Situation(), 10.0) is None


def test_one_that_moves_up_lays_no_places_of_two_robots_on_one_another() -> None:
    ride = _ride()
    _drive(ride, 3.0)
    assert ride.rough_pose(Situation(odom_pose=Pose2D()), 30.0).covariance[0, 0] < 0.3**2
    ride.hear(_told(ahead=AHEAD), 30.0)
    assert ride.rough_pose(Situation(odom_pose=Pose2D()), 30.0).covariance[0, 0] >= 0.5**2


def test_where_the_driver_is_follows_from_the_own_pose_and_the_marker() -> None:
    ride, driver, own = _ride(), Pose2D(4.0, 5.0, 0.5), Pose2D(2.9, 4.3, 0.6)
    seen = MarkerObservation(10.0, 0, between(own, compose(driver, MARKER_POSE)), np.array(SIGMA))
    place = ride.pose_ahead(own, Situation(observation=seen), 10.0)
    assert place is not None
    assert (place.x, place.y, place.theta) == pytest.approx((driver.x, driver.y, driver.theta))
    assert ride.pose_ahead(own, Situation(observation=seen), 11.0) is None


# What is told and what is seen are of different times.


def _rides(
    ride: Ride,
    driver_at: Callable[[float], Pose2D],
    until: float,
    *,
    age_s: float = 0.0,
    image_s: float = 0.3,
    latency_s: float = 0.1,
    rng: np.random.Generator | None = None,
    error: Pose2D | None = None,
    sigma: Any = SIGMA,
) -> tuple[Pose2D, Pose2D]:
    """The rider looks every ``image_s`` at images ``latency_s`` old, and hears every 0.5 s where the driver, wrong by
    ``error``, was ``age_s`` ago. It follows exactly, 2.4 s later. Where both are in the end."""

    def own_at(t: float) -> Pose2D:
        return driver_at(t - 2.4)

    wrong = error or Pose2D()
    for k in range(round((until - 10.0) / 0.1) + 1):
        now, looks = 10.0 + 0.1 * k, k % round(image_s / 0.1) == 0
        if looks:
            stamp = now - latency_s
            seen = between(own_at(stamp), compose(driver_at(stamp), MARKER_POSE))
            noise = np.zeros(3) if rng is None else rng.normal(0.0, [0.005, 0.005, 0.05])
            pose = Pose2D(seen.x + noise[0], seen.y + noise[1], seen.theta + noise[2])
            observation = MarkerObservation(stamp, 0, pose, np.diag(np.square([0.005, 0.005, 0.05])))
            view = Situation(observation=observation, seen_from=between(T_MAP_ODOM, own_at(stamp)))
            ride.look(view, now)
        if k % 5 == 0:
            true = driver_at(now - age_s)
            told = Pose2D(true.x + wrong.x, true.y + wrong.y, true.theta + wrong.theta)
            message = _told(x=told.x, y=told.y, theta=told.theta, age_s=age_s, sigma=sigma)
            ride.hear(message, now)
            ride.match(message, view, now)
    return driver_at(until), own_at(until)


def _round_the_corner(t: float) -> Pose2D:
    """At 0.5 m/s, 2 m straight on, then round a bend of 1 m; it began at 7 s."""
    s = 0.5 * (t - 7.0)
    if s <= 2.0:
        return Pose2D(s, 0.0, 0.0)
    turn = min((s - 2.0) / 1.0, math.pi / 2)
    on = max(0.0, s - 2.0 - math.pi / 2)
    return compose(Pose2D(2.0 + math.sin(turn), 1.0 - math.cos(turn), turn), Pose2D(on))


@pytest.mark.parametrize("age_s", [0.0, 0.1, 0.35])
@pytest.mark.parametrize("image_s", [0.1, 0.3])
def test_what_was_told_is_laid_on_what_was_seen_at_that_very_time(age_s: float, image_s: float) -> None:
    """Laid on the newest image of when the message came, it was 0.2 m and 0.11 rad off behind the bend."""
    ride = _ride()
    _, own = _rides(ride, _round_the_corner, 17.0, age_s=age_s, image_s=image_s)
    pose = ride.rough_pose(Situation(odom_pose=between(T_MAP_ODOM, own)), 17.0)
    assert pose is not None
    assert distance(pose.pose, own) < 0.01
    assert abs(wrap_angle(pose.pose.theta - own.theta)) < 0.01


@pytest.mark.parametrize("age_s", [2.0, 30.0])
def test_what_is_told_of_a_time_without_images_is_laid_on_none(age_s: float) -> None:
    ride = _ride()
    _, own = _rides(ride, _round_the_corner, 13.0, age_s=age_s, image_s=1.0)
    pose = ride.rough_pose(Situation(odom_pose=between(T_MAP_ODOM, own)), 13.0)
    assert pose is not None
    assert pose.covariance[0, 0] >= (0.5 + 0.6 * age_s) ** 2 - 1e-9  # from the message alone


@pytest.mark.parametrize("sigma", [(0.03, 0.03, 0.02), (0.2, 0.1, 0.05), (0.3, 0.3, 0.15)])
def test_a_rider_that_lost_its_driver_knows_how_badly_the_driver_knew_its_place(
    sigma: tuple[float, float, float],
) -> None:
    """With the second of these the squared normalised error was 8, with the third 26."""
    known = np.diag(np.square(sigma))
    scores = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        error = Pose2D(*rng.multivariate_normal(np.zeros(3), known))
        ride = _ride()
        _, own = _rides(ride, _round_the_corner, 17.0, rng=rng, error=error, sigma=covariance_rows(known))
        pose = ride.rough_pose(Situation(odom_pose=between(T_MAP_ODOM, own)), 17.0)
        assert pose is not None
        scores.append(mahalanobis_squared(pose_error(pose.pose, own), pose.covariance))
    assert np.mean(scores) < 3.5


@pytest.mark.parametrize("heading_sigma", [0.01, 0.04, 0.07])
@pytest.mark.parametrize("yaw_sigma", [0.01, 0.05])
def test_the_heading_of_the_way_corrects_what_is_known_worst(heading_sigma: float, yaw_sigma: float) -> None:
    """The heading that the driver tells is not exact. Taken to be, beside a look that is good to 0.01 rad, its error of
    0.07 rad stayed in the rider's heading by more than half; what the way tells is good to 0.015 rad."""
    known = np.diag(np.square([0.01, 0.01, heading_sigma]))
    scores, errors = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        error = Pose2D(*rng.multivariate_normal(np.zeros(3), known))
        ride = _ride()
        drift = rng.normal(0.0, 0.015)  # of the wheels
        driver, own = _drive(ride, 4.0, error=error, sigma=covariance_rows(known))
        look = between(own, compose(driver, MARKER_POSE))
        noise = rng.normal(0.0, [0.003, 0.003, yaw_sigma])
        seen = MarkerObservation(
            60.0,
            0,
            Pose2D(look.x + noise[0], look.y + noise[1], look.theta + noise[2]),
            np.diag(np.square([0.003, 0.003, yaw_sigma])),
        )
        odom = between(T_MAP_ODOM, own)
        ride._sightings = Sightings()  # it has stood for a while
        situation = Situation(seen_from=replace(odom, theta=odom.theta + drift))
        pose = ride.pose_behind_driver(seen, situation, 60.0)
        assert pose is not None
        miss = pose_error(pose.pose, own)
        errors.append(miss[2])
        scores.append(mahalanobis_squared(miss, pose.covariance))
    assert 1.5 < np.mean(scores) < 4.0
    assert np.std(errors) < 1.3 * min(math.hypot(heading_sigma, yaw_sigma), 0.018)


@pytest.mark.parametrize("age_s", [0.0, 0.4, 0.8])
def test_a_pose_of_a_while_ago_is_that_of_the_look_of_a_while_ago(age_s: float) -> None:
    """In a convoy the driver tells of the robot ahead as it was when somebody saw it. Paired with what is seen now,
    0.4 s later in a bend, the own pose was 0.2 m and 0.2 rad off."""
    ride = _ride()
    driver, own = _rides(ride, _round_the_corner, 14.0, age_s=age_s, image_s=0.1)
    stamp = 14.0
    seen = MarkerObservation(stamp, 0, between(own, compose(driver, MARKER_POSE)), np.diag([1e-6, 1e-6, 1e-6]))
    situation = Situation(observation=seen, seen_from=between(T_MAP_ODOM, own))
    pose = ride.pose_behind_driver(seen, situation, 14.0)
    assert pose is not None
    assert pose.stamp == stamp
    assert distance(pose.pose, own) < 0.01
    assert abs(wrap_angle(pose.pose.theta - own.theta)) < 0.01


def test_in_line_as_the_papers_take_it_the_heading_is_the_drivers() -> None:
    ride = _ride(handover="paper")
    driver, own = _drive(ride, 3.0)
    seen = between(own, compose(driver, MARKER_POSE))
    skewed = MarkerObservation(30.0, 0, replace(seen, y=seen.y + 0.1), np.diag([1e-4, 1e-4, 0.15**2]))
    pose = ride.pose_behind_driver(skewed, Situation(seen_from=between(T_MAP_ODOM, own)), 30.0)
    assert pose is not None
    assert pose.pose.theta == pytest.approx(driver.theta)
    np.testing.assert_allclose(pose.covariance, SIGMA)


@pytest.mark.parametrize("odom", [None, Pose2D(1.0, 2.0, 0.3)])
def test_a_robot_that_rolls_on_after_the_restart_does_not_take_the_driver_along(odom: Pose2D | None) -> None:
    driver, gone = Pose2D(4.0, 4.5, 0.4), Pose2D(0.2, 0.0, 0.1)
    restart = Restart(GIVEN, driver, odom)
    own = GIVEN.pose if odom is None else compose(GIVEN.pose, gone)
    place = restart.ahead_from(own, None if odom is None else compose(odom, gone))
    assert place is not None
    assert (place.x, place.y, place.theta) == pytest.approx((driver.x, driver.y, driver.theta))


# Localization starts again.


GIVEN = PoseEstimate(10.0, Pose2D(3.0, 4.0, 0.5), np.eye(3))


@pytest.mark.parametrize(
    ("stamp", "off_m", "taken"),
    [(10.1, 0.0, True), (10.1, 1.99, True), (10.1, 2.01, False), (10.0, 0.0, False), (9.0, 0.0, False)],
)
def test_localization_has_taken_a_pose_when_it_answers_later_and_near_it(
    stamp: float, off_m: float, taken: bool
) -> None:
    answer = PoseEstimate(stamp, Pose2D(3.0, 4.0 + off_m, 2.0), np.eye(3))
    assert Restart(GIVEN, None).taken(answer) is taken


def test_without_an_answer_no_pose_is_taken() -> None:
    assert not Restart(GIVEN, None).taken(None)


def test_the_driver_is_as_far_from_where_the_robot_is_as_from_where_it_was_taken_to_be() -> None:
    driver, own = Pose2D(4.0, 4.5, 0.4), Pose2D(3.1, 3.8, 0.45)
    place = Restart(GIVEN, driver).ahead_from(own)
    assert place is not None
    before, after = between(GIVEN.pose, driver), between(own, place)
    assert (after.x, after.y, after.theta) == pytest.approx((before.x, before.y, before.theta))
    assert Restart(GIVEN, None).ahead_from(own) is None


def test_boxes_of_the_newest_message_are_known() -> None:
    ride = _ride()
    ride.hear(_told(), 10.0)
    assert ride.report is not None
    assert ride.report.new_obstacles.obstacles == BOXES
