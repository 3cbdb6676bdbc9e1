"""What the benchmark of fleets counts: trips of the same robots with and without riding, growth, and what pays."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hitchhike_ros.experiments.bench.fleet import growth, modules_on
from hitchhike_ros.experiments.scenarios import fleet_runs
from hitchhike_ros.experiments.scenarios.fleet_runs import FleetTrip, run_fleet
from hitchhike_ros.simulation.grid.scenario import load_scenario
from repository import ROOT

SCENARIO = ROOT / "maps" / "fleet.scenario.yaml"


def trip(alone_s: float, took_s: float, coupled_s: float) -> FleetTrip:
    return FleetTrip("a", 60.0, alone_s, took_s, 60.0, 30.0, coupled_s, 5.0)


def test_a_small_fleet_is_compared_trip_by_trip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet_runs, "_LAST_TRIPS_S", 180.0)
    scenario = load_scenario(SCENARIO).sized(20)
    assert scenario.fleet is not None
    busy = replace(scenario.fleet, begin_s=(0.0, 30.0), rest_s=(0.0, 10.0))
    scenario = replace(scenario, duration_s=360.0, fleet=busy).changed(network={"range_m": 60.0})
    reported: list[tuple[str, int, int]] = []
    run = run_fleet(scenario, lambda *progress: reported.append(progress))
    assert reported[-1] == ("fleet of 20 (s)", 360, 360)
    assert (run.robots, run.duration_s, run.failed) == (20, 360.0, 0)
    assert run.real_time_factor == pytest.approx(360.0 / run.processor_s)
    assert run.processor_us == pytest.approx(1e6 * run.processor_s / 360.0 / 20)
    assert run.received > run.sent > 1.0 / 20.0  # beacons alone
    assert 5.0 < run.in_range < 19.0
    assert len(run.trips) >= 10
    assert run.rides > 0
    assert 0.0 < run.ridden_share < 0.9
    for one in run.trips:
        assert one.alone_s == pytest.approx(one.metres / 0.6, abs=3.0)
        assert one.ridden_m <= one.driven_m
        assert one.coupled_s <= one.took_s


def test_riding_pays_where_modules_are_off_for_longer_than_all_are_late() -> None:
    assert modules_on([trip(100.0, 110.0, 40.0), trip(100.0, 105.0, 0.0)]) == pytest.approx(175.0 / 200.0)
    assert modules_on([trip(100.0, 130.0, 20.0)]) > 1.0
    assert modules_on([]) == 1.0


def test_growth_is_the_exponent_of_a_power() -> None:
    assert growth([1.0, 10.0, 100.0], [3.0, 3.0 * 10**0.7, 3.0 * 100**0.7]) == pytest.approx(0.7)
