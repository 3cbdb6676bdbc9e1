"""map_saver: writes the map of a topic to NAME.yaml and NAME.pgm, as the map_saver of map_server does, and ends.

Usage: ``rosrun hitchhike_ros map_saver [-f NAME] [--occ PERCENT] [--free PERCENT] [--timeout S] [map:=TOPIC]``

  -f NAME          files to write, without suffix (map)
  --occ PERCENT    cells of at least this are saved as occupied (65)
  --free PERCENT   cells of at most this are saved as free (25); those between, as unknown
  --timeout S      wall time that it waits for a map (60)

Subscribed:
    map (nav_msgs/OccupancyGrid)
Published, services, parameters, TF: none.

When no map comes, or it cannot be saved, the node says why and ends with exit status 1.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import rospy
from nav_msgs.msg import OccupancyGrid

from hitchhike_ros.core.errors import HitchhikeError, MapFileError, ParameterError
from hitchhike_ros.mapping.map_file import save_map, trinary
from hitchhike_ros.ros_io.conversions import grid_from_msg
from hitchhike_ros.ros_io.node import run


class MapSaver:
    """Waits for one map, saves it, and asks for the end."""

    def __init__(self) -> None:
        parser = argparse.ArgumentParser("map_saver", add_help=False)
        parser.add_argument("-f", dest="name", default="map")
        parser.add_argument("--occ", type=int, default=65)
        parser.add_argument("--free", type=int, default=25)
        parser.add_argument("--timeout", type=float, default=60.0)
        arguments = parser.parse_args(rospy.myargv(sys.argv)[1:])
        if not 0 <= arguments.free < arguments.occ <= 100:
            value = f"--free {arguments.free} --occ {arguments.occ}"
            raise ParameterError(rospy.get_name(), "thresholds", value, "0 <= free < occ <= 100")
        topic = rospy.resolve_name("map")
        rospy.loginfo("waiting for a map on %s", topic)
        try:
            msg = rospy.wait_for_message("map", OccupancyGrid, arguments.timeout)
        except rospy.ROSException as exc:
            raise HitchhikeError(f"no map on {topic} within {arguments.timeout:g} s") from exc
        try:
            grid = grid_from_msg(msg)
        except ValueError as exc:
            raise MapFileError(topic, "", str(exc), "as many values as height times width say") from exc
        # Messages carry the resolution as float32: the shortest number that means the same is what was meant.
        grid = replace(grid, resolution=float(str(np.float32(grid.resolution))))
        path = Path(f"{arguments.name}.yaml")
        save_map(trinary(grid, arguments.free, arguments.occ), path)
        rospy.loginfo("%s: %d x %d cells of %g m", path, grid.width, grid.height, grid.resolution)
        rospy.signal_shutdown("saved")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros map_saver``."""
    run("map_saver", MapSaver)
