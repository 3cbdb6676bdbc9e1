"""ride_markers: what rviz has no display for: hitchhiking points, new boxes, the gap, and each robot's state as text.

Subscribed, for each robot:
    /<robot>/hhike_msg/status, /<robot>/new_obstacles, /<robot>/visual_servoing/observations (std_msgs/String)
Published:
    ride_markers (visualization_msgs/MarkerArray, latched): hitchhiking points and each robot's new boxes, in map; its
        state and reason beside it, and while it follows a marker the line to that from its middle with its length, both
        in <robot>/base_footprint
Parameters:
    ~world (path): its hitchhiking points and robots
    ~robots (string): names of the robots to show, separated by blanks
    ~period_s (s, 0.2)
TF: none; rviz places everything by the frames above.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import msgspec
import rospy
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.core.errors import MessageError, ParameterError
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import decode_status
from hitchhike_ros.ros_io.markers import DrawnRobot, drawn_robots, point_markers, robot_markers
from hitchhike_ros.ros_io.node import every, run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.simulation.world_file import load_world


@dataclass(frozen=True)
class RideMarkersParameters:
    """Section ``ride_markers``."""

    period_s: Positive = 0.2


class RideMarkers:
    """Callbacks keep what was said; a timer draws it."""

    def __init__(self) -> None:
        world = load_world(path_parameter("world"))
        names = str(rospy.get_param("~robots", " ".join(world.robots))).split()
        if not names or set(names) - set(world.robots):
            raise ParameterError(rospy.get_name(), "~robots", " ".join(names), f"some of {', '.join(world.robots)}")
        self._places = world.sites.hitchhiking_points
        self._lock = threading.Lock()
        self._publisher = rospy.Publisher("ride_markers", MarkerArray, queue_size=1, latch=True)
        self._robots = drawn_robots(names)
        self._subscribers = []
        for robot in self._robots:
            for topic, callback in (
                ("hhike_msg/status", self._on_status),
                ("new_obstacles", self._on_boxes),
                ("visual_servoing/observations", self._on_seen),
            ):
                subscriber = rospy.Subscriber(f"/{robot.name}/{topic}", String, callback, robot, queue_size=5)
                self._subscribers.append(subscriber)
        period_s = node_parameters(RideMarkersParameters, "ride_markers").period_s
        self._timer = every(period_s, self._draw)

    def _on_status(self, msg: String, robot: DrawnRobot) -> None:
        try:
            status = decode_status(msg.data)
        except MessageError as exc:
            rospy.logwarn_throttle(10.0, "%s", exc)
            return
        with self._lock:
            robot.status = status

    def _on_boxes(self, msg: String, robot: DrawnRobot) -> None:
        try:
            boxes = msgspec.json.decode(msg.data, type=NewObstacles).obstacles
        except msgspec.MsgspecError as exc:
            rospy.logwarn_throttle(10.0, "/%s/new_obstacles: %s", robot.name, exc)
            return
        with self._lock:
            robot.boxes = boxes

    def _on_seen(self, msg: String, robot: DrawnRobot) -> None:
        try:
            seen = decode_observations(msg.data).markers
        except MessageError as exc:
            rospy.logwarn_throttle(10.0, "%s", exc)
            return
        with self._lock:
            robot.seen = seen

    def _draw(self) -> None:
        now = rospy.get_time()
        clear = Marker(action=Marker.DELETEALL)
        with self._lock:
            drawn = [marker for place in self._places for marker in point_markers(place)]
            drawn += [marker for robot in self._robots for marker in robot_markers(robot, now)]
        for number, marker in enumerate(drawn):
            marker.id = number
        self._publisher.publish(MarkerArray([clear, *drawn]))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros ride_markers``."""
    run("ride_markers", RideMarkers)
