"""Every arrow of a machine's diagram is taken by some run: no table promises what cannot happen.

A search starts again and again from machines that it has brought to some state before, rather from one with arrows that
it has not seen taken. A few times it picks a row of the present state and lets happen what the row waits for, with
content by chance.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Hashable
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.protocol.diagrams import label
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.driver.table import is_offered
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven, NavigationReport, Situation, Tick
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.machine import Deadline, Machine, Row, arrows
from hitchhike_ros.protocol.messages import Ack, Beacon, Decouple, Driver, Lock, Request
from hitchhike_ros.protocol.parameters import HitchhikingParameters, Mode
from hitchhike_ros.protocol.status import GoalCommand
from protocol_helpers import (
    CAMERA,
    DRIVER,
    DRIVER_GOAL,
    MARKER_POSE,
    RIDER,
    RIDER_GOAL,
    SIGMA,
    SITES,
    WEST,
    corridor_path,
    messages,
)

Arrow = tuple[Any, Row]
RUNS, STEPS = 10_000, 6
KEPT = 40
"""Machines of a state at most, from which runs start."""


@dataclass
class Walk:
    """One machine, and the time."""

    machine: Any
    now: float = 1000.0


@dataclass(frozen=True)
class Search:
    """Machines of one class as they begin, and what happens to them: an event of a class, with content by chance."""

    begin: tuple[Any, ...]
    shape: Callable[[Any], Hashable]
    """What machines of one state are told apart by, so that the search starts from each."""
    happen: Callable[[Any, type, float, random.Random], object]


def begin_driver(mode: Mode, places: int, exact_goal: bool = False) -> DriverMachine:
    hasty: dict[str, Any] = {"stuck_timeout_s": 0.1, "planner_patience_s": 0.1, "contact_timeout_s": 0.5}
    params = HitchhikingParameters(mode=mode, places=places, min_ride_m=5.0, exact_goal=exact_goal, **hasty)
    machine = DriverMachine(DRIVER, params, SITES, corridor_path, MARKER_POSE)
    machine.facts.said = Beacon(robot_id=DRIVER, state="navigating", profile=50.0, priority=10, goal=DRIVER_GOAL)
    return machine


def shape_of_driver(machine: DriverMachine) -> Hashable:
    return tuple(sorted((rider.coupled, rider.leaving) for rider in machine.rides))


def happen_to_driver(machine: DriverMachine, event: type, now: float, luck: random.Random) -> object:
    if event is GoalGiven:
        return GoalGiven(DRIVER_GOAL, set_down=luck.random() < 0.3)
    if event is GoalCancelled:
        return GoalCancelled()
    if event is Tick:
        near = Pose2D(DRIVER_GOAL.x, DRIVER_GOAL.y - luck.choice((0.8, 3.0)))
        pose = luck.choice((WEST.aligning_pose, WEST.aligning_pose, Pose2D(10.0, 5.72), near, DRIVER_GOAL))
        parked = Pose2D(DRIVER_GOAL.x, DRIVER_GOAL.y - luck.choice((0.0, 0.0, 0.4, 9.0)))
        machine.facts.neighbours.hear(
            Beacon(robot_id="parked", state="idle", profile=50.0, priority=10, pose=parked), now
        )
        return Tick(_situation(machine.goal, pose, now, luck))
    rider = luck.choice(machine.rides) if machine.rides and luck.random() < (0.5 if event is Request else 0.9) else None
    name = luck.choice("abc") if rider is None else rider.offer.hitchhiker
    ride_id = f"{name}-{luck.randint(1, 2)}" if rider is None else rider.offer.ride_id
    if event is Request and rider is not None and luck.random() < 0.7:
        ride_id = f"{name}-{luck.randint(1, 9)}"
    if event is Lock and machine.facts.promised and luck.random() < 0.5:
        name, ride_id = luck.choice(list(machine.facts.promised))
    message = messages(name, DRIVER, ride_id)[event]
    if isinstance(message, Request):
        goal, in_s = luck.choice((RIDER_GOAL, Pose2D(15.0, 5.0), Pose2D(2.0, 5.0))), luck.choice((0.0, 0.0, 5.0))
        return replace(message, goal=goal, in_s=in_s)
    if isinstance(message, Lock):
        places = {
            "aligning": WEST.aligning_pose,
            "waiting": WEST.waiting_pose,
            "leave": (luck.choice((15.0, 24.0)), 5.72),
        }
        there: dict[str, Any] = places if machine.params.mode == "network" else {}
        return replace(message, **there, rear_marker=machine.facts.rear_marker)
    if isinstance(message, Ack):
        of = luck.choice((Driver.type, Decouple.type))
        return replace(message, of=of, following=luck.random() < 0.7, gap_m=luck.choice((0.8, 3.0)))
    return message


def _situation(goal: GoalCommand | None, pose: Pose2D, now: float, luck: random.Random) -> Situation:
    state = luck.choice(("driving", "driving", "arrived", "blocked", "failed"))
    report = None if goal is None else NavigationReport(goal.id, state)
    return Situation(PoseEstimate(now, pose, np.array(SIGMA)), luck.choice((0.0, 0.5)), navigation=report)


def begin_hitchhiker(mode: Mode) -> HitchhikerMachine:
    hasty = {"message_timeout_s": 2.0, "contact_timeout_s": 2.0, "planner_patience_s": 0.2, "look_s": 0.2}
    params = HitchhikingParameters(mode=mode, offer_window_s=1.0, seek_timeout_s=1.0, min_ride_m=5.0, **hasty)
    return HitchhikerMachine(RIDER, params, SITES, CAMERA)


def shape_of_hitchhiker(machine: HitchhikerMachine) -> Hashable:
    if machine.state is HitchhikerState.REQUESTING:
        return len(machine.facts.asking.offers)
    if machine.state is HitchhikerState.AWAITING_ALIGNED:
        return machine.way is not None, machine.facts.rendezvous.there_is_no_way(math.inf)
    return hasattr(machine.facts, "ride") and machine.facts.ride.silent(machine.facts.now)


def happen_to_hitchhiker(machine: HitchhikerMachine, event: type, now: float, luck: random.Random) -> object:
    if event is GoalGiven:
        return GoalGiven(luck.choice((RIDER_GOAL, Pose2D(2.0, 9.0))))
    if event is GoalCancelled:
        return GoalCancelled()
    if event is Tick:
        pose = luck.choice((WEST.waiting_pose, WEST.waiting_pose, Pose2D(1.7, 5.72), Pose2D(8.0, 5.72), None))
        situation = _situation(machine.way, pose or Pose2D(), now, luck)
        gap_m = luck.choice((0.8, 0.8, 1.3, None))
        seen = None
        if gap_m is not None:
            seen = MarkerObservation(now, 0, Pose2D(CAMERA[0] + gap_m, 0.0, math.pi), np.array(SIGMA))
        estimate = None if pose is None else situation.estimate
        return Tick(replace(situation, estimate=estimate, observation=seen))
    driver = DRIVER if luck.random() < 0.7 else luck.choice("ab")
    message = messages(driver, RIDER, machine.ride_id)[event]
    if isinstance(message, Ack):
        of, in_s = luck.choice((Lock.type, Lock.type, Driver.type)), luck.choice((0.0, 0.0, 500.0))
        return replace(message, of=of, in_s=in_s)
    return message


DRIVERS = (
    *(begin_driver(mode, places) for mode in get_args(Mode) for places in (1, 2)),
    begin_driver("local", 1, exact_goal=True),
)
HITCHHIKERS = tuple(begin_hitchhiker(mode) for mode in get_args(Mode))
SEARCHES: dict[str, Search] = {
    "driver": Search(DRIVERS, shape_of_driver, happen_to_driver),
    "hitchhiker": Search(HITCHHIKERS, shape_of_hitchhiker, happen_to_hitchhiker),
}


def _copy(walk: Walk) -> Walk:
    return deepcopy(walk, {id(SITES): SITES, id(walk.machine.params): walk.machine.params})


def _step(walk: Walk, search: Search, wanted: set[Arrow], luck: random.Random) -> None:
    """Let happen what one of the rows of the present state waits for."""
    state, table = walk.machine.state, walk.machine.TABLE
    rows = [
        *(row for (begin, _), rows in table.events.items() if begin is state for row in rows),
        *(row for row in table.ticks.get(state, ()) if isinstance(row, Row)),
        *table.deadlines.get(state, ()),
    ]
    row = luck.choices(rows, [4.0 if (state, row) in wanted else 1.0 for row in rows])[0]
    walk.now += luck.choice((0.05, 0.05, 0.3, 0.3, 0.6, 0.6, 2.5))
    event = row.on
    if isinstance(event, Deadline):
        walk.now += min(event.limit(walk.machine.facts), 1000.0)
        event = Tick
    walk.machine.step(search.happen(walk.machine, event, walk.now, luck), walk.now)
    walk.machine._last_words, walk.machine._effects = [], []  # what it says does not matter, and costs copies


def never_taken(search: Search, runs: int) -> set[Arrow]:
    """The arrows that none of so many runs has taken."""
    luck = random.Random(0)
    wanted: set[Arrow] = set(arrows(search.begin[0].ROWS))
    take = Machine._take

    def watched(self: Machine[Any, Any], row: Row, *event: object) -> None:
        wanted.discard((self.state, row))
        take(self, row, *event)

    # Of each machine that begins, those that it has become, by state and shape.
    kept = [{(machine.state, search.shape(machine)): [Walk(machine)]} for machine in search.begin]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Machine, "_take", watched)
        for run in range(runs):
            if not wanted:
                break
            reached = kept[run % len(kept)]
            promising = [key for key in reached if any(key[0] is begin for begin, _ in wanted)]
            key = luck.choice(promising if promising and luck.random() < 0.5 else list(reached))
            walk = _copy(luck.choice(reached[key]))
            for _ in range(STEPS):
                _step(walk, search, wanted, luck)
                if (new := (walk.machine.state, search.shape(walk.machine))) != key:
                    key, here = new, reached.setdefault(new, [])
                    here.append(_copy(walk))
                    del here[:-KEPT]
    return wanted


@pytest.mark.parametrize("name", SEARCHES)
def test_each_arrow_is_taken_by_some_run(name: str) -> None:
    missing = never_taken(SEARCHES[name], RUNS)
    assert not missing, sorted(f"{state.value} -> {row.to.value}: {label(row)}" for state, row in missing)


def test_an_arrow_that_cannot_be_taken_is_found() -> None:
    forged = Row((DriverState.IDLE,), Request, "_offer", DriverState.OFFERING, (is_offered,))
    eager = type("EagerDriver", (DriverMachine,), {"ROWS": (forged, *DriverMachine.ROWS)})
    machines = tuple(eager(DRIVER, m.params, SITES, corridor_path, MARKER_POSE) for m in DRIVERS)
    missing = never_taken(replace(SEARCHES["driver"], begin=machines), 200)
    assert (DriverState.IDLE, forged) in missing
    assert len(missing) < len(list(arrows(eager.ROWS)))
