"""Pure functions that make the markers which rviz and other viewers show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from hitchhike_ros.core.datatypes import FloatArray, HitchhikingPoint, MarkerObservation, Obstacle, Pose2D
from hitchhike_ros.mapping.octree import Voxels
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.conversions import header, pose_to_msg

# Colours of voxels from the floor to this height (m, chosen).
_COLOUR_M = 2.0
_GREEN, _ORANGE, _BLUE = (
    ColorRGBA(0.0, 0.62, 0.45, 1.0),
    ColorRGBA(0.84, 0.37, 0.0, 1.0),
    ColorRGBA(0.0, 0.45, 0.7, 1.0),
)
_BLACK = ColorRGBA(0.0, 0.0, 0.0, 1.0)
_TEXT_M, _LINE_M, _BOX_HEIGHT_M, _ABOVE_M = 0.3, 0.04, 0.4, 0.9
_ARROW = Vector3(0.5, 0.08, 0.08)
_BESIDE_M = 0.8  # where a robot's text stands
_OLD_S = 1.0  # a marker that was seen longer ago is not shown


@dataclass
class DrawnRobot:
    """What a robot said last; ``beside_m`` is from its middle to the left, where its text stands."""

    name: str
    beside_m: float
    status: Status | None = None
    boxes: tuple[Obstacle, ...] = ()
    seen: tuple[MarkerObservation, ...] = ()


def drawn_robots(names: Iterable[str]) -> list[DrawnRobot]:
    """Robots of which nothing was heard. Texts stand left and right in turn, as who rides together is near."""
    return [DrawnRobot(name, -_BESIDE_M if k % 2 else _BESIDE_M) for k, name in enumerate(names)]


def voxel_markers(voxels: Voxels, stamp: float) -> MarkerArray:
    """Voxels as octomap_server shows them: a list of cubes for each size, from red on the floor to blue above."""
    sides = voxels.resolution_m * 2.0 ** np.arange(16)
    markers = []
    for number, side in enumerate(sides):
        marker = Marker(header=header(stamp, "map"), ns="map", id=number, type=Marker.CUBE_LIST)
        centres = voxels.centres[np.isclose(voxels.sides, side, rtol=0.1)]
        marker.action = Marker.ADD if len(centres) else Marker.DELETE
        marker.pose.orientation.w = 1.0
        marker.scale = Vector3(side, side, side)
        marker.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
        marker.points = [Point(*centre) for centre in centres.tolist()]
        marker.colors = _colours(centres[:, 2])
        markers.append(marker)
    return MarkerArray(markers)


def _colours(heights: FloatArray) -> list[ColorRGBA]:
    """A colour for each height (N,) in m."""
    u = np.clip(heights / _COLOUR_M, 0.0, 1.0)
    rgb = np.column_stack((1.0 - u, 1.0 - np.abs(2.0 * u - 1.0), u))
    return [ColorRGBA(r, g, b, 1.0) for r, g, b in rgb.tolist()]


def point_markers(place: HitchhikingPoint) -> Iterator[Marker]:
    """A hitchhiking point: its area, where both robots stand, and its name."""
    outline = [Point(x, y, 0.02) for x, y in (*place.area, *place.area[:1])]
    yield _marker("map", "hitchhiking points", Marker.LINE_STRIP, _GREEN, Vector3(_LINE_M, 0.0, 0.0), points=outline)
    for pose in (place.waiting_pose, place.aligning_pose):
        yield _marker("map", "hitchhiking points", Marker.ARROW, _GREEN, _ARROW, pose)
    at = place.waiting_pose
    yield _text("map", "hitchhiking points", _GREEN, at.x, at.y - 1.0, 0.1, place.name)


def robot_markers(robot: DrawnRobot, now: float) -> Iterator[Marker]:
    """A robot: its new boxes, its state with the reason, and a line to the marker that it follows; ``now`` in s."""
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
