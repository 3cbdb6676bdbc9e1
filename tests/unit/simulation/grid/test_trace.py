"""The trace of the grid simulator: who is told what, and what is kept in words."""

from __future__ import annotations

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.events import GoalGiven, Report
from hitchhike_ros.simulation.grid.inbox import ObjectInbox
from hitchhike_ros.simulation.grid.trace import Trace


def test_the_last_events_are_kept() -> None:
    trace = Trace(2)
    for k in range(3):
        trace.tell(float(k), "r", GoalGiven(Pose2D(k, 0.5)), [Report("off")] if k == 2 else [])
    assert list(trace.lines()) == [
        "     1.000 r          goal (1.00, 0.50)",
        "     2.000 r          goal (2.00, 0.50) -> report 'off'",
    ]


def test_observers_are_told_and_nothing_is_kept_where_nothing_is_to_be() -> None:
    trace, told = Trace(0), []
    assert not trace.wanted
    trace.observers.append(lambda *what: told.append(what))
    assert trace.wanted
    trace.tell(1.0, "r", "crash", ())
    assert told == [(1.0, "r", "crash", ())]
    assert list(trace.lines()) == []


def test_an_old_beacon_is_not_new() -> None:
    inbox = ObjectInbox()
    assert inbox.is_new("a", (1.0, 1))
    assert inbox.is_new("b", (1.0, 1))
    assert not inbox.is_new("a", (1.0, 1))
    assert inbox.is_new("a", (1.0, 2))
    assert not inbox.is_new("a", (0.5, 3))
    assert inbox.dropped == {"replayed": 2}
