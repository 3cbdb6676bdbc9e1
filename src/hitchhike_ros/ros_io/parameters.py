"""Parameters of a node.

What all nodes of a robot share, as ``config`` and ``urdf``, may be a parameter of the robot's namespace; a private one
comes before it. A component's parameters are its dataclass's defaults, then its section of the file ``config``, then
the parameters ``SECTION/FIELD`` of the robot's namespace, then private ones with the names of its fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import rosgraph.names
import rospy

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import load_parameters

T = TypeVar("T")


def given(name: str, default: Any = None) -> Any:
    """The node's private parameter ``name``, or else the one of the robot's namespace, or else ``default``."""
    return rospy.get_param(f"~{name}") if rospy.has_param(f"~{name}") else rospy.get_param(name, default)


def is_given(name: str) -> bool:
    """Whether :func:`given` finds a parameter."""
    return bool(rospy.has_param(f"~{name}") or rospy.has_param(name))


def node_parameters(cls: type[T], section: str, changes: Mapping[str, object] | None = None) -> T:
    """Checked parameters of one component; ``changes`` come after the file and before all other parameters.

    Raises:
        ParameterError: names the file or the parameter, its value and what was expected.
    """
    overrides = dict(changes or {})
    for field in fields(cls):  # type: ignore[arg-type]
        for name in (f"{section}/{field.name}", f"~{field.name}"):
            if rospy.has_param(name):
                overrides[field.name] = rospy.get_param(name)
    return load_parameters(cls, section, given("config", "") or None, overrides)


def private_parameters(*names: str) -> dict[str, object]:
    """Those of these private parameters that are set, by name."""
    return {name: rospy.get_param(f"~{name}") for name in names if rospy.has_param(f"~{name}")}


def path_parameter(name: str) -> Path:
    """The existing file named by parameter ``name``, as of :func:`given`.

    Raises:
        ParameterError: the parameter is missing or names no file.
    """
    value = given(name, "")
    path = Path(str(value))
    if not value or not path.is_file():
        raise ParameterError(rospy.get_name(), f"~{name}", value, "the path of an existing file")
    return path


def folder_parameter(name: str) -> Path:
    """The folder named by private parameter ``name``, which is made where it is missing.

    Raises:
        ParameterError: the parameter is missing, or the folder cannot be made.
    """
    value = str(rospy.get_param(f"~{name}", ""))
    if not value:
        raise ParameterError(rospy.get_name(), f"~{name}", value, "the path of a folder")
    path = Path(value)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise ParameterError(rospy.get_name(), f"~{name}", value, f"a folder to write to ({exc.strerror})") from exc
    return path


def network_topic(name: str) -> str:
    """The topic that parameter ``name`` says, as of :func:`given`, where the robots talk with each other.

    Raises:
        ParameterError: it is no name of a topic.
    """
    topic = given(name, "/hhike_msg/network")
    if not isinstance(topic, str) or not rosgraph.names.is_legal_name(topic) or not topic:
        raise ParameterError(rospy.get_name(), f"~{name}", topic, "the name of a topic")
    return topic


def frame(name: str) -> str:
    """``<robot>/name``: the robot's frames carry ``~tf_prefix``, by default the node's namespace."""
    prefix = str(given("tf_prefix", rospy.get_namespace())).strip("/")
    return f"{prefix}/{name}" if prefix else name


def resolve(topic: str) -> str:
    """``topic``, or the one that a private parameter of the node names.

    Raises:
        ParameterError: the parameter is no name of a topic.
    """
    return network_topic(topic[1:]) if topic.startswith("~") else topic
