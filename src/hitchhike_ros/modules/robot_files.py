"""What a robot's modules are built from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.robot_model import fixed_transforms, mount
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites

T = TypeVar("T")


class RobotFiles(Protocol):
    """Where modules read what they are made of; a node reads the parameter server (``ros_io.node_files``).

    What a module does not need is not read, so that it can run without.
    """

    @property
    def robot_id(self) -> str:
        """The robot's name in the protocol."""

    @property
    def sites(self) -> Sites:
        """Markers and hitchhiking points of the world."""

    @property
    def grid(self) -> OccupancyGrid:
        """The original map."""

    @property
    def first_seq(self) -> int:
        """Greater than any number of a message of an earlier start."""

    def load(self, cls: type[T], section: str) -> T:
        """The parameters of one component.

        Raises:
            ParameterError: names the file, the field, its value and what was expected.
        """

    def mount(self, link: str) -> FloatArray:
        """T_base_link (4, 4) of a link.

        Raises:
            RobotModelError: the robot has no such link, or it sits where nothing can be made of it.
        """

    def has(self, link: str) -> bool:
        """Whether the robot has such a link."""


@dataclass(frozen=True)
class PlainFiles:
    """A robot's parameter file and URDF; ``changes`` are fields by section that differ from the file."""

    robot_id: str
    config: Path
    urdf: Path
    sites: Sites
    grid: OccupancyGrid
    changes: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    first_seq: int = 0

    def load(self, cls: type[T], section: str) -> T:
        """As of :class:`RobotFiles`."""
        return load_parameters(cls, section, self.config, self.changes.get(section))

    def mount(self, link: str) -> FloatArray:
        """As of :class:`RobotFiles`."""
        return mount(self.urdf, link)

    def has(self, link: str) -> bool:
        """As of :class:`RobotFiles`."""
        return link in fixed_transforms(self.urdf)
