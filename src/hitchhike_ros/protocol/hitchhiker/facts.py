"""What a hitchhiker knows: of its goal, of its newest request, and of the phase that it is in."""

from __future__ import annotations

from dataclasses import dataclass

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.hitchhiker.asking import Asking, Choice
from hitchhike_ros.protocol.hitchhiker.meeting import Rendezvous
from hitchhike_ros.protocol.hitchhiker.pursuit import Pursuit
from hitchhike_ros.protocol.hitchhiker.ride import Restart, Ride
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState as S
from hitchhike_ros.protocol.machine import Facts, of_phases
from hitchhike_ros.protocol.messages import EVERYBODY, PathPoints
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.phase import Phase

BEHIND_DRIVER = (Phase.COUPLING, Phase.COUPLED, Phase.RETURNING, Phase.HANDING_OVER, Phase.PARTING)
"""The phases in which there is a robot ahead, or was a moment ago."""


@dataclass(eq=False, kw_only=True)
class HitchhikerFacts(Facts):
    """What guards and deadlines of the table are functions of."""

    params: HitchhikingParameters
    neighbours: Neighbours

    # Of the goal.
    goal: Pose2D | None = None
    asked_since: float = 0.0
    rode: bool = False  # since it was given the goal
    whom: str = EVERYBODY  # it asks
    window_s: float  # for offers to come in
    ready_in_s: float = 0.0  # until it can start: the ride before may still be on

    # Of the newest request. They outlive the ride: its driver may still speak of it.
    ride_id: str = ""
    driver: str = ""  # whose offer was taken, for this request or an earlier one
    handed_over: bool = False  # whether that ride ended with a handover
    path: PathPoints | None = None  # from where it asked to the goal; None before it was planned

    # Of single phases.
    asking: Asking = of_phases(Phase.ASKING)
    choice: Choice = of_phases(S.LOCKING, Phase.MEETING, *BEHIND_DRIVER)
    rendezvous: Rendezvous = of_phases(S.LOCKING, Phase.MEETING, Phase.COUPLING)
    ride: Ride = of_phases(*BEHIND_DRIVER)
    restart: Restart | None = of_phases(S.LOCATING, S.RELOCALIZING)  # None where no pose could be given
    pursuit: Pursuit = of_phases(S.CATCHING_UP)
