"""The other robots in reach, as far as their messages tell."""

from __future__ import annotations

from dataclasses import dataclass

from hitchhike_ros.datatypes import Pose2D
from hitchhike_ros.protocol.messages import Beacon, Message, PoseFields
from hitchhike_ros.protocol.status import KnownRobot

# Radius of a robot whose beacon has not been heard yet (chosen).
_UNKNOWN_RADIUS_M = 0.4


@dataclass
class _Heard:
    """Where a robot was last and when that was said, and the last beacon and when it came."""

    place: Pose2D | None = None
    radius_m: float = _UNKNOWN_RADIUS_M
    at: float = 0.0
    beacon: Beacon | None = None
    beacon_at: float = 0.0
    _robot: KnownRobot | None = None  # made when asked for, as beacons come much more often

    def is_at(self, place: Pose2D, now: float) -> None:
        self.place, self.at, self._robot = place, now, None

    @property
    def robot(self) -> KnownRobot | None:
        if self._robot is None and self.place is not None:
            self._robot = KnownRobot(self.place.x, self.place.y, self.radius_m)
        return self._robot


class Neighbours:
    """Remembers what was heard; how long it holds is for whoever asks."""

    def __init__(self) -> None:
        self._heard: dict[str, _Heard] = {}

    def hear(self, message: Message, now: float) -> None:
        """Take any message of another robot."""
        if not isinstance(message, Beacon | PoseFields):
            return
        known = self._heard.get(message.robot_id)
        if known is None:
            known = self._heard[message.robot_id] = _Heard()
        if isinstance(message, Beacon):
            known.beacon, known.beacon_at, known.radius_m = message, now, message.radius_m
        pose = message.pose
        if pose is not None:
            known.is_at(pose, now)

    def saw(self, robot_id: str, place: Pose2D, now: float) -> None:
        """A robot was seen at ``place`` in ``map``: what it said last may be metres old."""
        known = self._heard.get(robot_id)
        if known is not None and known.place is not None:
            known.is_at(place, now)

    def robots(self, now: float, timeout_s: float, waiting: str, waiting_s: float) -> tuple[KnownRobot, ...]:
        """Where robots stand that were heard of in the last ``timeout_s``; ``waiting`` is remembered longer."""
        return tuple(
            robot
            for name, known in self._heard.items()
            if now - known.at <= (waiting_s if name == waiting else timeout_s) and (robot := known.robot) is not None
        )

    def known(self, now: float, timeout_s: float) -> set[str]:
        """All whose last beacon came in the last ``timeout_s``."""
        return {
            name
            for name, known in self._heard.items()
            if known.beacon is not None and now - known.beacon_at <= timeout_s
        }

    def drivers(self, now: float, timeout_s: float) -> set[str]:
        """Those whose last beacon of the last ``timeout_s`` offers a place."""
        return {
            name
            for name, known in self._heard.items()
            if known.beacon is not None and known.beacon.free_places > 0 and now - known.beacon_at <= timeout_s
        }

    def forget(self, before: float) -> None:
        """Of whom nothing was heard since ``before`` is gone."""
        self._heard = {name: k for name, k in self._heard.items() if max(k.at, k.beacon_at) >= before}
