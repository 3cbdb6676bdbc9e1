"""operator: does in simulation what a person does at the start: says where the robots are and gives them goals.

Each robot of the world file gets its start as ``initialpose``, off by as much as a person's click would be, and once
all localize, its goal, when it is time for that. The node then ends.

Published, for each robot:
    /<robot>/initialpose (geometry_msgs/PoseWithCovarianceStamped)
    /<robot>/move_base_simple/goal (geometry_msgs/PoseStamped)
Subscribed, for each robot:
    /<robot>/amcl_pose (geometry_msgs/PoseWithCovarianceStamped)
Parameters:
    ~world (path): start and goal of each robot, and how long after the first goals it gets its own
    ~robots (string, default all): names, separated by blanks, of the robots that it starts
    ~position_sigma_m (0.05), ~heading_sigma_rad (0.03): error of the start poses
    ~seed (int, 0): of that error
    ~goals (mapping, default empty): other goals than the world file's, {robot: {x, y, theta}}
    ~watcher (string, default none): a node that keeps what the robots say; it must listen before anything starts
    ~deadline_s (wall time, 120): how long it waits for that, and for the robots to localize and to listen
TF: none.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterable

import numpy as np
import rosgraph
import rospy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.ros_io.conversions import estimate_to_msg, pose_stamped
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import path_parameter
from hitchhike_ros.simulation.world_file import RobotEntry, load_world

_RETRY_S, _LOOK_S = 0.5, 0.05


class Operator:
    """Repeats the start pose of each robot until it localizes, then says once where it is wanted."""

    def __init__(self) -> None:
        path = path_parameter("world")
        world = load_world(path)
        chosen = str(rospy.get_param("~robots", "")).split() or list(world.robots)
        goals = {
            name: convert(goal, Pose2D, rospy.get_name(), f"~goals.{name}")
            for name, goal in dict(rospy.get_param("~goals", {})).items()
        }
        random = np.random.default_rng(int(rospy.get_param("~seed", 0)))
        deadline = time.monotonic() + float(rospy.get_param("~deadline_s", 120.0))
        robots = [
            _Robot(name, spec, goals.get(name, spec.goal), random)
            for name, spec in world.robots.items()
            if name in chosen
        ]
        watcher = str(rospy.get_param("~watcher", ""))
        topics = [f"/{robot.name}/hhike_msg/status" for robot in robots]
        while watcher and not rospy.is_shutdown() and not listens(watcher, topics):
            if time.monotonic() > deadline:
                raise HitchhikeError(f"{watcher}: does not listen to the robots within ~deadline_s")
            time.sleep(_RETRY_S)
        while not rospy.is_shutdown() and (waiting := [robot.name for robot in robots if not robot.placed()]):
            if time.monotonic() > deadline:
                raise HitchhikeError(f"{', '.join(waiting)}: not ready within ~deadline_s")
            time.sleep(_RETRY_S)
        begin = rospy.get_time()
        for robot in sorted(robots, key=lambda robot: robot.goal_at_s):
            while not rospy.is_shutdown() and rospy.get_time() < begin + robot.goal_at_s:
                time.sleep(_LOOK_S)
            robot.send()
        time.sleep(_RETRY_S)  # so that the last goal is out before the node ends
        rospy.signal_shutdown("goals given")


def listens(node: str, topics: Iterable[str]) -> bool:
    """Whether a node has subscribed to all of the topics."""
    _, subscriptions, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    listeners = dict(subscriptions)
    return all(node in listeners.get(topic, ()) for topic in topics)


class _Robot:
    def __init__(self, name: str, spec: RobotEntry, goal: Pose2D | None, random: np.random.Generator) -> None:
        self.name = name
        sigma = np.array(
            [rospy.get_param("~position_sigma_m", 0.05)] * 2 + [rospy.get_param("~heading_sigma_rad", 0.03)]
        )
        error = Pose2D(*(float(v) for v in random.normal(0.0, sigma)))
        self._start, self._covariance = compose(spec.start, error), np.diag(sigma**2)
        self._goal, self.goal_at_s = goal, spec.goal_at_s
        self._localized = threading.Event()
        self._initialpose = rospy.Publisher(f"/{name}/initialpose", PoseWithCovarianceStamped, queue_size=1)
        self._goal_topic = rospy.Publisher(f"/{name}/move_base_simple/goal", PoseStamped, queue_size=1, latch=True)
        self._estimates = rospy.Subscriber(f"/{name}/amcl_pose", PoseWithCovarianceStamped, self._on_estimate)

    def placed(self) -> bool:
        """Say where the robot is as long as it does not know; whether it does, and would hear of a goal."""
        if self._localized.is_set():
            return self._goal is None or self._goal_topic.get_num_connections() > 0
        if self._initialpose.get_num_connections():
            estimate = PoseEstimate(rospy.get_time(), self._start, self._covariance)
            self._initialpose.publish(estimate_to_msg(estimate))
        return False

    def send(self) -> None:
        """Say where the robot is wanted."""
        if self._goal is not None:
            self._goal_topic.publish(pose_stamped(self._goal, rospy.get_time(), "map"))

    def _on_estimate(self, _msg: PoseWithCovarianceStamped) -> None:
        self._localized.set()


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros operator``."""
    run("operator", Operator)
    sys.exit(0)
