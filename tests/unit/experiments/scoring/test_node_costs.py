"""CPU of every node in each phase of a run."""

from __future__ import annotations

import pytest

from hitchhike_ros.experiments.scenarios.ride_record import ClockSample, RideRecord
from hitchhike_ros.experiments.scoring.node_costs import node_costs, recent_real_time_factor
from hitchhike_ros.experiments.scoring.rides import find_ride, phases
from synthetic_ride import END, synthetic_ride


@pytest.fixture
def record() -> RideRecord:
    return synthetic_ride()


def test_cpu_is_told_by_node_and_phase_on_both_clocks(record: RideRecord) -> None:
    ride = find_ride(record)
    assert phases(record, ride) == {"coupling": (10.0, 25.0), "riding": (25.0, 65.8), "alone": (70.8, END)}
    cost = {cost.node: cost for cost in node_costs(record, ride)}["/turtlebot/slam"]
    assert (cost.cpu_s, cost.memory_mb) == (15.168, 50.0 + END)
    use = cost.phases["riding"]
    assert (use.cpu_s, use.sim_s, use.wall_s) == pytest.approx((0.408, 40.8, 51.0))


def test_the_recent_factor_is_that_of_the_last_seconds() -> None:
    record = RideRecord("", 0, (), {})
    assert recent_real_time_factor(record) is None
    record.clock = [ClockSample(0.0, 0.0), ClockSample(10.0, 10.0), ClockSample(12.0, 14.0)]
    assert recent_real_time_factor(record) == 0.5
