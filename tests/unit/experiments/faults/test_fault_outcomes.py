"""Fault seeds come out as they did: a change of the machines that is meant to change nothing changes nothing."""

from __future__ import annotations

import json

import pytest

from fault_outcomes import FILE, SEEDS, outcome
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState

EXPECTED = json.loads(FILE.read_text(encoding="utf-8"))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_seed_comes_out_as_it_did(seed: int) -> None:
    assert outcome(seed) == EXPECTED[str(seed)]


def test_the_seeds_come_to_every_state() -> None:
    states = {state.split(":")[0] for seed in EXPECTED.values() for robot in seed["states"].values() for state in robot}
    assert states == {state.value for state in (*DriverState, *HitchhikerState)}
