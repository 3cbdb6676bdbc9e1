"""The search for a driver out of sight: each step, its bound, and to which side it turns."""

from __future__ import annotations

import math

import pytest

from flat_world import TURTLEBOT as LIMITS
from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import compose, wrap_angle
from hitchhike_ros.servoing.driver_search import Departure, DriverSearch
from hitchhike_ros.servoing.driver_trail import DriverTrail
from hitchhike_ros.servoing.follow_parameters import FollowParameters

P, DT = FollowParameters(), 0.1


def search(departure, trail=None, known_m=0.9, seconds=20.0):
    """Poses, twists and states of a follower at the origin that has lost its driver."""
    trail = trail or DriverTrail((0.0, 0.0), (1.2, 0.0))
    seeker, own, log = DriverSearch(P, LIMITS, departure, 0.0), Pose2D(), []
    for i in range(round(seconds / DT)):
        driven = trail.advance(own.x, own.y)
        twist, state = seeker.step(i * DT, own, trail, known_m - driven)
        log.append((own, twist, state))
        own = compose(own, Pose2D(twist.v * DT, 0.0, twist.omega * DT))
    return log


def order(log):
    states = [state for _, _, state in log]
    return [s for before, s in zip(["", *states], states, strict=False) if s != before]


@pytest.mark.parametrize(("known_m", "farthest"), [(0.9, 0.6), (0.3, 0.33), (-0.2, 0.0)])
def test_coasting_is_bounded_by_the_way_and_by_time(known_m, farthest):
    log = search(Departure(0.5, 0.0, 0.0), known_m=known_m)
    assert max(own.x for own, _, _ in log) <= farthest
    assert sum(state == "coasting" for _, _, state in log) * DT <= P.coast_s
    assert order(log)[-3:] == ["looking", "turning", "lost"]


def test_a_robot_that_stood_does_not_coast():
    assert order(search(Departure(0.0, 0.0, 0.0))) == ["looking", "turning", "lost"]


def test_coasting_keeps_to_the_trail():
    arc = [(math.sin(a), 1.0 - math.cos(a)) for a in (0.1 * i for i in range(13))]
    log = search(Departure(0.5, 0.3, 0.5), DriverTrail(*arc), known_m=0.8)
    coasted = [own for own, _, state in log if state == "coasting"]
    assert len(coasted) > 5
    assert max(abs(math.hypot(own.x, own.y - 1.0) - 1.0) for own in coasted) < 0.05


@pytest.mark.parametrize(
    ("bearing", "turned", "side"),
    [(0.4, 0.0, 1.0), (-0.4, 0.0, -1.0), (0.05, 0.8, 1.0), (0.0, -0.8, -1.0), (-0.3, 0.9, -1.0)],
)
def test_it_turns_first_to_where_the_marker_left(bearing, turned, side):
    log = search(Departure(0.0, bearing, turned))
    assert order(log) == ["turning", "lost"]
    turning = [(own, twist) for own, twist, state in log if state == "turning"]
    assert math.copysign(1.0, turning[0][1].omega) == side
    assert all(twist.v == 0.0 and abs(twist.omega) <= P.search_yaw_rate_rps for _, twist in turning)
    headings = [wrap_angle(own.theta) for own, _ in turning]
    assert max(side * h for h in headings) == pytest.approx(P.search_angle_rad, abs=0.06)
    assert min(side * h for h in headings) == pytest.approx(-P.search_angle_rad, abs=0.06)
    assert abs(log[-1][0].theta) < 0.06  # it ends looking along the way


def test_turning_that_does_not_come_about_is_given_up():
    seeker = DriverSearch(P, LIMITS, Departure(0.0, 0.5, 0.0), 0.0)
    states = [seeker.step(i * DT, Pose2D(), DriverTrail((0.0, 0.0), (1.0, 0.0)), 0.0)[1] for i in range(200)]
    assert states.index("lost") * DT == pytest.approx(P.search_timeout_s, abs=0.25)
    assert set(states[states.index("lost") :]) == {"lost"}
