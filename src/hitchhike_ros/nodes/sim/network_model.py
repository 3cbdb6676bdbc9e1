"""network_model: the radio between simulated robots, which loses, delays, doubles and reorders what they say.

It stands between each robot's outgoing and incoming topic and is part of the simulated world: it knows where the robots
are. It counts from when a message reaches it, so messages take as much longer as the nodes' own exchange takes, and
arrive with the first /clock at or after their time.

Subscribed, for each robot:
    /<robot>/hhike_msg/network_out (std_msgs/String): what it says
    /<robot>/ground_truth (nav_msgs/Odometry): where it is; only with a range
Published, for each robot:
    /<robot>/hhike_msg/network_in (std_msgs/String): what reaches it
Published:
    /hhike_msg/network (std_msgs/String): everything that is said, as it is said, for monitors and bags
    /diagnostics (diagnostic_msgs/DiagnosticArray): copies sent, delivered, lost, doubled and out of reach, of all and
        of each pair; those that wait; how late the latest was delivered
Parameters:
    ~robots (string): names, separated by blanks; default: all of ~world
    ~world (path): only for its robots
    ~rate (Hz, 100): how often it looks for messages whose time has come
    ~max_waiting (10000): copies that may be under way at once; those beyond are lost and counted
    and the fields of simulation.radio.NetworkParameters:
    ~range_m (m, inf), ~delay_s (s, 0), ~jitter_s (s, 0: each copy takes longer by 0 to this), ~loss, ~duplication,
    ~reordering (probabilities, 0), ~reorder_delay_s (s, 1: of a copy that is reordered), ~seed (0)
    ~partitions (default none): [{begin_s, end_s, groups: [[robot, ...], ...]}, ...]; robots of different groups do not
        hear each other, those in no group hear all and are heard by all; on the system's clock times count from the
        start of this node
    ~config (path), section ``network``: a file with any of these fields
TF: none.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Annotated

import msgspec
import rosgraph.names
import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.ros_io.node import OK, WARN, Diagnostics, every, run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters, Radio
from hitchhike_ros.simulation.world_file import load_world

_QUEUE = 200


@dataclass(frozen=True)
class NetworkNodeParameters:
    """Private parameters of the node, beside those of the network."""

    rate: Positive = 100.0
    max_waiting: Annotated[int, msgspec.Meta(ge=1)] = 10_000


class NetworkModelNode:
    """Callbacks hand messages to the radio; a timer brings what has arrived."""

    def __init__(self) -> None:
        params = node_parameters(NetworkNodeParameters, "network_model")
        model = NetworkModel(node_parameters(NetworkParameters, "network"), rospy.get_name())
        robots = _robots()
        start_s = rospy.get_time() if rospy.rostime.is_wallclock() else 0.0
        self._radio = Radio[String](model, robots, params.max_waiting, start_s)
        self._lock = threading.Lock()  # of the radio
        self._diagnostics = Diagnostics("network_model")
        self._said = rospy.Publisher("/hhike_msg/network", String, queue_size=_QUEUE, tcp_nodelay=True)
        self._heard = {
            robot: rospy.Publisher(f"/{robot}/hhike_msg/network_in", String, queue_size=_QUEUE, tcp_nodelay=True)
            for robot in robots
        }
        self._subscribers = [
            rospy.Subscriber(
                f"/{robot}/hhike_msg/network_out", String, self._on_message, robot, queue_size=_QUEUE, tcp_nodelay=True
            )
            for robot in robots
        ]
        if math.isfinite(model.params.range_m):
            self._subscribers += [
                rospy.Subscriber(f"/{robot}/ground_truth", Odometry, self._on_truth, robot, queue_size=1)
                for robot in robots
            ]
        self._report()
        self._timers = [every(1.0 / params.rate, self._deliver), every(1.0, self._report)]

    def _on_truth(self, msg: Odometry, robot: str) -> None:
        with self._lock:
            self._radio.place(robot, msg.pose.pose.position.x, msg.pose.pose.position.y)

    def _on_message(self, msg: String, sender: str) -> None:
        self._said.publish(msg)
        with self._lock:
            self._radio.send(rospy.get_time(), sender, msg)
        self._deliver()

    def _deliver(self) -> None:
        with self._lock:
            for receiver, msg in self._radio.arrived(rospy.get_time()):
                self._heard[receiver].publish(msg)

    def _report(self) -> None:
        with self._lock:
            well, text, values = self._radio.diagnosis()
        self._diagnostics.set(OK if well else WARN, text, **values)


def _robots() -> list[str]:
    """Names of the robots from ~robots or ~world.

    Raises:
        ParameterError: there are fewer than one, or one cannot be a namespace.
    """
    value = rospy.get_param("~robots", "")
    if not str(value).strip():
        return list(load_world(path_parameter("world")).robots)
    robots = list(dict.fromkeys(str(value).split()))
    if not all(rosgraph.names.is_legal_base_name(robot) for robot in robots):
        raise ParameterError(rospy.get_name(), "~robots", value, "names of robots, separated by blanks")
    return robots


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros network_model``."""
    run("network_model", NetworkModelNode)
