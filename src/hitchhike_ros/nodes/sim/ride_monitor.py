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

import sys
import time
from dataclasses import astuple, dataclass
from pathlib import Path

import rosgraph
import rospkg
import rospy

from hitchhike_ros.core.datatypes import Positive, Seed
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.experiments.report.ride_files import RideEnd, write_files
from hitchhike_ros.experiments.report.ride_frames import FramePlan, frames_due
from hitchhike_ros.experiments.report.ride_report import change, live_line, progress
from hitchhike_ros.experiments.report.screen import LivingLine, console, show
from hitchhike_ros.experiments.scenarios.ride_record import CpuSample, MemorySample, TrafficSample
from hitchhike_ros.experiments.scenarios.ride_recorder import (
    WATCHERS,
    RideRecorder,
    Sampling,
    SamplingParameters,
    missed,
)
from hitchhike_ros.experiments.scoring.node_costs import recent_real_time_factor
from hitchhike_ros.experiments.scoring.rides import find_ride
from hitchhike_ros.nodes.sim.camera_frames import CameraFrames
from hitchhike_ros.nodes.sim.processes import NodeProcesses
from hitchhike_ros.nodes.sim.recorded_topics import RecordedTopics
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import folder_parameter, node_parameters, path_parameter
from hitchhike_ros.simulation.world_file import load_world


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
        self._output = folder_parameter("output")
        self._package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
        seed = convert(rospy.get_param("/simulator/seed", 0), Seed, rospy.get_name(), "/simulator/seed")
        self._recorder = RideRecorder.of_world(self._world, seed, self._package)
        self._record = self._recorder.record
        self._topics = RecordedTopics(self._recorder)
        self._sampling = Sampling(SamplingParameters())
        self._processes = NodeProcesses(WATCHERS, self._sampling.params.answer_timeout_s)
        self._cameras = {name: CameraFrames(name, self._output) for name in self._record.robots}
        self._plans = {name: FramePlan() for name in self._cameras}
        self._screen = console()

    def watch(self) -> int:
        """Show and record until the end, then report; the exit status."""
        started = time.monotonic()
        with LivingLine(self._screen) as line:
            cause = self._watch(line, started + self._params.deadline_s)
        self._sample_cpu()
        self._sample_traffic()
        with self._topics.lock:
            end = RideEnd(self._record, cause, time.monotonic() - started, self._topics.unreadable)
            write_files(end, self._output, self._world, self._package)
        print(f"{end.headline}\n", flush=True)
        if self._params.tables:
            show(self._screen, *end.tables())
            print(f"Report in {self._output}: ride.json, record.json, map.png", flush=True)
        rospy.signal_shutdown("ride over")
        return 0 if end.completed and (end.all_hold or not self._params.check) else 1

    def _watch(self, line: LivingLine, deadline: float) -> str:
        """Until the ride is over; why it ended early, or nothing."""
        while not rospy.is_shutdown():
            wall = time.monotonic()
            if self._sampling.due("nodes", wall):
                try:
                    self._processes.discover()
                except (OSError, rosgraph.MasterException) as exc:
                    return f"the ROS master does not answer ({exc})"
            if self._sampling.due("cpu", wall):
                self._sample_cpu()
            if self._sampling.due("memory", wall):
                self._sample_memory()
            with self._topics.lock:
                switched = self._recorder.switched()
            if switched:
                # Where modules are switched, connections end, and what went through them is soon forgotten.
                self._sampling.hurry("traffic")
            if self._sampling.due("traffic", wall):
                self._sample_traffic()
            free = {name: plan for name, plan in self._plans.items() if not self._cameras[name].busy}
            with self._topics.lock:
                now = progress(self._record, find_ride(self._record), recent_real_time_factor(self._record))
                line.show(live_line(now), change(now))
                frames = frames_due(self._record, free, rospy.get_time())
                if self._record.over:
                    return ""
            for name, camera in self._cameras.items():
                camera.step()
                if name in frames:
                    camera.take(frames[name])
            if lost := missed(self._processes.gone()):
                return f"{', '.join(lost)} ended"
            if wall > deadline:
                return f"deadline of {self._params.deadline_s:.0f} s"
            time.sleep(self._sampling.params.look_s)
        return "interrupted"

    # Samples are taken without the lock, as nodes may take their time to answer; callbacks touch none of the lists.

    def _sample_cpu(self) -> None:
        if rospy.get_time() <= 0.0:
            return
        self._recorder.clock(rospy.get_time(), time.monotonic())
        for use in self._processes.use():
            self._recorder.cpu(CpuSample(rospy.get_time(), time.monotonic(), *astuple(use)))

    def _sample_memory(self) -> None:
        if rospy.get_time() > 0.0:
            for node, pss_mb in self._processes.memory().items():
                self._recorder.memory(MemorySample(rospy.get_time(), node, pss_mb))

    def _sample_traffic(self) -> None:
        if rospy.get_time() > 0.0:
            for node, traffic in self._processes.traffic().items():
                self._recorder.traffic(TrafficSample(rospy.get_time(), node, *astuple(traffic)))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros ride_monitor``."""
    statuses: list[int] = []

    def watch() -> None:
        statuses.append(RideMonitor().watch())

    run("ride_monitor", watch)
    sys.exit(statuses[0] if statuses else 0)
