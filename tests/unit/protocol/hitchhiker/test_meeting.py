"""Where and when a hitchhiker meets its driver, and why it does not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate, Side
from hitchhike_ros.core.geometry import compose, distance
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.events import NavigationReport, Situation
from hitchhike_ros.protocol.hitchhiker.meeting import Rendezvous
from hitchhike_ros.protocol.matching import Meeting
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from protocol_helpers import SITES, WEST

PARAMS = HitchhikingParameters(
    mode="network",
    max_wait_s=60.0,
    max_align_s=30.0,
    contact_timeout_s=15.0,
    planner_patience_s=5.0,
    cruise_speed_mps=0.5,
)
MEETING = Meeting("p3dx", WEST, (20.0, 5.72), 17.0, in_s=20.0, begins_in_s=30.0, ends_in_s=70.0, more=False)
AWAY = compose(WEST.waiting_pose, Pose2D(-6.0))


def _at(pose: Pose2D | None, report: NavigationReport | None = None) -> Situation:
    estimate = None if pose is None else PoseEstimate(0.0, pose, np.eye(3))
    return Situation(estimate=estimate, navigation=report)


def _estimate(pose: Pose2D) -> PoseEstimate:
    return PoseEstimate(0.0, pose, np.eye(3))


def _arranged(ready_in_s: float = 0.0, place: int = 1, driver_in_s: float = 30.0) -> Rendezvous:
    """Chosen at 100 s, agreed upon at 101 s."""
    rendezvous = Rendezvous(PARAMS, SITES, "ride", MEETING, 100.0, ready_in_s)
    rendezvous.agree(place, driver_in_s, 101.0, _estimate(AWAY))
    return rendezvous


def _on_its_way(pose: Pose2D = AWAY, place: int = 1) -> Rendezvous:
    rendezvous = _arranged(place=place)
    rendezvous.go(_at(pose), 101.1, 0.0)
    return rendezvous


# Where there is no meeting from afar.


@pytest.mark.parametrize("wall", ["left", None])
def test_one_that_waits_where_it_is_turns_into_line(wall: Side | None) -> None:
    sites = Sites(SITES.markers, (replace(WEST, wall=wall),))
    rendezvous = Rendezvous(PARAMS, sites, "ride", None, 100.0, 0.0)
    assert rendezvous.way is None
    own = Pose2D(1.5, 5.6, 2.0)
    rendezvous.agree(1, 0.0, 101.0, _estimate(own))
    way = rendezvous.way
    assert way is not None
    assert (way.id, way.x, way.y, way.theta, way.along_wall) == ("ride-line", 1.5, 5.6, WEST.waiting_pose.theta, wall)
    assert (way.tolerance_m, way.tolerance_rad) == (0.25, 0.06)
    assert rendezvous.in_place(_at(own))  # it may couple meanwhile
    rendezvous.go(_at(own, NavigationReport("ride-line", "arrived")), 102.0, 0.0)
    assert rendezvous.way is None


@pytest.mark.parametrize(
    ("own", "turns"),
    [
        (Pose2D(1.8, 5.7, 0.059), False),
        (Pose2D(1.8, 5.7, 0.061), True),
        (Pose2D(1.8, 5.7, -0.061), True),
        (Pose2D(1.8, 5.7, 2.0 * math.pi), False),
        (Pose2D(9.0, 5.7, 2.0), False),  # at no hitchhiking point
    ],
)
def test_it_turns_only_at_a_hitchhiking_point_and_where_it_is_out_of_line(own: Pose2D, turns: bool) -> None:
    rendezvous = Rendezvous(PARAMS, SITES, "ride", None, 100.0, 0.0)
    rendezvous.agree(1, 0.0, 101.0, _estimate(own))
    assert (rendezvous.way is not None) is turns


def test_one_that_does_not_know_where_it_is_stays() -> None:
    rendezvous = Rendezvous(PARAMS, SITES, "ride", None, 100.0, 0.0)
    rendezvous.agree(1, 0.0, 101.0, None)
    assert rendezvous.way is None


def test_without_a_meeting_nothing_but_the_paper_time_ends_it() -> None:
    rendezvous = Rendezvous(PARAMS, SITES, "ride", None, 100.0, 0.0)
    rendezvous.agree(1, 1000.0, 101.0, None)
    assert (rendezvous.driver_is_gone(500.0), rendezvous.driver_is_late) == (False, False)
    assert rendezvous.patience_s == PARAMS.max_align_s


# The way to the meeting.


def test_it_is_sent_off_once_and_rests_when_it_is_there() -> None:
    rendezvous = _on_its_way()
    way = rendezvous.way
    assert way is not None
    assert (way.id, way.pose) == ("ride-meet-1", WEST.waiting_pose)
    rendezvous.go(_at(AWAY, NavigationReport(way.id, "driving")), 101.2, 0.0)
    assert rendezvous.way == way
    assert not rendezvous.in_place(_at(AWAY, NavigationReport(way.id, "driving")))
    assert rendezvous.in_place(_at(AWAY, NavigationReport(way.id, "arrived")))
    rendezvous.go(_at(WEST.waiting_pose, NavigationReport(way.id, "arrived")), 110.0, 0.0)
    assert rendezvous.way is None
    assert rendezvous.in_place(_at(WEST.waiting_pose, NavigationReport("other", "driving")))
    rendezvous.go(_at(WEST.waiting_pose), 110.1, 0.0)
    assert rendezvous.way is None


@pytest.mark.parametrize(("estimate", "ready_in_s"), [(None, 0.0), (AWAY, 0.1)])
def test_it_does_not_start_before_it_can(estimate: Pose2D | None, ready_in_s: float) -> None:
    rendezvous = _arranged(ready_in_s)
    rendezvous.go(_at(estimate), 101.1, ready_in_s)
    assert rendezvous.way is None
    assert not rendezvous.in_place(_at(estimate))


@pytest.mark.parametrize("place", [1, 2, 3])
def test_those_with_places_farther_back_wait_behind(place: int) -> None:
    way = _on_its_way(place=place).way
    assert way is not None
    apart = distance(WEST.aligning_pose, WEST.waiting_pose)
    assert way.id == f"ride-meet-{place}"
    assert (way.x, way.y) == pytest.approx((WEST.waiting_pose.x - (place - 1) * apart, WEST.waiting_pose.y))


def test_another_place_is_another_way() -> None:
    rendezvous = _on_its_way()
    rendezvous.update(1, 20.0, 102.0)
    rendezvous.go(_at(AWAY), 102.1, 0.0)
    assert rendezvous.way is not None and rendezvous.way.id == "ride-meet-1"
    rendezvous.update(2, 20.0, 103.0)
    assert not rendezvous.in_place(_at(AWAY))
    rendezvous.go(_at(AWAY), 103.1, 0.0)
    assert rendezvous.way.id == "ride-meet-2"


@pytest.mark.parametrize(
    ("off", "order"),
    [
        (Pose2D(0.24, 0.0, 0.0), None),
        (Pose2D(-0.24, 0.0, 1.0), "ride-line"),
        (Pose2D(-0.26, 0.0, 0.0), "ride-meet-1"),
    ],
)
def test_one_that_stands_there_already_only_turns(off: Pose2D, order: str | None) -> None:
    way = _on_its_way(compose(WEST.waiting_pose, off)).way
    assert (None if way is None else way.id) == order


# When.


def test_it_will_be_there_as_planned_unless_it_is_farther_away() -> None:
    rendezvous = Rendezvous(PARAMS, SITES, "ride", MEETING, 100.0, 0.0)
    assert rendezvous.arrives_in_s(_at(AWAY), 104.0, 0.0) == pytest.approx(16.0)
    assert rendezvous.arrives_in_s(_at(AWAY), 115.0, 0.0) == pytest.approx(12.0)  # 6 m at 0.5 m/s
    assert rendezvous.arrives_in_s(_at(None), 115.0, 0.0) == pytest.approx(5.0)
    assert rendezvous.arrives_in_s(_at(None), 130.0, 0.0) == 0.0


def test_once_in_place_it_is_there() -> None:
    rendezvous = _on_its_way(WEST.waiting_pose)
    assert rendezvous.arrives_in_s(_at(AWAY), 130.0, 0.0) == 0.0  # localization may jump


def test_while_it_cannot_start_it_will_be_there_later() -> None:
    """It is asked for the ride after the present one: 8 s until that ends, then a way of 12 s."""
    rendezvous = _arranged(ready_in_s=8.0)
    assert rendezvous.arrives_in_s(_at(AWAY), 104.0, 7.0) == pytest.approx(19.0)
    assert rendezvous.arrives_in_s(_at(None), 105.0, 0.0) == pytest.approx(18.0)  # and remembers what it said


def test_the_ride_ends_as_much_later_as_it_will_be_there_later() -> None:
    rendezvous = _arranged(ready_in_s=8.0)
    assert rendezvous.ride_ends_in_s(100.0) == pytest.approx(70.0)
    assert rendezvous.ride_ends_in_s(110.0) == pytest.approx(60.0)
    assert rendezvous.ride_ends_in_s(130.0) == pytest.approx(50.0)  # it will be there at any moment
    rendezvous.arrives_in_s(_at(AWAY), 110.0, 8.0)
    assert rendezvous.ride_ends_in_s(110.0) == pytest.approx(20.0 + 50.0)
    assert Rendezvous(PARAMS, SITES, "ride", None, 100.0, 0.0).ride_ends_in_s(100.0) == 0.0


# Why not.


def test_a_driver_that_is_not_heard_of_is_gone() -> None:
    rendezvous = _arranged()
    assert not rendezvous.driver_is_gone(116.0)
    assert rendezvous.driver_is_gone(116.1)
    rendezvous.hear(116.1)
    assert not rendezvous.driver_is_gone(131.0)


@pytest.mark.parametrize(("driver_in_s", "late"), [(90.0, False), (90.1, True)])
def test_a_driver_is_late_when_it_lets_one_wait_longer_than_one_would(driver_in_s: float, late: bool) -> None:
    """The ride was to begin in 30 s, and T_hwait is 60 s."""
    assert _arranged(driver_in_s=driver_in_s).driver_is_late is late
    rendezvous = _arranged(driver_in_s=1.0)
    rendezvous.update(1, driver_in_s - 4.0, 105.0)  # as it was agreed upon at 101 s
    assert rendezvous.driver_is_late is late


def test_a_way_that_navigation_does_not_find_is_given_up_after_a_while() -> None:
    rendezvous = _on_its_way()
    assert rendezvous.way is not None
    failed = _at(AWAY, NavigationReport(rendezvous.way.id, "failed", "no path"))
    for now in (102.0, 103.0, 107.0):
        rendezvous.go(failed, now, 0.0)
    assert not rendezvous.there_is_no_way(107.0)
    assert rendezvous.there_is_no_way(107.1)
    rendezvous.go(_at(AWAY, NavigationReport(rendezvous.way.id, "driving")), 107.2, 0.0)
    assert not rendezvous.there_is_no_way(120.0)
    rendezvous.go(failed, 121.0, 0.0)  # the time counts anew
    assert not rendezvous.there_is_no_way(126.0)
    rendezvous.go(_at(AWAY, NavigationReport("other", "failed")), 126.0, 0.0)
    assert not rendezvous.there_is_no_way(140.0)


def test_who_meets_from_afar_waits_for_as_long_as_the_way_takes_both() -> None:
    assert _arranged().patience_s == 2.0 * 30.0 + 60.0 + 30.0
