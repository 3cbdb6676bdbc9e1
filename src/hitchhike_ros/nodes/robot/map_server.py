"""map_server: serves a map file, with the interface of the map_server of ROS.

Usage: ``rosrun hitchhike_ros map_server MAP.yaml`` or parameter ``~map``.

Published:
    map (nav_msgs/OccupancyGrid, latched)
    map_metadata (nav_msgs/MapMetaData, latched)
Services:
    static_map (nav_msgs/GetMap)
Parameters:
    ~map (path): map_server YAML file, when none is given on the command line
    ~frame_id (string, map): frame of the map
TF: none.

A file that cannot be used ends the node with a message that names file, field and expectation, and exit status 1.
"""

from __future__ import annotations

import sys

import rospy
from nav_msgs.msg import MapMetaData
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from nav_msgs.srv import GetMap, GetMapRequest, GetMapResponse

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.ros_io.conversions import grid_to_msg
from hitchhike_ros.ros_io.node import OK, Diagnostics, DiagnosticsUpdater, run
from hitchhike_ros.ros_io.parameters import parameter


class MapServer:
    """Hands a map out by latched publishers and a service."""

    def __init__(
        self, path: str, grid: OccupancyGrid, updater: DiagnosticsUpdater | None = None, topic: str = "map"
    ) -> None:
        """``grid`` is the map of the file ``path``; ``updater`` publishes that it is served."""
        self._msg = grid_to_msg(grid, rospy.Time.now().to_sec(), parameter("frame_id", str, "map"))
        self._diagnostics = Diagnostics("map_server", updater)
        self._diagnostics.set(
            OK, "serving", file=path, width=grid.width, height=grid.height, resolution=grid.resolution
        )
        self._map = rospy.Publisher(topic, OccupancyGridMsg, queue_size=1, latch=True)
        self._metadata = rospy.Publisher(f"{topic}_metadata", MapMetaData, queue_size=1, latch=True)
        self._map.publish(self._msg)
        self._metadata.publish(self._msg.info)
        self._service = rospy.Service("static_map", GetMap, self._on_request)
        rospy.loginfo("%s: %d x %d cells of %g m", path, grid.width, grid.height, grid.resolution)

    def _on_request(self, _request: GetMapRequest) -> GetMapResponse:
        return GetMapResponse(map=self._msg)


def build() -> MapServer:
    """The node's only part."""
    arguments = rospy.myargv(sys.argv)[1:]
    path = arguments[0] if arguments else rospy.get_param("~map", "")
    if not isinstance(path, str) or not path:
        raise ParameterError(rospy.get_name(), "~map", path, "a map_server YAML file, here or as the argument")
    return MapServer(path, load_map(path))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros map_server``."""
    run("map_server", build)
