"""velocity_mux: the only writer of cmd_vel; passes on the most important fresh command within the robot's limits.

A human drives the base through it while the robot has no goal and no ride, or while nobody gives orders. On the way to
a goal, alone or with riders, obstacle_avoidance takes up what the human says; in all other states only a stop passes.

Subscribed:
    cmd_vel/teleop, cmd_vel/servoing, cmd_vel/navigation (geometry_msgs/Twist): in this order of priority
    hhike_msg/status (std_msgs/String): whether the robot has a goal or a ride
Published:
    cmd_vel (geometry_msgs/Twist): at once on a command, and after ``~period_s`` in which none came; while nobody drives
        and the robot stands, after ``~rest_period_s``
    /diagnostics (diagnostic_msgs/DiagnosticArray): the source that drives, commands refused
Parameters:
    ~config (path), sections ``velocity_mux`` (modules.velocity_mux.VelocityMuxParameters) and ``robot``. A private
        parameter with the name of one of theirs replaces it, e.g. ~period_s (s, 0.15), ~rest_period_s (s, 1)
TF: none.
"""

from __future__ import annotations

from hitchhike_ros.modules.velocity_mux import VelocityMux
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets


def build() -> ModuleHost:
    """The node's host."""
    module = VelocityMux.build(NodeFiles())
    return ModuleHost(Single(module), {module.name: outlets(module.name)})


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros velocity_mux``."""
    run("velocity_mux", build)
