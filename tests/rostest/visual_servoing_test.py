#!/usr/bin/python3
"""The visual_servoing node on drawn images: what it publishes, when it is off, and how it stops on bad input."""

import math
import threading
import time
import unittest

import cv2
import numpy as np
import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import Image
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Int8, String

from hitchhike_ros.core.datatypes import CameraInfo, LaserScan, Odometry, Pose2D, Twist2D
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import ModuleSwitches, ServoCommand, Status, encode_status
from hitchhike_ros.ros_io.conversions import odometry_to_msg, scan_to_msg
from hitchhike_ros.ros_io.images import camera_info_to_msg, image_to_msg

CAMERA = CameraInfo(640, 480, np.array([[554.26, 0.0, 319.5], [0.0, 554.26, 239.5], [0.0, 0.0, 1.0]]))
DEADLINE_S = 20.0
STOP_S = 0.5


def picture(marker_id, distance, size=0.16):
    """A marker square-on straight ahead of the camera, (480, 640, 3)."""
    side = round(554.26 * size / distance / 8) * 8
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag = cv2.rotate(cv2.aruco.generateImageMarker(dictionary, marker_id, side), cv2.ROTATE_180)
    plate = np.pad(tag, side // 8, constant_values=255)
    image = np.full((480, 640), 120, np.uint8)
    top, left = (480 - len(plate)) // 2, (640 - len(plate)) // 2
    image[top : top + len(plate), left : left + len(plate)] = plate
    return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)


class Robot:
    """Feeds one node with sensors at 10 Hz and keeps what it publishes, each with the time when it came."""

    def __init__(self, namespace):
        self.namespace = namespace
        self.image = None
        self.encoding = "rgb8"
        self.info = self.odometry = True
        self.camera = CAMERA
        self.truncated = False
        self.broken_odometry = False
        self._servo = self._ordered_at = None
        self._received = {}
        self._lock = threading.Lock()
        self._publishers = {
            name: rospy.Publisher(f"/{namespace}/{name}", cls, queue_size=1, latch=name == "hhike_msg/status")
            for name, cls in (
                ("camera/image_raw", Image),
                ("camera/camera_info", CameraInfoMsg),
                ("odom", OdometryMsg),
                ("scan", LaserScanMsg),
                ("hhike_msg/status", String),
            )
        }
        for name, cls in (
            ("cmd_vel/servoing", Twist),
            ("visual_servoing/observations", String),
            ("visual_servoing/object_position", PoseStamped),
            ("visual_servoing/object_position_covariance", PoseWithCovarianceStamped),
            ("visual_servoing/status", Int8),
            ("visual_servoing/code_message", String),
        ):
            rospy.Subscriber(f"/{namespace}/{name}", cls, self._keep, name)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._keep_diagnostics)
        self._timer = rospy.Timer(rospy.Duration(0.1), self._feed)

    def _keep(self, msg, name):
        with self._lock:
            self._received.setdefault(name, []).append((time.monotonic(), msg))

    def _keep_diagnostics(self, msg):
        for status in msg.status:
            if status.hardware_id == f"/{self.namespace}/visual_servoing":
                self._keep(status, "diagnostics")

    def _feed(self, _event):
        now = rospy.get_time()
        if self._ordered_at is not None and now - self._ordered_at >= 1.0:  # orders have an age
            self.order(self._servo)
        if self.odometry:
            x = math.nan if self.broken_odometry else 0.0
            msg = odometry_to_msg(Odometry(now, Pose2D(x, 0.0, 0.0), Twist2D()), "odom", "base_footprint")
            self._publishers["odom"].publish(msg)
        scan = LaserScan(now, -1.5, 0.1, 0.02, 8.0, np.full(31, 5.0))  # nothing is near
        self._publishers["scan"].publish(scan_to_msg(scan, "laser"))
        if self.info:
            self._publishers["camera/camera_info"].publish(camera_info_to_msg(self.camera, now, "camera_optical"))
        if self.image is not None:
            msg = image_to_msg(self.image, now, "camera_optical", "rgb8")
            msg.encoding = self.encoding
            msg.data = msg.data[: len(msg.data) // 2] if self.truncated else msg.data
            self._publishers["camera/image_raw"].publish(msg)

    def order(self, servo):
        self._servo, self._ordered_at = servo, rospy.get_time()
        status = Status(rospy.get_time(), self.namespace, modules=ModuleSwitches(VS=servo is not None), servo=servo)
        self._publishers["hhike_msg/status"].publish(String(encode_status(status)))

    def newest(self, name):
        with self._lock:
            return self._received[name][-1][1] if self._received.get(name) else None

    def diagnosis(self):
        """What /diagnostics said last."""
        status = self.newest("diagnostics")
        return "" if status is None else status.message

    def since(self, name, start):
        with self._lock:
            return [(at, msg) for at, msg in self._received.get(name, []) if at >= start]

    def sensors_subscribed(self):
        _, subscribers, _ = rosgraph.Master("/test").getSystemState()
        node = f"/{self.namespace}/visual_servoing"
        return any(topic == f"/{self.namespace}/camera/image_raw" and node in nodes for topic, nodes in subscribers)


def wait_until(condition, what):
    """Asks a condition fifty times a second; it may ask the master, so it is not asked under the lock of a watch."""
    end, pause = time.monotonic() + DEADLINE_S, threading.Event()
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"not within {DEADLINE_S} s: {what}")
        pause.wait(0.02)


class VisualServoingTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.robot, cls.alone = Robot("follower"), Robot("alone")

    def setUp(self):
        """Follows marker 0, seen 1.2 m ahead of the camera."""
        robot = self.robot
        robot.image, robot.encoding = picture(0, 1.2), "rgb8"
        robot.info = robot.odometry = True
        robot.camera, robot.truncated = CAMERA, False
        robot.broken_odometry = False
        robot.order(ServoCommand("follow", 0))

    def tearDown(self):
        self.robot.order(None)
        wait_until(lambda: not self.robot.sensors_subscribed(), "off, without subscriptions")

    def drives(self):
        self.wait_command(lambda v: v > 0.05, "driving")

    def wait_command(self, test, what):
        start = time.monotonic()
        wait_until(lambda: any(test(m.linear.x) for _, m in self.robot.since("cmd_vel/servoing", start)), what)

    def assert_stops(self, start, reason):
        """From STOP_S after ``start`` on every command is a stand, there are commands, and /diagnostics says why."""
        time_up = start + STOP_S
        wait_until(lambda: len(self.robot.since("cmd_vel/servoing", time_up)) >= 3, "commands to stand")
        for at, msg in self.robot.since("cmd_vel/servoing", time_up):
            self.assertEqual((msg.linear.x, msg.angular.z), (0.0, 0.0), f"{at - start:.2f} s after the failure")

        def explained():
            status = self.robot.newest("diagnostics")
            return status is not None and status.level == status.ERROR and reason in status.message

        wait_until(explained, f"/diagnostics with {reason!r}")

    def test_follows_and_reports(self):
        self.drives()
        wait_until(lambda: self.robot.newest("visual_servoing/object_position"), "a pose")
        told = decode_observations(self.robot.newest("visual_servoing/observations").data)
        self.assertEqual(told.following, "following")
        [seen] = told.markers
        pose = self.robot.newest("visual_servoing/object_position_covariance")
        self.assertEqual(seen.marker_id, 0)
        self.assertAlmostEqual(pose.pose.pose.position.z, 1.2, delta=0.06)
        self.assertAlmostEqual(seen.pose.x, pose.pose.pose.position.z + 0.12, delta=0.06)
        self.assertAlmostEqual(seen.pose.y, 0.0, delta=0.02)
        self.assertEqual(pose.header.frame_id, "camera_optical")
        self.assertTrue((np.linalg.eigvalsh(np.reshape(pose.pose.covariance, (6, 6))) > 0).all())
        self.assertEqual(self.robot.newest("visual_servoing/status").data, 3)
        self.assertEqual(self.robot.newest("visual_servoing/code_message").data, "36h11 id: 0")

    def test_observing_does_not_drive(self):
        self.drives()
        self.robot.order(ServoCommand("observe", 0))
        wait_until(lambda: self.robot.diagnosis() == "observing", "observing")
        start = time.monotonic()
        wait_until(lambda: len(self.robot.since("visual_servoing/observations", start)) >= 5, "observations")
        self.assertEqual(self.robot.since("cmd_vel/servoing", start), [])

    def test_lost_marker_has_a_status_and_no_pose(self):
        self.drives()
        self.robot.image = np.full((480, 640, 3), 120, np.uint8)
        wait_until(lambda: self.robot.newest("visual_servoing/status").data == 1, "marker out of view")
        start = time.monotonic()
        # These wheels never turn: there is nothing to coast, and turning ends by its timeout.
        wait_until(lambda: "looking" in self.robot.diagnosis(), "looking")
        said = decode_observations(self.robot.newest("visual_servoing/observations").data)
        self.assertIn(said.following, ("looking", "turning"))
        wait_until(lambda: "lost" in self.robot.diagnosis(), "lost")
        self.assert_stops(time.monotonic(), "lost")
        self.assertEqual(self.robot.since("visual_servoing/object_position", start + 0.1), [])
        self.assertEqual(decode_observations(self.robot.newest("visual_servoing/observations").data).markers, ())
        self.robot.image = picture(0, 1.2)
        self.drives()

    def test_silent_camera(self):
        self.drives()
        self.robot.image = None
        self.assert_stops(time.monotonic(), "no image")
        self.assertEqual(self.robot.newest("visual_servoing/status").data, 0)

    def test_no_camera_info(self):
        self.robot.order(None)
        wait_until(lambda: not self.robot.sensors_subscribed(), "off")
        self.robot.info = False
        self.robot.order(ServoCommand("follow", 0))
        wait_until(self.robot.sensors_subscribed, "on")
        self.assert_stops(time.monotonic(), "no camera_info")
        self.robot.info = True
        self.drives()

    def test_odometry_that_is_not_finite(self):
        self.drives()
        self.robot.broken_odometry = True
        self.assert_stops(time.monotonic(), "not finite")
        self.robot.broken_odometry = False
        self.drives()

    def test_silent_odometry(self):
        self.drives()
        self.robot.odometry = False
        self.assert_stops(time.monotonic() + 0.1, "odometry is")

    def test_unusable_images_are_named(self):
        self.drives()
        self.robot.encoding = "nv21"
        self.assert_stops(time.monotonic(), "nv21")
        self.robot.encoding = "rgb8"
        self.robot.image = picture(0, 1.2)[:240].copy()
        self.assert_stops(time.monotonic() + 0.2, "640 x 480")
        self.robot.image = np.zeros((0, 0, 3), np.uint8)
        self.assert_stops(time.monotonic() + 0.2, "image of 0 bytes")
        self.robot.image = np.zeros((3, 3, 3), np.uint8)
        self.assert_stops(time.monotonic() + 0.2, "(3, 3)")
        self.robot.image, self.robot.truncated = picture(0, 1.2), True
        self.assert_stops(time.monotonic() + 0.2, f"image of {640 * 480 * 3 // 2} bytes")
        self.robot.truncated = False
        self.drives()

    def test_a_calibration_of_zeros_is_named(self):
        self.drives()
        self.robot.camera = CameraInfo(640, 480, np.zeros((3, 3)))
        self.assert_stops(time.monotonic() + 0.2, "focal lengths")
        self.robot.camera = CAMERA
        self.drives()

    def test_annotates_for_who_looks(self):
        self.drives()
        pictures = []
        subscriber = rospy.Subscriber("/follower/visual_servoing/image_annotated", Image, pictures.append)
        wait_until(lambda: pictures, "an annotated image")
        subscriber.unregister()
        self.assertEqual((pictures[0].width, pictures[0].height, pictures[0].encoding), (640, 480, "rgb8"))
        pixels = np.frombuffer(pictures[0].data, np.uint8).reshape(480, 640, 3)
        self.assertTrue((pixels == (0, 255, 0)).all(axis=2).any())

    def test_off_is_silent(self):
        self.drives()
        self.robot.order(None)
        wait_until(lambda: not self.robot.sensors_subscribed(), "off")
        wait_until(lambda: self.robot.newest("cmd_vel/servoing").linear.x == 0.0, "a last stand")
        start = time.monotonic()
        wait_until(lambda: self.robot.diagnosis() == "off", "off in /diagnostics")
        for name in ("cmd_vel/servoing", "visual_servoing/observations", "visual_servoing/status"):
            self.assertEqual(self.robot.since(name, start + 0.2), [])

    def test_alone_it_gives_the_pose_of_one_marker(self):
        """As visp_auto_tracker: no status, no URDF, no odometry, a marker of another size."""
        self.alone.odometry = False
        self.alone.image = picture(3, 2.0, size=0.32)
        wait_until(lambda: self.alone.newest("visual_servoing/object_position"), "a pose")
        self.assertAlmostEqual(self.alone.newest("visual_servoing/object_position").pose.position.z, 2.0, delta=0.1)
        self.assertIsNone(self.alone.newest("cmd_vel/servoing"))
        wait_until(lambda: self.alone.diagnosis() == "observing", "observing")

    def test_a_marker_that_cannot_be_is_named_and_the_node_lives_on(self):
        for namespace, named in (("odd_family", "99h9"), ("no_size", "marker_size_m")):
            robot = Robot(namespace)
            for image in (None, picture(0, 1.2)):
                robot.image, start = image, time.monotonic()

                def explained(robot=robot, start=start, named=named):
                    said = [status for _, status in robot.since("diagnostics", start)]
                    return any(status.level == status.ERROR and named in status.message for status in said)

                wait_until(explained, f"/diagnostics with {named!r}")
            wait_until(lambda robot=robot: robot.newest("visual_servoing/status"), "a status of the image")
            self.assertEqual(robot.newest("visual_servoing/status").data, 0)
            self.assertIsNone(robot.newest("visual_servoing/object_position"))


if __name__ == "__main__":
    rospy.init_node("visual_servoing_test")
    rostest.rosrun("hitchhike_ros", "visual_servoing", VisualServoingTest)
