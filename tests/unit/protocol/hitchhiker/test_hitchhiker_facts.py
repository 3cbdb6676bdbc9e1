"""What belongs to a phase is known in that phase alone."""

from __future__ import annotations

import pytest

from hitchhike_ros.protocol.events import GoalCancelled
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.messages import Terminate
from hitchhike_ros.protocol.phase import Phase
from protocol_helpers import Bench, rider_in

S = HitchhikerState
BEHIND_DRIVER = S.of(Phase.COUPLING, Phase.COUPLED, Phase.RETURNING, Phase.HANDING_OVER, Phase.PARTING)
KNOWN = {
    "asking": (S.REQUESTING, S.LOCKING),
    "choice": (S.LOCKING, S.AWAITING_ALIGNED, *BEHIND_DRIVER),
    "rendezvous": (S.LOCKING, S.AWAITING_ALIGNED, S.COUPLING),
    "ride": BEHIND_DRIVER,
    "restart": (S.LOCATING, S.RELOCALIZING),
    "pursuit": (S.CATCHING_UP,),
}


def _known(bench: Bench) -> set[str]:
    return {name for name in KNOWN if hasattr(bench.machine.facts, name)}


@pytest.mark.parametrize("mode", ["local", "network"])
@pytest.mark.parametrize("state", S)
def test_what_is_known_in_each_state(state: HitchhikerState, mode: str) -> None:
    bench = rider_in(state, mode=mode)
    assert _known(bench) == {name for name, states in KNOWN.items() if state in states}


@pytest.mark.parametrize("state", S)
def test_what_is_over_is_forgotten(state: HitchhikerState) -> None:
    bench = rider_in(state)
    bench.hear(Terminate)
    bench.step(GoalCancelled())
    bench.pose = None
    bench.wait(bench.machine.params.localize_timeout_s + 0.2)
    assert (bench.machine.state, _known(bench)) == (S.IDLE, set())
