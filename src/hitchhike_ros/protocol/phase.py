"""The phases of a ride, which both roles go through, and the base of the roles' states: each state belongs to a phase.

Whoever asks what a robot is at asks for the phase, together with the role, and never compares names of states.
"""

from __future__ import annotations

from enum import Enum
from typing import Self


class Phase(Enum):
    """How far a robot has come with a ride."""

    __hash__ = object.__hash__  # members are one of a kind, and phases are looked up at every event

    ALONE = "alone"
    ASKING = "asking"
    MEETING = "meeting"
    COUPLING = "coupling"
    COUPLED = "coupled"
    RETURNING = "returning"
    HANDING_OVER = "handing_over"
    PARTING = "parting"


ON_BOARD = (Phase.COUPLED, Phase.RETURNING, Phase.HANDING_OVER, Phase.PARTING)
"""Of a hitchhiker from the moment that it is coupled until it is on its own again."""


class RoleState(Enum):
    """A state of one role; members are declared with their name on the wire and their phase.

    ``DriverState("driving")`` is found by the name alone.
    """

    __hash__ = object.__hash__  # as above: every event looks a row up by its state

    phase: Phase

    def __new__(cls, name: str, phase: Phase) -> Self:
        state = object.__new__(cls)
        state._value_ = name
        state.phase = phase
        return state

    @classmethod
    def of(cls, *phases: Phase) -> tuple[Self, ...]:
        """All states of these phases, in the order of their declaration."""
        return tuple(state for state in cls if state.phase in phases)
