"""slam: localizes the robot in its map (module LZN) and keeps that map up to date (module MAP), each switched alone.

Subscribed:
    hhike_msg/status (std_msgs/String): which modules are on, and where other robots say that they are
    initialpose (geometry_msgs/PoseWithCovarianceStamped): where the robot is
    hhike_msg/new_obstacles (std_msgs/String): boxes that a driver handed over
    odom (nav_msgs/Odometry), scan (sensor_msgs/LaserScan), visual_servoing/observations (std_msgs/String): markers that
        the camera sees; only while the module LZN is on
Published:
    amcl_pose (geometry_msgs/PoseWithCovarianceStamped): for each scan, with its stamp; none while it is not known
    particlecloud (geometry_msgs/PoseArray): for each pose, with the method ``particle`` and a subscriber
    map (nav_msgs/OccupancyGrid, latched), map_metadata (nav_msgs/MapMetaData, latched): the robot's own copy with the
        new boxes, when they have changed
    new_obstacles (std_msgs/String, latched): JSON ``{"obstacles": [{"id", "x", "y", "w", "b"}]}``
    lockstep/answer (std_msgs/Header): the stamp of each scan that has been worked on, when /lockstep is true
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Services:
    global_localization (std_srvs/Empty): the robot may be anywhere; only with the method ``particle``
Services used:
    static_map (nav_msgs/GetMap): the map to start from
Parameters:
    ~config (path), sections ``localization`` (localization.localizer.LocalizerParameters) and ``mapping``
        (mapping.new_obstacles.MappingParameters)
    ~method (``ekf`` or ``particle``, ekf): how to localize
    ~urdf (path): mount of the laser
    ~world (path): markers at known places
    ~initial_pose_x, ~initial_pose_y (m), ~initial_pose_a (rad): start, all three or none
    ~initial_cov_xx, ~initial_cov_yy (m², 0.25), ~initial_cov_aa (rad², 0.0685): its covariance, as of amcl
    ~always_on (bool, false): both modules on without anyone's status
    ~map_timeout_s (s of wall time, 60): how long static_map is awaited
TF: map -> odom, for each pose. While localization is off the last one is repeated, valid until it is repeated again:
    who looks on sees the robot go on by its wheels.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import get_args

import msgspec
import numpy as np
import rospy
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseArray,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from nav_msgs.msg import MapMetaData
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from nav_msgs.msg import Odometry as OdometryMsg
from nav_msgs.srv import GetMap
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import String
from std_srvs.srv import Empty, EmptyRequest, EmptyResponse
from tf2_ros import TransformBroadcaster

from hitchhike_ros.core.datatypes import LaserScan, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import HitchhikeError, MessageError, ParameterError, SensorDataError
from hitchhike_ros.core.geometry import compose, inverse, pose_from_matrix
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import mount
from hitchhike_ros.localization.localizer import Localizer, LocalizerParameters
from hitchhike_ros.localization.methods import Method, make_localizer
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.localization.rest import Rest
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.new_obstacles import MappingParameters, NewObstacleMapper
from hitchhike_ros.mapping.sites import load_sites
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import ModuleSwitches, Status
from hitchhike_ros.ros_io.conversions import (
    LaserScanArrayMsg,
    estimate_from_msg,
    estimate_to_msg,
    grid_from_msg,
    grid_to_msg,
    header,
    odometry_from_msg,
    quaternion_from_yaw,
    scan_from_msg,
)
from hitchhike_ros.ros_io.node import ERROR, OK, WARN, Diagnostics, LockstepAnswer, StatusListener, Switch, run
from hitchhike_ros.ros_io.parameters import frame, given, is_given, node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer

# Without a scan for longer than this, the diagnosis says so (chosen).
_SILENCE_S = 0.3
_WATCH_PERIOD_S = 0.1
# The map is large and boxes grow with every scan: it is not published more often (chosen).
_MAP_PERIOD_S = 1.0
# How often the last map -> odom is repeated while localization is off, and how long each holds (chosen: that costs next
# to nothing).
_REPEAT_PERIOD_S, _REPEAT_HOLDS_S = 0.5, 1.0


class Slam:
    """One lock around filter and mapper; odometry, scans and markers step them as they come."""

    def __init__(self) -> None:
        self._params = node_parameters(LocalizerParameters, "localization")
        mapper_params = node_parameters(MappingParameters, "mapping")
        self._markers = load_sites(path_parameter("world")).markers
        self._T_base_laser = pose_from_matrix(mount(path_parameter("urdf"), "laser"))
        self._odom_frame = frame("odom")
        self._pending = _initial_pose()
        self._diagnostics = Diagnostics("slam")
        self._grid = _static_map()

        self._lock = threading.RLock()
        self._mapper = NewObstacleMapper(self._grid, mapper_params)
        self._mapped: tuple[Obstacle, ...] = ()
        self._mapped_at = -math.inf
        self._modules = ModuleSwitches(LZN=False, MAP=False)
        self._others: list[tuple[Pose2D, float]] = []
        method = given("method", "ekf")
        if method not in get_args(Method):
            raise ParameterError(rospy.get_name(), "~method", method, f"one of {', '.join(get_args(Method))}")
        # Its features of the map are computed once; ``_localizer`` is it while the module is on.
        self._made = make_localizer(method, self._grid, self._markers, self._params, self._T_base_laser)
        self._localizer: Localizer | None = None
        self._odometry_problem = ""
        self._scanned_at = 0.0
        self._rest = Rest()
        self._left_out: LaserScanMsg | None = None  # the newest scan, where it was not worked on
        self._timer: Timer | None = None  # looks whether scans come or, off, repeats map -> odom
        self._T_map_odom: Transform | None = None  # the last that was published

        self._poses = rospy.Publisher("amcl_pose", PoseWithCovarianceStamped, queue_size=1, tcp_nodelay=True)
        self._particles = rospy.Publisher("particlecloud", PoseArray, queue_size=1)
        self._maps = rospy.Publisher("map", OccupancyGridMsg, queue_size=1, latch=True)
        self._metadata = rospy.Publisher("map_metadata", MapMetaData, queue_size=1, latch=True)
        self._boxes = rospy.Publisher("new_obstacles", String, queue_size=1, latch=True)
        self._transforms = TransformBroadcaster()
        self._answer = LockstepAnswer("slam")
        self._switch = Switch(
            [
                ("odom", OdometryMsg, self._on_odometry),
                ("scan", LaserScanArrayMsg, self._on_scan),
                ("visual_servoing/observations", String, self._on_observations),
            ]
        )
        self._publish_map(rospy.get_time())
        self._subscribers = [
            rospy.Subscriber("initialpose", PoseWithCovarianceStamped, self._on_initial_pose, queue_size=1),
            rospy.Subscriber("hhike_msg/new_obstacles", String, self._on_handed_over, queue_size=10),
        ]
        if isinstance(self._made, ParticleLocalizer):
            self._service = rospy.Service("global_localization", Empty, self._on_global_localization)
        if rospy.get_param("~always_on", False):
            self._turn(ModuleSwitches())
        else:
            self._diagnostics.set(OK, "off")
            self._listener = StatusListener(self._on_status, self._diagnostics)

    # Switching.

    def _on_status(self, status: Status) -> None:
        with self._lock:
            self._others = [(Pose2D(robot.x, robot.y), robot.radius_m) for robot in status.robots]
            self._rest.has_goal = status.goal is not None
            self._turn(status.modules)
            if self._rest.has_goal and self._left_out is not None:
                self._work(self._left_out)  # who drives now waits for its pose

    def _turn(self, modules: ModuleSwitches) -> None:
        with self._lock:
            self._modules = modules
            if not self._switch.set(modules.LZN):
                return
            if modules.LZN:
                self._every(_WATCH_PERIOD_S, self._watch)
                # Odometry from before the pause says nothing about the way since: the filter starts anew.
                self._localizer = self._made
                self._localizer.restart()
                self._odometry_problem, self._scanned_at, self._left_out = "", rospy.get_time(), None
                self._rest.wake()
                self._start()
                return
            self._every(_REPEAT_PERIOD_S, self._repeat)
            if self._localizer is not None and self._localizer.initialised:
                self._pending = self._localizer.estimate
            self._localizer = None
            self._diagnostics.set(OK, "off")

    def _every(self, period_s: float, callback: Callable[[], None]) -> None:
        if self._timer is not None:
            self._timer.shutdown()
        self._timer = Timer(period_s, callback)

    def _start(self) -> None:
        """Give the filter the pose that is known otherwise."""
        if self._localizer is None or self._pending is None:
            return
        try:
            self._localizer.initialise(self._pending)
        except ValueError as exc:
            self._diagnostics.count("bad_initialpose")
            rospy.logwarn("initialpose refused: %s", exc)
        self._pending = None

    # What arrives.

    def _on_initial_pose(self, msg: PoseWithCovarianceStamped) -> None:
        if msg.header.frame_id.strip("/") not in ("map", ""):
            self._diagnostics.count("bad_initialpose")
            rospy.logwarn("initialpose refused: frame %r, expected 'map'", msg.header.frame_id)
            return
        with self._lock:
            self._pending = estimate_from_msg(msg)
            self._rest.wake()
            self._start()

    def _on_global_localization(self, _request: EmptyRequest) -> EmptyResponse:
        with self._lock:
            if not isinstance(self._localizer, ParticleLocalizer):
                raise rospy.ServiceException("localization is off")
            self._rest.wake()
            self._localizer.globalize()
        return EmptyResponse()

    def _on_handed_over(self, msg: String) -> None:
        try:
            boxes = msgspec.json.decode(msg.data, type=NewObstacles).obstacles
        except msgspec.MsgspecError as exc:
            self._diagnostics.count("bad_new_obstacles")
            rospy.logwarn_throttle(10.0, "hhike_msg/new_obstacles: %s", exc)
            return
        with self._lock:
            self._mapper.add(boxes)
            self._publish_map(rospy.get_time())

    def _on_odometry(self, msg: OdometryMsg) -> None:
        with self._lock:
            if self._localizer is None:
                return
            try:
                odometry = odometry_from_msg(msg)
                self._localizer.predict(odometry)
                self._rest.move(odometry.twist)
                self._odometry_problem = ""
            except SensorDataError as exc:
                self._odometry_problem = str(exc)
                self._diagnostics.count("bad_odometry")

    def _on_observations(self, msg: String) -> None:
        with self._lock:
            if self._localizer is None or not self._localizer.initialised:
                return
            try:
                self._localizer.update_markers(decode_observations(msg.data).markers)
            except (MessageError, SensorDataError) as exc:
                self._diagnostics.count("bad_observations")
                rospy.logwarn_throttle(10.0, "markers not used: %s", exc)

    def _on_scan(self, msg: LaserScanMsg) -> None:
        with self._lock:
            self._scanned_at = rospy.get_time()
            stamp = msg.header.stamp.to_sec()
            self._left_out = msg
            if self._odometry_problem or not self._rest.leaves_out(stamp):
                self._work(msg)
            elif self._rest.owes_pose(stamp):
                self._tell(stamp)
        self._answer(stamp)

    def _work(self, msg: LaserScanMsg) -> None:
        self._left_out = None
        try:
            scan = scan_from_msg(msg)
            estimate = self._localize(scan)
        except SensorDataError as exc:
            self._refuse(exc)
        else:
            if estimate is not None:
                self._rest.worked(scan.stamp)
                self._publish_pose(estimate)
                self._map(scan, estimate)

    def _tell(self, stamp: float) -> None:
        """The pose at a scan that is left out, as the wheels stand."""
        if self._localizer is None:
            return
        try:
            estimate = self._localizer.estimate_at(stamp)
        except SensorDataError as exc:
            self._refuse(exc)
        else:
            self._rest.told(stamp)
            self._publish_pose(estimate)

    def _refuse(self, exc: SensorDataError) -> None:
        self._diagnostics.count("bad_scans")
        self._diagnostics.set(ERROR, str(exc))

    # Localizing and mapping.

    def _localize(self, scan: LaserScan) -> PoseEstimate | None:
        localizer = self._localizer
        if localizer is None:
            return None
        if self._odometry_problem:
            raise SensorDataError(self._odometry_problem)
        if not localizer.initialised:
            self._diagnostics.set(WARN, "no initial pose yet")
            return None
        used = localizer.update_scan(scan)
        estimate = localizer.estimate_at(scan.stamp)
        if localizer.explained is not None:
            self._diagnostics.set(OK, "localizing", explained=round(localizer.explained, 2))
        if not used:
            self._diagnostics.set(WARN, "the scan shows too little of the map")
        return estimate

    def _map(self, scan: LaserScan, estimate: PoseEstimate) -> None:
        if not self._modules.MAP:
            return
        self._mapper.update(scan, estimate, self._T_base_laser, self._others)
        if self._mapper.obstacles != self._mapped and scan.stamp - self._mapped_at >= _MAP_PERIOD_S:
            self._publish_map(scan.stamp)

    def _watch(self) -> None:
        with self._lock:
            silent = rospy.get_time() - self._scanned_at
            if self._localizer is not None and silent > _SILENCE_S:
                self._diagnostics.set(ERROR, f"no scan for {silent:.1f} s")

    # Output.

    def _publish_pose(self, estimate: PoseEstimate) -> None:
        self._poses.publish(estimate_to_msg(estimate))
        if self._localizer is None:
            return
        if isinstance(self._localizer, ParticleLocalizer) and self._particles.get_num_connections():
            poses = [Pose(Point(x, y, 0.0), quaternion_from_yaw(yaw)) for x, y, yaw in self._localizer.particles]
            self._particles.publish(PoseArray(header(estimate.stamp, "map"), poses))
        T_map_odom = compose(estimate.pose, inverse(self._localizer.odometry_at(estimate.stamp)))
        rotation: Quaternion = quaternion_from_yaw(T_map_odom.theta)
        self._T_map_odom = Transform(Vector3(T_map_odom.x, T_map_odom.y, 0.0), rotation)
        self._send_transform(estimate.stamp)

    def _repeat(self) -> None:
        with self._lock:
            if self._localizer is None and self._T_map_odom is not None:
                self._send_transform(rospy.get_time() + _REPEAT_HOLDS_S)

    def _send_transform(self, stamp: float) -> None:
        self._transforms.sendTransform(TransformStamped(header(stamp, "map"), self._odom_frame, self._T_map_odom))

    def _publish_map(self, now: float) -> None:
        self._mapped, self._mapped_at = self._mapper.obstacles, now
        self._boxes.publish(String(msgspec.json.encode(NewObstacles(obstacles=self._mapped), enc_hook=float).decode()))
        msg = grid_to_msg(self._grid.with_obstacles(self._mapped), now)
        self._maps.publish(msg)
        self._metadata.publish(msg.info)


def _initial_pose() -> PoseEstimate | None:
    """The start of the parameters, as amcl reads it; None where they name none.

    Raises:
        ParameterError: one of them is no number, or only some of the three are given.
    """
    names = ("initial_pose_x", "initial_pose_y", "initial_pose_a")
    named = [name for name in names if is_given(name)]
    if not named:
        return None
    if len(named) < len(names):
        missing = next(name for name in names if name not in named)
        raise ParameterError(rospy.get_name(), f"~{missing}", None, "a number, as the other two are given")
    x, y, a = (convert(given(name), float, rospy.get_name(), f"~{name}") for name in names)
    defaults = {"xx": 0.25, "yy": 0.25, "aa": (math.pi / 12.0) ** 2}
    variances = [
        convert(given(f"initial_cov_{k}", v), float, rospy.get_name(), f"~initial_cov_{k}") for k, v in defaults.items()
    ]
    return PoseEstimate(rospy.get_time(), Pose2D(x, y, a), np.diag(variances))


def _static_map() -> OccupancyGrid:
    """The map of map_server, awaited for a bounded time."""
    timeout_s = convert(given("map_timeout_s", 60.0), float, rospy.get_name(), "~map_timeout_s")
    try:
        rospy.wait_for_service("static_map", timeout_s)
        return grid_from_msg(rospy.ServiceProxy("static_map", GetMap)().map)
    except (rospy.ROSException, rospy.ServiceException) as exc:
        raise HitchhikeError(f"service {rospy.resolve_name('static_map')} gave no map: {exc}") from exc


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros slam``."""
    run("slam", Slam, dozes=True)
