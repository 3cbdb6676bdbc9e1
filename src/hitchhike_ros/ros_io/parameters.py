"""Parameters of a node: its dataclass's defaults, then its section of the file ``~config``, then private ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import rosgraph.names
import rospy

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import load_parameters

T = TypeVar("T")


def node_parameters(cls: type[T], section: str, changes: Mapping[str, object] | None = None) -> T:
    """Checked parameters of one component; ``changes`` come after the file and before private parameters.

    Raises:
        ParameterError: names the file or the private parameter, its value and what was expected.
    """
    private = {
        f.name: rospy.get_param(f"~{f.name}")
        for f in fields(cls)  # type: ignore[arg-type]
        if rospy.has_param(f"~{f.name}")
    }
    return load_parameters(cls, section, rospy.get_param("~config", "") or None, {**(changes or {}), **private})


def path_parameter(name: str) -> Path:
    """The existing file named by private parameter ``name``.

    Raises:
        ParameterError: the parameter is missing or names no file.
    """
    value = rospy.get_param(f"~{name}", "")
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
    """The topic that private parameter ``name`` says, where the robots talk with each other.

    Raises:
        ParameterError: it is no name of a topic.
    """
    topic = rospy.get_param(f"~{name}", "/hhike_msg/network")
    if not isinstance(topic, str) or not rosgraph.names.is_legal_name(topic) or not topic:
        raise ParameterError(rospy.get_name(), f"~{name}", topic, "the name of a topic")
    return topic


def frame(name: str) -> str:
    """``<robot>/name``: the robot's frames carry ``~tf_prefix``, by default the node's namespace."""
    prefix = str(rospy.get_param("~tf_prefix", rospy.get_namespace())).strip("/")
    return f"{prefix}/{name}" if prefix else name
