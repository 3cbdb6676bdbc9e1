"""How long coupling and decoupling take: short rides from the hitchhiking points of the papers' corridors.

The driver comes from where the world file has it start, the hitchhiker stands as the experiment says: in line where
there is a marker (P17 Exp. 1), anyhow where there is only the left wall (P17 Exp. 2). The ride is cut short, since its
length changes neither. What a seed changes: where both start, and the noise of wheels and laser.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.experiments.scenarios.composed_record import ComposedRecorder
from hitchhike_ros.experiments.scoring.ride_figures import find_ride
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.physics.world import World
from hitchhike_ros.simulation.world_file import load_world

_DRIVER, _RIDER = "p3dx", "turtlebot"
_RIDE_M, _LIMIT_S = 4.0, 90.0
_SIGMA = np.diag(np.square([0.05, 0.05, 0.03]))  # of the poses that an operator gives: x, y in m, theta in rad
_DRIVER_ASIDE = np.array([0.2, 0.2, 0.2])


@dataclass(frozen=True)
class Place:
    """A hitchhiking point, and how the hitchhiker stands there: x, y in m and theta in rad about its waiting pose.

    ``sigma`` are standard deviations, but a heading of infinite spread is any heading.
    """

    name: str
    world: str
    sigma: tuple[float, float, float]


MARKER = Place("with a marker", "p17_exp1", (0.05, 0.05, 0.05))
WALL = Place("by the left wall, from any heading", "p17_exp2", (0.1, 0.1, np.inf))


@dataclass(frozen=True)
class CouplingResult:
    """Seconds of simulated time; None where the step was not completed."""

    seed: int
    couple_s: float | None
    decouple_s: float | None
    contacts: tuple[str, ...]


def couple(package: Path, place: Place, seed: int) -> CouplingResult:
    """One short ride."""
    file = load_world(package / "maps" / f"{place.world}.world.yaml")
    point, rng = file.sites.hitchhiking_points[0], np.random.default_rng([seed, 41])
    aside = rng.normal(0.0, np.where(np.isinf(place.sigma), 0.0, place.sigma))
    if np.isinf(place.sigma[2]):
        aside[2] = rng.uniform(-np.pi, np.pi)
    goal = compose(point.aligning_pose, Pose2D(_RIDE_M))
    starts = {
        _DRIVER: compose(file.robots[_DRIVER].start, Pose2D(*rng.normal(0.0, _DRIVER_ASIDE).tolist())),
        _RIDER: compose(point.waiting_pose, Pose2D(*aside.tolist())),
    }
    robots = {name: replace(file.robots[name], start=start, goal=goal) for name, start in starts.items()}
    changes = {name: {"hitchhiking": {"min_ride_m": 0.5 * _RIDE_M}} for name in robots}
    with World(replace(file, boxes=(), robots=robots), seed, package=package) as world:
        composed = ComposedRide(world, package, changes=changes)
        recorder = ComposedRecorder(composed, seed)
        composed.start({name: PoseEstimate(0.0, start, _SIGMA) for name, start in starts.items()})
        rode = False
        for _ in recorder.run(_LIMIT_S):
            rode = rode or composed.robots[_RIDER].status.state == "riding"
            if rode and composed.robots[_RIDER].status.role != "hitchhiker":
                break
        ride = find_ride(recorder.record)
        contacts = tuple(f"{c.robot} and {c.other} at {c.stamp:.1f} s" for c in world.contacts())
    if ride is None:
        return CouplingResult(seed, None, None, contacts)
    return CouplingResult(seed, ride.couple_s, ride.decouple_s, contacts)
