"""scripted_operator: stands in for the human of P18 Experiment 4: types keys into teleop, which runs in a terminal.

For each robot that it drives it starts teleop in a pseudo-terminal of its own, takes the robot in hand, and drives it
over its route while the robot lets it; one robot after another. It sees what a person would: where each robot is on the
map, its route, and what it says of itself. It ends, with the counts written, when all robots are where they are wanted;
the exit status is 1 when one of them is not.

Subscribed, for each robot:
    /<robot>/hhike_msg/status (std_msgs/String); of those that it drives also /<robot>/amcl_pose
    (geometry_msgs/PoseWithCovarianceStamped), /<robot>/plan (nav_msgs/Path), and to count /<robot>/cmd_vel/teleop
Parameters:
    ~world (path): its robots that have goals are waited for
    ~drives (string): names of the robots that it drives, in this order, separated by blanks
    ~output (path, default none): JSON ``{"completed", "keys", "commands", "bytes", "seconds", "robots", "states"}``:
        keys typed, Twist messages that went to robots, bytes of both, simulated seconds from the first goal to the end;
        the first three also for each robot and, of all robots, for each state that a robot was in
    ~watcher (string, default none): a node that must listen to the robots before anything starts
    ~deadline_s (wall time, 900)
    ~config (path, default none), section ``human`` (experiments.scenarios.scripted_human.HumanParameters)
TF: none.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path as PathMsg
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.core.errors import HitchhikeError, MessageError, ParameterError
from hitchhike_ros.experiments.scenarios.scripted_human import (
    DrivenRobot,
    HumanParameters,
    OperatorParameters,
    OperatorScript,
)
from hitchhike_ros.nodes.sim.operator import listens
from hitchhike_ros.nodes.sim.teleop_terminal import TeleopTerminal
from hitchhike_ros.protocol.status import decode_status
from hitchhike_ros.ros_io.conversions import estimate_from_msg, path_from_msg
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import node_parameters, parameter, path_parameter
from hitchhike_ros.simulation.world_file import load_world


class ScriptedOperator:
    """Hands the script what it sees, and types what it says, until all have arrived."""

    def __init__(self) -> None:
        world = load_world(path_parameter("world"))
        self._deadline = time.monotonic() + parameter("deadline_s", Positive, 900.0)
        wanted = [name for name, entry in world.robots.items() if entry.goal is not None]
        drives = str(rospy.get_param("~drives", "")).split()
        if not drives or set(drives) - set(wanted):
            raise ParameterError(rospy.get_name(), "~drives", " ".join(drives), f"some of {', '.join(wanted)}")
        self._periods = OperatorParameters()
        self._script = OperatorScript(drives, wanted, node_parameters(HumanParameters, "human"))
        self._lock = threading.Lock()
        self._terminals: dict[str, TeleopTerminal] = {}
        self._counted: dict[str, rospy.Subscriber] = {}
        watcher = str(rospy.get_param("~watcher", ""))
        topics = [f"/{name}/hhike_msg/status" for name in wanted]
        try:
            self._wait(lambda: not watcher or listens(watcher, topics), lambda: f"{watcher} listens to the robots")
            with contextlib.ExitStack() as stack:
                for name, robot in self._script.driven.items():
                    self._terminals[name] = stack.enter_context(TeleopTerminal(name, self._periods.leave_s))
                    self._subscribe(name, robot)
                self._wait(self._take, lambda: self._script.waits_for)
                # These subscriptions are what the node operator waits for before it gives goals.
                for topic, name in zip(topics, wanted, strict=True):
                    rospy.Subscriber(topic, String, self._on_status, name, queue_size=10)
                self._wait(self._drive, lambda: self._script.waits_for, self._periods.look_s)
        finally:
            self._report()
        rospy.signal_shutdown("all robots have stopped")
        self.completed = self._script.completed

    def _wait(self, done: Callable[[], bool], what: Callable[[], str], period_s: float | None = None) -> None:
        while not rospy.is_shutdown() and not done():
            for terminal in self._terminals.values():
                terminal.check()
            if time.monotonic() > self._deadline:
                raise HitchhikeError(f"not within ~deadline_s: {what()}")
            time.sleep(period_s or self._periods.wait_s)

    def _take(self) -> bool:
        """Take the robots in hand whose teleop is heard; whether all are."""
        for name, robot in self._script.driven.items():
            heard = listens(f"/{name}/obstacle_avoidance", [f"/{name}/cmd_vel/teleop", f"/{name}/teleop/active"])
            if heard and self._counted[name].get_num_connections():
                with self._lock:
                    keys = robot.take()
                self._terminals[name].type(keys)
        return self._script.in_hand

    def _drive(self) -> bool:
        """Type what the script says; whether it is over."""
        with self._lock:
            typed, over = self._script.keys(rospy.get_time()), self._script.turn is None
        if typed is not None:
            name, keys = typed
            self._terminals[name].type(keys)
        return over

    def _subscribe(self, name: str, robot: DrivenRobot) -> None:
        def locked(take: Callable[[rospy.AnyMsg], None]) -> Callable[[rospy.AnyMsg], None]:
            def callback(msg: rospy.AnyMsg) -> None:
                with self._lock:
                    take(msg)

            return callback

        pose = locked(lambda msg: robot.pose(estimate_from_msg(msg).pose))
        route = locked(lambda msg: robot.route(path_from_msg(msg) if len(msg.poses) > 1 else None))
        sent = locked(lambda msg: robot.sent(len(msg._buff)))
        rospy.Subscriber(f"/{name}/amcl_pose", PoseWithCovarianceStamped, pose, queue_size=1)
        rospy.Subscriber(f"/{name}/plan", PathMsg, route, queue_size=1)
        self._counted[name] = rospy.Subscriber(f"/{name}/cmd_vel/teleop", rospy.AnyMsg, sent, queue_size=100)

    def _on_status(self, msg: String, name: str) -> None:
        try:
            status = decode_status(msg.data)
        except MessageError as exc:
            rospy.logwarn_throttle(10.0, "%s: %s", name, exc)
            return
        with self._lock:
            self._script.status(name, status)

    def _report(self) -> None:
        with self._lock:
            report = self._script.report(rospy.get_time())
        rospy.loginfo("%s", json.dumps(report))
        output = str(rospy.get_param("~output", ""))
        if output:
            Path(output).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros scripted_operator``."""
    done: list[ScriptedOperator] = []
    run("scripted_operator", lambda: done.append(ScriptedOperator()))
    sys.exit(0 if done and done[0].completed else 1)
