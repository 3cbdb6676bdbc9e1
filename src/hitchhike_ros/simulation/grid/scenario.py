"""Scenario files of the grid simulator: a map, places, a network, and robots that are named or drawn by a seed.

A file may begin with ``base``, as world files may.
"""

from __future__ import annotations

import math
import os
import random
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from hitchhike_ros.core.datatypes import NonNegative, Obstacle, Pose2D, Positive, UnitInterval
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.mapping.sites import (
    Sites,
    parse_sites,
    read_entry,
    read_list,
    read_mapping,
    read_world,
    require_unique,
)
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.robot import Errand
from hitchhike_ros.simulation.grid.world import GridWorld
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters, check_network

Count = Annotated[int, msgspec.Meta(ge=1)]

# Two places where robots of a fleet go are not nearer to each other (chosen).
_APART_M = 2.0
_TRIES = 10_000


@dataclass(frozen=True)
class ScenarioRobot:
    """A robot by name. ``hitchhiking`` is what differs from the scenario's parameters."""

    start: Pose2D
    goal: Pose2D | None = None
    begins_s: NonNegative = 0.0
    goal_at_s: NonNegative = 0.0
    clock_offset_s: float = 0.0
    hitchhiking: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Fleet:
    """Robots drawn by a seed: each drives ``trips`` from place to place, and rests in between.

    ``places`` are drawn on the map, so far from obstacles and from each other as a robot needs.
    """

    robots: Count = 10
    trips: Count = 2
    places: Annotated[int, msgspec.Meta(ge=2)] = 40
    least_trip_m: NonNegative = 30.0
    most_trip_m: Positive = 1e6
    rest_s: tuple[NonNegative, NonNegative] = (0.0, 60.0)
    begin_s: tuple[NonNegative, NonNegative] = (0.0, 60.0)
    profile: tuple[float, float] = (0.0, 100.0)
    only_drive: UnitInterval = 0.0  # this share of the robots never asks for a ride


@dataclass(frozen=True)
class Scenario:
    """Everything in a scenario file. ``settings`` is for whoever runs it and is not looked at here."""

    path: Path
    map: Path
    sites: Sites = field(default_factory=Sites)
    boxes: tuple[Obstacle, ...] = ()
    network: NetworkParameters = field(default_factory=NetworkParameters)
    world: GridWorldParameters = field(default_factory=GridWorldParameters)
    hitchhiking: Mapping[str, Any] = field(default_factory=dict)
    robots: Mapping[str, ScenarioRobot] = field(default_factory=dict)
    fleet: Fleet | None = None
    duration_s: float = 600.0
    settings: Mapping[str, Any] = field(default_factory=dict)

    def parameters(self, robot: ScenarioRobot, marker_id: int) -> HitchhikingParameters:
        """The parameters of one robot."""
        merged = {"marker_id": marker_id, **self.hitchhiking, **robot.hitchhiking}
        return convert(merged, HitchhikingParameters, self.path, "hitchhiking", WorldFileError)

    def seeded(self, seed: int) -> Scenario:
        """The same scenario with another seed of the network, the noise and the fleet."""
        return replace(self, network=replace(self.network, seed=seed), world=replace(self.world, seed=seed))

    def sized(self, robots: int) -> Scenario:
        """The same scenario with a fleet of so many."""
        if self.fleet is None:
            raise WorldFileError(self.path, "fleet", None, "a fleet")
        return replace(self, fleet=replace(self.fleet, robots=robots))

    def changed(
        self,
        network: Mapping[str, Any] | None = None,
        hitchhiking: Mapping[str, Any] | None = None,
        robots: Mapping[str, ScenarioRobot] | None = None,
    ) -> Scenario:
        """The same scenario with these values in place of its own."""
        return replace(
            self,
            network=replace(self.network, **(network or {})),
            hitchhiking={**self.hitchhiking, **(hitchhiking or {})},
            robots=self.robots if robots is None else robots,
        )


@dataclass(frozen=True)
class _Scalars:
    map: str
    duration_s: Positive = 600.0


def load_scenario(path: Path | str) -> Scenario:
    """Read and check a scenario file; relative paths in it start at its folder.

    Raises:
        WorldFileError: names the file, the field, its value and what was expected.
    """
    path = Path(path)
    content = read_world(path)
    own = {f.name for f in fields(Scenario)} - {"path", "sites"}
    known = own | {"markers", "hitchhiking_points"}
    for key in content:
        if key not in known:
            raise WorldFileError(path, str(key), content[key], f"one of the fields {', '.join(sorted(known))}")
    if "map" not in content:
        raise WorldFileError(path, "map", None, "the path of a map_server YAML file")
    scalars = convert(
        {f.name: content[f.name] for f in fields(_Scalars) if f.name in content}, _Scalars, path, error=WorldFileError
    )
    if not os.path.isfile(scalars.map):
        raise WorldFileError(path, "map", scalars.map, "the path of a map_server YAML file")
    boxes = read_list(content, "boxes", Obstacle, path)
    require_unique((box.id for box in boxes), "boxes", "id", path)
    common = read_mapping(content, "hitchhiking", path)
    convert(common, HitchhikingParameters, path, "hitchhiking", WorldFileError)
    robots = {
        str(name): _robot(entry, path, f"robots.{name}")
        for name, entry in read_mapping(content, "robots", path).items()
    }
    fleet = read_entry(content["fleet"], Fleet, path, "fleet") if content.get("fleet") is not None else None
    if not robots and fleet is None:
        raise WorldFileError(path, "robots", content.get("robots"), "robots by name, or a fleet")
    scenario = Scenario(
        path=path,
        map=Path(scalars.map),
        sites=parse_sites(content, path),
        boxes=boxes,
        network=check_network(
            convert(read_mapping(content, "network", path), NetworkParameters, path, "network"), path
        ),
        world=read_entry(read_mapping(content, "world", path), GridWorldParameters, path, "world"),
        hitchhiking=common,
        robots=robots,
        fleet=fleet,
        duration_s=scalars.duration_s,
        settings=read_mapping(content, "settings", path),
    )
    markers: dict[int, str] = {}
    for i, (name, robot) in enumerate(robots.items()):
        params = scenario.parameters(robot, i)
        if params.marker_id in markers:
            raise WorldFileError(path, f"robots.{name}", params.marker_id, "a marker_id that no other robot has")
        markers[params.marker_id] = name
    return scenario


def build(scenario: Scenario, **world: Any) -> GridWorld:
    """Build the world of a scenario with all its robots, at time 0; ``world`` changes its parameters.

    Raises:
        WorldFileError: a robot stands, or is wanted, where none may be, or the map has not enough room for the fleet.
        MapFileError: as :func:`load_map`.
    """
    grid = load_map(scenario.map)
    params = replace(scenario.world, **world)
    made = GridWorld(grid, scenario.sites, NetworkModel(scenario.network), params, scenario.boxes)
    for i, (name, robot) in enumerate(scenario.robots.items()):
        for what, pose in (("start", robot.start), ("goal", robot.goal)):
            if pose is not None and not made.paths.free((pose.x, pose.y)):
                expected = f"a pose with {made.paths.clearance_m:.2f} m of room around it"
                raise WorldFileError(scenario.path, f"robots.{name}.{what}", (pose.x, pose.y), expected)
        errands = [] if robot.goal is None else [Errand(robot.goal, robot.goal_at_s)]
        parameters = scenario.parameters(robot, i)
        made.add_robot(name, robot.start, parameters, errands, robot.clock_offset_s, robot.begins_s)
    if scenario.fleet is not None:
        _add_fleet(made, scenario, scenario.fleet)
    return made


def _add_fleet(world: GridWorld, scenario: Scenario, fleet: Fleet) -> None:
    """Draw places first, so that fleets of two sizes go to the same ones; each robot has a seed of its own."""
    places = _places(world, scenario, fleet)
    for k in range(fleet.robots):
        luck = random.Random(f"{world.params.seed} {k}")
        here = luck.choice(places)
        start, begins, errands = here, luck.uniform(*fleet.begin_s), []
        for trip in range(fleet.trips):
            there = _next_place(world, places, here, fleet, luck)
            after = luck.uniform(*fleet.rest_s) if trip else 0.0
            errands.append(Errand(Pose2D(*there, luck.uniform(-math.pi, math.pi)), begins, after))
            here = there
        own: dict[str, Any] = {"profile": luck.uniform(*fleet.profile)}
        if luck.random() < fleet.only_drive:
            own["may_ride"] = False
        robot = ScenarioRobot(Pose2D(*start), hitchhiking=own)
        params = scenario.parameters(robot, len(world.robots))
        # Beacons of a fleet do not all fall on the same moment.
        world.add_robot(f"r{k:04d}", robot.start, params, errands, begins_s=luck.uniform(0.0, params.beacon_period_s))


def _places(world: GridWorld, scenario: Scenario, fleet: Fleet) -> list[tuple[float, float]]:
    luck = random.Random(f"{world.params.seed} places")
    grid = world.grid
    found: list[tuple[float, float]] = []
    reachable = world.paths.region()
    rows, columns = np.nonzero(reachable)
    for _ in range(_TRIES):
        k = luck.randrange(len(rows))
        x, y = grid.cell_to_world([(rows[k], columns[k])])[0].tolist()
        if all(math.dist((x, y), other) >= _APART_M for other in found):
            found.append((x, y))
            if len(found) == fleet.places:
                return found
    raise WorldFileError(scenario.path, "fleet.places", fleet.places, f"at most {len(found)}: there is no more room")


def _next_place(
    world: GridWorld,
    places: list[tuple[float, float]],
    here: tuple[float, float],
    fleet: Fleet,
    luck: random.Random,
) -> tuple[float, float]:
    """A place that is as far away as trips are, by the way that robots go, or else the next best."""
    candidates = [place for place in places if place != here]
    luck.shuffle(candidates)
    for place in candidates:
        if fleet.least_trip_m <= world.paths.metres(here, place) <= fleet.most_trip_m:
            return place
    return min(candidates, key=lambda place: abs(world.paths.metres(here, place) - fleet.least_trip_m))


def _robot(entry: object, path: Path, name: str) -> ScenarioRobot:
    robot = read_entry(entry, ScenarioRobot, path, name)
    convert(robot.hitchhiking, HitchhikingParameters, path, f"{name}.hitchhiking", WorldFileError)
    return robot
