"""What rviz is shown of a ride."""

from __future__ import annotations

import numpy as np
from visualization_msgs.msg import Marker

from hitchhike_ros.core.datatypes import HitchhikingPoint, MarkerObservation, Obstacle, Pose2D
from hitchhike_ros.mapping.octree import Voxels
from hitchhike_ros.protocol.status import ServoCommand, Status
from hitchhike_ros.ros_io.markers import DrawnRobot, drawn_robots, point_markers, robot_markers, voxel_markers


def _seen(stamp: float, marker_id: int) -> MarkerObservation:
    return MarkerObservation(stamp, marker_id, Pose2D(0.6, 0.8, 3.1), np.zeros((3, 3)))


def _texts(robot: DrawnRobot, now: float) -> list[str]:
    return [m.text for m in robot_markers(robot, now) if m.type == Marker.TEXT_VIEW_FACING]


def test_a_robot_of_which_nothing_was_heard_is_not_drawn() -> None:
    assert list(robot_markers(DrawnRobot("turtlebot", 0.8), 1.0)) == []


def test_texts_of_robots_that_follow_each_other_stand_on_different_sides() -> None:
    robots = drawn_robots(["p3dx", "turtlebot", "last"])
    assert [robot.name for robot in robots] == ["p3dx", "turtlebot", "last"]
    assert [robot.beside_m for robot in robots] == [0.8, -0.8, 0.8]


def test_state_and_reason_stand_beside_the_robot_in_its_own_frame() -> None:
    status = Status(1.0, "turtlebot", "hitchhiker", "awaiting_aligned", "Driver is late")
    (marker,) = robot_markers(DrawnRobot("turtlebot", 0.8, status=status), 1.0)
    assert (marker.header.frame_id, marker.text) == (
        "turtlebot/base_footprint",
        "turtlebot: awaiting aligned\nDriver is late",
    )


def test_the_line_goes_to_the_marker_that_is_followed_while_it_is_seen() -> None:
    status = Status(1.0, "turtlebot", "hitchhiker", "riding", servo=ServoCommand("follow", 0))
    robot = DrawnRobot("turtlebot", 0.8, status=status, seen=(_seen(5.0, 0), _seen(5.0, 7)))
    lines = [m for m in robot_markers(robot, 5.2) if m.ns == "gap" and m.type == Marker.LINE_LIST]
    assert [(p.x, p.y) for p in lines[0].points] == [(0.0, 0.0), (0.6, 0.8)]
    assert len(lines) == 1
    assert _texts(robot, 5.2)[1:] == ["1.00 m to marker 0"]
    assert _texts(robot, 6.5)[1:] == []


def test_boxes_are_where_they_are_in_the_map() -> None:
    robot = DrawnRobot("p3dx", 0.8, boxes=(Obstacle("a", 1.0, 2.0, 0.4, 0.6),))
    (box,) = robot_markers(robot, 0.0)
    assert (box.header.frame_id, box.pose.position.x, box.pose.position.y) == ("map", 1.2, 2.3)
    assert (box.scale.x, box.scale.y) == (0.4, 0.6)


def test_a_hitchhiking_point_is_a_closed_line_two_arrows_and_its_name() -> None:
    area = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0))
    outline, waiting, aligning, name = point_markers(
        HitchhikingPoint("west", area, Pose2D(1.5, 1.0, 0.0), Pose2D(0.5, 1.0, 0.0))
    )
    assert [(p.x, p.y) for p in outline.points] == [*area, area[0]]
    assert (waiting.pose.position.x, aligning.pose.position.x, name.text) == (0.5, 1.5, "west")


def test_voxels_are_cubes_of_their_size_from_red_on_the_floor_to_blue_above() -> None:
    centres = np.array([(1.0, 2.0, 0.0), (1.0, 2.0, 1.0), (3.0, 4.0, 2.5)])
    found = voxel_markers(Voxels(0.05, centres, np.array([0.05, 0.05, 0.1])), 7.0).markers
    small, large, *none = found
    assert {marker.header.frame_id for marker in found} == {"map"}
    assert small.header.stamp.to_sec() == 7.0
    assert (small.action, small.type, small.scale.x, large.scale.z) == (Marker.ADD, Marker.CUBE_LIST, 0.05, 0.1)
    assert [(p.x, p.y, p.z) for p in small.points] == [(1.0, 2.0, 0.0), (1.0, 2.0, 1.0)]
    assert [(c.r, c.g, c.b) for c in small.colors] == [(1.0, 0.0, 0.0), (0.5, 1.0, 0.5)]
    assert [(c.r, c.g, c.b) for c in large.colors] == [(0.0, 0.0, 1.0)]
    assert {marker.action for marker in none} == {Marker.DELETE}
    assert len({marker.id for marker in found}) == len(found) == 16
