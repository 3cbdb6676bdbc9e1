"""Fault runs: nothing is broken, runs repeat, and the referee sees it when a rule is broken on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import pytest

from hitchhike_ros.experiments.faults.fleets import SEVERE, fault_run
from hitchhike_ros.protocol.agent import Agent
from hitchhike_ros.protocol.driver import machine as d
from hitchhike_ros.protocol.driver.convoy import Convoy, Rider
from hitchhike_ros.protocol.driver.facts import DriverFacts
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.events import Award, Send, TakeObstacles
from hitchhike_ros.protocol.hitchhiker import machine as h
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.hitchhiker.ride import Ride
from hitchhike_ros.protocol.machine import Machine, Table
from hitchhike_ros.protocol.matching import Stretch
from hitchhike_ros.protocol.messages import Ack

# Bad networks and worse ones take turns.
SEEDS = [seed for k in range(100) for seed in (k, SEVERE + k)]


def test_no_invariant_is_broken() -> None:
    results = [fault_run(seed) for seed in SEEDS[:40]]
    assert [(r.seed, r.failure) for r in results if r.failure] == []
    assert sum(r.completed for r in results) >= 10  # there was something to break


@pytest.mark.parametrize("seed", [3, SEVERE + 3])
def test_a_run_repeats(seed: int) -> None:
    assert fault_run(seed) == fault_run(seed)


Patch = Callable[[pytest.MonkeyPatch], None]


def _before(cls: type, name: str, change: Callable[..., Any]) -> Patch:
    """The method with ``change(original, self, *args)`` in its place."""

    def patch(monkeypatch: pytest.MonkeyPatch) -> None:
        original = getattr(cls, name)
        monkeypatch.setattr(cls, name, lambda self, *args, **kw: change(original, self, *args, **kw))

    return patch


def _without_timeout(cls: Any, state: object) -> Patch:
    def patch(monkeypatch: pytest.MonkeyPatch) -> None:
        table = Table(cls.ROWS)
        del table.deadlines[state]
        monkeypatch.setattr(cls, "TABLE", table)

    return patch


def _credit_twice(original: Any, self: DriverMachine, *args: Any, **kw: Any) -> None:
    original(self, *args, **kw)
    self._effects += [effect for effect in self._effects if isinstance(effect, Award)]


def _without_obstacles(original: Any, self: HitchhikerMachine, *args: Any) -> None:
    original(self, *args)
    self._effects[:] = [effect for effect in self._effects if not isinstance(effect, TakeObstacles)]


def _count_twice(original: Any, self: DriverMachine, *args: Any, **kw: Any) -> None:
    before = {id(rider): rider.ridden_m for rider in self.rides}
    original(self, *args, **kw)
    for rider in self.rides:
        rider.ridden_m += rider.ridden_m - before[id(rider)]


def _never_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DriverFacts, "free_places", property(lambda _self: 1))


def _fast_with_riders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DriverFacts, "speed_limit_mps", property(lambda self: self.params.safe_speed_mps))


def _keep(_original: Any, self: Convoy, rider: Rider) -> None:
    self._riders[self._riders.index(rider)] = replace(rider)


def _join_again(original: Any, self: DriverMachine, lock: Any) -> None:
    self.facts.convoy.add(replace(self._rider(lock)))
    original(self, lock)


def _credit_nobody(original: Any, self: DriverMachine, *args: Any, **kw: Any) -> None:
    original(self, *args, **kw)
    self._effects[:] = [effect for effect in self._effects if not isinstance(effect, Award)]


def _wait_for_coupling(monkeypatch: pytest.MonkeyPatch) -> None:
    _without_timeout(DriverMachine, d.S.ALIGNED)(monkeypatch)
    _before(Convoy, "silent", lambda *_: ())(monkeypatch)


def _end_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Stretch, "end", property(lambda self: self.line.pose(self.end_m - 5.0)))


def _end_early_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    _end_early(monkeypatch)
    monkeypatch.setattr(d, "RIDE_TOLERANCE_M", 5.0)


def _tell_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def confirm(original: Any, self: DriverMachine, lock: Any) -> None:
        original(self, lock)
        self._effects[:] = [
            replace(effect, message=replace(effect.message, ride_m=effect.message.ride_m + 6.0))
            if isinstance(effect, Send) and isinstance(effect.message, Ack)
            else effect
            for effect in self._effects
        ]

    _before(DriverMachine, "_confirm_lock", confirm)(monkeypatch)


def _nothing(*_: Any, **__: Any) -> None:
    return None


MUTATIONS: dict[str, Patch] = {
    "skip the cancel": _before(HitchhikerMachine, "_cancel_offers", _nothing),
    "leave late offers unanswered": _before(HitchhikerMachine, "_refuse_offer", _nothing),
    "credit twice": _before(DriverMachine, "_finish", _credit_twice),
    "credit nobody": _before(DriverMachine, "_finish", _credit_nobody),
    "count metres twice": _before(DriverMachine, "_count_metres", _count_twice),
    "never count metres": _before(DriverMachine, "_count_metres", _nothing),
    "wait for a rider for ever": _without_timeout(DriverMachine, d.S.WAITING_FOR_RIDER),
    "wait for coupling for ever": _wait_for_coupling,
    "hand over for ever": _without_timeout(DriverMachine, d.S.DECOUPLING),
    "ask for a lock for ever": _without_timeout(HitchhikerMachine, h.S.LOCKING),
    "believe in a silent driver": _before(Ride, "silent", lambda *_: False),
    "never miss a rider": _before(Convoy, "missing", lambda *_: ()),
    "keep a rider that has left": _before(DriverMachine, "_drop_sender", _nothing),
    "keep a rider that was handed over": _before(Convoy, "remove", _keep),
    "give a place twice": _before(DriverMachine, "_confirm_lock", _join_again),
    "more riders than places": _never_free,
    "take the map without its boxes": _before(HitchhikerMachine, "_restart", _without_obstacles),
    "forget the goal after a ride": _before(Agent, "_go_on", lambda *_: []),
    "say everything at every tick": _before(Machine, "_every", lambda *_: True),
    "hurry with a rider": _fast_with_riders,
    "end a ride before its end": _end_early,
    "end a ride before its end and credit all of it": _end_early_for_all,
    "tell a length that is not kept": _tell_more,
}


@pytest.mark.parametrize("rule", MUTATIONS)
def test_a_rule_that_is_broken_on_purpose_is_caught_within_200_seeds(
    rule: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    MUTATIONS[rule](monkeypatch)
    caught = islice((result for result in map(_run, SEEDS) if result), 1)
    assert next(caught, ""), f"{len(SEEDS)} runs hold although they {rule}"


def _run(seed: int) -> str:
    """What the run of a seed breaks; a machine that falls over what a rule would have kept from it counts."""
    try:
        return fault_run(seed).failure
    except (AssertionError, AttributeError, KeyError, ValueError, StopIteration, TypeError) as exc:
        return f"{type(exc).__name__}: {exc}"
