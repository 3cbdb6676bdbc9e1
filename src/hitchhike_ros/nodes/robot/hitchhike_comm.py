"""hitchhike_comm: asks for rides, gives rides, and switches the other modules of its robot (P17 Fig. 8).

Subscribed (in the robot's namespace unless absolute):
    /hhike_msg/network (std_msgs/String), or ~network_in: JSON messages of all robots
    move_base_simple/goal (geometry_msgs/PoseStamped): where the robot is wanted, in ``map``; forwarded to the action
    amcl_pose (geometry_msgs/PoseWithCovarianceStamped), odom (nav_msgs/Odometry), map (nav_msgs/OccupancyGrid)
    new_obstacles (std_msgs/String): boxes that the own slam found
    path_planning/status, navigation/status (std_msgs/String): how the goal fares
    visual_servoing/observations (std_msgs/String)
Published:
    /hhike_msg/network (std_msgs/String), or ~network_out
    hhike_msg/status (std_msgs/String, latched, on change and at 1 Hz): which modules are on, where to
        drive, whom to follow
    hhike_msg/new_obstacles (std_msgs/String): boxes that a driver handed over
    hhike_msg/award (std_msgs/String, latched): the points of the newest ride that this robot drove
    initialpose (geometry_msgs/PoseWithCovarianceStamped): the pose taken over from a driver
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Action:
    move_base (move_base_msgs/MoveBaseAction): drives or rides to a pose in ``map``, with feedback at each new pose; a
        new goal preempts the one before, a cancel stops the robot, and an abort's text says why
Parameters:
    ~config (path), sections ``hitchhiking`` (protocol.parameters.HitchhikingParameters) and ``robot``
    ~urdf (path): mounts of camera and marker
    ~world (path): markers and hitchhiking points; what it says of this robot, and of all, comes before ~config
    ~robot_id (string, default: the namespace)
    ~rate (Hz, 10): steps of the machines; half as many while nothing happens and the robot rides or stands
    ~network_in, ~network_out (string, /hhike_msg/network): topics where it hears the others and speaks to them
    ~awards (path, $ROS_HOME/hitchhike_awards.sqlite): ledger of what this robot earns by driving, which several robots
        may share; ROS_HOME is ~/.ros where it is not set; empty: none is kept
    and every field of HitchhikingParameters, e.g. ~profile (0-100), ~priority (0-20), ~max_wait_s
TF: none.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import replace
from typing import Any

import msgspec
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from nav_msgs.msg import Odometry as OdometryMsg
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import MessageError, PlanningError, SensorDataError, WorldFileError
from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import RobotLimits, mount
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import load_hitchhiking, load_sites
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.protocol.agent import Traveller
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.machine import (
    Award,
    Effect,
    NavigationReport,
    Report,
    Send,
    Situation,
    TakeObstacles,
    TakePose,
    Tick,
    stamped,
)
from hitchhike_ros.protocol.messages import Ack, Beacon, Driver, NewObstacles, encode
from hitchhike_ros.protocol.observations import Observations, decode_observations
from hitchhike_ros.protocol.pace import Pace
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import Status, encode_status
from hitchhike_ros.ros_io.awards import AwardKeeper
from hitchhike_ros.ros_io.conversions import (
    estimate_from_msg,
    estimate_to_msg,
    grid_from_msg,
    odometry_from_msg,
)
from hitchhike_ros.ros_io.move_base import MoveBaseServer
from hitchhike_ros.ros_io.node import ERROR, OK, WARN, Diagnostics, run
from hitchhike_ros.ros_io.parameters import network_topic, node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer

# An estimate older than this is no longer the robot's pose (s).
_ESTIMATE_AGE_S = 1.0
# The status is repeated, since orders have an age (s).
_STATUS_PERIOD_S = 1.0
# What comes again and again can wait for the next step.
_REPEATED = (Ack, Beacon, Driver)
# Bad messages of one sender are logged once in so long (s).
_LOG_PERIOD_S = 10.0


class HitchhikeComm:
    """Stores what arrives; a timer, and network messages that want an answer, step the traveller and carry out what it
    wants, one at a time under a lock."""

    def __init__(self) -> None:
        world = path_parameter("world")
        robot_id = str(rospy.get_param("~robot_id", rospy.get_namespace().strip("/")))
        own = load_hitchhiking(world, robot_id)
        convert(own, HitchhikingParameters, world, f"robots.{robot_id}.hitchhiking", WorldFileError)
        params = node_parameters(HitchhikingParameters, "hitchhiking", own)
        limits = node_parameters(RobotLimits, "robot")
        self._planner = GlobalPlanner(node_parameters(GlobalPlannerParameters, "global_planner"), limits)
        urdf = path_parameter("urdf")
        camera = pose_from_matrix(mount(urdf, "camera"))
        sites = load_sites(world)
        marker_pose = pose_from_matrix(mount(urdf, "marker"))
        self._traveller = Traveller(
            robot_id, params, sites, self._plan, marker_pose, (camera.x, camera.y), limits.circumscribed_m
        )
        self._inbox = Inbox(robot_id)
        # Starting from the clock keeps a restarted robot from looking like a replay of its old self.
        self._seq = int(rospy.Time.now().to_sec() * 1000)
        self._lock, self._steps = threading.Lock(), threading.Lock()
        self._events: deque[object] = deque()
        self._grid: OccupancyGrid | None = None
        self._situation = Situation()
        self._navigation = self._planning = NavigationReport("", "idle")
        self._odometry = PoseBuffer()
        self._estimate: PoseEstimate | None = None
        self._fed_back: PoseEstimate | None = None
        self._observations = Observations()
        self._published: Status | None = None
        self._pace = Pace()
        self._logged: dict[str, float] = {}
        self._diagnostics = Diagnostics("hitchhike_comm")

        self._awards = AwardKeeper(robot_id)
        self._move_base = MoveBaseServer()

        self._network = rospy.Publisher(network_topic("network_out"), String, queue_size=50, tcp_nodelay=True)
        self._status = rospy.Publisher("hhike_msg/status", String, queue_size=10, latch=True, tcp_nodelay=True)
        self._obstacles = rospy.Publisher("hhike_msg/new_obstacles", String, queue_size=10)
        self._award = rospy.Publisher("hhike_msg/award", String, queue_size=10, latch=True)
        self._initialpose = rospy.Publisher("initialpose", PoseWithCovarianceStamped, queue_size=10)
        subscriptions: tuple[tuple[str, Any, Any], ...] = (
            (network_topic("network_in"), String, self._on_network),
            ("amcl_pose", PoseWithCovarianceStamped, self._on_estimate),
            ("odom", OdometryMsg, self._on_odometry),
            ("map", OccupancyGridMsg, self._on_map),
            ("new_obstacles", String, self._on_new_obstacles),
            ("navigation/status", String, self._on_navigation),
            ("path_planning/status", String, self._on_planning),
            ("visual_servoing/observations", String, self._on_observations),
        )
        self._subscribers = [
            rospy.Subscriber(topic, cls, callback, queue_size=50 if cls is String else 1, tcp_nodelay=True)
            for topic, cls, callback in subscriptions
        ]
        self._timer = Timer(1.0 / float(rospy.get_param("~rate", 10.0)), self._step)

    # Callbacks store.

    def _on_network(self, msg: String) -> None:
        try:
            with self._lock:
                message = self._inbox.receive(msg.data)
        except MessageError as exc:
            self._drop(str(msg._connection_header.get("callerid", "?")), f"network message dropped: {exc}")
            return
        if message is None:
            return
        with self._lock:
            self._events.append(message)
        if not isinstance(message, _REPEATED):
            self._step()

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        with self._lock:
            self._estimate = estimate_from_msg(msg)

    def _on_odometry(self, msg: OdometryMsg) -> None:
        with self._lock:
            try:
                odometry = odometry_from_msg(msg)
                self._odometry.add(odometry)
            except SensorDataError:
                self._odometry.clear()
                # Unknown is not standing still; the modules that drive stop by themselves.
                self._situation = replace(self._situation, speed_mps=math.inf)
                return
            self._situation = replace(self._situation, speed_mps=odometry.twist.v)

    def _on_map(self, msg: OccupancyGridMsg) -> None:
        grid = grid_from_msg(msg)
        with self._lock:
            self._grid = grid

    def _on_new_obstacles(self, msg: String) -> None:
        found = self._decode(msg.data, NewObstacles, "new_obstacles")
        if found is not None:
            with self._lock:
                self._situation = replace(self._situation, obstacles=found.obstacles)

    def _on_navigation(self, msg: String) -> None:
        report = self._decode(msg.data, NavigationReport, "navigation/status")
        if report is not None:
            with self._lock:
                self._navigation = report

    def _on_planning(self, msg: String) -> None:
        report = self._decode(msg.data, NavigationReport, "path_planning/status")
        if report is not None:
            with self._lock:
                self._planning = report

    def _on_observations(self, msg: String) -> None:
        try:
            observations = decode_observations(msg.data)
        except MessageError as exc:
            self._drop("visual_servoing/observations", str(exc))
            return
        with self._lock:
            self._observations = observations

    # Steps the machines, one step at a time: at the timer's turns, and at once for a message that wants an answer.

    def _step(self) -> None:
        with self._steps:
            self._step_once(rospy.Time.now().to_sec())

    def _step_once(self, now: float) -> None:
        with self._lock:
            if self._pace.leaves_out(self._published, self._observations.following, bool(self._events)):
                return
            events, self._events = list(self._events), deque()
            estimate, observations, situation = self._estimate, self._observations, self._situation
            # Without a plan there is nothing to say of driving along it.
            navigation = self._planning if self._planning.state == "failed" else self._navigation
        if estimate is not None and now - estimate.stamp > _ESTIMATE_AGE_S:
            estimate = None
        servo = None if self._published is None else self._published.servo
        seen = next((o for o in observations.markers if servo is not None and o.marker_id == servo.marker_id), None)
        with self._lock:
            seen_from = self._odometry.at(seen.stamp) if seen and self._odometry.covers(seen.stamp) else None
            odom_pose = self._odometry.at(now) if self._odometry.covers(now) else None
        situation = replace(situation, navigation=navigation, estimate=estimate)
        situation = replace(situation, observation=seen, seen_from=seen_from, odom_pose=odom_pose)
        tick = Tick(replace(situation, following=observations.following))
        wanted = self._move_base.poll()
        for event in [*events, *([] if wanted is None else [wanted]), tick]:
            for effect in self._traveller.step(event, now):
                self._carry_out(effect, now)
        self._awards.step()
        self._publish_status(self._traveller.status(now))
        if self._move_base.active:
            if estimate is not None and estimate is not self._fed_back:
                self._fed_back = estimate
                self._move_base.feed_back(estimate.pose, estimate.stamp)
            if (outcome := self._traveller.outcome) is not None:
                self._move_base.finish(*outcome)

    def _carry_out(self, effect: Effect, now: float) -> None:
        if isinstance(effect, Send):
            self._seq += 1
            message = stamped(effect.message, self._seq, now)
            with self._lock:
                self._inbox.sent(message)  # it comes back on a topic that all share
            self._network.publish(String(encode(message)))
        elif isinstance(effect, TakePose):
            self._initialpose.publish(estimate_to_msg(effect.estimate))
        elif isinstance(effect, TakeObstacles):
            payload = NewObstacles(obstacles=effect.obstacles)
            self._obstacles.publish(String(msgspec.json.encode(payload).decode()))
        elif isinstance(effect, Award):
            self._awards.credit(effect)
            self._award.publish(String(msgspec.json.encode(effect).decode()))
            rospy.loginfo("%.1f points for %.1f m with %s", effect.points, effect.ride_m, effect.hitchhiker)
        elif isinstance(effect, Report):
            rospy.loginfo("%s", effect.text)

    def _publish_status(self, status: Status) -> None:
        last = self._published
        repeat = last is None or not 0.0 <= status.time_stamp - last.time_stamp < _STATUS_PERIOD_S
        if last is None or repeat or replace(last, time_stamp=status.time_stamp) != status:
            self._published = status
            self._status.publish(String(encode_status(status)))
        level, message = OK, status.state
        if self._grid is None:
            level, message = ERROR, "no map received"
        elif self._awards.trouble:
            level, message = WARN, f"{status.state}; awards are not written down: {self._awards.trouble}"
        self._diagnostics.set(
            level,
            message,
            reason=status.reason,
            role=status.role,
            awards_waiting=self._awards.waiting,
            **{f"dropped_{k}": v for k, v in self._inbox.dropped.items()},
        )

    def _plan(self, start: Pose2D, goal: Pose2D) -> FloatArray:
        with self._lock:
            grid = self._grid
        if grid is None:
            raise PlanningError("no map received yet")
        return self._planner.plan(grid, start, goal)

    def _decode(self, text: str, cls: type[Any], topic: str) -> Any:
        try:
            return msgspec.json.decode(text, type=cls)
        except msgspec.MsgspecError as exc:
            self._drop(topic, f"{topic}: {exc}")
            return None

    def _drop(self, sender: str, text: str) -> None:
        """Count a bad message and log it, once per sender and period."""
        self._diagnostics.count("dropped")
        now = rospy.Time.now().to_sec()
        if now - self._logged.get(sender, -math.inf) >= _LOG_PERIOD_S:
            self._logged[sender] = now
            rospy.logwarn("from %s: %s", sender, text)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros hitchhike_comm``."""
    run("hitchhike_comm", HitchhikeComm)
