"""What every rostest needs: keep what topics say, and wait for conditions with a wall-clock deadline."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import msgspec
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.award_ledger import AwardLedger, Credit
from hitchhike_ros.protocol.messages import Message, decode
from hitchhike_ros.protocol.status import Status, decode_status
from hitchhike_ros.ros_io.awards import default_ledger
from hitchhike_ros.ros_io.conversions import pose_from_msg


class Watch:
    """Statuses, network messages, diagnostics and ground truth of the robots, and whatever else is subscribed."""

    def __init__(self, *robots: str) -> None:
        self._changed = threading.Condition(threading.RLock())
        self.newest: dict[str, Any] = {}
        self.statuses: dict[str, list[Status]] = defaultdict(list)
        self.messages: list[Message] = []
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        self._subscribers: list[rospy.Subscriber] = []
        for robot in robots:
            self.subscribe(f"/{robot}/hhike_msg/status", String, self._on_status)
            self.subscribe(f"/{robot}/ground_truth", Odometry)
        self.subscribe("/hhike_msg/network", String, self._on_network)
        self.subscribe("/diagnostics", DiagnosticArray, self._on_diagnostics)

    def subscribe(self, topic: str, cls: type, callback: Callable[[Any], None] | None = None) -> None:
        """Keep the newest message of ``topic``; ``callback`` runs under the lock that conditions run under."""

        def receive(msg: Any) -> None:
            with self._changed:
                self.newest[topic] = msg
                if callback is not None:
                    callback(msg)
                self._changed.notify_all()

        self._subscribers.append(rospy.Subscriber(topic, cls, receive, queue_size=100, tcp_nodelay=True))

    def until(self, condition: Callable[[], Any], deadline_s: float, what: str, every_s: float = 1.0) -> Any:
        """The first true value of ``condition``; AssertionError naming ``what`` after ``deadline_s`` of wall time.

        The condition is asked at every message, and after ``every_s`` without one, which a condition needs that looks
        at something else than messages or that does something to come true.
        """
        end = time.monotonic() + deadline_s
        with self._changed:
            while not (value := condition()):
                left = end - time.monotonic()
                if left <= 0.0 or rospy.is_shutdown():
                    raise AssertionError(f"{what}: not within {deadline_s:.0f} s of wall time; {self.summary()}")
                self._changed.wait(min(left, every_s))
            return value

    def state(self, robot: str) -> str:
        """The robot's newest state, empty before it has said any."""
        return self.statuses[robot][-1].state if self.statuses[robot] else ""

    def truth(self, robot: str) -> Pose2D:
        """Where the robot is."""
        return pose_from_msg(self.newest[f"/{robot}/ground_truth"].pose.pose)

    def speed(self, robot: str) -> float:
        """How fast the robot is, in m/s; 0 before anything is known of it."""
        truth = self.newest.get(f"/{robot}/ground_truth")
        return 0.0 if truth is None else float(truth.twist.twist.linear.x)

    def of_type(self, cls: type[Message]) -> list[Any]:
        """The network messages of one type, oldest first."""
        return [message for message in self.messages if isinstance(message, cls)]

    def diagnostic(self, name: str) -> tuple[int, str, dict[str, str]]:
        """Level, text and values that a module reports; level OK and nothing before it has reported."""
        status = self.diagnostics.get(name, DiagnosticStatus())
        return status.level, status.message, {value.key: value.value for value in status.values}

    def summary(self) -> str:
        """Where everybody is, for the message of a failed wait."""
        states = {robot: (log[-1].state, log[-1].reason) for robot, log in self.statuses.items() if log}
        poses = {topic: self.truth(topic.split("/")[1]) for topic in self.newest if topic.endswith("/ground_truth")}
        worries = {name: s.message for name, s in self.diagnostics.items() if s.level != DiagnosticStatus.OK}
        return f"states {states}, truth {poses}, diagnostics {worries}"

    def _on_status(self, msg: String) -> None:
        status = decode_status(msg.data)
        self.statuses[status.robot_id].append(status)

    def _on_network(self, msg: String) -> None:
        try:
            self.messages.append(decode(msg.data))
        except (MessageError, msgspec.MsgspecError):
            self.newest["unreadable"] = msg.data  # a test sends garbage on purpose

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self.diagnostics.update({status.name: status for status in msg.status})


def credits_of_this_run() -> list[Credit]:
    """What the ledger says that hitchhike_comm keeps by default, without the rides of other tests before."""
    run = rospy.get_param("/run_id")[:8]
    return [credit for credit in AwardLedger(default_ledger()).credits() if credit.ride_id.startswith(run)]
