"""What an operator says at the start of a run: where robots are, until they know it, then where they are wanted.

The start pose is off by as much as a person's click on the map would be.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, NonNegative, Pose2D, PoseEstimate, Positive, Seed
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.simulation.world_file import RobotEntry


@dataclass(frozen=True)
class StartParameters:
    """Section ``operator``; chosen. The last three are wall time."""

    position_sigma_m: NonNegative = 0.05
    heading_sigma_rad: NonNegative = 0.03
    seed: Seed = 0
    deadline_s: Positive = 120.0  # for the robots to listen and to localize
    retry_s: Positive = 0.5  # a start pose is said again, and the last goal is out before the operator goes
    look_s: Positive = 0.05  # whether it is time for a goal


class RobotStart:
    """One robot at its start.

    Args:
        entry: of the world file.
        goal: where it is wanted; None: nowhere.
        error: of the start pose, in its frame.
        sigma: standard deviations (3,) of that error, in m and rad.
    """

    def __init__(self, entry: RobotEntry, goal: Pose2D | None, error: Pose2D, sigma: FloatArray) -> None:
        self.goal, self.goal_at_s = goal, entry.goal_at_s
        self.localized = False
        self._start, self._covariance = compose(entry.start, error), np.diag(sigma**2)

    def pose(self, now: float, *, heard: bool) -> PoseEstimate | None:
        """What to say of its pose at ``now``: nothing when it knows, or when nobody would hear it."""
        return PoseEstimate(now, self._start, self._covariance) if heard and not self.localized else None

    def ready(self, *, heard: bool) -> bool:
        """Whether it knows where it is, and would hear of its goal."""
        return self.localized and (self.goal is None or heard)


class RobotStarts:
    """The robots that an operator starts, in the order of the world file.

    Args:
        entries: all robots of the world file.
        goals: of some robots, in place of those of the world file.
        chosen: names of the robots that are started; none: all.
    """

    def __init__(
        self,
        entries: Mapping[str, RobotEntry],
        goals: Mapping[str, Pose2D],
        chosen: Collection[str],
        params: StartParameters,
    ) -> None:
        random = np.random.default_rng(params.seed)
        sigma = np.array([params.position_sigma_m, params.position_sigma_m, params.heading_sigma_rad])
        self.robots: dict[str, RobotStart] = {}
        for name, entry in entries.items():
            if not chosen or name in chosen:
                error = Pose2D(*(float(value) for value in random.normal(0.0, sigma)))
                self.robots[name] = RobotStart(entry, goals.get(name, entry.goal), error, sigma)
        self._waiting = sorted(self.robots, key=lambda name: self.robots[name].goal_at_s)

    @property
    def over(self) -> bool:
        """Whether all goals were given."""
        return not self._waiting

    def due(self, elapsed_s: float) -> dict[str, Pose2D]:
        """Goals to give ``elapsed_s`` after all were ready, by name; each once."""
        names = [name for name in self._waiting if self.robots[name].goal_at_s <= elapsed_s]
        self._waiting = self._waiting[len(names) :]
        return {name: goal for name in names if (goal := self.robots[name].goal) is not None}
