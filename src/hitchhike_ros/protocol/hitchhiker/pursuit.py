"""Where a hitchhiker looks for a driver that it has lost from sight and that waits for it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import compose, distance
from hitchhike_ros.protocol.events import Situation
from hitchhike_ros.protocol.messages import RearMarker
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import GoalCommand

# The place behind the driver is so much farther off than the gap, and need be reached no better than this (chosen).
_CATCH_UP_M, _CATCH_UP_TOLERANCE_M, _CATCH_UP_TOLERANCE_RAD = 0.4, 0.25, 0.25


class Pursuit:
    """Goes from place to place from where the driver's marker may be seen."""

    def __init__(
        self, params: HitchhikingParameters, camera: tuple[float, float], ride_id: str, numbers: Iterator[int]
    ) -> None:
        """``numbers`` tell the ways apart that are ordered on one ride, in this pursuit and in others."""
        self.way: GoalCommand | None = None
        self.nowhere_left = False  # to look, with the driver where it says that it is
        self._params, self._camera_x, self._ride_id, self._numbers = params, camera[0], ride_id, numbers
        self._aimed_at: Pose2D | None = None
        self._places: deque[Pose2D] = deque()
        self._looking_since: float | None = None

    def aim(self, told: Sequence[Pose2D], rear_marker: RearMarker, situation: Situation, now: float) -> None:
        """Order the way to the next place when it is time for one, or note that none is left.

        A driver that has gone on is a reason to begin anew.

        Args:
            told: poses of the driver in ``map``, the newest last.
            rear_marker: the driver's.
            situation: what the own modules know.
            now: the present time.
        """
        if told and told[-1] != self._aimed_at:
            self._aimed_at, self._places = told[-1], deque(self._places_to_look(told, rear_marker, situation))
            self.way = None
        if self.way is not None and not self._looked_in_vain(self.way, situation, now):
            return
        self.nowhere_left = not self._places
        if self.nowhere_left:
            return
        place = self._places.popleft()
        self._looking_since = None
        order = f"{self._ride_id}-behind-{next(self._numbers)}"
        self.way = GoalCommand(order, place.x, place.y, place.theta, _CATCH_UP_TOLERANCE_M, _CATCH_UP_TOLERANCE_RAD)

    def _places_to_look(self, told: Sequence[Pose2D], rear_marker: RearMarker, situation: Situation) -> list[Pose2D]:
        """On the driver's own way, or on the spot when the driver is near; then straight in front of its marker."""
        if situation.estimate is None:
            return []
        own = situation.estimate.pose
        marker = compose(told[-1], rear_marker.marker_pose)
        off = self._camera_x + self._params.gap_m
        behind = next((p for p in reversed(told) if distance(p, marker) >= off + _CATCH_UP_M), told[0])
        behind = own if distance(own, marker) < off + _CATCH_UP_M else behind
        return [
            Pose2D(p.x, p.y, math.atan2(marker.y - p.y, marker.x - p.x)) for p in (behind, compose(marker, Pose2D(off)))
        ]

    def _looked_in_vain(self, way: GoalCommand, situation: Situation, now: float) -> bool:
        """Whether the robot has stood at the place for a while, or has had no path to it for as long."""
        report = situation.navigation
        if report is None or report.goal_id != way.id or report.state not in ("arrived", "failed"):
            self._looking_since = None
            return False
        if self._looking_since is None:
            self._looking_since = now
        return now - self._looking_since > self._params.look_s
