"""What the modules in a node are built from: the parameter server, and the files and services that it names."""

from __future__ import annotations

from functools import cached_property
from typing import TypeVar

import rospy
from nav_msgs.srv import GetMap

from hitchhike_ros.core.datatypes import FloatArray, Positive
from hitchhike_ros.core.errors import HitchhikeError, WorldFileError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import fixed_transforms, mount
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.mapping.sites import Sites, load_hitchhiking, load_sites
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.ros_io.conversions import grid_from_msg
from hitchhike_ros.ros_io.parameters import given, is_given, node_parameters, path_parameter

T = TypeVar("T")


class NodeFiles:
    """Reads what :class:`modules.robot_files.RobotFiles` names, each when it is first asked for.

    Private parameters of the node: ~config (path of a file with one section per component), ~urdf (path), ~world
    (path), ~robot_id (default: the namespace), ~map (path of a map_server YAML file; without it the service
    ``static_map`` gives the map), ~map_timeout_s (s, 60: the longest wait for that service). A private parameter with
    the name of a component's field replaces what the file says.
    """

    @property
    def robot_id(self) -> str:
        """The robot's name in the protocol."""
        return str(given("robot_id", rospy.get_namespace().strip("/")))

    @property
    def first_seq(self) -> int:
        """The first sequence number. It comes from the clock, so that a restart does not look like a replay."""
        return int(rospy.get_time() * 1000)

    @cached_property
    def sites(self) -> Sites:
        """Markers and hitchhiking points of the file ~world."""
        return load_sites(path_parameter("world"))

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map of the file ~map, or else of map_server, awaited for a bounded time.

        Raises:
            MapFileError: the file cannot be used.
            HitchhikeError: the service gave none.
        """
        if is_given("map"):
            return load_map(path_parameter("map"))
        timeout_s = convert(given("map_timeout_s", 60.0), Positive, rospy.get_name(), "~map_timeout_s")
        try:
            rospy.wait_for_service("static_map", timeout_s)
            return grid_from_msg(rospy.ServiceProxy("static_map", GetMap)().map)
        except (rospy.ROSException, rospy.ServiceException) as exc:
            raise HitchhikeError(f"service {rospy.resolve_name('static_map')} gave no map: {exc}") from exc

    def load(self, cls: type[T], section: str) -> T:
        """Parameters of a component; what the world file says of this robot's rides replaces what ~config says.

        Raises:
            ParameterError, WorldFileError: name the file, the field, its value and what was expected.
        """
        own = {}
        if section == "hitchhiking":
            world = path_parameter("world")
            own = load_hitchhiking(world, self.robot_id)
            convert(own, HitchhikingParameters, world, f"robots.{self.robot_id}.hitchhiking", WorldFileError)
        return node_parameters(cls, section, own)

    def mount(self, link: str) -> FloatArray:
        """T_base_link (4, 4) from the file ~urdf.

        Raises:
            RobotModelError: it has no such link.
            ParameterError: ~urdf names no file.
        """
        return mount(path_parameter("urdf"), link)

    def has(self, link: str) -> bool:
        """Whether the file ~urdf has such a link; False where the parameter is not set."""
        return is_given("urdf") and link in fixed_transforms(path_parameter("urdf"))
