"""The rides of bench following: what is drawn for a seed."""

from __future__ import annotations

import pytest

from hitchhike_ros.core.geometry import distance
from hitchhike_ros.experiments.scenarios.following_rides import (
    CORNERS,
    DRIVER,
    FAST,
    RIDER,
    S_BEND,
    STRAIGHT,
    build,
    changes_of,
)
from simulated_room import PACKAGE


@pytest.mark.parametrize("course", [STRAIGHT, FAST, CORNERS, S_BEND])
def test_the_pair_starts_aligned_on_free_ground(course) -> None:
    file = build(course, PACKAGE, 3)
    gap = distance(file.robots[DRIVER].start, file.robots[RIDER].start)
    assert gap == pytest.approx(1.2, abs=0.15)
    assert build(course, PACKAGE, 3) == file != build(course, PACKAGE, 4)
    assert {box.id for box in course.doors} <= {box.id for box in file.boxes}
    assert changes_of(course)[DRIVER]["hitchhiking"]["ride_speed_mps"] == course.speed_mps
