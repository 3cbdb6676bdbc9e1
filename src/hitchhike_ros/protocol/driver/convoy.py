"""The hitchhikers of one driver: in which order they ride, whom each of them follows, where it is, and how it fares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hitchhike_ros.core.datatypes import (
    FloatArray,
    HitchhikingPoint,
    MarkerObservation,
    Odometry,
    Pose2D,
    PoseEstimate,
    Twist2D,
)
from hitchhike_ros.core.geometry import compose, distance, inverse
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.core.pose_buffer import PoseBuffer, PoseBufferParameters
from hitchhike_ros.localization.handover import handover
from hitchhike_ros.protocol.announcement import ASTRAY_M
from hitchhike_ros.protocol.matching import Stretch
from hitchhike_ros.protocol.messages import Ack, Message, RearMarker

# A rider that has not said how it sees the robot ahead is about so far behind it: m, m, rad (chosen).
_UNSEEN = Pose2D(1.0)
_UNSEEN_SIGMA = np.diag(np.square([0.5, 0.3, 0.3]))
# Riders who would leave within this of each other leave together (chosen).
LEAVE_TOGETHER_M = 1.0
# A driver whose pose has changed by less may be standing: that is noise.
_MOVED_M = 0.2


# Poses of so long ago are kept, for what is told of them later; none are guessed beyond the newest (chosen).
_HISTORY = PoseBufferParameters(history_s=3.0, max_extrapolation_s=0.0, max_speed_mps=np.inf, max_yaw_rate_rps=np.inf)


def _history() -> PoseBuffer:
    return PoseBuffer(_HISTORY)


def _keep(history: PoseBuffer, stamp: float, pose: Pose2D) -> None:
    """Add the pose, unless there is a newer one already; a clock that was set back begins anew."""
    if history and stamp < history.newest.stamp - _HISTORY.history_s:
        history.clear()
    if not history or stamp > history.newest.stamp:
        history.add(Odometry(stamp, pose, Twist2D()))


@dataclass(frozen=True, eq=False)
class Offer:
    """A ride that was offered: to whom, from which point (aligned as the hitchhiker stands there), and along what.

    The stretch begins where the driver aligns. From the lock on it stays as it is.
    """

    hitchhiker: str
    ride_id: str
    point: HitchhikingPoint
    stretch: Stretch

    @property
    def ride_m(self) -> float:
        """How long the ride is."""
        return self.stretch.length_m

    @property
    def decouple_pose(self) -> Pose2D:
        """dloc, where the driver stops."""
        return self.stretch.end


@dataclass(eq=False)
class Rider:
    """A hitchhiker that was offered a ride, and how it fares.

    ``due`` is when it will be at its waiting place, ``heard_at`` when it said so last.
    """

    offer: Offer
    rear_marker: RearMarker | None = None
    due: float = 0.0
    heard_at: float = 0.0
    coupled: bool = False
    leaving: bool = False
    ridden_m: float = 0.0
    gap_m: float | None = None
    following: bool = True
    acked_at: float = 0.0
    seen: MarkerObservation | None = field(default=None, repr=False)  # the marker ahead in the newest image it told of
    sightings: PoseBuffer = field(default_factory=_history, repr=False)  # and in those before

    @property
    def left_m(self) -> float:
        """Metres of the ride that are still ahead."""
        return self.offer.ride_m - self.ridden_m

    def hear(self, ack: Ack, now: float) -> None:
        """How it follows, in its own words."""
        self.acked_at, self.following, self.gap_m = now, ack.following, ack.gap_m
        if ack.seen is None or ack.seen_sigma is None:
            return
        seen = MarkerObservation(now - ack.seen_age_s, 0, ack.seen, np.array(ack.seen_sigma))
        if self.seen is None or seen.stamp > self.seen.stamp:
            self.seen = seen
            _keep(self.sightings, seen.stamp, seen.pose)

    def saw_at(self, stamp: float) -> MarkerObservation | None:
        """The robot ahead as it was seen then: between two images, or in the one that is nearest."""
        if self.seen is None:
            return None
        return replace(self.seen, stamp=stamp, pose=self.sightings.get(stamp) or self.seen.pose)


class Convoy:
    """Riders in the order of their places; the first follows the driver, each other one the rider ahead of it."""

    def __init__(self, rear_marker: RearMarker) -> None:
        """``rear_marker`` is the driver's."""
        self._rear_marker = rear_marker
        self._riders: list[Rider] = []
        self._driven = _history()  # the driver's own poses
        self.waits_since = 0.0  # for riders that are missing

    def __iter__(self) -> Iterator[Rider]:
        return iter(tuple(self._riders))

    def __len__(self) -> int:
        return len(self._riders)

    @property
    def first(self) -> Rider | None:
        return self._riders[0] if self._riders else None

    @property
    def coupled(self) -> tuple[Rider, ...]:
        return tuple(rider for rider in self._riders if rider.coupled)

    @property
    def next_to_couple(self) -> Rider | None:
        """Riders couple one after another, from the front."""
        return next((rider for rider in self._riders if not rider.coupled), None)

    @property
    def next_to_leave(self) -> Rider | None:
        return min(self.coupled, key=lambda rider: rider.left_m, default=None)

    @property
    def leaving(self) -> tuple[Rider, ...]:
        """At the end of a ride, those for whom it is the end."""
        return tuple(rider for rider in self.coupled if rider.leaving)

    def missing(self, since: float) -> tuple[Rider, ...]:
        """Those that do not follow, or have not said so after ``since``."""
        return tuple(r for r in self.coupled if not r.following or r.acked_at <= since)

    def behind(self, most_m: float) -> tuple[Rider, ...]:
        """Those for whom the driver waits: missing since it does, or with a gap above ``most_m`` (P17 §4)."""
        missing = self.missing(self.waits_since)
        return tuple(r for r in self.coupled if r in missing or (r.gap_m or 0.0) > most_m)

    def silent(self, now: float, timeout_s: float) -> tuple[Rider, ...]:
        """Those on their way that have not said for so long when they will be there, nor have come when they said."""
        return tuple(r for r in self._riders if not r.coupled and now - max(r.heard_at, r.due) > timeout_s)

    def let_leave(self) -> None:
        """The ride ends for the next to leave, and for those who would leave within a metre of it."""
        first = self.next_to_leave
        for rider in self.coupled:
            rider.leaving = first is not None and rider.left_m <= first.left_m + LEAVE_TOGETHER_M

    def credit(self, metres: float) -> None:
        """All that are coupled have ridden so far, and none beyond the end of its ride."""
        for rider in self.coupled:
            rider.ridden_m = min(rider.ridden_m + metres, rider.offer.ride_m)

    def find(self, message: Message) -> Rider | None:
        """The rider that sends a message of its present ride."""
        for rider in self._riders:
            if (rider.offer.hitchhiker, rider.offer.ride_id) == (message.robot_id, message.ride_id):
                return rider
        return None

    def of(self, hitchhiker: str) -> Rider | None:
        return next((rider for rider in self._riders if rider.offer.hitchhiker == hitchhiker), None)

    def add(self, rider: Rider, may_pass: bool = False) -> None:
        """Behind all others, or ``may_pass`` those that are not coupled and will be there later: who comes first waits
        in front."""
        k = len(self._riders)
        while may_pass and k > 0 and not self._riders[k - 1].coupled and self._riders[k - 1].due > rider.due:
            k -= 1
        self._riders.insert(k, rider)

    def remove(self, rider: Rider) -> None:
        """Those behind it move up."""
        self._riders.remove(rider)

    def place(self, rider: Rider) -> int:
        return self._riders.index(rider) + 1

    def ahead_of(self, rider: Rider) -> RearMarker:
        """The rear marker that ``rider`` follows: of the next robot ahead that has one."""
        rear_markers = [
            ahead.rear_marker for ahead in self._riders[: self._riders.index(rider)] if ahead.rear_marker is not None
        ]
        return rear_markers[-1] if rear_markers else self._rear_marker

    def note(self, driver: PoseEstimate) -> None:
        """Where the driver is: riders say later what they saw of it."""
        _keep(self._driven, driver.stamp, driver.pose)

    def pose_ahead_of(self, rider: Rider, driver: PoseEstimate, mounting: FloatArray) -> PoseEstimate:
        """Where the robot is that ``rider`` follows, from the driver's own pose and what the riders between see.

        What they see is of the images of which they have told, so the estimate is of the newest time of which all have.
        """
        between = [ahead for ahead in self._riders[: self._riders.index(rider)] if ahead.rear_marker is not None]
        stamp = min([driver.stamp, *(ahead.seen.stamp for ahead in between if ahead.seen is not None)])
        then = self._driven.get(stamp)
        here, rear_marker = driver if then is None else replace(driver, stamp=stamp, pose=then), self._rear_marker
        for ahead in between:
            assert ahead.rear_marker is not None
            seen = ahead.saw_at(stamp)
            if seen is None:
                behind = compose(here.pose, inverse(_UNSEEN))
                here = PoseEstimate(here.stamp, behind, here.covariance + _UNSEEN_SIGMA)
            else:
                estimate = handover("measured", here, seen, rear_marker.marker_pose, mounting)
                here = replace(estimate, stamp=here.stamp)
            rear_marker = ahead.rear_marker
        return here


class Odometer:
    """How far a driver has come with its riders along the path that their rides follow, from its estimates."""

    def __init__(self, line: Polyline, begin_m: float) -> None:
        """The rides begin ``begin_m`` along the ``line``."""
        self._line, self._come_m = line, begin_m
        self._at: Pose2D | None = None
        self._gone_m = 0.0  # since it was seen to come farther along the path

    def step(self, pose: Pose2D, last: bool = False) -> float:
        """Metres along the path since those that were counted last; none while it goes round something beside it.

        A step that is too short to count waits, unless it is the last.
        """
        at = self._at = self._at or pose
        if (moved := distance(at, pose)) >= _MOVED_M:
            self._at, self._gone_m = pose, self._gone_m + moved
        reach_m = self._gone_m + _MOVED_M + ASTRAY_M
        arc, away = self._line.project(pose.x, pose.y, self._come_m, self._come_m + reach_m)
        metres = arc - self._come_m
        if away > ASTRAY_M or (metres < _MOVED_M and not last):
            return 0.0
        self._come_m, self._gone_m = arc, 0.0
        return metres
