"""What the modules in a node are built from: the parameter server, and the files and services that it names."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, TypeVar

import msgspec
import rosgraph.names
import rospy
from nav_msgs.srv import GetMap

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.errors import HitchhikeError, ParameterError, WorldFileError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import fixed_transforms, mount
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.mapping.sites import Sites, load_hitchhiking, load_sites
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.ros_io.conversions import grid_from_msg
from hitchhike_ros.ros_io.parameters import given, is_given, node_parameters, parameter, path_parameter

T = TypeVar("T")

_Patience = Annotated[float, msgspec.Meta(gt=0, le=86400)]


class NodeFiles:
    """Reads what :class:`modules.robot_files.RobotFiles` names, each when it is first asked for.

    Private parameters of the node: ~config (path of a file with one section per component), ~urdf (path), ~world
    (path), ~robot_id (default: the namespace), ~map (path of a map_server YAML file; without it the service
    ``static_map`` gives the map), ~map_timeout_s (s, 60: the longest wait for that service). A private parameter with
    the name of a component's field replaces what the file says.
    """

    @property
    def robot_id(self) -> str:
        """The robot's name in the protocol.

        Raises:
            ParameterError: neither the parameter nor the namespace is one.
        """
        name = given("robot_id", rospy.get_namespace().strip("/"))
        if not isinstance(name, str) or not name or not rosgraph.names.is_legal_name(name):
            expected = "a robot's name of letters, digits and _: the node's namespace, __ns:=ROBOT, or this parameter"
            raise ParameterError(rospy.get_name(), "~robot_id", name, expected)
        return name

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
        timeout_s = parameter("map_timeout_s", _Patience, 60.0)
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
