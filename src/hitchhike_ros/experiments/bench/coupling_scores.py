"""The short rides of :mod:`couplings`, driven, and how long their coupling and decoupling took."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hitchhike_ros.core.datatypes import PoseEstimate
from hitchhike_ros.experiments.scenarios.composed_record import ComposedRecorder
from hitchhike_ros.experiments.scenarios.couplings import CHANGES, LIMIT_S, RIDER, SIGMA, CouplingPlace, build
from hitchhike_ros.experiments.scoring.rides import find_ride
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.physics.world import World


@dataclass(frozen=True)
class CouplingResult:
    """Seconds of simulated time; None where the step was not completed."""

    seed: int
    couple_s: float | None
    decouple_s: float | None
    contacts: tuple[str, ...]


def couple(package: Path, place: CouplingPlace, seed: int) -> CouplingResult:
    """One short ride, until its hitchhiker drives on by itself."""
    file = build(place, package, seed)
    with World(file, seed, package=package) as world:
        composed = ComposedRide(world, package, changes=CHANGES)
        recorder = ComposedRecorder(composed, seed)
        composed.start({name: PoseEstimate(0.0, entry.start, SIGMA) for name, entry in file.robots.items()})
        recorder.run_ride(RIDER, LIMIT_S)
        ride = find_ride(recorder.record)
        contacts = tuple(map(str, world.contacts()))
    if ride is None:
        return CouplingResult(seed, None, None, contacts)
    return CouplingResult(seed, ride.couple_s, ride.decouple_s, contacts)
