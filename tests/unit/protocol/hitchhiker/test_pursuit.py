"""Where a hitchhiker looks for its driver, one place after another."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, distance
from hitchhike_ros.protocol.events import NavigationReport, Situation
from hitchhike_ros.protocol.hitchhiker.pursuit import Pursuit
from hitchhike_ros.protocol.messages import RearMarker
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from protocol_helpers import CAMERA, MARKER_POSE

PARAMS = HitchhikingParameters(gap_m=0.8, look_s=2.0)
MARKER = RearMarker(marker_id=0, marker_size_m=0.16, marker_pose=MARKER_POSE)
TOLD = [Pose2D(x, 5.0) for x in np.arange(10.0, 13.1, 0.25).tolist()]
AT_MARKER = compose(TOLD[-1], MARKER_POSE)
OFF_M = CAMERA[0] + PARAMS.gap_m  # from the base to the marker, in the gap


def _pursuit() -> Pursuit:
    return Pursuit(PARAMS, CAMERA, "ride", itertools.count(1))


def _at(pose: Pose2D | None, report: NavigationReport | None = None) -> Situation:
    estimate = None if pose is None else PoseEstimate(0.0, pose, np.eye(3))
    return Situation(estimate=estimate, navigation=report)


def test_first_it_looks_from_the_drivers_own_way_as_near_as_it_may_stand() -> None:
    pursuit = _pursuit()
    pursuit.aim(TOLD, MARKER, _at(Pose2D(9.0, 5.3)), 0.0)
    way = pursuit.way
    assert way is not None
    assert way.pose in [Pose2D(p.x, p.y) for p in TOLD]
    assert OFF_M + 0.4 <= distance(way.pose, AT_MARKER) < OFF_M + 0.4 + 0.25
    assert (way.id, way.theta) == ("ride-behind-1", 0.0)
    assert (way.tolerance_m, way.tolerance_rad) == (0.25, 0.25)  # it need only see the marker from there


def test_a_driver_that_has_hardly_moved_is_looked_for_from_the_first_place_that_it_told() -> None:
    pursuit = _pursuit()
    pursuit.aim(TOLD[-3:], MARKER, _at(Pose2D(9.0, 5.3)), 0.0)
    assert pursuit.way is not None
    assert (pursuit.way.x, pursuit.way.y) == (TOLD[-3].x, TOLD[-3].y)


@pytest.mark.parametrize(("away_m", "turns"), [(OFF_M + 0.39, True), (OFF_M + 0.41, False)])
def test_near_the_marker_it_turns_to_it_and_does_not_go_back(away_m: float, turns: bool) -> None:
    pursuit, own = _pursuit(), compose(AT_MARKER, Pose2D(0.0, away_m, 1.0))
    pursuit.aim(TOLD, MARKER, _at(own), 0.0)
    way = pursuit.way
    assert way is not None
    assert ((way.x, way.y) == (own.x, own.y)) is turns
    assert way.theta == pytest.approx(math.atan2(AT_MARKER.y - way.y, AT_MARKER.x - way.x))


def test_then_it_looks_from_straight_in_front_of_the_marker_and_then_from_nowhere() -> None:
    pursuit, own = _pursuit(), Pose2D(9.0, 5.3)
    pursuit.aim(TOLD, MARKER, _at(own), 0.0)
    first = pursuit.way
    assert first is not None
    for now in (1.0, 3.0):
        pursuit.aim(TOLD, MARKER, _at(own, NavigationReport(first.id, "arrived")), now)
        assert (pursuit.way, pursuit.nowhere_left) == (first, False)
    pursuit.aim(TOLD, MARKER, _at(own, NavigationReport(first.id, "arrived")), 3.1)
    second = pursuit.way
    assert second is not None and second.id == "ride-behind-2"
    front = compose(AT_MARKER, Pose2D(OFF_M))
    assert (second.x, second.y, second.theta) == pytest.approx((front.x, front.y, 0.0))
    for now, nowhere in ((4.0, False), (6.0, False), (6.1, True)):
        pursuit.aim(TOLD, MARKER, _at(own, NavigationReport(second.id, "failed")), now)
        assert pursuit.nowhere_left is nowhere


def test_it_looks_for_as_long_at_each_place_and_only_once_it_stands_there() -> None:
    pursuit, own = _pursuit(), Pose2D(9.0, 5.3)
    pursuit.aim(TOLD, MARKER, _at(own), 0.0)
    way = pursuit.way
    assert way is not None
    there, other = NavigationReport(way.id, "arrived"), NavigationReport("other", "arrived")
    for now, report in ((1.0, there), (2.0, NavigationReport(way.id, "driving")), (2.5, there), (4.4, there)):
        pursuit.aim(TOLD, MARKER, _at(own, report), now)
    assert pursuit.way == way
    for now in (5.0, 9.0):
        pursuit.aim(TOLD, MARKER, _at(own, other), now)  # of the way before
    assert pursuit.way == way
    pursuit.aim(TOLD, MARKER, _at(own, None), 20.0)
    assert pursuit.way == way


def test_a_driver_that_has_gone_on_is_looked_for_anew() -> None:
    pursuit, own = _pursuit(), Pose2D(9.0, 5.3)
    pursuit.aim(TOLD, MARKER, _at(own), 0.0)
    first = pursuit.way
    assert first is not None
    pursuit.aim(TOLD, MARKER, _at(own), 0.1)
    assert pursuit.way == first
    gone_on = [*TOLD, Pose2D(14.0, 5.0)]
    pursuit.aim(gone_on, MARKER, _at(own), 0.2)
    assert pursuit.way is not None
    assert (pursuit.way.id, pursuit.way.x > first.x) == ("ride-behind-2", True)


def test_without_knowing_where_either_is_there_is_nowhere_to_look() -> None:
    for told, own in ((TOLD, None), ([], Pose2D(9.0, 5.3))):
        pursuit = _pursuit()
        assert not pursuit.nowhere_left
        pursuit.aim(told, MARKER, _at(own), 0.0)
        assert (pursuit.way, pursuit.nowhere_left) == (None, True)
