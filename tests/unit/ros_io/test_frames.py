"""Poses in frames other than ``map``."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace
from typing import Any

import pytest
import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped, Transform, TransformStamped, Vector3

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import FrameError
from hitchhike_ros.ros_io.conversions import pose_stamped, quaternion_from_yaw
from hitchhike_ros.ros_io.frames import is_map, pose_in_map


@pytest.fixture
def listeners(monkeypatch: pytest.MonkeyPatch, ros: FakeRos) -> list[str]:  # noqa: F811
    """Of TF, which knows where ``p3dx/odom`` is: what became of them."""
    log: list[str] = []

    def listen(buffer: Any) -> Any:
        log.append("listens")
        transform = Transform(Vector3(3.0, -1.0, 0.2), quaternion_from_yaw(math.pi / 2))
        msg = TransformStamped(transform=transform, child_frame_id="p3dx/odom")
        msg.header.frame_id, msg.header.stamp = "map", rospy.Time(5)
        buffer.set_transform(msg, "test")
        return SimpleNamespace(unregister=lambda: log.append("has ended"))

    monkeypatch.setattr(tf2_ros, "TransformListener", listen)
    return log


def test_a_pose_in_another_frame_is_where_tf_has_the_frame(listeners: list[str]) -> None:
    pose = pose_in_map(pose_stamped(Pose2D(2.0, 0.5, 0.3), 0.0, "/p3dx/odom"))
    assert (pose.x, pose.y, pose.theta) == pytest.approx((2.5, 1.0, math.pi / 2 + 0.3))
    assert listeners == ["listens", "has ended"]


@pytest.mark.parametrize("frame", ["map", "/map", ""])
def test_for_a_pose_in_the_map_nobody_listens_to_tf(frame: str, listeners: list[str]) -> None:
    assert is_map(frame)
    assert pose_in_map(pose_stamped(Pose2D(2.0, 0.5, 0.3), 0.0, frame)) == Pose2D(2.0, 0.5, pytest.approx(0.3))
    assert listeners == []


def test_an_unknown_frame_is_named_after_a_moment(listeners: list[str]) -> None:
    began = time.monotonic()
    with pytest.raises(FrameError, match="frame 'cellar', expected 'map' or one that TF connects with it"):
        pose_in_map(pose_stamped(Pose2D(), 0.0, "cellar"), timeout_s=0.1)
    assert time.monotonic() - began < 30.0
    assert listeners == ["listens", "has ended"]


def test_a_senseless_pose_stays_senseless(listeners: list[str]) -> None:
    nowhere = PoseStamped()
    nowhere.header.frame_id = "p3dx/odom"
    assert math.isnan(pose_in_map(nowhere).theta)
