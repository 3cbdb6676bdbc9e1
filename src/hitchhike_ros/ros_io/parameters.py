"""Parameters of a node.

What all nodes of a robot share, as ``config`` and ``urdf``, may be a parameter of the robot's namespace; a private one
comes before it. A component's parameters are its dataclass's defaults, then its section of the file ``config``, then
the parameters ``SECTION/FIELD`` of the robot's namespace, then private ones with the names of its fields.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import rosgraph.names
import rospy

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import convert, load_parameters

T = TypeVar("T")


def given(name: str, default: Any = None) -> Any:
    """The node's private parameter ``name``, or else the one of the robot's namespace, or else ``default``."""
    return rospy.get_param(f"~{name}") if rospy.has_param(f"~{name}") else rospy.get_param(name, default)


def parameter(name: str, cls: type[T], default: object) -> T:
    """The parameter ``name``, as of :func:`given`, as a checked ``cls``.

    Raises:
        ParameterError: names the parameter, its value and what was expected.
    """
    return convert(given(name, default), cls, rospy.get_name(), f"~{name}")


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
    return load_parameters(cls, section, path_parameter("config") if given("config", "") != "" else None, overrides)


def private_parameters(*names: str) -> dict[str, object]:
    """Those of these private parameters that are set, by name."""
    return {name: rospy.get_param(f"~{name}") for name in names if rospy.has_param(f"~{name}")}


def path_parameter(name: str) -> Path:
    """The existing file named by parameter ``name``, as of :func:`given`.

    Raises:
        ParameterError: the parameter is missing or names no file.
    """
    value = given(name, "")
    if not isinstance(value, str) or not os.path.isfile(value):  # Path.is_file raises where a name is too long
        raise ParameterError(rospy.get_name(), f"~{name}", value, "the path of an existing file")
    return Path(value)


def folder_parameter(name: str) -> Path:
    """The folder named by private parameter ``name``, which is made where it is missing.

    Raises:
        ParameterError: the parameter is missing, or the folder cannot be made.
    """
    value = rospy.get_param(f"~{name}", "")
    if not isinstance(value, str) or not value:
        raise ParameterError(rospy.get_name(), f"~{name}", value, "the path of a folder")
    path = Path(value)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as exc:
        raise ParameterError(rospy.get_name(), f"~{name}", value, f"a folder to write to ({exc})") from exc
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
    """``<robot>/name``: the robot's frames carry ``~tf_prefix``, by default the node's namespace.

    Raises:
        ParameterError: the parameter is no name.
    """
    prefix = given("tf_prefix", rospy.get_namespace())
    if not isinstance(prefix, str) or not rosgraph.names.is_legal_name(prefix):
        raise ParameterError(rospy.get_name(), "~tf_prefix", prefix, "the beginning of the names of frames")
    prefix = prefix.strip("/")
    return f"{prefix}/{name}" if prefix else name


def resolve(topic: str) -> str:
    """``topic``, or the one that a private parameter of the node names.

    Raises:
        ParameterError: the parameter is no name of a topic.
    """
    return network_topic(topic[1:]) if topic.startswith("~") else topic
