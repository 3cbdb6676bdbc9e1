"""The bodies of people in pybullet: cylinders that stand where their walkers are."""

from __future__ import annotations

from collections.abc import Iterable

import pybullet as p

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.simulation.people import HEIGHT_M, RADIUS_M, Person, Walker

_COLOUR = (0.25, 0.35, 0.60, 1.0)


class WalkingBody:
    """A walker's cylinder in a pybullet client."""

    def __init__(self, client: int, person: Person, body: int) -> None:
        self.walker, self.body, self._client = Walker(person), body, client
        self._place()

    def step(self, now: float, dt: float, robots: Iterable[Pose2D]) -> None:
        """Walk for ``dt`` s."""
        if self.walker.step(now, dt, robots):
            self._place()

    def reset(self) -> None:
        """Back to the start of the path."""
        self.send(self.walker.person)

    def send(self, person: Person) -> None:
        """He walks another way, from its start."""
        self.walker = Walker(person)
        self._place()

    def touches(self, robot: int) -> tuple[float, float] | None:
        """Where the body of a robot touches him, (x, y) in ``map``; None when it does not."""
        points = p.getClosestPoints(robot, self.body, 0.0, physicsClientId=self._client)
        deepest = min(points, key=lambda point: float(point[8]), default=None)
        return None if deepest is None or deepest[8] > 0.0 else (float(deepest[5][0]), float(deepest[5][1]))

    def _place(self) -> None:
        pose = self.walker.pose
        p.resetBasePositionAndOrientation(
            self.body, [pose.x, pose.y, HEIGHT_M / 2], [0.0, 0.0, 0.0, 1.0], physicsClientId=self._client
        )


def cylinder(client: int) -> tuple[int, int]:
    """Collision and visual shape of a person."""
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=RADIUS_M, height=HEIGHT_M, physicsClientId=client)
    look = p.createVisualShape(
        p.GEOM_CYLINDER, radius=RADIUS_M, length=HEIGHT_M, rgbaColor=_COLOUR, specularColor=(0.0, 0.0, 0.0),
        physicsClientId=client,
    )  # fmt: skip
    return shape, look
