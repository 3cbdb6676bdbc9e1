"""Stands between a simulated robot's sensors and its modules, and spoils what a test wants spoilt."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, LaserScan

TOPICS: dict[str, type] = {
    "odom": Odometry,
    "scan": LaserScan,
    "camera/image_raw": Image,
    "camera/camera_info": CameraInfo,
}


class Tamper:
    """Passes each topic of ``robot`` on to ``tampered/<topic>``; images only while somebody wants them."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._spoil: dict[str, Callable[[Any], Any]] = {}
        self.last_good: dict[str, float] = {}  # stamp of the last message that was passed on as it was
        self._publishers: dict[str, rospy.Publisher] = {}
        self._sources: dict[str, rospy.Subscriber] = {}
        for topic, cls in TOPICS.items():
            listener = _OnDemand(self, topic)
            self._publishers[topic] = rospy.Publisher(
                f"/{robot}/tampered/{topic}", cls, subscriber_listener=listener, queue_size=1, tcp_nodelay=True
            )

    def spoil(self, topic: str, how: Callable[[Any], Any]) -> None:
        """From now on pass ``how(message)`` on, or nothing where that is None."""
        self._spoil[topic] = how

    def heal(self, topic: str) -> None:
        """Pass everything on again."""
        self._spoil.pop(topic, None)

    def want(self, topic: str, wanted: bool) -> None:
        """Subscribe the source while somebody listens."""
        if wanted and topic not in self._sources:
            source = f"/{self._robot}/{topic}"
            self._sources[topic] = rospy.Subscriber(
                source, TOPICS[topic], self._relay, topic, queue_size=1, buff_size=1 << 22, tcp_nodelay=True
            )
        elif not wanted and topic in self._sources:
            self._sources.pop(topic).unregister()

    def _relay(self, msg: Any, topic: str) -> None:
        how = self._spoil.get(topic)
        if how is None:
            self.last_good[topic] = msg.header.stamp.to_sec()
            self._publishers[topic].publish(msg)
            return
        spoilt = how(copy.deepcopy(msg))
        if spoilt is not None:
            self._publishers[topic].publish(spoilt)


class _OnDemand(rospy.SubscribeListener):
    def __init__(self, tamper: Tamper, topic: str) -> None:
        self._tamper, self._topic, self._peers = tamper, topic, 0

    def peer_subscribe(self, _topic: str, _publish: object, _peer: object) -> None:
        self._peers += 1
        self._tamper.want(self._topic, True)

    def peer_unsubscribe(self, _topic: str, peers: int) -> None:
        self._peers = peers
        self._tamper.want(self._topic, peers > 0)


def nothing(_msg: Any) -> None:
    """The sensor is silent."""


def nan_odometry(msg: Odometry) -> Odometry:
    msg.pose.pose.position.x = msg.twist.twist.linear.x = math.nan
    return msg


def nan_scan(msg: LaserScan) -> LaserScan:
    msg.ranges = [math.nan] * len(msg.ranges)
    return msg


def holey_scan(msg: LaserScan) -> LaserScan:
    """As of drivers that send NaN, or 0.0, for what does not return."""
    msg.ranges = [(r, math.nan, 0.0, r)[k % 4] for k, r in enumerate(msg.ranges)]
    return msg


def empty_calibration(msg: CameraInfo) -> CameraInfo:
    msg.K = [0.0] * 9
    return msg
