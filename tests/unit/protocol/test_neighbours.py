"""Where other robots are, as they say it and as they were seen."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.messages import Beacon, Decouple, Driver
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.status import KnownRobot
from protocol_helpers import DRIVER, messages

SEEN = Pose2D(7.0, 8.0, 0.9)
UNKNOWN_RADIUS_M = 0.4


def _robots(neighbours: Neighbours, now: float, waiting: str = "") -> list[tuple[float, float, float]]:
    return [(r.x, r.y, r.radius_m) for r in neighbours.robots(now, 3.0, waiting, 40.0)]


@pytest.mark.parametrize("kind", [Driver, Decouple])
def test_the_rider_ahead_is_a_robot_of_its_own(kind: type[Driver] | type[Decouple]) -> None:
    neighbours, heard = Neighbours(), messages()
    neighbours.hear(replace(heard[Beacon], radius_m=0.27), 10.0)
    neighbours.hear(replace(heard[kind], place=2), 10.5)
    assert _robots(neighbours, 11.0) == [(1.0, 2.0, 0.27), (3.0, 5.72, UNKNOWN_RADIUS_M)]
    neighbours.saw_ahead(DRIVER, SEEN, 11.0)
    assert _robots(neighbours, 11.0) == [(1.0, 2.0, 0.27), (7.0, 8.0, UNKNOWN_RADIUS_M)]
    neighbours.saw_driver(DRIVER, Pose2D(9.0, 9.0), 11.0)
    assert _robots(neighbours, 11.0) == [(9.0, 9.0, 0.27), (7.0, 8.0, UNKNOWN_RADIUS_M)]


def test_a_driver_that_waits_is_remembered_with_the_rider_ahead_for_longer() -> None:
    neighbours, heard = Neighbours(), messages()
    neighbours.hear(heard[Driver], 10.0)
    neighbours.hear(replace(heard[Driver], place=3, x=2.0), 10.0)
    assert _robots(neighbours, 13.1) == []
    assert [x for x, *_ in _robots(neighbours, 50.0, waiting=DRIVER)] == [3.0, 2.0]
    assert _robots(neighbours, 50.1, waiting=DRIVER) == []


def test_nothing_is_left_of_who_is_forgotten() -> None:
    neighbours, heard = Neighbours(), messages()
    for message, now in ((heard[Driver], 10.0), (replace(heard[Driver], place=2), 12.0)):
        neighbours.hear(message, now)
    neighbours.forget(11.0)
    assert neighbours.robots(12.0, 9.0, "", 9.0) == (KnownRobot(3.0, 5.72, UNKNOWN_RADIUS_M),)
    neighbours.forget(12.1)
    assert neighbours.robots(12.0, 9.0, "", 9.0) == ()
