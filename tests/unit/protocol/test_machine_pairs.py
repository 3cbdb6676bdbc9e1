"""Every pair of state and event of both machines: a row of the table, or a defined nothing."""

from __future__ import annotations

from enum import Enum

import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.messages import MESSAGE_TYPES, Message
from protocol_helpers import DRIVER, RIDER, Bench, driver_in, messages, rider_in

PAIRS = [
    (state, event)
    for states in (DriverState, HitchhikerState)
    for state in states
    for event in (*MESSAGE_TYPES.values(), GoalGiven, GoalCancelled)
]


def _bench_in(state: Enum) -> Bench:
    return driver_in(state) if isinstance(state, DriverState) else rider_in(state)


def _event(state: Enum, cls: type, ride_id: str) -> object:
    if cls is GoalGiven:
        return GoalGiven(Pose2D(20.0, 5.0, 0.0))
    if cls is GoalCancelled:
        return GoalCancelled()
    sender, to = (RIDER, DRIVER) if isinstance(state, DriverState) else (DRIVER, RIDER)
    return messages(sender, to, ride_id)[cls]


@pytest.mark.parametrize(("state", "cls"), PAIRS, ids=lambda value: getattr(value, "value", None) or value.__name__)
def test_what_no_row_names_is_counted_or_raises(state: Enum, cls: type) -> None:
    bench = _bench_in(state)
    machine = bench.machine
    ride = machine.ride
    event = _event(state, cls, "ride" if ride is None else ride.ride_id)
    if rows := machine.TABLE.events.get((state, cls)):
        machine.step(event, bench.now)
        assert machine.state is state or machine.state in {row.to for row in rows}
        return
    ignored = machine.ignored
    if issubclass(cls, Message):
        assert machine.step(event, bench.now) == []
        assert machine.ignored == ignored + 1
    else:
        with pytest.raises(TransitionError, match=rf"{cls.__name__} is not allowed in {state.value}"):
            machine.step(event, bench.now)
    assert machine.state is state
    assert machine.ride == ride
