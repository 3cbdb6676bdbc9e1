"""velocity_mux: the only writer of cmd_vel; passes on the most important fresh command within the robot's limits.

A human drives the base through it while the robot has no goal and no ride, or nobody says anything. On the way to a
goal, alone or with riders, obstacle_avoidance takes up what the human says; in all other states only a stop passes.

Subscribed:
    cmd_vel/teleop, cmd_vel/servoing, cmd_vel/navigation (geometry_msgs/Twist): in this order of priority
    hhike_msg/status (std_msgs/String): whether the robot has a goal or a ride
Published:
    cmd_vel (geometry_msgs/Twist): at once on a command, and every 1 / ``~rate`` of ROS time in which none came; five
        times a second while the robot does what it was told, once while nobody drives and it stands
    /diagnostics (diagnostic_msgs/DiagnosticArray): the source that drives, commands refused
Parameters:
    ~config (path), sections ``velocity_mux`` (control.velocity_mux.VelocityMuxParameters) and ``robot``
    ~rate (Hz, 10)
TF: none.
"""

from __future__ import annotations

import threading

import rospy
from geometry_msgs.msg import Twist

from hitchhike_ros.control.velocity_mux import SOURCES, Source, VelocityMux, VelocityMuxParameters
from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.conversions import twist_from_msg, twist_to_msg
from hitchhike_ros.ros_io.node import ERROR, OK, Diagnostics, StatusListener, run
from hitchhike_ros.ros_io.parameters import node_parameters
from hitchhike_ros.ros_io.timer import Timer


class VelocityMuxNode:
    """Commands and a timer step the mux, one at a time."""

    def __init__(self) -> None:
        self._mux = VelocityMux(
            node_parameters(VelocityMuxParameters, "velocity_mux"), node_parameters(RobotLimits, "robot")
        )
        rate = convert(rospy.get_param("~rate", 10.0), Positive, rospy.get_name(), "~rate")
        self._lock = threading.Lock()
        self._senseless: set[Source] = set()  # sources whose newest command was refused
        self._diagnostics = Diagnostics("velocity_mux")
        self._output = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        self._subscribers = [
            rospy.Subscriber(f"cmd_vel/{s}", Twist, self._on_command, s, queue_size=1, tcp_nodelay=True)
            for s in SOURCES
        ]
        self._listener = StatusListener(self._on_status, self._diagnostics)
        self._timer = Timer(1.0 / rate, self._on_timer)

    def _on_command(self, msg: Twist, source: Source) -> None:
        with self._lock:
            if self._mux.command(source, twist_from_msg(msg), rospy.get_time()):
                self._senseless.discard(source)
            else:
                self._senseless.add(source)
                rospy.logwarn_throttle(10.0, "cmd_vel/%s is not finite: refused", source)
        self._step()

    def _on_status(self, status: Status) -> None:
        with self._lock:
            self._mux.teleop_mode = status.teleop_mode

    def _on_timer(self) -> None:
        with self._lock:
            due = self._mux.takes_turn(rospy.get_time())
        if due:
            self._step()

    def _step(self) -> None:
        with self._lock:
            self._output.publish(twist_to_msg(self._mux.step(rospy.get_time())))
            refused = {f"refused_{source}": count for source, count in self._mux.refused.items()}
            values = {"active": self._mux.active or "", **refused}
            if self._senseless:
                names = ", ".join(sorted(self._senseless))
                self._diagnostics.set(ERROR, f"commands of {names} are not finite", **values)
            else:
                self._diagnostics.set(OK, self._mux.active or "nobody drives", **values)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros velocity_mux``."""
    run("velocity_mux", VelocityMuxNode)
