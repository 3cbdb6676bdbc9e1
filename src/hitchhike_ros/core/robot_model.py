"""What the modules know of their own robot: mounts from its URDF, limits from its parameter file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive
from hitchhike_ros.core.errors import RobotModelError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy, pose_from_matrix

_MAX_BYTES = 10_000_000
# In m, and in rad; beyond it is no robot but a slip.
_MAX_COORDINATE = 1000.0
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_NO_XACRO = "a URDF, not the text that xacro makes one of: xacro FILE.xacro > FILE.urdf"

# A laser that leans more meets the floor within its range: from 0.2 m above it, 4 m away. What looks up or down more
# steeply has no heading. Nothing of an indoor robot is farther from its middle (all chosen).
_MAX_TILT_RAD, _MAX_ELEVATION_RAD, _FARTHEST_M = math.radians(3.0), math.radians(45.0), 5.0
# The axis of a link's frame along which it looks; of a marker that is its outward normal.
_LOOKS_ALONG = {"camera": 0, "camera_optical": 2, "marker": 0}


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
        RobotModelError: the file cannot be read, is no URDF, its joints are no tree, one of them has a senseless
            origin, or there is no ``base_footprint``.
    """
    root = _read_urdf(urdf)
    links = _names(root, urdf)
    if "base_footprint" not in links:
        raise RobotModelError(urdf, "link", "missing", "a link named base_footprint")
    fixed: dict[str, list[tuple[str, FloatArray]]] = {}
    parents: dict[str, str] = {}
    for i, joint in enumerate(root.findall("joint")):
        field = f"joint {joint.get('name', i)}"
        parent, child = (_end(joint, end, links, urdf, field) for end in ("parent", "child"))
        if child in parents:
            raise RobotModelError(urdf, f"{field}: child", child, "a link that no other joint leads to")
        parents[child] = parent
        T = _origin(joint.find("origin"), urdf, field)
        if joint.get("type") == "fixed":
            fixed.setdefault(parent, []).append((child, T))
    _check_tree(parents, urdf)
    transforms, open_links = {"base_footprint": np.eye(4)}, ["base_footprint"]
    while open_links:
        parent = open_links.pop()
        for child, T in fixed.get(parent, []):
            transforms[child] = transforms[parent] @ T
            open_links.append(child)
    return transforms


def _read_urdf(urdf: Path | str) -> ElementTree.Element:
    try:
        with Path(urdf).open("rb") as file:
            text = file.read(_MAX_BYTES + 1)
        if len(text) > _MAX_BYTES:
            raise RobotModelError(urdf, "", "larger", f"a URDF file of at most {_MAX_BYTES} bytes")
        root = ElementTree.fromstring(text)
    except (OSError, ElementTree.ParseError, LookupError, ValueError) as exc:  # the last two: an unknown encoding
        if isinstance(exc, ElementTree.ParseError) and b"<xacro:" in text:
            raise RobotModelError(urdf, "", "xacro text", _NO_XACRO) from exc
        raise RobotModelError(urdf, "", str(exc), "a readable URDF file") from exc
    if root.tag != "robot":
        raise RobotModelError(urdf, "", f"<{root.tag}>", "a URDF, whose first element is <robot>")
    for element in root.iter():
        if isinstance(element.tag, str) and "xacro" in element.tag.rpartition("}")[0]:
            raise RobotModelError(urdf, "", f"<xacro:{element.tag.rpartition('}')[2]}>", _NO_XACRO)
    return root


def _names(root: ElementTree.Element, urdf: Path | str) -> set[str]:
    """Names of the links."""
    names: set[str] = set()
    for link in root.findall("link"):
        name = link.get("name")
        if not name or name in names:
            raise RobotModelError(urdf, "link", name, "a name that no other link has")
        if "${" in name or "$(" in name:
            raise RobotModelError(urdf, "link", name, _NO_XACRO)
        names.add(name)
    return names


def _end(joint: ElementTree.Element, end: str, links: set[str], urdf: Path | str, field: str) -> str:
    element = joint.find(end)
    link = None if element is None else element.get("link")
    if link is None or link not in links:
        raise RobotModelError(urdf, f"{field}: {end}", link, "the name of one of the links")
    return link


def _origin(origin: ElementTree.Element | None, urdf: Path | str, field: str) -> FloatArray:
    """T_parent_child (4, 4) of an element ``origin``; without one they are the same."""
    triples = []
    for key, unit in (("xyz", "m"), ("rpy", "rad")):
        text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
        numbers = text.split()
        if len(numbers) != 3 or not all(_NUMBER.fullmatch(number) for number in numbers):
            raise RobotModelError(
                urdf, f"{field}: origin {key}", text, _NO_XACRO if "$" in text else f"three numbers in {unit}"
            )
        x, y, z = (float(number) for number in numbers)
        if not max(abs(x), abs(y), abs(z)) <= _MAX_COORDINATE:
            expected = f"three numbers of at most {_MAX_COORDINATE:g} {unit}"
            raise RobotModelError(urdf, f"{field}: origin {key}", text, expected)
        triples.append((x, y, z))
    return matrix_from_xyz_rpy(*triples)


def _check_tree(parents: Mapping[str, str], urdf: Path | str) -> None:
    """Raises RobotModelError where joints form a ring; each link has one parent at most."""
    sound: set[str] = set()
    for start in parents:
        link, above = start, dict[str, None]()
        while link in parents and link not in sound:
            if link in above:
                ring = [*above][[*above].index(link) :]
                raise RobotModelError(urdf, "joint", " < ".join([*ring, link]), "a tree of links, not a ring")
            above[link] = None
            link = parents[link]
        sound.update(above)


def mount(urdf: Path | str, link: str) -> FloatArray:
    """T_base_link (4, 4) of one link (``laser``, ``camera_optical``, ``marker`` …).

    A laser stands level, upright or upside down, with any yaw. A camera and a marker may be turned about the axis along
    which they look, and lean; they look less up or down than ahead or aside.

    Raises:
        RobotModelError: the URDF has no such link on fixed joints, or it sits where nothing can be made of it.
    """
    transforms = fixed_transforms(urdf)
    if link not in transforms:
        raise RobotModelError(urdf, "link", link, f"one of {', '.join(sorted(transforms))}")
    T = transforms[link]
    away = float(np.linalg.norm(T[:3, 3]))
    if away > _FARTHEST_M:
        expected = f"within {_FARTHEST_M:g} m of base_footprint: xyz is in metres"
        raise RobotModelError(urdf, f"mount of link {link}", f"{away:.1f} m away", expected)
    if link == "laser":
        tilt = math.acos(min(abs(float(T[2, 2])), 1.0))
        if tilt > _MAX_TILT_RAD:
            expected = f"a scan in the floor's plane to {math.degrees(_MAX_TILT_RAD):.0f}°, upright or upside down"
            raise RobotModelError(urdf, f"tilt of link {link}", f"{math.degrees(tilt):.1f}°", expected)
    elif link in _LOOKS_ALONG:
        up = math.asin(max(-1.0, min(1.0, float(T[2, _LOOKS_ALONG[link]]))))
        if abs(up) > _MAX_ELEVATION_RAD:
            expected = f"a look no steeper than {math.degrees(_MAX_ELEVATION_RAD):.0f}° up or down"
            raise RobotModelError(urdf, f"elevation of link {link}", f"{math.degrees(up):.1f}°", expected)
    return T


@dataclass(frozen=True)
class LaserMount:
    """Where a laser sits in the plane of ``base_footprint``.

    ``pose`` is that of a laser that stands upright. Where this one is upside down, what it measures is what that one
    would, of beams that go round the other way (:meth:`.LaserScan.mirrored`). That it may lean by 3° changes no range
    by more than 0.14 %.
    """

    pose: Pose2D
    upside_down: bool

    @classmethod
    def of(cls, T_base_laser: FloatArray) -> LaserMount:
        """From the mount (4, 4), which :func:`mount` has found level."""
        return cls(pose_from_matrix(T_base_laser), bool(T_base_laser[2, 2] < 0.0))
