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
import time
from collections.abc import Callable, Iterable

import rosgraph
import rospy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import HitchhikeError, ParameterError
from hitchhike_ros.experiments.scenarios.robot_starts import RobotStart, RobotStarts, StartParameters
from hitchhike_ros.ros_io.conversions import estimate_to_msg, pose_stamped
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import node_parameters, parameter, path_parameter
from hitchhike_ros.simulation.world_file import load_world


class Operator:
    """Repeats the start pose of each robot until it localizes, then says once where it is wanted."""

    def __init__(self) -> None:
        self._params = node_parameters(StartParameters, "operator")
        self._deadline = time.monotonic() + self._params.deadline_s
        chosen = str(rospy.get_param("~robots", "")).split()
        goals = parameter("goals", dict[str, Pose2D], {})
        entries = load_world(path_parameter("world")).robots
        for name, names in (("robots", chosen), ("goals", goals)):
            if set(names) - set(entries):
                raise ParameterError(rospy.get_name(), f"~{name}", list(names), f"some of {', '.join(entries)}")
        starts = RobotStarts(entries, goals, chosen, self._params)
        robots = {name: _Robot(name, start) for name, start in starts.robots.items()}
        watcher = str(rospy.get_param("~watcher", ""))
        topics = [f"/{name}/hhike_msg/status" for name in robots]
        if watcher:
            self._wait(lambda: () if listens(watcher, topics) else (watcher,), "does not listen to the robots")
        self._wait(lambda: [name for name, robot in robots.items() if not robot.placed()], "not ready")
        begin = rospy.get_time()
        while not rospy.is_shutdown() and not starts.over:
            for name, goal in starts.due(rospy.get_time() - begin).items():
                robots[name].send(goal)
            time.sleep(self._params.look_s)
        time.sleep(self._params.retry_s)  # so that the last goal is out before the node ends
        rospy.signal_shutdown("goals given")

    def _wait(self, missing: Callable[[], Iterable[str]], what: str) -> None:
        """Until nothing is missing.

        Raises:
            HitchhikeError: something still is at the deadline.
        """
        while not rospy.is_shutdown() and (names := list(missing())):
            if time.monotonic() > self._deadline:
                raise HitchhikeError(f"{', '.join(names)}: {what} within ~deadline_s")
            time.sleep(self._params.retry_s)


def listens(node: str, topics: Iterable[str]) -> bool:
    """Whether a node has subscribed to all of the topics."""
    _, subscriptions, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    listeners = dict(subscriptions)
    return all(node in listeners.get(topic, ()) for topic in topics)


class _Robot:
    """The topics of one robot."""

    def __init__(self, name: str, start: RobotStart) -> None:
        self._start = start
        self._initialpose = rospy.Publisher(f"/{name}/initialpose", PoseWithCovarianceStamped, queue_size=1)
        self._goal = rospy.Publisher(f"/{name}/move_base_simple/goal", PoseStamped, queue_size=1, latch=True)
        self._estimates = rospy.Subscriber(f"/{name}/amcl_pose", PoseWithCovarianceStamped, self._on_estimate)

    def placed(self) -> bool:
        """Say where the robot is as long as it does not know; whether it does, and would hear of a goal."""
        pose = self._start.pose(rospy.get_time(), heard=self._initialpose.get_num_connections() > 0)
        if pose is not None:
            self._initialpose.publish(estimate_to_msg(pose))
        return self._start.ready(heard=self._goal.get_num_connections() > 0)

    def send(self, goal: Pose2D) -> None:
        """Say where the robot is wanted."""
        self._goal.publish(pose_stamped(goal, rospy.get_time(), "map"))

    def _on_estimate(self, _msg: PoseWithCovarianceStamped) -> None:
        self._start.localized = True


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros operator``."""
    run("operator", Operator)
    sys.exit(0)
