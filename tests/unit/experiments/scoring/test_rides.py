"""Which rides a run had, and when their steps began."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hitchhike_ros.experiments.scenarios.ride_record import (
    RideRecord,
)
from hitchhike_ros.experiments.scoring.rides import find_ride, module_changes
from synthetic_ride import DECOUPLING, RELEASED, REQUESTED, RIDING, synthetic_ride


@pytest.fixture
def record() -> RideRecord:
    return synthetic_ride()


def test_the_ride_is_the_one_that_was_coupled_and_its_wait_counts_from_the_first_request(record: RideRecord) -> None:
    ride = find_ride(record)
    assert ride is not None
    assert (ride.hitchhiker, ride.driver) == ("turtlebot", "p3dx")
    assert (ride.requested_at, ride.riding_at, ride.decoupling_at, ride.released_at) == (
        REQUESTED,
        RIDING,
        DECOUPLING,
        RELEASED,
    )


def test_where_another_left_before_the_nearer_decoupling_counts_although_it_is_stamped_later(
    record: RideRecord,
) -> None:
    driver, hitchhiker = record.robots["p3dx"], record.robots["turtlebot"]
    settled_at = next(s.time_stamp for s in hitchhiker.statuses if s.state == "settling")
    own = next(i for i, s in enumerate(driver.statuses) if s.state == "decoupling")
    of_both = replace(driver.statuses[own], time_stamp=50.0, convoy=("other", "turtlebot"))
    driver.statuses[own : own + 1] = [of_both, replace(driver.statuses[own], time_stamp=settled_at + 0.1)]
    ride = find_ride(record)
    assert ride is not None and ride.decoupling_at == settled_at + 0.1


def test_before_coupling_the_ride_knows_the_steps_so_far(record: RideRecord) -> None:
    hitchhiker = record.robots["turtlebot"]
    hitchhiker.statuses = [s for s in hitchhiker.statuses if s.time_stamp < RIDING]
    ride = find_ride(record)
    assert ride is not None
    assert (ride.aligning_at, ride.riding_at, ride.released_at, ride.couple_s) == (15.0, None, None, None)


def test_modules_over_time_are_those_of_table_3(record: RideRecord) -> None:
    changes = [change for change in module_changes(record) if change.robot == "turtlebot"]
    assert [change.state for change in changes] == ["idle", "riding", "relocalizing"]
    riding = changes[1].modules
    assert (riding.PP, riding.OBS, riding.LZN, riding.MAP, riding.COM, riding.VS) == (False,) * 4 + (True, True)
