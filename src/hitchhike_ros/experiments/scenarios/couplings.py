"""Short rides from the hitchhiking points of the papers' corridors, to see coupling and decoupling.

The driver comes from where the world file has it start, the hitchhiker stands as the experiment says: in line where
there is a marker (P17 Exp. 1), anyhow where there is only the left wall (P17 Exp. 2). The ride is cut short, since its
length changes neither. A seed changes where both start, and the noise of wheels and laser.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.simulation.composed import Changes
from hitchhike_ros.simulation.world_file import WorldFile, load_world

DRIVER, RIDER = "p3dx", "turtlebot"
LIMIT_S = 90.0
SIGMA = np.diag(np.square([0.05, 0.05, 0.03]))  # of the poses that an operator gives: x, y in m, theta in rad
_RIDE_M = 4.0
_DRIVER_ASIDE = np.array([0.2, 0.2, 0.2])
CHANGES: dict[str, Changes] = {name: {"hitchhiking": {"min_ride_m": 0.5 * _RIDE_M}} for name in (DRIVER, RIDER)}
"""What differs from the parameter files: so short a ride is worth it."""


@dataclass(frozen=True)
class CouplingPlace:
    """A hitchhiking point, and how the hitchhiker stands there: x, y in m and theta in rad about its waiting pose.

    ``sigma`` are standard deviations, but a heading of infinite spread is any heading.
    """

    name: str
    world: str
    sigma: tuple[float, float, float]


MARKER = CouplingPlace("with a marker", "p17_exp1", (0.05, 0.05, 0.05))
WALL = CouplingPlace("by the left wall, from any heading", "p17_exp2", (0.1, 0.1, np.inf))


def build(place: CouplingPlace, package: Path, seed: int) -> WorldFile:
    """The world file of a place with the pair of a seed."""
    file = load_world(package / "maps" / f"{place.world}.world.yaml")
    point, rng = file.sites.hitchhiking_points[0], np.random.default_rng([seed, 41])
    aside = rng.normal(0.0, np.where(np.isinf(place.sigma), 0.0, place.sigma))
    if np.isinf(place.sigma[2]):
        aside[2] = rng.uniform(-np.pi, np.pi)
    goal = compose(point.aligning_pose, Pose2D(_RIDE_M))
    starts = {
        DRIVER: compose(file.robots[DRIVER].start, Pose2D(*rng.normal(0.0, _DRIVER_ASIDE).tolist())),
        RIDER: compose(point.waiting_pose, Pose2D(*aside.tolist())),
    }
    robots = {name: replace(file.robots[name], start=start, goal=goal) for name, start in starts.items()}
    return replace(file, boxes=(), robots=robots)
