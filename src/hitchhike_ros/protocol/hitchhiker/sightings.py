"""Where a rider saw the marker ahead, and from where: what the driver tells later is of the time of no image."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D
from hitchhike_ros.core.geometry import between, compose, interpolate, wrap_angle

# Images of so long ago are kept. Where the robot ahead went between two that are farther apart is not known (chosen).
_HISTORY_S, _APART_S = 3.0, 0.7


@dataclass(frozen=True, eq=False)
class Sighting:
    """The marker as seen at one time, and where this robot was then, in ``odom``."""

    seen: MarkerObservation
    own: Pose2D

    @property
    def stamp(self) -> float:
        """Of the image."""
        return self.seen.stamp

    @property
    def place(self) -> Pose2D:
        """The marker in ``odom``."""
        return compose(self.own, self.seen.pose)


class Sightings:
    """The images of the last seconds in which the marker ahead was seen."""

    def __init__(self) -> None:
        self._images: deque[Sighting] = deque()

    @property
    def newest(self) -> float | None:
        """Stamp of the last image, None without any."""
        return self._images[-1].stamp if self._images else None

    def add(self, seen: MarkerObservation, own: Pose2D) -> None:
        """An image, unless it is known already; after the clock was set back, what was before is forgotten."""
        if self._images and seen.stamp < self._images[-1].stamp - _HISTORY_S:
            self._images.clear()
        if not self._images or seen.stamp > self._images[-1].stamp:
            self._images.append(Sighting(seen, own))
        while self._images[0].stamp < self._images[-1].stamp - _HISTORY_S:
            self._images.popleft()

    def at(self, stamp: float) -> Sighting | None:
        """At the time of an image or between two, both robots moving on steadily; None where no images tell."""
        k = bisect_left(self._images, stamp, key=lambda image: image.stamp)
        if k == len(self._images):
            return None
        after = self._images[k]
        if after.stamp == stamp:
            return after
        before = self._images[k - 1] if k > 0 else None
        if before is None or after.stamp - before.stamp > _APART_S:
            return None
        share = (stamp - before.stamp) / (after.stamp - before.stamp)
        own, a, b = interpolate(before.own, after.own, share), before.place, after.place
        # The yaw of a marker is seen so badly that it must not bend the way between two places of it.
        place = Pose2D(
            a.x + share * (b.x - a.x),
            a.y + share * (b.y - a.y),
            wrap_angle(a.theta + share * wrap_angle(b.theta - a.theta)),
        )
        nearest = after if share >= 0.5 else before
        seen = MarkerObservation(stamp, after.seen.marker_id, between(own, place), nearest.seen.covariance)
        return Sighting(seen, own)
