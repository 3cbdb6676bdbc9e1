"""simulator: the robots of a world file, their sensors and simulated time (pybullet, no window).

With ``~lockstep`` it waits after every sensor frame until the modules that are on, by ``hhike_msg/status``, have
published their ``lockstep/answer`` to it, for a bounded wall time. A frame is made and goes out only when somebody
subscribes to it.

With ``~system_clock`` it runs in real time and stamps everything with the time of the system's clock, as the drivers of
real robots do: it publishes no /clock and waits for no module. A period of the clock that begins too late is counted.
When it is 0.2 s behind, simulated time jumps: the robots stand still meanwhile.

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
    /clock (rosgraph_msgs/Clock): not on the system's clock
    ~contacts (std_msgs/String): JSON ``{"stamp", "robot", "other", "x", "y"}``, once a touch; the floor does not count
    /diagnostics (diagnostic_msgs/DiagnosticArray): real-time factor, contacts, answers missed; on the system's clock
        also periods of the clock (steps), those that were late, their share, and the time lost by jumps in s
Services:
    ~reset (std_srvs/Trigger): robots and boxes back to the start; time goes on
    ~pause (std_srvs/SetBool)
Parameters:
    ~world (path): world file
    ~seed (int, 0): of all noise
    ~system_clock (bool, default: ``/system_clock``, else false)
    ~lockstep (bool, default: ``/lockstep``, else false): not on the system's clock
    ~package (path, default: this package): folder with urdf/<model>.urdf and config/<model>.yaml
    the fields of simulation.frames.FrameParameters and simulation.physics.world.WorldParameters, with their defaults
TF: odom -> base_footprint, base_link -> wheel_left and wheel_right of every robot, with its name before each.
"""

from __future__ import annotations

import faulthandler
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import rospkg
import rospy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolRequest, SetBoolResponse, Trigger, TriggerRequest, TriggerResponse
from tf2_msgs.msg import TFMessage

from hitchhike_ros.core.datatypes import Seed
from hitchhike_ros.nodes.sim.robot_topics import RobotTopics, publisher
from hitchhike_ros.ros_io.conversions import to_stamp
from hitchhike_ros.ros_io.node import OK, WARN, Diagnostics, run
from hitchhike_ros.ros_io.parameters import node_parameters, parameter, path_parameter
from hitchhike_ros.simulation.frames import FrameParameters, Frames, Gate, SubRates
from hitchhike_ros.simulation.lockstep import Lockstep
from hitchhike_ros.simulation.physics.world import World, WorldParameters
from hitchhike_ros.simulation.real_time import RealTime, SystemTime
from hitchhike_ros.simulation.simulator_report import SimulatorReport
from hitchhike_ros.simulation.world_file import decode_box, decode_box_id


class Simulator:
    """Owns the world. :meth:`spin` alone touches it, so that callbacks and services only leave orders."""

    def __init__(self) -> None:
        params = node_parameters(FrameParameters, "simulator")
        world_params = node_parameters(WorldParameters, "simulator")
        rates = SubRates(params, world_params.physics_rate_hz, rospy.get_name())
        package = rospy.get_param("~package", "") or rospkg.RosPack().get_path("hitchhike_ros")
        on_system_clock = parameter("system_clock", bool, rospy.get_param("/system_clock", False))
        self._time = SystemTime(time.time()) if on_system_clock else RealTime(params.max_real_time_factor)
        seed = parameter("seed", Seed, 0)
        world, start_s = path_parameter("world"), self._time.start_s
        self._world = World(world, seed, world_params, package=Path(str(package)), start_s=start_s)
        self._report = SimulatorReport(params.print_period_s)
        self._diagnostics = Diagnostics("simulator")
        self._diagnostics.set(OK, "running", contacts=0, lockstep_misses=0)
        in_lockstep = not on_system_clock and parameter("lockstep", bool, rospy.get_param("/lockstep", False))
        self._gate = Gate(Lockstep(params.answer_timeout_s, params.join_timeout_s)) if in_lockstep else None
        self._robots = [RobotTopics(robot, self._diagnostics, self._gate) for robot in self._world.robots.values()]
        self._clock = None if on_system_clock else publisher("/clock", Clock)
        self._tf = publisher("/tf", TFMessage)
        self._contacts = rospy.Publisher("~contacts", String, queue_size=100)
        self._frames = Frames(self._world, rates, self._time, self._robots, self._publish_state, self._gate)
        self._subscribers = [
            rospy.Subscriber(f"~{name}", String, self._on_order, act, queue_size=100)
            for name, act in (("add_box", self._add_box), ("remove_box", self._remove_box))
        ]
        self._services = [
            rospy.Service("~reset", Trigger, self._on_reset),
            rospy.Service("~pause", SetBool, self._on_pause),
        ]

    def spin(self) -> None:
        """Step the world until ROS shuts down."""
        try:
            while not rospy.is_shutdown():
                turn = self._frames.turn(rospy.is_shutdown)
                for exc in turn.refused:
                    self._diagnostics.count("bad_orders")
                    rospy.logerr("%s", exc)
                for robot, module in turn.missed:
                    rospy.logwarn_throttle(10.0, "%s/%s did not answer in time", robot, module)
                self._publish_contacts()
                self._diagnose()
        finally:
            self._world.close()

    def _publish_state(self, now: float, wheels: bool) -> None:
        if self._clock is not None:
            self._clock.publish(Clock(to_stamp(now)))
        transforms = [robot.publish_state(now) for robot in self._robots]
        if wheels:
            transforms += [wheel for robot in self._robots for wheel in robot.wheel_transforms(now)]
        self._tf.publish(TFMessage(transforms))

    def _publish_contacts(self) -> None:
        for contact in self._report.touches(self._world.contacts()):
            self._contacts.publish(msgspec.json.encode(contact).decode())
            rospy.logwarn("%s touched %s at (%.2f, %.2f)", contact.robot, contact.other, contact.x, contact.y)

    def _diagnose(self) -> None:
        misses = self._gate.misses if self._gate is not None else {}
        found = self._report.due(self._world.elapsed_s, self._time.factor, misses, self._time.counts())
        if found is not None:
            self._diagnostics.set(OK if found.well else WARN, found.text, **found.values)
            if found.line:
                rospy.loginfo("%s", found.line)

    # Orders, carried out between two periods of the clock.

    def _add_box(self, text: str) -> None:
        self._world.add_box(decode_box(text, "~add_box"))

    def _remove_box(self, text: str) -> None:
        self._world.remove_box(decode_box_id(text, "~remove_box"))

    def _reset(self) -> None:
        self._world.reset()
        self._report.restart()

    # From other threads.

    def _on_order(self, msg: String, act: Callable[[str], None]) -> None:
        self._frames.orders.put(partial(act, msg.data))

    def _on_reset(self, _request: TriggerRequest) -> TriggerResponse:
        if self._frames.orders.call(self._reset):
            return TriggerResponse(True, "robots and boxes are back at the start")
        return TriggerResponse(False, "the simulator is busy; the reset is still to come")

    def _on_pause(self, request: SetBoolRequest) -> SetBoolResponse:
        self._frames.paused = bool(request.data)
        return SetBoolResponse(True, "paused" if request.data else "running")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros simulator``."""
    faulthandler.enable()  # a crash inside pybullet says where it happened
    run("simulator", lambda: Simulator().spin())
