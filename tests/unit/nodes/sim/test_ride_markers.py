"""What rviz is shown of a ride."""

from __future__ import annotations

import numpy as np
from visualization_msgs.msg import Marker

from hitchhike_ros.core.datatypes import HitchhikingPoint, MarkerObservation, Obstacle, Pose2D
from hitchhike_ros.nodes.sim.ride_markers import _of_robot, _place, _Robot
from hitchhike_ros.protocol.status import ServoCommand, Status


def _seen(stamp: float, marker_id: int) -> MarkerObservation:
    return MarkerObservation(stamp, marker_id, Pose2D(0.6, 0.8, 3.1), np.zeros((3, 3)))


def _texts(robot: _Robot, now: float) -> list[str]:
    return [m.text for m in _of_robot(robot, now) if m.type == Marker.TEXT_VIEW_FACING]


def test_a_robot_of_which_nothing_was_heard_is_not_drawn() -> None:
    assert list(_of_robot(_Robot("turtlebot"), 1.0)) == []


def test_state_and_reason_stand_beside_the_robot_in_its_own_frame() -> None:
    status = Status(1.0, "turtlebot", "hitchhiker", "awaiting_aligned", "Driver is late")
    (marker,) = _of_robot(_Robot("turtlebot", status=status), 1.0)
    assert (marker.header.frame_id, marker.text) == (
        "turtlebot/base_footprint",
        "turtlebot: awaiting aligned\nDriver is late",
    )


def test_the_line_goes_to_the_marker_that_is_followed_while_it_is_seen() -> None:
    status = Status(1.0, "turtlebot", "hitchhiker", "riding", servo=ServoCommand("follow", 0))
    robot = _Robot("turtlebot", status=status, seen=(_seen(5.0, 0), _seen(5.0, 7)))
    lines = [m for m in _of_robot(robot, 5.2) if m.ns == "gap" and m.type == Marker.LINE_LIST]
    assert [(p.x, p.y) for p in lines[0].points] == [(0.0, 0.0), (0.6, 0.8)]
    assert len(lines) == 1
    assert _texts(robot, 5.2)[1:] == ["1.00 m to marker 0"]
    assert _texts(robot, 6.5)[1:] == []


def test_boxes_are_where_they_are_in_the_map() -> None:
    robot = _Robot("p3dx", boxes=(Obstacle("a", 1.0, 2.0, 0.4, 0.6),))
    (box,) = _of_robot(robot, 0.0)
    assert (box.header.frame_id, box.pose.position.x, box.pose.position.y) == ("map", 1.2, 2.3)
    assert (box.scale.x, box.scale.y) == (0.4, 0.6)


def test_a_hitchhiking_point_is_a_closed_line_two_arrows_and_its_name() -> None:
    area = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0))
    outline, waiting, aligning, name = _place(
        HitchhikingPoint("west", area, Pose2D(1.5, 1.0, 0.0), Pose2D(0.5, 1.0, 0.0))
    )
    assert [(p.x, p.y) for p in outline.points] == [*area, area[0]]
    assert (waiting.pose.position.x, aligning.pose.position.x, name.text) == (0.5, 1.5, "west")
