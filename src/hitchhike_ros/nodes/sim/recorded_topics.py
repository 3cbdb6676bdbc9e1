"""Everything that is heard of a run, subscribed and handed to its recorder."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import msgspec
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from hitchhike_ros.core.datatypes import Contact
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.experiments.scenarios.ride_recorder import RideRecorder
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.messages import NewObstacles
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import decode_status
from hitchhike_ros.ros_io.conversions import estimate_from_msg, pose_from_msg

Take = Callable[[RideRecorder, str, Any], object]
"""Converts a message, of a robot, and hands it to the recorder."""

_OF_A_ROBOT: tuple[tuple[str, type, Take], ...] = (
    ("ground_truth", Odometry, lambda r, name, m: r.truth(name, m.header.stamp.to_sec(), pose_from_msg(m.pose.pose))),
    ("amcl_pose", PoseWithCovarianceStamped, lambda r, name, m: r.estimate(name, estimate_from_msg(m))),
    ("initialpose", PoseWithCovarianceStamped, lambda r, name, m: r.initial_pose(name, estimate_from_msg(m))),
    ("hhike_msg/status", String, lambda r, name, m: r.status(name, decode_status(m.data))),
    ("hhike_msg/award", String, lambda r, name, m: r.award(name, msgspec.json.decode(m.data, type=Award))),
    ("new_obstacles", String, lambda r, name, m: r.obstacles(name, _decode(m, NewObstacles).obstacles)),
    ("visual_servoing/observations", String, lambda r, name, m: r.markers(name, decode_observations(m.data).markers)),
)


class RecordedTopics:
    """Subscribers that feed a recorder under ``lock``. ``unreadable`` counts messages that could not be read."""

    def __init__(self, recorder: RideRecorder) -> None:
        self.lock = threading.Lock()
        self.unreadable = 0
        self._recorder = recorder
        for name in recorder.record.robots:
            for topic, cls, take in _OF_A_ROBOT:
                rospy.Subscriber(f"/{name}/{topic}", cls, self._receive, (take, name), queue_size=100)
        for topic, cls, take in (
            ("/hhike_msg/network", String, _take_message),
            ("/simulator/contacts", String, _take_contact),
            ("/diagnostics", DiagnosticArray, _take_diagnostics),
        ):
            rospy.Subscriber(topic, cls, self._receive, (take, ""))

    def _receive(self, msg: Any, target: tuple[Take, str]) -> None:
        take, name = target
        with self.lock:
            try:
                take(self._recorder, name, msg)
            except (MessageError, msgspec.MsgspecError) as exc:
                self.unreadable += 1
                rospy.logwarn_throttle(10.0, "unreadable: %s", exc)


def _decode(msg: String, cls: Any) -> Any:
    return msgspec.json.decode(msg.data, type=cls)


def _take_message(recorder: RideRecorder, _name: str, msg: String) -> None:
    recorder.message(rospy.get_time(), msg.data)


def _take_contact(recorder: RideRecorder, _name: str, msg: String) -> None:
    recorder.contact(_decode(msg, Contact))


def _take_diagnostics(recorder: RideRecorder, _name: str, msg: DiagnosticArray) -> None:
    for status in msg.status:
        if status.hardware_id == "/simulator":
            recorder.simulator(msg.header.stamp.to_sec(), {value.key: value.value for value in status.values})
