"""Poses that people and programs give in any frame, in ``map``."""

from __future__ import annotations

import time

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import FrameError
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.ros_io.conversions import pose_from_msg, yaw_from_quaternion

_TIMEOUT_S = 2.0  # wall time: transforms come several times a second (chosen)
_LOOK_S = 0.02


def is_map(frame_id: str) -> bool:
    """Whether a frame is ``map``, by name or because none is named."""
    return frame_id.strip("/") in ("map", "")


def pose_in_map(msg: PoseStamped, timeout_s: float = _TIMEOUT_S) -> Pose2D:
    """Return a pose of any frame in ``map``, where the frame is now.

    TF is listened to only meanwhile, as poses in other frames are rare and all transforms are a lot to hear.

    Raises:
        FrameError: TF does not connect the frame with ``map`` within ``timeout_s`` of wall time.
    """
    pose, frame = pose_from_msg(msg.pose), msg.header.frame_id.strip("/")
    if is_map(frame):
        return pose
    buffer = tf2_ros.Buffer(debug=False)
    listener = tf2_ros.TransformListener(buffer)
    try:
        end = time.monotonic() + timeout_s
        while not buffer.can_transform("map", frame, rospy.Time()):
            if time.monotonic() >= end or rospy.is_shutdown():
                raise FrameError(f"frame {frame!r}, expected 'map' or one that TF connects with it")
            time.sleep(_LOOK_S)
        transform = buffer.lookup_transform("map", frame, rospy.Time()).transform
    finally:
        listener.unregister()
    at = transform.translation
    return compose(Pose2D(at.x, at.y, yaw_from_quaternion(transform.rotation)), pose)
