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
from collections.abc import Iterator
from dataclasses import dataclass, field

import msgspec
import rospy
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from hitchhike_ros.core.datatypes import HitchhikingPoint, MarkerObservation, Obstacle, Pose2D, Positive
from hitchhike_ros.core.errors import MessageError, ParameterError
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import Status, decode_status
from hitchhike_ros.ros_io.conversions import pose_to_msg
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer
from hitchhike_ros.simulation.world_file import load_world

_GREEN, _ORANGE, _BLUE = (
    ColorRGBA(0.0, 0.62, 0.45, 1.0),
    ColorRGBA(0.84, 0.37, 0.0, 1.0),
    ColorRGBA(0.0, 0.45, 0.7, 1.0),
)
_BLACK = ColorRGBA(0.0, 0.0, 0.0, 1.0)
_TEXT_M, _LINE_M, _BOX_HEIGHT_M, _ABOVE_M, _BESIDE_M = 0.3, 0.04, 0.4, 0.9, 0.8
_ARROW = Vector3(0.5, 0.08, 0.08)
_OLD_S = 1.0  # a marker that was seen longer ago is not shown


@dataclass(frozen=True)
class RideMarkersParameters:
    """Section ``ride_markers``."""

    period_s: Positive = 0.2


@dataclass
class _Robot:
    """What it said last."""

    name: str
    beside_m: float = _BESIDE_M  # from its middle to the left, where its text stands
    status: Status | None = None
    boxes: tuple[Obstacle, ...] = ()
    seen: tuple[MarkerObservation, ...] = ()
    subscribers: list[rospy.Subscriber] = field(default_factory=list)


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
        # One to the left, the next to the right: who rides together is near.
        self._robots = [_Robot(name, -_BESIDE_M if k % 2 else _BESIDE_M) for k, name in enumerate(names)]
        for robot in self._robots:
            for topic, callback in (
                ("hhike_msg/status", self._on_status),
                ("new_obstacles", self._on_boxes),
                ("visual_servoing/observations", self._on_seen),
            ):
                robot.subscribers.append(
                    rospy.Subscriber(f"/{robot.name}/{topic}", String, callback, robot, queue_size=5)
                )
        period_s = node_parameters(RideMarkersParameters, "ride_markers").period_s
        self._timer = Timer(period_s, self._draw)

    def _on_status(self, msg: String, robot: _Robot) -> None:
        try:
            status = decode_status(msg.data)
        except MessageError as exc:
            rospy.logwarn_throttle(10.0, "%s", exc)
            return
        with self._lock:
            robot.status = status

    def _on_boxes(self, msg: String, robot: _Robot) -> None:
        try:
            boxes = msgspec.json.decode(msg.data, type=NewObstacles).obstacles
        except msgspec.MsgspecError as exc:
            rospy.logwarn_throttle(10.0, "/%s/new_obstacles: %s", robot.name, exc)
            return
        with self._lock:
            robot.boxes = boxes

    def _on_seen(self, msg: String, robot: _Robot) -> None:
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
            drawn = [marker for place in self._places for marker in _place(place)]
            drawn += [marker for robot in self._robots for marker in _of_robot(robot, now)]
        for number, marker in enumerate(drawn):
            marker.id = number
        self._publisher.publish(MarkerArray([clear, *drawn]))


def _place(place: HitchhikingPoint) -> Iterator[Marker]:
    """The area, where both stand, and the name."""
    outline = [Point(x, y, 0.02) for x, y in (*place.area, *place.area[:1])]
    yield _marker("map", "hitchhiking points", Marker.LINE_STRIP, _GREEN, Vector3(_LINE_M, 0.0, 0.0), points=outline)
    for pose in (place.waiting_pose, place.aligning_pose):
        yield _marker("map", "hitchhiking points", Marker.ARROW, _GREEN, _ARROW, pose)
    at = place.waiting_pose
    yield _text("map", "hitchhiking points", _GREEN, at.x, at.y - 1.0, 0.1, place.name)


def _of_robot(robot: _Robot, now: float) -> Iterator[Marker]:
    frame, status = f"{robot.name}/base_footprint", robot.status
    for box in robot.boxes:
        middle = Pose2D(box.x + box.w / 2, box.y + box.b / 2, 0.0)
        size = Vector3(max(box.w, _LINE_M), max(box.b, _LINE_M), _BOX_HEIGHT_M)
        marker = _marker("map", f"new boxes of {robot.name}", Marker.CUBE, _ORANGE, size, middle)
        marker.pose.position.z = _BOX_HEIGHT_M / 2
        yield marker
    if status is None:
        return
    said = f"{robot.name}: {status.state.replace('_', ' ')}" + (f"\n{status.reason}" if status.reason else "")
    yield _text(frame, "state", _BLACK, 0.0, robot.beside_m, _ABOVE_M, said)
    servo = status.servo
    if servo is None or servo.task != "follow":
        return
    for seen in robot.seen:
        if seen.marker_id == servo.marker_id and now - seen.stamp <= _OLD_S:
            ends = [Point(0.0, 0.0, _BOX_HEIGHT_M), Point(seen.pose.x, seen.pose.y, _BOX_HEIGHT_M)]
            yield _marker(frame, "gap", Marker.LINE_LIST, _BLUE, Vector3(_LINE_M, 0.0, 0.0), points=ends)
            away = (seen.pose.x**2 + seen.pose.y**2) ** 0.5
            yield _text(
                frame, "gap", _BLUE, seen.pose.x / 2, 0.5, _BOX_HEIGHT_M, f"{away:.2f} m to marker {seen.marker_id}"
            )


def _text(frame: str, namespace: str, colour: ColorRGBA, x: float, y: float, z: float, text: str) -> Marker:
    marker = _marker(frame, namespace, Marker.TEXT_VIEW_FACING, colour, Vector3(0.0, 0.0, _TEXT_M), Pose2D(x, y, 0.0))
    marker.pose.position.z, marker.text = z, text
    return marker


def _marker(
    frame: str,
    namespace: str,
    kind: int,
    colour: ColorRGBA,
    scale: Vector3,
    pose: Pose2D | None = None,
    points: list[Point] | None = None,
) -> Marker:
    """``pose`` and ``points`` are in ``frame``, at its newest place."""
    return Marker(
        header=Header(frame_id=frame),
        ns=namespace,
        type=kind,
        action=Marker.ADD,
        pose=pose_to_msg(pose or Pose2D()),
        scale=scale,
        color=colour,
        points=points or [],
        frame_locked=True,
    )


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros ride_markers``."""
    run("ride_markers", RideMarkers)
