"""What the modules know of their own robot: mounts from its URDF, limits from its parameter file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Positive
from hitchhike_ros.core.errors import RobotModelError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy


@dataclass(frozen=True)
class RobotLimits:
    """Kinematics and footprint of a differential drive, section ``robot`` of its parameter file.

    The footprint is a rectangle around ``base_footprint`` (x forward); ``radius_m`` set means a round robot.
    """

    wheel_separation_m: Positive
    wheel_radius_m: Positive
    front_m: Positive
    rear_m: Positive
    half_width_m: Positive
    max_speed_mps: Positive
    max_yaw_rate_rps: Positive
    max_acceleration_mps2: Positive = 0.5
    max_yaw_acceleration_rps2: Positive = 1.5
    radius_m: Positive | None = None

    @property
    def inscribed_m(self) -> float:
        """Radius of the largest circle about the base within the footprint."""
        return self.radius_m or min(self.front_m, self.rear_m, self.half_width_m)

    @property
    def circumscribed_m(self) -> float:
        """Radius of the smallest circle about the base around the footprint."""
        return self.radius_m or float(np.hypot(max(self.front_m, self.rear_m), self.half_width_m))


def fixed_transforms(urdf: Path | str) -> dict[str, FloatArray]:
    """T_base_link (4, 4) of every link that hangs on ``base_footprint`` by fixed joints, from a URDF file.

    Raises:
        RobotModelError: the file cannot be read, is not XML or has no ``base_footprint``.
    """
    try:
        root = ElementTree.parse(urdf).getroot()
    except (OSError, ElementTree.ParseError) as exc:
        raise RobotModelError(urdf, "", str(exc), "a readable URDF file") from exc
    children: dict[str, list[tuple[str, FloatArray]]] = {}
    for joint in root.iter("joint"):
        parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
        if joint.get("type") != "fixed" or parent is None or child is None:
            continue
        xyz, rpy = (
            tuple(float(v) for v in (origin.get(key, "0 0 0") if origin is not None else "0 0 0").split())
            for key in ("xyz", "rpy")
        )
        T = matrix_from_xyz_rpy(xyz, rpy)  # type: ignore[arg-type]
        children.setdefault(str(parent.get("link")), []).append((str(child.get("link")), T))
    if "base_footprint" not in {link.get("name") for link in root.iter("link")}:
        raise RobotModelError(urdf, "link", "missing", "a link named base_footprint")
    transforms, open_links = {"base_footprint": np.eye(4)}, ["base_footprint"]
    while open_links:
        parent_name = open_links.pop()
        for child_name, T in children.get(parent_name, []):
            transforms[child_name] = transforms[parent_name] @ T
            open_links.append(child_name)
    return transforms


def mount(urdf: Path | str, link: str) -> FloatArray:
    """T_base_link (4, 4) of one link (``laser``, ``camera_optical``, ``marker`` …).

    Raises:
        RobotModelError: the URDF has no such link on fixed joints.
    """
    transforms = fixed_transforms(urdf)
    if link not in transforms:
        raise RobotModelError(urdf, "link", link, f"one of {', '.join(sorted(transforms))}")
    return transforms[link]
