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
        hear each other, those in no group hear all and are heard by all
    ~config (path), section ``network``: a file with any of these fields
TF: none.
"""

from __future__ import annotations

import heapq
import math
import threading
from collections import Counter
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Annotated

import msgspec
import rosgraph.names
import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.ros_io.node import OK, WARN, Diagnostics, run
from hitchhike_ros.ros_io.parameters import node_parameters, path_parameter
from hitchhike_ros.ros_io.timer import Timer
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters
from hitchhike_ros.simulation.world_file import load_world

_QUEUE = 200


@dataclass(frozen=True)
class NetworkNodeParameters:
    """Private parameters of the node, beside those of the network."""

    rate: Positive = 100.0
    max_waiting: Annotated[int, msgspec.Meta(ge=1)] = 10_000


class NetworkModelNode:
    """Callbacks ask the model and put copies under way; a timer on simulated time delivers them."""

    def __init__(self) -> None:
        self._params = node_parameters(NetworkNodeParameters, "network_model")
        self._model = NetworkModel(node_parameters(NetworkParameters, "network"), rospy.get_name())
        self._robots = _robots()
        self._lock = threading.Lock()
        self._places: dict[str, tuple[float, float]] = {}
        self._under_way: list[tuple[float, int, str, str, String]] = []  # a heap
        self._order = count()
        self._now = self._latest_s = 0.0
        self._counts: Counter[tuple[str, str, str]] = Counter()  # (what, sender, receiver)
        self._diagnostics = Diagnostics("network_model")
        self._said = rospy.Publisher("/hhike_msg/network", String, queue_size=_QUEUE, tcp_nodelay=True)
        self._heard = {
            robot: rospy.Publisher(f"/{robot}/hhike_msg/network_in", String, queue_size=_QUEUE, tcp_nodelay=True)
            for robot in self._robots
        }
        self._subscribers = [
            rospy.Subscriber(
                f"/{robot}/hhike_msg/network_out", String, self._on_message, robot, queue_size=_QUEUE, tcp_nodelay=True
            )
            for robot in self._robots
        ]
        if math.isfinite(self._model.params.range_m):
            self._subscribers += [
                rospy.Subscriber(f"/{robot}/ground_truth", Odometry, self._on_truth, robot, queue_size=1)
                for robot in self._robots
            ]
        self._report()
        self._timers = [
            Timer(1.0 / self._params.rate, self._on_timer),
            Timer(1.0, self._report),
        ]

    def _on_truth(self, msg: Odometry, robot: str) -> None:
        with self._lock:
            self._places[robot] = msg.pose.pose.position.x, msg.pose.pose.position.y

    def _on_message(self, msg: String, sender: str) -> None:
        self._said.publish(msg)
        with self._lock:
            now = self._read_clock()
            for receiver in self._robots:
                if receiver != sender:
                    self._send(now, sender, receiver, msg)
            self._deliver(now)

    def _on_timer(self) -> None:
        with self._lock:
            self._deliver(self._read_clock())

    def _read_clock(self) -> float:
        now = rospy.get_time()
        if now < self._now:  # the simulation has begun anew
            self._under_way.clear()
        self._now = now
        return now

    def _send(self, now: float, sender: str, receiver: str, msg: String) -> None:
        """Put the copies that arrive under way."""
        tell = partial(self._tell, sender=sender, receiver=receiver)
        tell("sent")
        distance_m = self._distance(sender, receiver)
        if not self._model.reaches(now, sender, receiver, distance_m):
            tell("out_of_reach")
            return
        arrivals = self._model.deliveries(now, sender, receiver, distance_m)
        if not arrivals:
            tell("lost")
        elif len(arrivals) > 1:
            tell("doubled")
        for at in arrivals:
            if len(self._under_way) < self._params.max_waiting:
                heapq.heappush(self._under_way, (at, next(self._order), sender, receiver, msg))
            else:
                tell("overflowed")

    def _deliver(self, now: float) -> None:
        """Publish what has arrived by now, in that order."""
        while self._under_way and self._under_way[0][0] <= now:
            at, _, sender, receiver, msg = heapq.heappop(self._under_way)
            self._heard[receiver].publish(msg)
            self._tell("delivered", sender, receiver)
            self._latest_s = max(self._latest_s, now - at)

    def _distance(self, sender: str, receiver: str) -> float:
        """Between the two in m; without end where one has not been seen yet."""
        if sender not in self._places or receiver not in self._places:
            return math.inf
        return math.dist(self._places[sender], self._places[receiver])

    def _tell(self, what: str, sender: str, receiver: str) -> None:
        self._counts[what, sender, receiver] += 1

    def _report(self) -> None:
        with self._lock:
            counts, waiting, latest_s = dict(self._counts), len(self._under_way), self._latest_s
        totals = dict.fromkeys(("sent", "delivered", "lost", "doubled", "out_of_reach", "overflowed"), 0)
        for (what, _, _), number in counts.items():
            totals[what] += number
        overflowed = totals["overflowed"]
        self._diagnostics.set(
            WARN if overflowed else OK,
            f"{overflowed} copies more than ~max_waiting" if overflowed else "running",
            **totals,
            waiting=waiting,
            latest_s=f"{latest_s:.3f}",
            **{f"{what}_{sender}_to_{receiver}": number for (what, sender, receiver), number in counts.items()},
        )


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
