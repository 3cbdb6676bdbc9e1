"""slam's messages: what it says of pose, map and boxes, and where it is told to start."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.modules.inputs import FoundObstacles, HandedOverObstacles, InitialPose
from hitchhike_ros.modules.module import Health
from hitchhike_ros.modules.slam import SlamOutputs
from hitchhike_ros.ros_io.conversions import estimate_to_msg
from hitchhike_ros.ros_io.inlets import INLETS
from hitchhike_ros.ros_io.outlets import HITCHHIKE_COMM, slam_outlets

ESTIMATE = PoseEstimate(2.5, Pose2D(1.0, 2.0, 0.5), np.diag([0.01, 0.02, 0.03]))
BOX = Obstacle("obs1", 1.0, 2.0, 0.5, 0.25)
GRID = OccupancyGrid(np.eye(3, 5, dtype=np.int8) * 100, 0.5, Pose2D(-1.0, 2.0))


@pytest.fixture(autouse=True)
def _ros_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rospy, "get_time", lambda: 12.5)


def messages(outputs: SlamOutputs) -> dict[str, Any]:
    """The newest message of each topic, of outlets whose field says something."""
    said = {}
    for outlet in slam_outlets("p3dx/odom"):
        value = getattr(outputs, outlet.field) if outlet.field else outputs
        for msg in () if value is None else outlet.convert(value):
            assert isinstance(msg, outlet.cls)
            said[outlet.topic] = msg
    return said


def test_a_pose_comes_with_its_transform_and_its_particles() -> None:
    particles = np.array([(1.0, 2.0, 0.5), (1.5, 2.5, -0.5)])
    outputs = SlamOutputs(health=Health(), pose=ESTIMATE, T_map_odom=(2.5, Pose2D(3.0, 4.0, 1.0)), particles=particles)
    said = messages(outputs)
    assert set(said) == {"amcl_pose", "/tf", "particlecloud"}
    assert said["amcl_pose"] == estimate_to_msg(ESTIMATE)
    (transform,) = said["/tf"].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "p3dx/odom")
    assert transform.header.stamp.to_sec() == 2.5
    assert (transform.transform.translation.x, transform.transform.translation.y) == (3.0, 4.0)
    assert transform.transform.rotation.z == pytest.approx(math.sin(0.5))
    cloud = said["particlecloud"]
    assert (cloud.header.frame_id, cloud.header.stamp.to_sec()) == ("map", 2.5)
    assert [(pose.position.x, pose.position.y) for pose in cloud.poses] == [(1.0, 2.0), (1.5, 2.5)]
    assert cloud.poses[1].orientation.z == pytest.approx(math.sin(-0.25))


@pytest.mark.parametrize(("told", "published"), [("", "p3dx/odom"), ("odom", "odom"), ("robbie/odom", "robbie/odom")])
def test_the_map_is_joined_to_the_frame_that_odometry_names(told: str, published: str) -> None:
    (transform,) = messages(SlamOutputs(health=Health(), T_map_odom=(2.5, Pose2D()), odom_frame=told))["/tf"].transforms
    assert transform.child_frame_id == published


def test_without_particles_there_is_no_cloud() -> None:
    assert set(messages(SlamOutputs(health=Health(), pose=ESTIMATE))) == {"amcl_pose"}


def test_a_map_and_its_boxes_are_kept_for_who_comes_later() -> None:
    said = messages(SlamOutputs(health=Health(), grid=GRID, boxes=FoundObstacles((BOX,))))
    assert set(said) == {"map", "map_metadata", "new_obstacles"}
    assert said["map_metadata"] == said["map"].info
    assert (said["map"].info.width, said["map"].info.height, said["map"].info.resolution) == (5, 3, 0.5)
    assert said["map"].header.stamp.to_sec() == 12.5
    arrived = INLETS[OccupancyGrid].convert(said["map"])
    np.testing.assert_array_equal(arrived.data, GRID.data)  # type: ignore[attr-defined]
    assert INLETS[FoundObstacles].convert(said["new_obstacles"]) == FoundObstacles((BOX,))
    assert {outlet.topic for outlet in slam_outlets("odom") if outlet.latch} == set(said)


def test_what_a_driver_hands_over_arrives() -> None:
    by_field = {outlet.field: outlet for outlet in HITCHHIKE_COMM}
    (msg,) = by_field["handed_over"].convert(HandedOverObstacles((BOX,)))
    inlet = INLETS[HandedOverObstacles]
    assert inlet.topic == by_field["handed_over"].topic
    assert inlet.convert(msg) == HandedOverObstacles((BOX,))
    (msg,) = by_field["initial_pose"].convert(InitialPose(ESTIMATE))
    inlet = INLETS[InitialPose]
    assert inlet.topic == by_field["initial_pose"].topic
    start = inlet.convert(msg)
    assert isinstance(start, InitialPose)
    assert (start.estimate.stamp, start.estimate.pose.x) == (2.5, 1.0)
    np.testing.assert_array_equal(start.estimate.covariance, ESTIMATE.covariance)


@pytest.mark.parametrize("frame", ["map", "/map", ""])
def test_an_initial_pose_in_map_is_taken(frame: str) -> None:
    msg = estimate_to_msg(ESTIMATE, frame)
    assert isinstance(INLETS[InitialPose].convert(msg), InitialPose)


def test_an_initial_pose_in_another_frame_is_refused() -> None:
    msg = PoseWithCovarianceStamped()
    msg.header.frame_id = "odom"
    with pytest.raises(MessageError, match="frame 'odom', expected 'map'"):
        INLETS[InitialPose].convert(msg)


def test_boxes_that_are_none_are_refused() -> None:
    with pytest.raises(MessageError):
        INLETS[HandedOverObstacles].convert(String('{"obstacles": [{"id": 1}]}'))
