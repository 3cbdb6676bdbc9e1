"""The schedule of the grid simulator: events in order of time, and in the order in which they were pushed."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.simulation.grid.schedule import Schedule


@given(st.lists(st.integers(0, 5)))
def test_events_happen_by_time_and_those_of_one_time_in_the_order_of_pushing(times: list[int]) -> None:
    schedule, seen = Schedule(), []
    for k, time in enumerate(times):
        schedule.push(time, seen.append, (time, k))
    assert not schedule.run(math.inf, lambda: False)
    assert seen == sorted(seen)
    assert len(seen) == schedule.events == len(times)


def test_it_runs_to_a_time_and_no_farther() -> None:
    schedule, seen = Schedule(), []
    for time in (1.0, 2.0, 3.0):
        schedule.at(time, lambda: seen.append(schedule.now))
    assert not schedule.run(2.0)
    assert (seen, schedule.now, schedule.next_event_s) == ([1.0, 2.0], 2.0, 3.0)
    assert not schedule.run(2.5)
    assert schedule.now == 2.5
    assert schedule.step()
    assert not schedule.step()
    assert (schedule.now, schedule.next_event_s) == (3.0, math.inf)


def test_it_stops_after_the_event_that_was_waited_for() -> None:
    schedule, seen = Schedule(), []
    for time in (1.0, 2.0, 3.0):
        schedule.at(time, lambda: seen.append(schedule.now))
    assert schedule.run(10.0, lambda: len(seen) == 2)
    assert schedule.now == 2.0


def test_an_event_may_push_others_of_its_own_time() -> None:
    schedule, seen = Schedule(), []
    schedule.at(1.0, lambda: schedule.at(1.0, lambda: seen.append("second")))
    schedule.at(1.0, lambda: seen.append("first"))
    schedule.run(1.0)
    assert seen == ["first", "second"]
