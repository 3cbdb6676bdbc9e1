"""visual_servoing: finds markers in the camera's image and rides behind one (module VS).

The marker that it rides behind, or alone the one marker that it is there for, is carried from image to image by a
model-based tracker between detections. What is published belongs to the image that it was seen in; a marker that is not
seen has a status, and no pose.

Alone it stands in for visp_auto_tracker and apriltag_ros, with one marker of any camera that has been calibrated:

    rosrun hitchhike_ros visual_servoing _always_on:=true _family:=36h11 _marker_id:=0 _marker_size_m:=0.16 \\
        camera/image_raw:=/usb_cam/image_raw camera/camera_info:=/usb_cam/camera_info

Subscribed:
    hhike_msg/status (std_msgs/String): whether the module is on, and which marker to follow or observe
    camera/image_raw (sensor_msgs/Image: mono8, rgb8 or bgr8), camera/camera_info (sensor_msgs/CameraInfo, plumb_bob),
    odom (nav_msgs/Odometry): only while the module is on
    scan (sensor_msgs/LaserScan): only while the task is to follow, with a config and a URDF that has a laser: what
        comes between is braked for
Published, once an image, or every other one while it follows steadily:
    visual_servoing/observations (std_msgs/String): JSON of all markers seen, in base_footprint
    visual_servoing/object_position (geometry_msgs/PoseStamped), object_position_covariance
        (geometry_msgs/PoseWithCovarianceStamped): the marker in the frame of the image; x is its outward normal, z up
    visual_servoing/status (std_msgs/Int8): as visp_auto_tracker: 0 no usable image, 1 seeking the marker, 3 seen
    visual_servoing/code_message (std_msgs/String): family and id, e.g. ``36h11 id: 0``, or what the QR code says
    visual_servoing/image_annotated (sensor_msgs/Image): only when somebody subscribes
Published while the task is to follow:
    cmd_vel/servoing (geometry_msgs/Twist): likewise, and a stand when images are missing
Always:
    /diagnostics (diagnostic_msgs/DiagnosticArray): what is followed, or why the robot stands
Parameters:
    ~config (path), sections ``marker_detector`` (servoing.marker_detector.MarkerDetectorParameters), ``marker_tracker``
        (servoing.marker_tracker.MarkerTrackerParameters), ``follow`` (servoing.follow.FollowParameters),
        ``visual_servoing`` (VisualServoingParameters) and, to follow, ``robot``. A private parameter with the name of
        one of theirs replaces it, e.g. ~family (36h11; 25h9, 16h5, circle21h7 or qr). With a marker that cannot be, of
        size 0 or of an unknown family, the node sees nothing and /diagnostics says why
    ~urdf (path): mount of the camera (link camera_optical); without it the camera is taken for the robot's base
    ~always_on (bool, false): on without anyone's status; then also
    ~marker_id (int, -1): the marker, -1 for whichever is nearest; ~code_message (string): instead, what its QR code
        says; ~marker_size_m (m, 0.16): side of the black square, or of the code; ~task (observe, or follow);
        ~gap_m (m, 0.8)
    ~tf_prefix: prefix of the camera's frame when the images name none
TF: none.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import cv2
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import Image
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Int8, String

from hitchhike_ros.control.safety_limiter import SafetyLimiter
from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, MarkerObservation, Positive, Twist2D
from hitchhike_ros.core.errors import ParameterError, SensorDataError, VisionError
from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import RobotLimits, fixed_transforms, mount
from hitchhike_ros.protocol.observations import encode_observations
from hitchhike_ros.protocol.status import ANY_MARKER, ServoCommand, Status
from hitchhike_ros.ros_io.conversions import (
    LaserScanArrayMsg,
    camera_info_from_msg,
    image_from_msg,
    image_to_msg,
    odometry_from_msg,
    quaternion_from_rotation,
    scan_from_msg,
    twist_to_msg,
)
from hitchhike_ros.ros_io.node import ERROR, OK, WARN, Diagnostics, LockstepAnswer, StatusListener, Switch, run
from hitchhike_ros.ros_io.parameters import frame, is_given, node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer
from hitchhike_ros.servoing.follow import Decision, FollowLaw
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.marker_detector import (
    MarkerDetection,
    MarkerDetectorParameters,
    nearest,
    planar_observation,
)
from hitchhike_ros.servoing.marker_tracker import MarkerTracker, MarkerTrackerParameters
from hitchhike_ros.servoing.qr_codes import code_id

# States of visp_auto_tracker. Its 2, 4 and 5 are steps of one image's work here.
NO_IMAGE, SEEKING, SEEN = 0, 1, 3
# What following says of itself; the rest are errors.
_LEVELS = {"following": OK, "searching": WARN, "coasting": WARN, "looking": WARN, "turning": WARN}
# Distortion models that OpenCV's coefficients describe; a camera without distortion may name none.
LENSES = ("plumb_bob", "rational_polynomial", "")
# Optical frame (z forward, x right, y down) of a camera that looks along the robot's x axis.
T_FORWARD_OPTICAL = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class VisualServoingParameters:
    """Section ``visual_servoing``."""

    image_timeout_s: Positive = 0.3
    """Without an image for longer than this the robot stands (chosen)."""
    watch_period_s: Positive = 0.1
    """How often that is looked at (chosen)."""
    start_s: Positive = 1.0
    """For so long after being switched on, what is missing is not called an error (chosen)."""
    steady_period_s: Positive = 0.19
    """While it follows steadily, an image that comes sooner than this after the one looked at last is left alone: at
    10 Hz every other one (chosen; with one of three it weaves)."""
    steady_gap_m: Positive = 0.04
    """It follows steadily when it is no farther off its gap than this (chosen)"""
    steady_speed_mps: Positive = 0.25
    """and drives at least so fast: starting and stopping takes every image (chosen)"""
    steady_yaw_rate_rps: Positive = 0.15
    """and hardly turns (chosen)."""


class VisualServoing:
    """Odometry is stored as it comes; each image, or its absence, steps detector and law under one lock."""

    def __init__(self) -> None:
        self._params = node_parameters(VisualServoingParameters, "visual_servoing")
        self._unusable = ""
        self._following = ""  # what the law said last
        self._tracker = self._make_tracker()
        self._T_base_camera: FloatArray = (
            mount(path_parameter("urdf"), "camera_optical") if is_given("urdf") else T_FORWARD_OPTICAL
        )
        self._law: FollowLaw | None = None
        self._limiter: SafetyLimiter | None = None
        if is_given("config"):
            limits = node_parameters(RobotLimits, "robot")
            self._law = FollowLaw(
                node_parameters(FollowParameters, "follow"), limits, camera_x_m=float(self._T_base_camera[0, 3])
            )
            laser = fixed_transforms(path_parameter("urdf")).get("laser") if is_given("urdf") else None
            self._limiter = None if laser is None else SafetyLimiter(limits, pose_from_matrix(laser))
        self._camera_frame = frame("camera_optical")
        self._lock = threading.RLock()
        self._servo: ServoCommand | None = None
        self._info: CameraInfo | None = None
        self._lens = ""
        self._odometry_problem = ""
        self._on_since = self._image_at = 0.0
        self._looked_at = 0.0  # stamp of the newest image that was searched
        self._steady: Twist2D | None = None  # the command, while it is to stay as it is for a while
        self._timer: Timer | None = None

        self._commands = rospy.Publisher("cmd_vel/servoing", Twist, queue_size=1, tcp_nodelay=True)
        self._observations = self._output("observations", String)
        self._poses = self._output("object_position", PoseStamped)
        self._poses_covariance = self._output("object_position_covariance", PoseWithCovarianceStamped)
        self._states = self._output("status", Int8)
        self._codes = self._output("code_message", String)
        self._annotated = self._output("image_annotated", Image)
        self._answer = LockstepAnswer("visual_servoing")
        self._diagnostics = Diagnostics("visual_servoing")
        self._switch = Switch(
            [
                ("odom", OdometryMsg, self._on_odometry),
                ("camera/camera_info", CameraInfoMsg, self._on_camera_info),
                ("camera/image_raw", Image, self._on_image),
            ]
        )
        self._laser = Switch([("scan", LaserScanArrayMsg, self._on_scan)])
        self._alone = bool(rospy.get_param("~always_on", False))
        if self._alone:
            self._turn(ServoCommand("observe", ANY_MARKER) if self._unusable else self._own_command())
        else:
            self._turn(None)
            self._listener = StatusListener(self._on_status, self._diagnostics)

    def _make_tracker(self) -> MarkerTracker:
        """Of the marker that the parameters describe; one that cannot be sought is spoken of for as long as it is asked
        for, and the robot stands."""
        try:
            return MarkerTracker(
                node_parameters(MarkerDetectorParameters, "marker_detector"),
                node_parameters(MarkerTrackerParameters, "marker_tracker"),
            )
        except (ParameterError, VisionError) as exc:
            rospy.logerr("%s: %s", rospy.get_name(), exc)
            self._unusable = str(exc)
            return MarkerTracker()

    @staticmethod
    def _output(name: str, cls: type) -> rospy.Publisher:
        return rospy.Publisher(f"visual_servoing/{name}", cls, queue_size=1, tcp_nodelay=True)

    def _own_command(self) -> ServoCommand:
        """What to do without anyone's status.

        Raises:
            ParameterError: a private parameter is of the wrong type, out of range or missing.
        """
        given = {
            name: rospy.get_param(f"~{name}")
            for name in ("task", "marker_id", "marker_size_m", "gap_m")
            if rospy.has_param(f"~{name}")
        }
        if rospy.has_param("~code_message"):
            given["marker_id"] = code_id(str(rospy.get_param("~code_message")))
        servo = convert({"task": "observe", "marker_id": ANY_MARKER, **given}, ServoCommand, rospy.get_name())
        if servo.task not in ("observe", "follow"):
            raise ParameterError(rospy.get_name(), "~task", servo.task, "observe or follow")
        if servo.task == "follow" and self._law is None:
            raise ParameterError(rospy.get_name(), "~config", "", "a file with a section robot, to follow")
        return servo

    # Switching.

    def _on_status(self, status: Status) -> None:
        self._turn(status.servo if status.modules.VS else None)

    def _turn(self, servo: ServoCommand | None) -> None:
        with self._lock:
            before, self._servo = self._servo, servo
            followed = (before.task, before.marker_id) if before is not None else None
            if servo is None or (servo.task, servo.marker_id) != followed:
                self._tracker.reset()
                self._steady = None
                if self._law is not None:
                    self._law.reset()
                if before is not None and before.task == "follow":
                    self._commands.publish(twist_to_msg(Twist2D()))
            self._laser.set(self._limiter is not None and servo is not None and servo.task == "follow")
            if self._switch.set(servo is not None):
                if servo is not None:
                    self._timer = Timer(self._params.watch_period_s, self._watch)
                    self._info, self._lens, self._odometry_problem = None, "", ""
                    self._image_at = self._on_since = rospy.get_time()
                elif self._timer is not None:
                    self._timer.shutdown()
                    self._timer = None
            if servo is None:
                self._diagnostics.set(OK, "off")

    # Sensors.

    def _on_odometry(self, msg: OdometryMsg) -> None:
        with self._lock:
            try:
                odometry = odometry_from_msg(msg)
                if self._law is not None:
                    self._law.add_odometry(odometry)
            except SensorDataError as exc:
                # What it did meanwhile is not known: the trail is no longer where it was.
                if self._law is not None:
                    self._law.reset()
                self._odometry_problem = str(exc)
                self._diagnostics.count("bad_odometry")
                return
            self._odometry_problem = ""

    def _on_scan(self, msg: LaserScanMsg) -> None:
        with self._lock:
            if self._limiter is None:
                return
            try:
                self._limiter.see(scan_from_msg(msg))
            except SensorDataError:  # obstacle_avoidance says so; without a scan nothing is limited
                self._diagnostics.count("bad_scans")

    def _on_camera_info(self, msg: CameraInfoMsg) -> None:
        with self._lock:
            self._info = camera_info_from_msg(msg) if msg.distortion_model in LENSES else None
            self._lens = msg.distortion_model

    def _on_image(self, msg: Image) -> None:
        with self._lock:
            servo = self._servo
            if servo is None:
                return
            self._image_at = rospy.get_time()
            stamp = msg.header.stamp.to_sec()
            if self._needless(stamp):
                self._answer(stamp)
                return
            self._looked_at = stamp
            problem, detections = "", []
            try:
                detections = self._detect(msg, servo, stamp)
            except (SensorDataError, VisionError) as exc:
                problem = str(exc)
                self._diagnostics.count("bad_images")
            observations = [planar_observation(d, self._T_base_camera, stamp) for d in detections]
            target = self._target(detections, servo)
            seen = next((o for o, d in zip(observations, detections, strict=True) if d is target), None)
            self._step(servo, seen, problem)
            self._publish(msg, stamp, observations, target, bool(problem))
            self._answer(stamp)

    def _needless(self, stamp: float) -> bool:
        """Whether an image may be left alone; not one from which the robot had to brake for what comes between."""
        if self._steady is None or not 0.0 <= stamp - self._looked_at < self._params.steady_period_s:
            return False
        return self._limiter is None or not self._limiter.limit(rospy.get_time(), self._steady)[1]

    def _detect(self, msg: Image, servo: ServoCommand, stamp: float) -> list[MarkerDetection]:
        if self._unusable:
            raise VisionError(self._unusable)
        if self._info is None:
            reason = (
                f"distortion model {self._lens!r} in it, expected one of {LENSES}" if self._lens else "none received"
            )
            raise SensorDataError(f"no camera_info: {reason}")
        pixels = image_from_msg(msg)
        if pixels.ndim == 3:
            to_gray = cv2.COLOR_RGB2GRAY if msg.encoding == "rgb8" else cv2.COLOR_BGR2GRAY
            pixels = cv2.cvtColor(pixels, to_gray)
        sizes = {servo.marker_id: servo.marker_size_m} if servo.marker_id != ANY_MARKER else {}
        gray = np.ascontiguousarray(pixels)  # copies only where rows are padded
        if servo.task != "follow" and not self._alone:  # every marker says where the robot is
            self._tracker.reset()
        target = None if servo.marker_id == ANY_MARKER else servo.marker_id
        own = None if self._law is None else self._law.pose_at(stamp)
        heading = 0.0 if own is None else own.theta
        return self._tracker.see(
            gray, self._info, self._T_base_camera, stamp, heading=heading, target=target, sizes_m=sizes
        )

    @staticmethod
    def _target(detections: list[MarkerDetection], servo: ServoCommand) -> MarkerDetection | None:
        return nearest(d for d in detections if servo.marker_id in (d.id, ANY_MARKER))

    # The one place that steps the law.

    def _step(self, servo: ServoCommand, seen: MarkerObservation | None, problem: str) -> None:
        now = rospy.get_time()
        # The first image may come before the first camera_info.
        bad = ERROR if now - self._on_since > self._params.start_s else WARN
        self._following, self._steady = "", None
        if servo.task != "follow":
            self._diagnostics.set(bad if problem else OK, problem or "observing")
            return
        if self._law is None:
            self._diagnostics.set(ERROR, "cannot follow: no ~config with a section robot")
            return
        decision = self._law.step(now, seen, None, servo.gap_m, servo.feed_forward_mps)
        problem = problem or self._odometry_problem
        if problem:
            decision = Decision(Twist2D(), "stopped", problem)
        self._following = decision.state
        twist, limited = (decision.twist, False) if self._limiter is None else self._limiter.limit(now, decision.twist)
        self._commands.publish(twist_to_msg(twist))
        if seen is not None and not limited and self._follows_steadily(decision, servo.gap_m):
            self._steady = twist
        level = _LEVELS.get(decision.state, bad)
        gap = "" if decision.gap_m is None else round(decision.gap_m, 3)
        message = f"{decision.state}: {decision.reason}" if decision.reason else decision.state
        self._diagnostics.set(level, message, gap_m=gap, braked_for_an_obstacle=limited)

    def _follows_steadily(self, decision: Decision, gap_m: float) -> bool:
        """Whether the command may stay as it is for an image."""
        p = self._params
        return (
            decision.state == "following"
            and decision.gap_m is not None
            and abs(decision.gap_m - gap_m) <= p.steady_gap_m
            and decision.twist.v >= p.steady_speed_mps
            and abs(decision.twist.omega) <= p.steady_yaw_rate_rps
        )

    def _watch(self) -> None:
        """Images that stay away must not leave the robot driving."""
        with self._lock:
            servo = self._servo
            if servo is None:
                return
            now = rospy.get_time()
            silent = now - self._image_at
            if not 0.0 <= silent <= self._params.image_timeout_s:
                self._states.publish(Int8(NO_IMAGE))
                self._step(servo, None, self._unusable or f"no image for {silent:.1f} s")

    # Output.

    def _publish(
        self,
        image: Image,
        stamp: float,
        observations: list[MarkerObservation],
        target: MarkerDetection | None,
        unusable: bool,
    ) -> None:
        self._observations.publish(String(encode_observations(stamp, observations, self._following)))
        self._states.publish(Int8(NO_IMAGE if unusable else SEEN if target is not None else SEEKING))
        if target is not None:
            self._codes.publish(String(target.code.message))
            if self._poses.get_num_connections() or self._poses_covariance.get_num_connections():
                self._publish_pose(image, target)
        if self._annotated.get_num_connections():
            self._publish_annotated(image, stamp, observations, target)

    def _publish_pose(self, image: Image, target: MarkerDetection) -> None:
        msg = PoseWithCovarianceStamped(header=image.header)
        msg.header.frame_id = image.header.frame_id or self._camera_frame
        T = target.T_camera_marker
        msg.pose.pose.position.x, msg.pose.pose.position.y, msg.pose.pose.position.z = T[:3, 3].tolist()
        msg.pose.pose.orientation = quaternion_from_rotation(T[:3, :3])
        msg.pose.covariance = target.covariance.ravel().tolist()
        self._poses.publish(PoseStamped(msg.header, msg.pose.pose))
        self._poses_covariance.publish(msg)

    def _publish_annotated(
        self, image: Image, stamp: float, observations: list[MarkerObservation], target: MarkerDetection | None
    ) -> None:
        """The image with the marker's outline, and its distance and bearing as text."""
        try:
            pixels = image_from_msg(image)
        except SensorDataError:  # said in /diagnostics already
            return
        picture = cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB) if pixels.ndim == 2 else pixels.copy()
        text = f"{len(observations)} markers"
        if target is not None:
            cv2.polylines(picture, [np.rint(target.corners).astype(np.int32)], True, (0, 255, 0), 2, cv2.LINE_AA)
            x, y, z = target.T_camera_marker[:3, 3]
            range_m, bearing_deg = np.linalg.norm((x, y, z)), np.degrees(np.arctan2(-x, z))
            how = "carried" if self._tracker.tracking else "detected"
            text = f"{target.code.message} {how}: {range_m:.2f} m, bearing {bearing_deg:.0f} deg"
        cv2.putText(picture, text, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 255, 0), 2, cv2.LINE_AA)
        encoding = "rgb8" if pixels.ndim == 2 else image.encoding
        self._annotated.publish(image_to_msg(picture, stamp, image.header.frame_id, encoding))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros visual_servoing``."""
    run("visual_servoing", VisualServoing, dozes=True)
