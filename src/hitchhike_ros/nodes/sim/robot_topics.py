"""The topics of one simulated robot, for the node simulator."""

from __future__ import annotations

import threading
from typing import Any

import cv2
import rospy
from geometry_msgs.msg import Transform, TransformStamped, Twist, Vector3
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import Image
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Header, String

from hitchhike_ros.core.datatypes import Odometry, Twist2D
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.status import decode_status
from hitchhike_ros.ros_io.conversions import (
    header,
    odometry_to_msg,
    quaternion_from_yaw,
    scan_to_msg,
    transform_from_matrix,
    twist_from_msg,
)
from hitchhike_ros.ros_io.images import camera_info_to_msg, image_to_msg
from hitchhike_ros.ros_io.node import Diagnostics
from hitchhike_ros.simulation.frames import Gate
from hitchhike_ros.simulation.physics.robot import SimulatedRobot


class RobotTopics:
    """One robot's topics: commands come in under a lock, its sensors go out.

    Args:
        robot: whose topics they are.
        diagnostics: count what is refused.
        gate: of lock-step, which learns which modules are on and what they have answered.
    """

    def __init__(self, robot: SimulatedRobot, diagnostics: Diagnostics, gate: Gate | None = None) -> None:
        self.robot, self.name, self._diagnostics = robot, robot.name, diagnostics
        self._lock = threading.Lock()
        self._command: Twist2D | None = None
        name = self.name
        self._odom = publisher(f"{name}/odom", OdometryMsg)
        self._truth = publisher(f"{name}/ground_truth", OdometryMsg)
        self._scan = publisher(f"{name}/scan", LaserScanMsg)
        self._image = publisher(f"{name}/camera/image_raw", Image)
        self._mono = publisher(f"{name}/camera/image_mono", Image)
        self._info = publisher(f"{name}/camera/camera_info", CameraInfoMsg)
        if robot.has_depth_camera:
            self._depth = publisher(f"{name}/camera/depth/image_raw", Image)
            self._depth_info = publisher(f"{name}/camera/depth/camera_info", CameraInfoMsg)
        self._subscribers = [
            rospy.Subscriber(f"{name}/cmd_vel", Twist, self._on_command, queue_size=1, tcp_nodelay=True)
        ]
        if gate is not None:
            answer = f"{name}/lockstep/answer"
            self._subscribers += [
                rospy.Subscriber(f"{name}/hhike_msg/status", String, self._on_status, gate, queue_size=10),
                rospy.Subscriber(answer, Header, self._on_answer, gate, queue_size=50, tcp_nodelay=True),
            ]

    def _on_command(self, msg: Twist) -> None:
        twist = twist_from_msg(msg)
        if not twist.is_finite():
            self._diagnostics.count("bad_cmd_vel")
            rospy.logerr_throttle(10.0, "%s/cmd_vel is not finite: the robot stops", self.name)
        with self._lock:
            self._command = twist

    def _on_status(self, msg: String, gate: Gate) -> None:
        try:
            gate.take_status(self.name, decode_status(msg.data))
        except MessageError as exc:
            self._diagnostics.count("bad_status")
            rospy.logwarn_throttle(10.0, "%s", exc)

    def _on_answer(self, msg: Header, gate: Gate) -> None:
        gate.answered(self.name, msg.frame_id, msg.stamp.to_sec())

    def drive(self, now: float) -> None:
        """Give the robot the newest command, if one came since the last call."""
        with self._lock:
            command, self._command = self._command, None
        if command is not None:
            self.robot.command(command, now)

    def publish_state(self, now: float) -> TransformStamped:
        """Odometry and ground truth; the transform for TF."""
        name, odometry = self.name, self.robot.odometry()
        pose, twist = self.robot.ground_truth()
        self._odom.publish(odometry_to_msg(odometry, f"{name}/odom", f"{name}/base_footprint"))
        self._truth.publish(odometry_to_msg(Odometry(now, pose, twist), "map", f"{name}/base_footprint"))
        transform = Transform(Vector3(odometry.pose.x, odometry.pose.y, 0.0), quaternion_from_yaw(odometry.pose.theta))
        return TransformStamped(header(odometry.stamp, f"{name}/odom"), f"{name}/base_footprint", transform)

    def wheel_transforms(self, now: float) -> list[TransformStamped]:
        """Of its wheels, for TF."""
        name = self.name
        return [
            TransformStamped(header(now, f"{name}/base_link"), f"{name}/{wheel}", transform_from_matrix(T))
            for wheel, T in self.robot.wheel_mounts().items()
        ]

    def scan_wanted(self) -> bool:
        """Whether anybody subscribes the scan."""
        return bool(self._scan.get_num_connections())

    def publish_scan(self) -> None:
        self._scan.publish(scan_to_msg(self.robot.scan(), f"{self.name}/laser"))

    def image_wanted(self) -> bool:
        """Whether anybody subscribes the image, in colours or grey."""
        return bool(self._image.get_num_connections() or self._mono.get_num_connections())

    def publish_image(self, now: float) -> None:
        frame = f"{self.name}/camera_optical"
        self._info.publish(camera_info_to_msg(self.robot.camera_info, now, frame))
        image = self.robot.camera()
        if self._image.get_num_connections():
            self._image.publish(image_to_msg(image, now, frame, "rgb8"))
        if self._mono.get_num_connections():
            self._mono.publish(image_to_msg(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), now, frame, "mono8"))

    def publish_depth(self, now: float) -> None:
        if self.robot.has_depth_camera and self._depth.get_num_connections():
            frame = f"{self.name}/depth_camera_optical"
            self._depth_info.publish(camera_info_to_msg(self.robot.depth_info, now, frame))
            self._depth.publish(image_to_msg(self.robot.depth(), now, frame, "32FC1"))


def publisher(topic: str, cls: Any) -> rospy.Publisher:
    """With the queue of a sensor, and without waiting for more to send."""
    return rospy.Publisher(topic, cls, queue_size=10, tcp_nodelay=True)
