"""simulator: the robots of a world file, their sensors and simulated time (pybullet, no window).

With ``~lockstep`` it waits after every sensor frame until the modules that are on, by ``hhike_msg/status``, have
published their ``lockstep/answer`` to it, for a bounded wall time. A frame is made and goes out only when somebody
subscribes it.

Per robot, in its namespace
    Subscribed:
        cmd_vel (geometry_msgs/Twist): stops 0.5 s of simulated time after the last one
        hhike_msg/status (std_msgs/String), lockstep/answer (std_msgs/Header): for lock-step
    Published:
        odom (nav_msgs/Odometry), ground_truth (nav_msgs/Odometry, in ``map``)
        scan (sensor_msgs/LaserScan)
        camera/image_raw (sensor_msgs/Image, rgb8), camera/image_mono (the same in mono8, as image_proc has it),
            camera/camera_info (sensor_msgs/CameraInfo)
        camera/depth/image_raw (sensor_msgs/Image, 32FC1 in m, NaN for no reading), camera/depth/camera_info: where the
            robot has a depth camera
Subscribed:
    ~add_box (std_msgs/String): JSON ``{"id", "x", "y", "w", "b", "height_m"}``, the box as in a world file
    ~remove_box (std_msgs/String): JSON ``{"id"}``; Debian has no service type that carries either
Published:
    /clock (rosgraph_msgs/Clock)
    ~contacts (std_msgs/String): JSON ``{"stamp", "robot", "other", "x", "y"}``, once a touch; the floor does not count
    /diagnostics (diagnostic_msgs/DiagnosticArray): real-time factor, contacts, answers missed
Services:
    ~reset (std_srvs/Trigger): robots and boxes back to the start; time goes on
    ~pause (std_srvs/SetBool)
Parameters:
    ~world (path): world file
    ~seed (int, 0): of all noise
    ~lockstep (bool, default: ``/lockstep``, else false)
    ~package (path, default: this package): folder with urdf/<model>.urdf and config/<model>.yaml
    the fields of SimulatorParameters and of simulation.physics.world.WorldParameters, with their defaults
TF: odom -> base_footprint, base_link -> wheel_left and wheel_right of every robot, with its name before each.
"""

from __future__ import annotations

import faulthandler
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import cv2
import msgspec
import rospkg
import rospy
from geometry_msgs.msg import Transform, TransformStamped, Twist, Vector3
from nav_msgs.msg import Odometry as OdometryMsg
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import Image
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, SetBoolRequest, SetBoolResponse, Trigger, TriggerRequest, TriggerResponse
from tf2_msgs.msg import TFMessage

from hitchhike_ros.core.datatypes import NonNegative, Odometry, Positive, Twist2D
from hitchhike_ros.core.errors import HitchhikeError, MessageError, ParameterError, WorldFileError
from hitchhike_ros.mapping.sites import read_entry
from hitchhike_ros.protocol.status import decode_status
from hitchhike_ros.ros_io.conversions import (
    camera_info_to_msg,
    header,
    image_to_msg,
    odometry_to_msg,
    quaternion_from_yaw,
    scan_to_msg,
    to_stamp,
    transform_from_matrix,
    twist_from_msg,
)
from hitchhike_ros.ros_io.node import OK, WARN, Diagnostics, run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.simulation.lockstep import IMAGE, SCAN, Lockstep
from hitchhike_ros.simulation.physics.robot import SimulatedRobot
from hitchhike_ros.simulation.physics.world import World, WorldParameters
from hitchhike_ros.simulation.world_file import Box

Rate = Annotated[int, msgspec.Meta(ge=1)]
T = TypeVar("T")


@dataclass(frozen=True)
class SimulatorParameters:
    """Rates in simulated time. ``clock_rate_hz`` divides the physics rate and is a multiple of the others.

    ``max_real_time_factor`` 0 is as fast as possible. The last three are wall time: how long lock-step waits for a
    module, for one that has not answered yet since it was switched on, and how often the real-time factor is printed.
    """

    clock_rate_hz: Rate = 10
    scan_rate_hz: Rate = 10
    image_rate_hz: Rate = 10
    depth_rate_hz: Rate = 5
    wheel_rate_hz: Rate = 5
    max_real_time_factor: NonNegative = 0.0
    answer_timeout_s: Positive = 5.0
    join_timeout_s: Positive = 0.5
    print_period_s: Positive = 30.0


class RobotTopics:
    """One robot's topics: commands come in under a lock, its sensors go out."""

    def __init__(self, robot: SimulatedRobot, diagnostics: Diagnostics) -> None:
        self.robot, self._diagnostics = robot, diagnostics
        self._lock = threading.Lock()
        self._command: Twist2D | None = None
        name = robot.name
        self._odom = _publisher(f"{name}/odom", OdometryMsg)
        self._truth = _publisher(f"{name}/ground_truth", OdometryMsg)
        self._scan = _publisher(f"{name}/scan", LaserScanMsg)
        self._image = _publisher(f"{name}/camera/image_raw", Image)
        self._mono = _publisher(f"{name}/camera/image_mono", Image)
        self._info = _publisher(f"{name}/camera/camera_info", CameraInfoMsg)
        if robot.has_depth_camera:
            self._depth = _publisher(f"{name}/camera/depth/image_raw", Image)
            self._depth_info = _publisher(f"{name}/camera/depth/camera_info", CameraInfoMsg)
        self._subscriber = rospy.Subscriber(f"{name}/cmd_vel", Twist, self._on_command, queue_size=1, tcp_nodelay=True)

    def _on_command(self, msg: Twist) -> None:
        twist = twist_from_msg(msg)
        if not twist.is_finite():
            self._diagnostics.count("bad_cmd_vel")
            rospy.logerr_throttle(10.0, "%s/cmd_vel is not finite: the robot stops", self.robot.name)
        with self._lock:
            self._command = twist

    def drive(self, now: float) -> None:
        """Give the robot the newest command, if one came since the last call."""
        with self._lock:
            command, self._command = self._command, None
        if command is not None:
            self.robot.command(command, now)

    def publish_state(self, now: float) -> TransformStamped:
        """Odometry and ground truth; the transform for TF."""
        name, odometry = self.robot.name, self.robot.odometry()
        pose, twist = self.robot.ground_truth()
        self._odom.publish(odometry_to_msg(odometry, f"{name}/odom", f"{name}/base_footprint"))
        self._truth.publish(odometry_to_msg(Odometry(now, pose, twist), "map", f"{name}/base_footprint"))
        transform = Transform(Vector3(odometry.pose.x, odometry.pose.y, 0.0), quaternion_from_yaw(odometry.pose.theta))
        return TransformStamped(header(odometry.stamp, f"{name}/odom"), f"{name}/base_footprint", transform)

    def wheel_transforms(self, now: float) -> list[TransformStamped]:
        """Of its wheels, for TF."""
        name = self.robot.name
        return [
            TransformStamped(header(now, f"{name}/base_link"), f"{name}/{wheel}", transform_from_matrix(T))
            for wheel, T in self.robot.wheel_mounts().items()
        ]

    def listened(self) -> bool:
        """Whether anybody subscribes the scan."""
        return bool(self._scan.get_num_connections())

    def publish_scan(self) -> None:
        self._scan.publish(scan_to_msg(self.robot.scan(), f"{self.robot.name}/laser"))

    def watched(self) -> bool:
        """Whether anybody subscribes the image, in colours or grey."""
        return bool(self._image.get_num_connections() or self._mono.get_num_connections())

    def publish_image(self, now: float) -> None:
        frame = f"{self.robot.name}/camera_optical"
        self._info.publish(camera_info_to_msg(self.robot.camera_info, now, frame))
        image = self.robot.camera()
        if self._image.get_num_connections():
            self._image.publish(image_to_msg(image, now, frame, "rgb8"))
        if self._mono.get_num_connections():
            self._mono.publish(image_to_msg(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), now, frame, "mono8"))

    def publish_depth(self, now: float) -> None:
        if self.robot.has_depth_camera and self._depth.get_num_connections():
            frame = f"{self.robot.name}/depth_camera_optical"
            self._depth_info.publish(camera_info_to_msg(self.robot.depth_info, now, frame))
            self._depth.publish(image_to_msg(self.robot.depth(), now, frame, "32FC1"))


class Simulator:
    """Owns the world. :meth:`spin` alone touches it, so that callbacks and services only leave orders."""

    def __init__(self) -> None:
        self._params = node_parameters(SimulatorParameters, "simulator")
        world_params = node_parameters(WorldParameters, "simulator")
        self._steps = _ratio("clock_rate_hz", world_params.physics_rate_hz, self._params.clock_rate_hz)
        self._every = {
            name: _ratio(name, self._params.clock_rate_hz, getattr(self._params, name))
            for name in ("scan_rate_hz", "image_rate_hz", "depth_rate_hz", "wheel_rate_hz")
        }
        package = rospy.get_param("~package", "") or rospkg.RosPack().get_path("hitchhike_ros")
        seed = rospy.get_param("~seed", 0)
        if not isinstance(seed, int) or seed < 0:
            raise ParameterError(rospy.get_name(), "~seed", seed, "an integer of at least 0")
        self._world = World(path_parameter("world"), seed, world_params, package=Path(str(package)))
        self._diagnostics = Diagnostics("simulator")
        self._diagnostics.set(OK, "running", contacts=0, lockstep_misses=0)
        self._lockstep = Lockstep(self._params.answer_timeout_s, self._params.join_timeout_s)
        self._answers = threading.Condition()  # guards the lock-step
        self._orders: deque[Callable[[], None]] = deque()
        self._paused = False
        self._ticks = self._reported_contacts = 0
        self._robots = [RobotTopics(robot, self._diagnostics) for robot in self._world.robots.values()]
        self._clock = _publisher("/clock", Clock)
        self._tf = _publisher("/tf", TFMessage)
        self._contacts = rospy.Publisher("~contacts", String, queue_size=100)
        self._subscribers = [
            rospy.Subscriber("~add_box", String, self._on_add_box, queue_size=100),
            rospy.Subscriber("~remove_box", String, self._on_remove_box, queue_size=100),
        ]
        if rospy.get_param("~lockstep", rospy.get_param("/lockstep", False)):
            for name in self._world.robots:
                self._subscribers += [
                    rospy.Subscriber(f"{name}/hhike_msg/status", String, self._on_status, name, queue_size=10),
                    rospy.Subscriber(
                        f"{name}/lockstep/answer", Header, self._on_answer, name, queue_size=50, tcp_nodelay=True
                    ),
                ]
        self._services = [
            rospy.Service("~reset", Trigger, self._on_reset),
            rospy.Service("~pause", SetBool, self._on_pause),
        ]

    def spin(self) -> None:
        """Step the world until ROS shuts down."""
        pace = Pace(self._params.max_real_time_factor, self._params.print_period_s)
        try:
            while not rospy.is_shutdown():
                while self._orders:
                    self._orders.popleft()()
                if self._paused:
                    time.sleep(0.02)
                    pace.restart(self._world.now)
                    continue
                self._tick()
                if pace.keep(self._world.now):
                    self._report(pace)
        finally:
            self._world.close()

    def _tick(self) -> None:
        """One period of the clock: physics, then everything that is due, then the modules' turn."""
        for robot in self._robots:
            robot.drive(self._world.now)
        for _ in range(self._steps):
            self._world.step()
        self._ticks += 1
        now = self._world.now
        self._clock.publish(Clock(to_stamp(now)))
        frames = [robot.publish_state(now) for robot in self._robots]
        if self._due("wheel_rate_hz"):
            frames += [wheel for robot in self._robots for wheel in robot.wheel_transforms(now)]
        self._tf.publish(TFMessage(frames))
        if self._due("scan_rate_hz"):
            for robot in self._robots:
                if robot.listened():
                    self._expect(robot, SCAN, now)
                    robot.publish_scan()
        # Rendering takes longest: meanwhile the modules work on the scans.
        for robot in self._robots:
            if self._due("image_rate_hz") and robot.watched():
                self._expect(robot, IMAGE, now)
                robot.publish_image(now)
            if self._due("depth_rate_hz"):
                robot.publish_depth(now)
        self._publish_contacts()
        self._wait_for_answers()

    def _due(self, rate: str) -> bool:
        return self._ticks % self._every[rate] == 0

    def _publish_contacts(self) -> None:
        contacts = self._world.contacts()
        for contact in contacts[self._reported_contacts :]:
            self._contacts.publish(msgspec.json.encode(contact).decode())
            rospy.logwarn("%s touched %s at (%.2f, %.2f)", contact.robot, contact.other, contact.x, contact.y)
        self._reported_contacts = len(contacts)

    # Lock-step: a frame is expected before it is sent, so that no answer can come too early.

    def _expect(self, robot: RobotTopics, sensor: str, now: float) -> None:
        with self._answers:
            self._lockstep.sent(robot.robot.name, sensor, now)

    def _wait_for_answers(self) -> None:
        sent = time.monotonic()
        with self._answers:
            while self._lockstep.waits(time.monotonic() - sent) and not rospy.is_shutdown():
                self._answers.wait(0.05)
            late = self._lockstep.give_up()
        for robot, module in late:
            rospy.logwarn_throttle(10.0, "%s/%s did not answer in time", robot, module)

    def _on_status(self, msg: String, name: str) -> None:
        try:
            status = decode_status(msg.data)
        except MessageError as exc:
            self._diagnostics.count("bad_status")
            rospy.logwarn_throttle(10.0, "%s", exc)
            return
        with self._answers:
            self._lockstep.set_modules(name, status.modules)
            self._answers.notify_all()

    def _on_answer(self, msg: Header, name: str) -> None:
        with self._answers:
            self._lockstep.answered(name, msg.frame_id, msg.stamp.to_sec())
            self._answers.notify_all()

    # Orders from outside, carried out between two ticks.

    def _on_add_box(self, msg: String) -> None:
        self._order(lambda: self._world.add_box(_decode(msg.data, Box, "~add_box")))

    def _on_remove_box(self, msg: String) -> None:
        self._order(lambda: self._world.remove_box(_decode(msg.data, _BoxName, "~remove_box").id))

    def _order(self, act: Callable[[], None]) -> None:
        def carry_out() -> None:
            try:
                act()
            except HitchhikeError as exc:
                self._diagnostics.count("bad_orders")
                rospy.logerr("%s", exc)

        self._orders.append(carry_out)

    def _on_reset(self, _request: TriggerRequest) -> TriggerResponse:
        done = threading.Event()

        def carry_out() -> None:
            self._world.reset()
            self._reported_contacts = 0
            done.set()

        self._orders.append(carry_out)
        if done.wait(5.0):
            return TriggerResponse(True, "robots and boxes are back at the start")
        return TriggerResponse(False, "the simulator is busy; the reset is still to come")

    def _on_pause(self, request: SetBoolRequest) -> SetBoolResponse:
        self._paused = bool(request.data)
        return SetBoolResponse(True, "paused" if request.data else "running")

    def _report(self, pace: Pace) -> None:
        with self._answers:
            misses = dict(self._lockstep.misses)
        contacts = self._reported_contacts
        self._diagnostics.set(
            WARN if contacts else OK,
            f"{contacts} contacts" if contacts else "running",
            real_time_factor=f"{pace.factor:.2f}",
            contacts=contacts,
            lockstep_misses=sum(misses.values()),
            **{f"lockstep_misses_{robot}_{module}": count for (robot, module), count in misses.items()},
        )
        if pace.print_due():
            rospy.loginfo(
                "%.0f s simulated, real-time factor %.2f, %d answers missed, %d contacts",
                self._world.now, pace.factor, sum(misses.values()), contacts,
            )  # fmt: skip


class Pace:
    """Simulated time against wall time: holds it back where asked, and measures the real-time factor."""

    def __init__(self, max_factor: float, print_period_s: float) -> None:
        self._max_factor, self._print_period_s = max_factor, print_period_s
        self._printed = time.monotonic()
        self.factor = math.nan
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Measure from here on, as after a pause."""
        self._wall, self._now = time.monotonic(), now

    def keep(self, now: float) -> bool:
        """Sleep off what the simulation is ahead; whether a second of wall time is over and ``factor`` is new."""
        if self._max_factor > 0.0:
            ahead = (now - self._now) / self._max_factor - (time.monotonic() - self._wall)
            if ahead > 0.0:
                time.sleep(ahead)
        elapsed = time.monotonic() - self._wall
        if elapsed < 1.0:
            return False
        self.factor = (now - self._now) / elapsed
        self.restart(now)
        return True

    def print_due(self) -> bool:
        due = time.monotonic() - self._printed > self._print_period_s
        if due:
            self._printed = time.monotonic()
        return due


@dataclass(frozen=True)
class _BoxName:
    id: str


def _decode(text: str, cls: type[T], topic: str) -> T:
    try:
        value = msgspec.json.decode(text)
    except msgspec.DecodeError as exc:
        raise WorldFileError(topic, "", text, f"a JSON object ({exc})") from exc
    return read_entry(value, cls, topic, "box")


def _publisher(topic: str, cls: Any) -> rospy.Publisher:
    return rospy.Publisher(topic, cls, queue_size=10, tcp_nodelay=True)


def _ratio(name: str, fast: int, slow: int) -> int:
    """How many periods of ``fast`` make one of ``slow``.

    Raises:
        ParameterError: not a whole number.
    """
    if fast % slow:
        raise ParameterError(rospy.get_name(), f"~{name}", slow, f"a divisor of {fast}")
    return fast // slow


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros simulator``."""
    faulthandler.enable()  # a crash inside pybullet says where it happened
    run("simulator", lambda: Simulator().spin())
