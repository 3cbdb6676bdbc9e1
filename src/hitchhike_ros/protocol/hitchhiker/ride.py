"""A hitchhiker behind its driver: the gap, what the driver says, and the pose that follows from both."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import between, compose, compose_jacobians, distance, inverse
from hitchhike_ros.localization.driver_track import DriverTrack, with_heading
from hitchhike_ros.localization.handover import handover
from hitchhike_ros.localization.motion import carried_on
from hitchhike_ros.protocol.events import Situation
from hitchhike_ros.protocol.hitchhiker.sightings import Sightings
from hitchhike_ros.protocol.messages import Decouple, Driver, RearMarker
from hitchhike_ros.protocol.parameters import HitchhikingParameters

# The driver's speed, known to 0.3 m/s, is passed on in such steps, as every change of the status wakes all modules
# (chosen).
_SPEED_STEP_MPS = 0.05
# The driver's places are kept when they are so far apart, and for so many metres (chosen).
_TOLD_STEP_M, _TOLD_M = 0.2, 4.0
# Images of so long a time show the robot in the gap before it is coupled: four at 10 Hz. It goes no faster meanwhile:
# it may close the last centimetres while the driver sets off (chosen).
_SETTLED_S, _SETTLED_MPS = 0.25, 0.1
# A robot does not back up. One that stands nearer than the gap, by no more than this, is coupled all the same: the gap
# opens when the driver sets off (chosen).
_NEARER_M = 0.3
# A marker within this beyond the gap can be coupled with; a farther one may be behind a corner (chosen).
_COUPLING_REACH_M = 1.2
# What a pose from the driver's message may be off by when the marker is lost: x, y in m, theta in rad (chosen).
_LOST_SIGMA = (0.5, 0.5, 0.3)
# Localization has taken a pose over when it answers with one that is this near to it (chosen: 4 of these sigmas).
_TAKEN_M = 4.0 * _LOST_SIGMA[0]


class Ride:
    """What the rider knows of its driver, from the first image for coupling to the end of the ride.

    ``camera`` is the position of the camera in the own ``base_footprint``; gaps are measured from there.
    """

    def __init__(
        self,
        params: HitchhikingParameters,
        camera: tuple[float, float],
        rear_marker: RearMarker,
        now: float,
        place: int = 1,
    ) -> None:
        """``rear_marker`` is of the robot ahead: the driver, or another rider where the ``place`` is not the first."""
        self.rear_marker, self.place = rear_marker, place
        self.report: Driver | Decouple | None = None  # the newest message of the driver,
        self.told_at: float | None = None  # and of when it tells, on the own clock
        self.told: deque[Pose2D] = deque()  # where the driver said that it was: the last metres of its way
        self._params, self._camera = params, Pose2D(*camera)
        self._heard_at = self._seen_at = now
        self._in_gap_since: float | None = None  # stamp of an image
        self._begin_track()

    @property
    def ridden_m(self) -> float:
        """The metres ridden, as the driver counts them."""
        return 0.0 if self.report is None else self.report.ridden_m

    # The marker ahead.

    def seen(self, situation: Situation, now: float) -> MarkerObservation | None:
        """The marker ahead, None unless it was seen a moment ago."""
        seen = situation.observation
        if seen is None or seen.marker_id != self.rear_marker.marker_id:
            return None
        return seen if now - seen.stamp <= self._params.repeat_period_s else None

    def gap_m(self, situation: Situation, now: float) -> float | None:
        """Distance from the own camera to the marker ahead, None while that is not in view."""
        seen = self.seen(situation, now)
        return None if seen is None else distance(self._camera, seen.pose)

    def look(self, situation: Situation, now: float) -> None:
        """Note since when the marker ahead is out of sight, and since when the robot keeps the gap."""
        self._lay(situation)
        gap, seen = self.gap_m(situation, now), self.seen(situation, now)
        if gap is None or seen is None:
            self._in_gap_since = None
            return
        self._seen_at = now
        in_gap = -_NEARER_M <= gap - self._params.gap_m <= self._params.gap_tolerance_m
        if not in_gap or abs(situation.speed_mps) > _SETTLED_MPS:
            self._in_gap_since = None
        elif self._in_gap_since is None:
            self._in_gap_since = seen.stamp

    def settled(self, situation: Situation, now: float) -> bool:
        """Whether images over a while have shown that the gap is right and hardly changes."""
        seen, since = self.seen(situation, now), self._in_gap_since
        return seen is not None and since is not None and seen.stamp - since >= _SETTLED_S

    def begin_to_settle(self) -> None:
        """Images from before do not count for :meth:`settled`."""
        self._in_gap_since = None

    def within_reach(self, situation: Situation, now: float) -> bool:
        """Whether the marker ahead is near enough to couple with."""
        gap = self.gap_m(situation, now)
        return gap is not None and gap <= self._params.gap_m + _COUPLING_REACH_M

    def out_of_sight(self, now: float) -> bool:
        """Whether the marker ahead has been out of sight for longer than between two images."""
        return now - self._seen_at > self._params.repeat_period_s

    # What the driver says.

    def begin(self, now: float) -> None:
        """The ride begins: silence of the driver counts from here."""
        self._heard_at = now

    def hear(self, message: Driver | Decouple, now: float) -> None:
        """Take a message of the driver.

        A rider that moves up in its convoy has another robot ahead of it, and knows nothing of that one's way.
        """
        if message.ahead is not None and message.ahead != self.rear_marker:
            self.rear_marker, self.told = message.ahead, deque()
            self._begin_track()
        self._heard_at, self.told_at = now, now - message.age_s
        self.report, self.place = message, message.place
        if not self.told or distance(self.told[-1], message.pose) >= _TOLD_STEP_M:
            self.told.append(message.pose)
        while distance(self.told[0], message.pose) > _TOLD_M:
            self.told.popleft()

    def match(self, message: Driver, situation: Situation, now: float) -> None:
        """Join the place of the marker that a message tells to where it was seen at that very time.

        The image that shows it then, or the one after it, may be yet to come.
        """
        mount = self.rear_marker.marker_pose
        J, J_mount = compose_jacobians(message.pose, mount)
        sigma = J @ np.array(message.sigma) @ J.T + J_mount @ self._params.mounting @ J_mount.T
        self._unmatched.append((now - message.age_s, compose(message.pose, mount), sigma))
        self._lay(situation)

    def _begin_track(self) -> None:
        """Nothing is known yet of the way of the robot ahead."""
        self._track, self._sightings = DriverTrack(), Sightings()
        self._unmatched: deque[tuple[float, Pose2D, FloatArray]] = deque()  # what was told of a time, in ``map``

    def _lay(self, situation: Situation) -> None:
        """Take the newest image, and lay together what was told and what was seen of the same times."""
        seen, own = situation.observation, situation.seen_from
        if seen is None or own is None or seen.marker_id != self.rear_marker.marker_id:
            return
        self._sightings.add(seen, own)
        while self._unmatched and self._unmatched[0][0] <= seen.stamp:
            stamp, told, sigma = self._unmatched.popleft()
            then = self._sightings.at(stamp)
            if then is not None:
                self._track.add(then.place, told, sigma)

    def silent(self, now: float) -> bool:
        """Whether the driver has said nothing for too long."""
        return now - self._heard_at > self._params.message_timeout_s

    def speed_mps(self, now: float) -> float:
        """The driver's speed in steps; 0 once it is old: a driver that has fallen silent may stand."""
        if not isinstance(self.report, Driver) or now - self._heard_at > self._params.ack_timeout_s:
            return 0.0
        return _SPEED_STEP_MPS * round(self.report.v / _SPEED_STEP_MPS)

    # The own pose.

    def pose_behind_driver(self, seen: MarkerObservation, situation: Situation, now: float) -> PoseEstimate | None:
        """The own pose of the image in which the marker is ``seen``, from the driver's last one (P17 §6.2).

        The marker is taken as it was when the driver told of, and the way since then by the own wheels. Where images do
        not tell that, both robots are taken to have stood since. None before any message.
        """
        driver, own = self._driver_estimate(now), situation.seen_from
        if driver is None:
            return None
        self._lay(situation)
        then = None if own is None else self._sightings.at(driver.stamp)
        if then is None:
            return self._behind(driver, seen, own)
        return carried_on(self._behind(driver, then.seen, then.own), then.own, own, seen.stamp)

    def _behind(self, driver: PoseEstimate, seen: MarkerObservation, own: Pose2D | None) -> PoseEstimate:
        """The own pose behind the ``driver``, of one time with the look at its marker, from ``own`` in ``odom``."""
        method, turn = self._params.handover, self._track.turn()
        estimate = handover(method, driver, seen, self.rear_marker.marker_pose, self._params.mounting)
        if method == "paper" or own is None or turn is None:
            return estimate
        return with_heading(estimate, own.theta + turn[0], turn[1])

    def rough_pose(self, situation: Situation, now: float) -> PoseEstimate | None:
        """The own pose without the marker: by the driver's track and the own wheels, else by the last message alone.

        The latter is P17 §4. Both robots may have gone on since the driver spoke last, and the covariance says so.
        Before any message the own estimate still holds: it has not been switched off yet.
        """
        own = situation.odom_pose
        located = None if own is None else self._track.locate(now, own)
        if located is not None:
            return located
        driver = self._driver_estimate(now)
        if driver is None:
            return situation.estimate
        ahead = Pose2D(self._camera.x + self._params.gap_m, 0.0, np.pi)
        gone_m = self._params.ride_speed_mps * (now - driver.stamp)
        covariance = np.diag(np.square([_LOST_SIGMA[0] + gone_m, _LOST_SIGMA[1] + gone_m, _LOST_SIGMA[2]]))
        assumed = MarkerObservation(now, self.rear_marker.marker_id, ahead, covariance)
        return handover("measured", driver, assumed, self.rear_marker.marker_pose, self._params.mounting)

    def _driver_estimate(self, now: float) -> PoseEstimate | None:
        """Of the time of which the driver told it."""
        message, stamp = self.report, now if self.told_at is None else min(self.told_at, now)
        return None if message is None else PoseEstimate(stamp, message.pose, np.array(message.sigma))

    def place_when_seen(self, own: Pose2D, situation: Situation) -> Pose2D:
        """Where this robot, which is at ``own`` in ``map`` now, was when the newest image was taken."""
        then, odom = situation.seen_from, situation.odom_pose
        return own if then is None or odom is None else compose(own, between(odom, then))

    def pose_ahead(self, own: Pose2D, situation: Situation, now: float) -> Pose2D | None:
        """Where the robot ahead was in ``map`` in the newest image, taken from ``own``; None while its marker is not in
        view."""
        seen = self.seen(situation, now)
        return None if seen is None else compose(compose(own, seen.pose), inverse(self.rear_marker.marker_pose))


@dataclass(frozen=True, eq=False)
class Restart:
    """Localization starts again: from which pose, and where the robot ahead was seen from there, in ``map``.

    ``odom`` is the same pose of this robot in ``odom``, where that is known.
    """

    estimate: PoseEstimate
    ahead: Pose2D | None
    odom: Pose2D | None = None

    def taken(self, answer: PoseEstimate | None) -> bool:
        """Whether localization goes on from the pose: it may wake up with what it knew when it went to sleep."""
        given = self.estimate
        if answer is None or answer.stamp <= given.stamp:
            return False
        return distance(given.pose, answer.pose) <= _TAKEN_M

    def ahead_from(self, own: Pose2D, odom: Pose2D | None = None) -> Pose2D | None:
        """Where the robot ahead was, when localization now says ``own``.

        This robot is at ``odom`` by its wheels then; without that it stands where it stood.
        """
        if self.ahead is None:
            return None
        gone = Pose2D() if odom is None or self.odom is None else between(self.odom, odom)
        return compose(compose(own, inverse(gone)), between(self.estimate.pose, self.ahead))
