"""Which topic carries which input and output of the modules, and how each is converted: a row each.

Topics are relative to the robot's namespace. An input has one row, whoever takes it; of an output every module has rows
of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import Twist
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Twist2D
from hitchhike_ros.modules.inputs import NavigationCommand, ServoingCommand, TeleopCommand
from hitchhike_ros.protocol.status import Status, decode_status
from hitchhike_ros.ros_io.conversions import twist_from_msg, twist_to_msg


@dataclass(frozen=True, eq=False)
class Inlet:
    """``convert`` makes an input of the type ``what`` of a message, or raises SensorDataError or MessageError."""

    what: type
    topic: str
    cls: Any
    convert: Callable[[Any], object]
    queue_size: int = 1


@dataclass(frozen=True, eq=False)
class Outlet:
    """``convert`` makes the messages of a field of the outputs (``""``: of all outputs)."""

    field: str
    topic: str
    cls: Any
    convert: Callable[[Any], Iterable[Any]]
    latch: bool = False
    queue_size: int = 1


def _twist_of(command: type) -> Callable[[Twist], object]:
    return lambda msg: command(twist_from_msg(msg))


def _twists(twist: Twist2D) -> Iterable[Twist]:
    yield twist_to_msg(twist)


INLETS: dict[type, Inlet] = {
    inlet.what: inlet
    for inlet in (
        Inlet(Status, "hhike_msg/status", String, lambda msg: decode_status(msg.data), queue_size=10),
        Inlet(TeleopCommand, "cmd_vel/teleop", Twist, _twist_of(TeleopCommand)),
        Inlet(ServoingCommand, "cmd_vel/servoing", Twist, _twist_of(ServoingCommand)),
        Inlet(NavigationCommand, "cmd_vel/navigation", Twist, _twist_of(NavigationCommand)),
    )
}

VELOCITY_MUX = (Outlet("twist", "cmd_vel", Twist, _twists),)
