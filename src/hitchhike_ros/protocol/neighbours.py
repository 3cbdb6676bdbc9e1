"""The other robots in reach, as far as their messages tell."""

from __future__ import annotations

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.messages import Beacon, Decouple, Driver, Message, PoseFields
from hitchhike_ros.protocol.status import KnownRobot

# Radius of a robot whose beacon has not been heard yet (chosen).
_UNKNOWN_RADIUS_M = 0.4


class Neighbours:
    """Remembers what was heard; how long it holds is for whoever asks.

    Beacons come by the hundred for every question, so hearing one only puts it away.
    """

    def __init__(self) -> None:
        self._beacons: dict[str, tuple[Beacon, float]] = {}
        self._places: dict[str, tuple[Pose2D | PoseFields, float]] = {}  # that other messages told, or that were seen
        # By driver: the rider ahead in its convoy, of whom no message tells the name.
        self._ahead: dict[str, tuple[Pose2D | PoseFields, float]] = {}

    def beacons(self, now: float, timeout_s: float) -> list[Beacon]:
        """The last one of each robot, of the last ``timeout_s``."""
        return [beacon for beacon, at in self._beacons.values() if now - at <= timeout_s]

    def beacon(self, name: str) -> Beacon | None:
        """The last one of a robot, while it is remembered."""
        heard = self._beacons.get(name)
        return None if heard is None else heard[0]

    def hear(self, message: Message, now: float) -> None:
        """Take any message of another robot."""
        if isinstance(message, Beacon):
            self.put_away(message, (message, now))
        elif isinstance(message, Driver | Decouple) and message.place > 1:
            self._ahead[message.robot_id] = message, now
        elif isinstance(message, PoseFields):
            self._places[message.robot_id] = message, now

    def put_away(self, beacon: Beacon, heard: tuple[Beacon, float]) -> None:
        """Take a beacon, with the time when it came."""
        if beacon.pose is None and (place := self._place(beacon.robot_id)) is not None:
            self._places[beacon.robot_id] = place  # the beacon before may have told it
        self._beacons[beacon.robot_id] = heard

    def saw_driver(self, driver: str, place: Pose2D, now: float) -> None:
        """A driver was seen at ``place`` in ``map``: what it said last may be metres old."""
        if self._place(driver) is not None:
            self._places[driver] = place, now

    def saw_ahead(self, driver: str, place: Pose2D, now: float) -> None:
        """The rider ahead in a driver's convoy was seen at ``place`` in ``map``."""
        self._ahead[driver] = place, now

    def robots(self, now: float, timeout_s: float, waiting: str, waiting_s: float) -> tuple[KnownRobot, ...]:
        """Where robots stand that were heard of in the last ``timeout_s``.

        The driver ``waiting`` is remembered for ``waiting_s``, and so is the rider ahead that waits with it.
        """
        found = []
        for name in {**self._beacons, **self._places, **self._ahead}:
            since = now - (waiting_s if name == waiting else timeout_s)
            beacon = self._beacons.get(name)
            radius_m = _UNKNOWN_RADIUS_M if beacon is None else beacon[0].radius_m
            for place, its_radius_m in ((self._place(name), radius_m), (self._ahead.get(name), _UNKNOWN_RADIUS_M)):
                if place is not None and place[1] >= since:
                    found.append(KnownRobot(place[0].x, place[0].y, its_radius_m))
        return tuple(found)

    def known(self, now: float, timeout_s: float) -> set[str]:
        """All whose last beacon came in the last ``timeout_s``."""
        return {name for name, (_, at) in self._beacons.items() if now - at <= timeout_s}

    def drivers(self, now: float, timeout_s: float) -> set[str]:
        """Those whose last beacon of the last ``timeout_s`` offers a place."""
        return {
            name for name, (beacon, at) in self._beacons.items() if beacon.free_places > 0 and now - at <= timeout_s
        }

    def forget(self, before: float) -> None:
        """Of whom nothing was heard since ``before`` is gone."""
        for heard in (self._beacons, self._places, self._ahead):
            for name in [name for name, (_, at) in heard.items() if at < before]:
                del heard[name]

    def _place(self, name: str) -> tuple[Pose2D | PoseFields, float] | None:
        """Where a robot was last, and when that was heard."""
        told, heard = self._places.get(name), self._beacons.get(name)
        if heard is None or heard[0].pose is None or (told is not None and told[1] > heard[1]):
            return told
        return heard[0].pose, heard[1]
