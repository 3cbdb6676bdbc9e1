"""ride_monitor: shows a simulated ride as it happens, records it, and scores it against ground truth and the paper.

It is no part of any robot: it reads what no robot knows. It ends when every robot has reached its goal or given up,
when a node of the system has ended, or at its deadline. The exit status is 0 when the ride was completed (with ~check:
and every bound holds), else 1.

Subscribed, for each robot of the world file:
    /<robot>/ground_truth (nav_msgs/Odometry), /<robot>/amcl_pose, /<robot>/initialpose
    (geometry_msgs/PoseWithCovarianceStamped), /<robot>/hhike_msg/status, /<robot>/hhike_msg/award,
    /<robot>/new_obstacles, /<robot>/visual_servoing/observations (std_msgs/String)
Subscribed:
    /hhike_msg/network (std_msgs/String), /simulator/contacts (std_msgs/String), /diagnostics
    /<hitchhiker>/camera/image_raw (sensor_msgs/Image): for one frame at each of its steps, and at times on the way
Parameters:
    ~world (path): true boxes, robots and their goals
    ~output (path): folder for ride.json, record.json, map.png and frames/; made if missing
    ~deadline_s (900): wall time after which the ride counts as failed
    ~tables (bool, true): whether the report on the terminal is more than its verdict
    ~check (bool, false): whether the exit status also says whether every bound holds
    /simulator/seed (int, 0): for the report
TF: none.
"""

from __future__ import annotations

import platform
import shutil
import sys
import threading
import time
from dataclasses import astuple, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rosgraph
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.core.errors import MessageError, ParameterError
from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.robot_model import mount
from hitchhike_ros.experiments.report.ride_frames import FramePlan
from hitchhike_ros.experiments.report.ride_picture import draw_ride
from hitchhike_ros.experiments.report.ride_report import (
    box_table,
    cpu_table,
    figure_table,
    live_line,
    module_names,
    progress,
)
from hitchhike_ros.experiments.report.terminal import has_colours
from hitchhike_ros.experiments.scenarios.ride_record import (
    ClockSample,
    Contact,
    CpuSample,
    RideRecord,
    RobotRecord,
    Sighting,
    TimedEstimate,
    TimedPose,
    TimedText,
    TrafficSample,
    save_record,
)
from hitchhike_ros.experiments.scoring.boxes import match_boxes
from hitchhike_ros.experiments.scoring.figures import all_hold
from hitchhike_ros.experiments.scoring.node_costs import node_costs
from hitchhike_ros.experiments.scoring.ride_figures import ride_figures
from hitchhike_ros.experiments.scoring.rides import Ride, find_ride, module_changes
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.nodes.sim.camera_frames import CameraFrames
from hitchhike_ros.nodes.sim.processes import NodeProcesses
from hitchhike_ros.protocol.machine import Award
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import Status, decode_status
from hitchhike_ros.ros_io.conversions import estimate_from_msg, pose_from_msg
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.simulation.world_file import RobotEntry, WorldFile, load_world

_PERIOD_S = 0.2
_CPU_PERIOD_S = 0.4
_DISCOVERY_PERIOD_S = 1.0
# Seldom, as to be asked costs a node time.
_TRAFFIC_PERIOD_S = 4.0
# They only look on: what is sent to them is no cost of a robot's.
_WATCHERS = ("/ride_monitor", "/record", "/rviz")
# The real-time factor that is shown is that of so many seconds past.
_SHOWN_FACTOR_S = 5.0
# Without these nodes a ride cannot go on.
_ESSENTIAL = frozenset(
    {
        "hitchhike_comm",
        "map_server",
        "network_model",
        "obstacle_avoidance",
        "path_planning",
        "simulator",
        "slam",
        "velocity_mux",
        "visual_servoing",
    }
)


@dataclass(frozen=True)
class RideMonitorParameters:
    """Private parameters of the node."""

    deadline_s: Positive = 900.0
    check: bool = False
    tables: bool = True


class RideMonitor:
    """Callbacks record under a lock; :meth:`watch` does the rest."""

    def __init__(self) -> None:
        self._params = node_parameters(RideMonitorParameters, "ride_monitor")
        self._world = load_world(path_parameter("world"))
        self._output = _output_folder()
        seed = int(rospy.get_param("/simulator/seed", 0))
        package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
        robots = {name: _robot_record(entry, package) for name, entry in self._world.robots.items()}
        self._record = RideRecord(scenario_name(self._world), seed, self._world.boxes, robots)
        self._lock = threading.Lock()
        self._traffic_due = False
        self._unreadable = 0
        self._shown = ""
        self._processes = NodeProcesses(_WATCHERS)
        self._cameras = {name: (CameraFrames(name, self._output), FramePlan()) for name in robots}
        self._screen = _Screen()
        for name, robot in robots.items():
            self._subscribe(name, robot)
        rospy.Subscriber("/hhike_msg/network", String, self._on_network)
        rospy.Subscriber("/simulator/contacts", String, self._on_contacts)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics)

    def watch(self) -> int:
        """Show and record until the end, then report; the exit status."""
        started = time.monotonic()
        reason = self._watch(started + self._params.deadline_s)
        self._sample_cpu()
        self._sample_traffic()
        with self._lock:
            ride = find_ride(self._record)
            step = progress(self._record, ride, None).step
        completed = not reason and ride is not None and ride.decouple_s is not None and step == "Arrived"
        if completed:
            verdict = "Ride completed"
        elif not reason and ride is None and step == "Arrived":
            verdict = "No ride: every robot drove alone"
        else:
            verdict = f"Ride not completed, at step {step!r}: {reason or 'no robot goes on'}"
        status = self._report(ride, completed, verdict, time.monotonic() - started)
        rospy.signal_shutdown("ride over")
        return status

    def _watch(self, deadline: float) -> str:
        """Until the ride is over; why it ended early, or nothing."""
        next_cpu = next_discovery = next_traffic = 0.0
        while not rospy.is_shutdown():
            wall = time.monotonic()
            try:
                if wall >= next_discovery:
                    next_discovery = wall + _DISCOVERY_PERIOD_S
                    self._processes.discover()
            except (OSError, rosgraph.MasterException) as exc:
                return f"the ROS master does not answer ({exc})"
            if wall >= next_cpu:
                next_cpu = wall + _CPU_PERIOD_S
                self._sample_cpu()
            if self._traffic_due or wall >= next_traffic:
                next_traffic = wall + _TRAFFIC_PERIOD_S
                self._sample_traffic()
            with self._lock:
                self._show()
                frames = self._frames_due()
                active = [robot for robot in self._record.robots.values() if robot.has_goal]
                if active and all(robot.ended for robot in active):
                    return ""
            self._take_frames(frames)
            gone = [node for node in self._processes.gone() if node.split("/")[-1] in _ESSENTIAL]
            if gone:
                return f"{', '.join(gone)} ended"
            if wall > deadline:
                return f"deadline of {self._params.deadline_s:.0f} s"
            time.sleep(_PERIOD_S)
        return "interrupted"

    def _frames_due(self) -> dict[str, str]:
        """Robots of whose camera a frame is to be kept now, and the states they are in."""
        now, due = rospy.get_time(), {}
        for name, (camera, plan) in self._cameras.items():
            status = self._record.robots[name].newest_status
            if status is not None and not camera.busy and plan.due(status, self._ridden_m(status), now):
                due[name] = status.state
        return due

    def _take_frames(self, due: dict[str, str]) -> None:
        for name, (camera, _) in self._cameras.items():
            camera.step()
            if name in due:
                camera.take(due[name])

    def _ridden_m(self, status: Status) -> float:
        """How far the ride is by now, as its driver has it."""
        if status.ride is None or status.ride.driver not in self._record.robots:
            return 0.0
        driver = self._record.robots[status.ride.driver].newest_status
        told = driver.ride if driver is not None else None
        return told.ridden_m if told is not None else 0.0

    # Samples are taken without the lock, as nodes may take their time to answer; callbacks touch none of the lists.

    def _sample_cpu(self) -> None:
        if rospy.get_time() <= 0.0:
            return
        self._record.clock.append(ClockSample(rospy.get_time(), time.monotonic()))
        for use in self._processes.use():
            stamp, wall = rospy.get_time(), time.monotonic()
            self._record.cpu.append(CpuSample(stamp, wall, use.node, use.cpu_s, use.memory_mb, use.peak_mb))

    def _sample_traffic(self) -> None:
        self._traffic_due = False
        if rospy.get_time() <= 0.0:
            return
        for node, traffic in self._processes.traffic().items():
            self._record.traffic.append(TrafficSample(rospy.get_time(), node, *astuple(traffic)))

    def _show(self) -> None:
        clock = self._record.clock
        recent = [c for c in clock if c.wall_s >= clock[-1].wall_s - _SHOWN_FACTOR_S]
        factor = None
        if len(recent) > 1 and recent[-1].wall_s > recent[0].wall_s:
            factor = (recent[-1].stamp - recent[0].stamp) / (recent[-1].wall_s - recent[0].wall_s)
        now = progress(self._record, find_ride(self._record), factor)
        change = f"{now.step} {module_names(now.modules) if now.modules is not None else ''}"
        self._screen.live(live_line(now, self._screen.columns, self._screen.colours), changed=change != self._shown)
        self._shown = change

    def _report(self, ride: Ride | None, completed: bool, verdict: str, wall_s: float) -> int:
        """Files and tables; the exit status."""
        record, colours = self._record, self._screen.colours
        figures, costs = ride_figures(record), node_costs(record, ride)
        found = record.robots[ride.hitchhiker].obstacles if ride is not None else ()
        matches = match_boxes(record.true_boxes, found)
        sim_s = record.clock[-1].stamp if record.clock else 0.0
        summary = {
            "completed": completed,
            "verdict": verdict,
            "scenario": record.scenario,
            "seed": record.seed,
            "versions": _versions(),
            "sim_s": sim_s,
            "wall_s": wall_s,
            "figures": figures,
            "boxes": matches,
            "ride": ride,
            "modules": module_changes(record),
            "cpu": costs,
            "simulator": record.simulator,
            "unreadable_messages": self._unreadable,
        }
        encoded = msgspec.json.format(msgspec.json.encode(summary), indent=2)
        (self._output / "ride.json").write_bytes(encoded)
        save_record(record, self._output / "record.json")
        title = f"{record.scenario}, seed {record.seed}: {verdict[0].lower()}{verdict[1:]}"
        draw_ride(self._output / "map.png", record, ride, load_map(self._world.map), self._world.sites, title)
        self._screen.end()
        parts = [f"{verdict}, {sim_s:.1f} s simulated in {wall_s:.1f} s, seed {record.seed}"]
        if self._params.tables and ride is not None and ride.released_at is not None:
            parts += [figure_table(figures, colours), box_table(matches, colours), cpu_table(costs, colours)]
        if self._params.tables:
            parts += [f"Report in {self._output}: ride.json, record.json, map.png"]
        print("\n\n".join(parts), flush=True)
        return 0 if completed and (all_hold(figures) or not self._params.check) else 1

    # Callbacks.

    def _subscribe(self, name: str, robot: RobotRecord) -> None:
        for topic, cls, callback in (
            ("ground_truth", Odometry, self._on_truth),
            ("amcl_pose", PoseWithCovarianceStamped, self._on_estimate),
            ("initialpose", PoseWithCovarianceStamped, self._on_initial_pose),
            ("hhike_msg/status", String, self._on_status),
            ("hhike_msg/award", String, self._on_award),
            ("new_obstacles", String, self._on_obstacles),
            ("visual_servoing/observations", String, self._on_observations),
        ):
            rospy.Subscriber(f"/{name}/{topic}", cls, self._receive, (callback, robot), queue_size=100)

    def _receive(self, msg: Any, target: tuple[Any, RobotRecord]) -> None:
        callback, robot = target
        with self._lock:
            try:
                callback(msg, robot)
            except (MessageError, msgspec.MsgspecError) as exc:
                self._note_unreadable(exc)

    def _on_truth(self, msg: Odometry, robot: RobotRecord) -> None:
        pose = pose_from_msg(msg.pose.pose)
        robot.truth.append(TimedPose(msg.header.stamp.to_sec(), pose.x, pose.y, pose.theta))

    def _on_estimate(self, msg: PoseWithCovarianceStamped, robot: RobotRecord) -> None:
        robot.estimates.append(TimedEstimate.of(estimate_from_msg(msg)))

    def _on_initial_pose(self, msg: PoseWithCovarianceStamped, robot: RobotRecord) -> None:
        robot.initial_poses.append(TimedEstimate.of(estimate_from_msg(msg)))

    def _on_status(self, msg: String, robot: RobotRecord) -> None:
        # Where modules are switched, connections end, and what went through them is soon forgotten.
        self._traffic_due |= robot.add_status(decode_status(msg.data))

    def _on_award(self, msg: String, robot: RobotRecord) -> None:
        robot.awards.append(msgspec.json.decode(msg.data, type=Award))

    def _on_obstacles(self, msg: String, robot: RobotRecord) -> None:
        robot.obstacles = msgspec.json.decode(msg.data, type=NewObstacles).obstacles

    def _on_observations(self, msg: String, robot: RobotRecord) -> None:
        for seen in decode_observations(msg.data).markers:
            pose = seen.pose
            robot.sightings.append(Sighting(seen.stamp, pose.x, pose.y, pose.theta, seen.marker_id))

    def _on_network(self, msg: String) -> None:
        with self._lock:
            self._record.messages.append(TimedText(rospy.get_time(), msg.data))

    def _on_contacts(self, msg: String) -> None:
        with self._lock:
            try:
                self._record.contacts.append(msgspec.json.decode(msg.data, type=Contact))
            except msgspec.MsgspecError as exc:
                self._note_unreadable(exc)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.hardware_id == "/simulator":
                with self._lock:
                    self._record.simulator = {value.key: value.value for value in status.values}

    def _note_unreadable(self, exc: Exception) -> None:
        self._unreadable += 1
        rospy.logwarn_throttle(10.0, "unreadable: %s", exc)


class _Screen:
    """A terminal with one line that is rewritten, or a file that gets a line at each change."""

    def __init__(self) -> None:
        self.colours = has_colours(sys.stdout)
        self._rewrites = sys.stdout.isatty()

    @property
    def columns(self) -> int:
        return shutil.get_terminal_size((160, 24)).columns - 1 if self._rewrites else 160

    def live(self, line: str, changed: bool) -> None:
        if self._rewrites:
            print(f"\r{line}\x1b[K", end="", flush=True)
        elif changed:
            print(line, flush=True)

    def end(self) -> None:
        """Make room for what comes after the line."""
        print("\r\x1b[K" if self._rewrites else "", end="" if self._rewrites else "\n", flush=True)


def scenario_name(world: WorldFile) -> str:
    """A world file's name without its endings."""
    return world.path.name.split(".")[0]


def _robot_record(entry: RobotEntry, package: Path) -> RobotRecord:
    urdf = package / "urdf" / f"{entry.model}.urdf"
    camera, marker = (pose_from_matrix(mount(urdf, link)) for link in ("camera", "marker"))
    return RobotRecord(camera, marker, has_goal=entry.goal is not None)


def _output_folder() -> Path:
    value = str(rospy.get_param("~output", ""))
    if not value:
        raise ParameterError(rospy.get_name(), "~output", value, "the path of a folder")
    path = Path(value)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise ParameterError(rospy.get_name(), "~output", value, f"a folder to write to ({exc.strerror})") from exc
    return path


def _versions() -> dict[str, str]:
    own = rospkg.RosPack().get_manifest("hitchhike_ros").version
    wheels = {name: metadata.version(name) for name in ("msgspec", "pybullet")}
    return {"hitchhike_ros": own, "python": platform.python_version(), "numpy": np.__version__, **wheels}


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros ride_monitor``."""
    statuses: list[int] = []

    def watch() -> None:
        statuses.append(RideMonitor().watch())

    run("ride_monitor", watch)
    sys.exit(statuses[0] if statuses else 0)
