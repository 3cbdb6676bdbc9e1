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
import math
import os
import pty
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path as PathMsg
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.errors import HitchhikeError, MessageError, ParameterError
from hitchhike_ros.experiments.scenarios.scripted_human import HumanParameters, ScriptedHuman
from hitchhike_ros.nodes.sim.operator import listens
from hitchhike_ros.protocol.driver.machine import ARRIVED
from hitchhike_ros.protocol.status import Status, decode_status
from hitchhike_ros.ros_io.conversions import estimate_from_msg, path_from_msg
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.simulation.world_file import load_world

_LOOK_S, _RETRY_S = 0.01, 0.2  # wall time
_LEAVE_S = 10.0  # wall time that teleop has to end
_SAME_PLACE_M = 0.3
_QUIT = b"\x04"


class ScriptedOperator:
    """Drives until all have arrived, then counts."""

    def __init__(self) -> None:
        world = load_world(path_parameter("world"))
        self._deadline = time.monotonic() + float(rospy.get_param("~deadline_s", 900.0))
        wanted = [name for name, entry in world.robots.items() if entry.goal is not None]
        drives = str(rospy.get_param("~drives", "")).split()
        if not drives or set(drives) - set(wanted):
            raise ParameterError(rospy.get_name(), "~drives", " ".join(drives), f"some of {', '.join(wanted)}")
        params = node_parameters(HumanParameters, "human")
        watcher = str(rospy.get_param("~watcher", ""))
        if watcher:
            topics = [f"/{name}/hhike_msg/status" for name in wanted]
            self._wait(lambda: listens(watcher, topics), f"{watcher} listens to the robots")
        self._driven = {name: _Driven(name, params) for name in drives}
        completed = False
        try:
            for robot in self._driven.values():
                self._wait(robot.taken, f"{robot.name} is in hand")
            # From here on the robots may be given their goals.
            self._robots = {name: _Robot(name) for name in wanted}
            self._wait(lambda: all(r.goal_at is not None for r in self._robots.values()), "the robots have goals")
            self._drive()
            completed = all(r.status is not None and r.status.reason == ARRIVED for r in self._robots.values())
        finally:
            for robot in self._driven.values():
                robot.leave()
            self._report(completed)
        rospy.signal_shutdown("all robots have stopped")
        self.completed = completed

    def _wait(self, condition: object, what: str) -> None:
        assert callable(condition)
        while not rospy.is_shutdown() and not condition():
            if time.monotonic() > self._deadline:
                raise HitchhikeError(f"not within ~deadline_s: {what}")
            for robot in self._driven.values() if hasattr(self, "_driven") else ():
                robot.check()
            time.sleep(_RETRY_S)

    def _drive(self) -> None:
        for name in [*self._driven, *(name for name in self._robots if name not in self._driven)]:
            robot, driven = self._robots[name], self._driven.get(name)
            while not rospy.is_shutdown() and not robot.done:
                if time.monotonic() > self._deadline:
                    raise HitchhikeError(f"not within ~deadline_s: {name} is at its goal")
                if driven is not None:
                    driven.check()
                    driven.drive(robot.status, rospy.get_time())
                time.sleep(_LOOK_S)

    def _report(self, completed: bool) -> None:
        robots = {name: driven.total() for name, driven in self._driven.items()}
        states: dict[str, Counter[str]] = {}
        for driven in self._driven.values():
            for state, counts in driven.counts.items():
                states.setdefault(state, Counter()).update(counts)
        begins = [r.goal_at for r in getattr(self, "_robots", {}).values() if r.goal_at is not None]
        total: Counter[str] = Counter(keys=0, commands=0, bytes=0)
        for counts in robots.values():
            total.update(counts)
        report = {
            "completed": completed,
            **total,
            "seconds": round(rospy.get_time() - min(begins), 2) if begins else None,
            "robots": robots,
            "states": states,
        }
        rospy.loginfo("%s", json.dumps(report))
        output = str(rospy.get_param("~output", ""))
        if output:
            Path(output).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


class _Robot:
    """What a robot says of itself."""

    def __init__(self, name: str) -> None:
        self.status: Status | None = None
        self.goal_at: float | None = None
        self._subscriber = rospy.Subscriber(f"/{name}/hhike_msg/status", String, self._on_status, queue_size=10)

    @property
    def done(self) -> bool:
        return self.goal_at is not None and self.status is not None and self.status.state == "idle"

    def _on_status(self, msg: String) -> None:
        with contextlib.suppress(MessageError):
            self.status = decode_status(msg.data)
            if self.goal_at is None and self.status.state != "idle":
                self.goal_at = self.status.time_stamp


class _Driven:
    """A robot that is driven: its teleop in a terminal, and what the person sees and types."""

    def __init__(self, name: str, params: HumanParameters) -> None:
        self.name = name
        self.counts: dict[str, Counter[str]] = {}
        self._human = ScriptedHuman(params)
        self._state = "idle"
        self._pose: Pose2D | None = None
        self._route: FloatArray | None = None
        self._lock = threading.Lock()
        self._terminal, slave = pty.openpty()
        command = ["rosrun", "hitchhike_ros", "teleop", f"__ns:=/{name}", "__name:=teleop"]
        self._process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
        os.close(slave)
        self._shown = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._said = 0
        self._subscribers = [
            rospy.Subscriber(f"/{name}/amcl_pose", PoseWithCovarianceStamped, self._on_estimate, queue_size=1),
            rospy.Subscriber(f"/{name}/plan", PathMsg, self._on_plan, queue_size=1),
            rospy.Subscriber(f"/{name}/cmd_vel/teleop", rospy.AnyMsg, self._on_command, queue_size=100),
        ]

    def taken(self) -> bool:
        """Stop it until it is in hand; whether it is."""
        topics = [f"/{self.name}/cmd_vel/teleop", f"/{self.name}/teleop/active"]
        ready = listens(f"/{self.name}/obstacle_avoidance", topics) and self._subscribers[2].get_num_connections()
        if ready and not self._said:
            self._type(" ")
        return bool(self._said)

    def drive(self, status: Status | None, now: float) -> None:
        """Type what the person would."""
        if status is None:
            return
        self._state = status.state
        pose, route, goal = self._pose, self._route, status.goal
        if status.teleop_mode != "guided" or goal is None or pose is None or route is None:
            return
        if math.dist(route[-1], (goal.x, goal.y)) < _SAME_PLACE_M:  # else it is the route to a goal before
            self._type(self._human.keys(pose, route, now))

    def check(self) -> None:
        """Raises HitchhikeError when teleop has ended."""
        if self._process.poll() is not None:
            raise HitchhikeError(f"teleop of {self.name} has ended: {self._shown.decode(errors='replace')}")

    def leave(self) -> None:
        """End teleop."""
        with contextlib.suppress(OSError):
            os.write(self._terminal, _QUIT)
        try:
            self._process.wait(_LEAVE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._terminal)

    def total(self) -> Counter[str]:
        total: Counter[str] = Counter()
        for counts in self.counts.values():
            total.update(counts)
        return total

    def _type(self, keys: str) -> None:
        if keys:
            self._count(keys=len(keys), bytes=len(keys))
            os.write(self._terminal, keys.encode())

    def _count(self, **what: int) -> None:
        with self._lock:
            self.counts.setdefault(self._state, Counter()).update(what)

    def _read(self) -> None:
        """A terminal that nobody reads from would fill up."""
        with contextlib.suppress(OSError):
            while data := os.read(self._terminal, 4096):
                self._shown = (self._shown + data)[-4096:]

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        self._pose = estimate_from_msg(msg).pose

    def _on_plan(self, msg: PathMsg) -> None:
        self._route = path_from_msg(msg) if len(msg.poses) > 1 else None

    def _on_command(self, msg: rospy.AnyMsg) -> None:
        self._said += 1
        self._count(commands=1, bytes=len(msg._buff))


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros scripted_operator``."""
    done: list[ScriptedOperator] = []
    run("scripted_operator", lambda: done.append(ScriptedOperator()))
    sys.exit(0 if done and done[0].completed else 1)
