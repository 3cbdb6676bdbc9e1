"""The simulated world: a map's walls, boxes, markers, people and robots in one pybullet client.

Nothing here reads a clock: time passes by :meth:`World.step` alone. Several worlds may live in one process.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Annotated

import msgspec
import numpy as np
import pybullet as p

from hitchhike_ros.core.datatypes import Contact, Marker, Positive
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.geometry import distance, distance_to_box
from hitchhike_ros.core.stamps import carried
from hitchhike_ros.mapping.grid import FREE
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.simulation.people import Person
from hitchhike_ros.simulation.physics.camera import Renderer, load_renderer, silenced
from hitchhike_ros.simulation.physics.robot import (
    FLOOR_GROUP,
    ROLLING_GROUP,
    SOLID_GROUP,
    Engine,
    SimulatedRobot,
    robot_files,
)
from hitchhike_ros.simulation.physics.tags import write_tag
from hitchhike_ros.simulation.physics.walking_bodies import WalkingBody, cylinder
from hitchhike_ros.simulation.physics.walls import wall_meshes, write_obj
from hitchhike_ros.simulation.world_file import Box, WorldFile, check_box, load_world

Steps = Annotated[int, msgspec.Meta(ge=1)]

_WALL_COLOUR = (0.86, 0.85, 0.80, 1.0)
_FLOOR_COLOUR = (0.52, 0.54, 0.56, 1.0)
_BOX_COLOUR = (0.72, 0.52, 0.30, 1.0)
# Markers of the world are printed on boards this thick, so that they may be placed on a wall's face.
_BOARD_M = 0.005
# A robot whose centre is farther than this from a person's does not touch him.
_NEAR_M = 1.0


@dataclass(frozen=True)
class WorldParameters:
    """Section ``simulator``. A physics step is 1 / ``physics_rate_hz``; encoders are read every ``encoder_steps``."""

    physics_rate_hz: Annotated[int, msgspec.Meta(ge=60)] = 240
    encoder_steps: Steps = 4
    ray_threads: Steps = 1
    renderer: Renderer = "auto"
    # A touch that was away for less than this is the same contact.
    contact_gap_s: Positive = 0.5


class World:
    """A world file come to life.

    Example:
        >>> with World("maps/p17_exp1.world.yaml", seed=1, package=package) as world:
        ...     world.robots["p3dx"].command(Twist2D(0.3), world.now)
        ...     world.run(1.0)
        ...     scan = world.robots["p3dx"].scan()
    """

    def __init__(
        self,
        world_file: WorldFile | Path | str,
        seed: int = 0,
        params: WorldParameters | None = None,
        *,
        package: Path | str,
        start_s: float = 0.0,
    ) -> None:
        """Build it. ``package`` is the folder with ``urdf/<model>.urdf`` and ``config/<model>.yaml``.

        Time begins at ``start_s``: 0, or what the system's clock says.

        Raises:
            WorldFileError, MapFileError, RobotModelError, ParameterError: a file cannot be used.
        """
        self.file = world_file if isinstance(world_file, WorldFile) else load_world(world_file)
        self.params = params or WorldParameters()
        self.grid = load_map(self.file.map)
        self.dt = 1.0 / self.params.physics_rate_hz
        self._start_s, self._now = start_s, carried(start_s)
        self._steps = 0
        self._check_robots(Path(package))
        self.client = p.connect(p.DIRECT)
        try:
            self._build(seed, Path(package))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> World:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _value: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give back pybullet's client; the world cannot be used afterwards."""
        if p.isConnected(self.client):
            with silenced():
                p.disconnect(self.client)

    @property
    def now(self) -> float:
        """Simulated time in s, as a ROS stamp has it; :meth:`reset` does not turn it back."""
        return self._now

    @property
    def elapsed_s(self) -> float:
        """How much simulated time has been stepped through, in s."""
        return self._steps / self.params.physics_rate_hz

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The boxes that stand in the world."""
        return tuple(box for box, _ in self._boxes.values())

    def step(self) -> None:
        """One physics step."""
        for robot in self.robots.values():
            robot.drive(self.dt)
        if self.people:
            self._walk()
        p.stepSimulation(physicsClientId=self.client)
        self._steps += 1
        self._now = carried(self._start_s + self._steps / self.params.physics_rate_hz)
        for robot in self.robots.values():
            self._note_contacts(robot)
            if self._steps % self.params.encoder_steps == 0:
                robot.read_encoders()

    def skip(self, seconds: float) -> None:
        """Time passes, and nothing moves."""
        self._start_s += seconds
        self._now = carried(self._start_s + self._steps / self.params.physics_rate_hz)

    def run(self, duration_s: float) -> None:
        """As many steps as make ``duration_s``."""
        for _ in range(round(duration_s * self.params.physics_rate_hz)):
            self.step()

    def contacts(self) -> tuple[Contact, ...]:
        """What every robot has touched since the start, floor excepted, by time."""
        return tuple(sorted((c for r in self.robots.values() for c in r.contacts()), key=lambda contact: contact.stamp))

    def reset(self) -> None:
        """Robots and people back to their starts, boxes as in the file, noise as at the beginning; time goes on."""
        for robot in self.robots.values():
            robot.reset()
        for box_id in list(self._boxes):
            self.remove_box(box_id)
        for box in self.file.boxes:
            self.add_box(box)
        for person in self.people:
            person.reset()
        self._walk_from = self.now
        self._touching.clear()

    def add_box(self, box: Box) -> None:
        """Put a box on the floor.

        Raises:
            WorldFileError: its id is in use, it has no extent, or a robot stands there.
        """
        check_box(box, "add_box", "box")
        if box.id in self._boxes:
            raise WorldFileError("add_box", "id", box.id, "an id that no box has")
        for name, robot in self.robots.items():
            pose, _ = robot.ground_truth()
            if distance_to_box(pose.x, pose.y, box) < robot.limits.inscribed_m:
                raise WorldFileError("add_box", "box", (box.x, box.y, box.w, box.b), f"a place where {name} is not")
        half = [box.w / 2, box.b / 2, box.height_m / 2]
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=self.client)
        look = p.createVisualShape(p.GEOM_BOX, halfExtents=half, **_paint(_BOX_COLOUR), physicsClientId=self.client)
        body = self._add_static(shape, look, [box.x + half[0], box.y + half[1], half[2]])
        self._boxes[box.id] = (box, body)
        self._names[body] = box.id

    def remove_box(self, box_id: str) -> None:
        """Take a box away.

        Raises:
            WorldFileError: there is no such box.
        """
        if box_id not in self._boxes:
            raise WorldFileError("remove_box", "id", box_id, f"one of {', '.join(self._boxes) or '(no boxes)'}")
        _, body = self._boxes.pop(box_id)
        del self._names[body]
        p.removeBody(body, physicsClientId=self.client)

    def _check_robots(self, package: Path) -> None:
        for name, entry in self.file.robots.items():
            for file in robot_files(entry.model, package):
                if not os.path.isfile(file):
                    raise WorldFileError(
                        self.file.path, f"robots.{name}.model", entry.model, f"a model with a file {file}"
                    )
            x, y = entry.start.x, entry.start.y
            cell = self.grid.world_to_cell([[x, y]])
            free = bool(self.grid.in_bounds(cell)[0]) and self.grid.data[tuple(cell[0])] == FREE
            if not free or any(distance_to_box(x, y, box) == 0.0 for box in self.file.boxes):
                raise WorldFileError(self.file.path, f"robots.{name}.start", (x, y), "a free place of the map")

    def _build(self, seed: int, package: Path) -> None:
        client, params = self.client, self.params
        renderer = load_renderer(client, params.renderer)
        p.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        p.setTimeStep(self.dt, physicsClientId=client)
        p.setPhysicsEngineParameter(deterministicOverlappingPairs=1, enableFileCaching=0, physicsClientId=client)
        self.robots: Mapping[str, SimulatedRobot] = {}
        self.people: tuple[WalkingBody, ...] = ()
        self._names: dict[int, str] = {}
        self._boxes: dict[str, tuple[Box, int]] = {}
        self._touching: dict[tuple[str, str], float] = {}
        self._add_floor()
        for box in self.file.boxes:
            self.add_box(box)
        with tempfile.TemporaryDirectory() as folder:
            self._add_walls(Path(folder))
            for marker in self.file.sites.markers:
                self._add_marker(marker, Path(folder))
        engine = Engine(client, lambda: self.now, seed, renderer, params.ray_threads)
        robots = {name: SimulatedRobot(name, entry, package, engine) for name, entry in self.file.robots.items()}
        self._names.update({robot.body: name for name, robot in robots.items()})
        self.robots = MappingProxyType(robots)
        self.people = tuple(self._add_person(person) for person in self.file.people)
        self._walk_from = self.now

    def _add_floor(self) -> None:
        rows, columns = self.grid.data.shape
        corners = self.grid.cell_to_world([[-0.5, -0.5], [rows - 0.5, columns - 0.5]])
        half = [*(np.abs(corners[1] - corners[0]) / 2 + 5.0).tolist(), 0.05]
        middle = corners.mean(axis=0).tolist()
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=self.client)
        look = p.createVisualShape(
            p.GEOM_BOX, halfExtents=half, **_paint(_FLOOR_COLOUR), visualFramePosition=[*middle, -half[2]],
            physicsClientId=self.client,
        )  # fmt: skip
        floor = self._add_static(plane, look, [0.0, 0.0, 0.0])
        p.changeDynamics(floor, -1, lateralFriction=1.0, physicsClientId=self.client)
        everything = FLOOR_GROUP | SOLID_GROUP | ROLLING_GROUP
        p.setCollisionFilterGroupMask(floor, -1, FLOOR_GROUP, everything, physicsClientId=self.client)

    def _add_walls(self, folder: Path) -> None:
        for i, (vertices, normals, triangles) in enumerate(wall_meshes(self.grid, self.file.wall_height_m)):
            shape = p.createCollisionShape(
                p.GEOM_MESH, vertices=vertices.tolist(), indices=triangles.ravel().tolist(),
                flags=p.GEOM_FORCE_CONCAVE_TRIMESH, physicsClientId=self.client,
            )  # fmt: skip
            file = folder / f"walls{i}.obj"  # the EGL renderer reads meshes from files only
            write_obj(file, vertices, normals, triangles)
            look = p.createVisualShape(
                p.GEOM_MESH, fileName=str(file), **_paint(_WALL_COLOUR), physicsClientId=self.client
            )
            self._names[self._add_static(shape, look, [0.0, 0.0, 0.0])] = "walls"

    def _add_marker(self, marker: Marker, folder: Path) -> None:
        for mesh, grey in zip(write_tag(marker, folder, _BOARD_M), (0.0, 1.0), strict=True):
            look = p.createVisualShape(
                p.GEOM_MESH, fileName=str(mesh), **_paint((grey, grey, grey, 1.0)), physicsClientId=self.client
            )
            self._add_static(-1, look, [marker.x, marker.y, marker.z], marker.yaw)

    def _add_person(self, person: Person) -> WalkingBody:
        body = self._add_static(*cylinder(self.client), [0.0, 0.0, 0.0])
        for robot in self.robots.values():  # the laser sees people, but they do not push
            for link in range(-1, p.getNumJoints(robot.body, physicsClientId=self.client)):
                p.setCollisionFilterPair(robot.body, body, link, -1, 0, physicsClientId=self.client)
        return WalkingBody(self.client, person, body)

    def _walk(self) -> None:
        """People take a step, and whom a robot touches is noted."""
        poses = {name: robot.ground_truth()[0] for name, robot in self.robots.items()}
        for person in self.people:
            person.step(self.now - self._walk_from, self.dt, poses.values())
            for name, pose in poses.items():
                if distance(pose, person.walker.pose) < _NEAR_M:
                    place = person.touches(self.robots[name].body)
                    if place is not None:
                        self._note_contact(self.robots[name], person.walker.person.id, place)

    def _add_static(self, shape: int, look: int, position: list[float], yaw: float = 0.0) -> int:
        """A body that never moves; its id."""
        body = p.createMultiBody(
            0.0, shape, look, position, p.getQuaternionFromEuler([0.0, 0.0, yaw]), physicsClientId=self.client
        )
        if shape >= 0:
            p.setCollisionFilterGroupMask(body, -1, SOLID_GROUP, SOLID_GROUP, physicsClientId=self.client)
        return int(body)

    def _note_contacts(self, robot: SimulatedRobot) -> None:
        for point in p.getContactPoints(robot.body, physicsClientId=self.client):
            other = self._names.get(point[2])
            if other is None or point[2] == robot.body or point[8] > 0.0:  # the floor, itself, near but not touching
                continue
            self._note_contact(robot, other, (point[5][0], point[5][1]))

    def _note_contact(self, robot: SimulatedRobot, other: str, place: tuple[float, float]) -> None:
        touch = (robot.name, other)
        if self.now - self._touching.get(touch, -math.inf) > self.params.contact_gap_s:
            robot.contact_log.append(Contact(self.now, robot.name, other, *place))
        self._touching[touch] = self.now


def _paint(rgba: tuple[float, float, float, float]) -> dict[str, tuple[float, ...]]:
    return {"rgbaColor": rgba, "specularColor": (0.0, 0.0, 0.0)}
