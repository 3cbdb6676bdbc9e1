"""octomap_saver: writes a robot's 3D map to a .bt file, as the octomap_saver of octomap_server does, and ends.

Usage: ``rosrun hitchhike_ros octomap_saver [--timeout S] FILE [octomap_binary:=TOPIC]``

  FILE             to write, e.g. ride.bt; octomap-tools and octovis read it
  --timeout S      wall time that it waits for a map (60)

Subscribed:
    octomap_binary (std_msgs/UInt8MultiArray): of mapping_3d
Published, services, parameters, TF: none.

When no map comes, or it cannot be saved, the node says why and ends with exit status 1.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import rospy
from std_msgs.msg import UInt8MultiArray

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.mapping.octree import save
from hitchhike_ros.ros_io.node import run


class OctomapSaver:
    """Waits for one map, saves it, and asks for the end."""

    def __init__(self) -> None:
        parser = argparse.ArgumentParser("octomap_saver", add_help=False)
        parser.add_argument("file", type=Path)
        parser.add_argument("--timeout", type=float, default=60.0)
        arguments = parser.parse_args(rospy.myargv(sys.argv)[1:])
        topic = rospy.resolve_name("octomap_binary")
        rospy.loginfo("waiting for a map on %s", topic)
        try:
            msg = rospy.wait_for_message("octomap_binary", UInt8MultiArray, arguments.timeout)
        except rospy.ROSException as exc:
            raise HitchhikeError(f"no map on {topic} within {arguments.timeout:g} s") from exc
        voxels = save(bytes(msg.data), arguments.file)
        rospy.loginfo("%s: %d occupied voxels, %g m", arguments.file, len(voxels.sides), voxels.resolution_m)
        rospy.signal_shutdown("saved")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros octomap_saver``."""
    run("octomap_saver", OctomapSaver)
