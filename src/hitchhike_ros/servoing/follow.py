"""Riding behind a marker: the follower drives the driver's track at a constant gap (P17 §3, step 3).

What the camera sees is joined with the own wheel odometry (no localization: that is off during a ride) to an estimate
of the driver's motion and a short trail of where its axle has been. One of the :mod:`servo_laws` turns both into
velocities. They are bent so that the marker stays in view, and saturated. :mod:`driver_search` searches for a driver
that is out of sight. Nothing here reads a clock. All coordinates are in the follower's ``odom`` frame unless said
otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hitchhike_ros.core.datatypes import MarkerObservation, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import compose, wrap_angle
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.servoing.driver_estimate import USUAL_MARKER, DriverEstimate
from hitchhike_ros.servoing.driver_search import Departure, DriverSearch
from hitchhike_ros.servoing.driver_trail import DriverTrail
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.servo_laws import LawInput, Target, make_law, saturate

# A follower farther than this from the trail of a driver that it lost does not go back to it (chosen).
STRAY_M = 0.5
# The least share of the own turning that counts for the bearing: with a camera behind the axle, near the marker, it
# would be none (chosen).
_LEAST_LEVER = 0.2

State = Literal["searching", "following", "coasting", "looking", "turning", "lost", "stopped"]


@dataclass(frozen=True)
class FollowDecision:
    """What to do now, and why when it is not following; gap and bearing of the marker as predicted for now."""

    twist: Twist2D
    state: State
    reason: str = ""
    gap_m: float | None = None
    bearing_rad: float | None = None


class FollowLaw:
    """Follows one marker.

    The camera is ``camera_x_m`` ahead of the own axle and ``camera_y_m`` to the left, and looks ``camera_yaw_rad`` to
    the left of ahead. The gap is the horizontal distance from camera to marker.
    """

    def __init__(
        self,
        params: FollowParameters,
        limits: RobotLimits,
        camera_x_m: float,
        camera_y_m: float = 0.0,
        camera_yaw_rad: float = 0.0,
    ) -> None:
        self._params, self._limits = params, limits
        self._camera = Pose2D(camera_x_m, camera_y_m, camera_yaw_rad)
        self._law = make_law(params, limits)
        self._max_omega = min(params.max_yaw_rate_rps, limits.max_yaw_rate_rps)
        self._odometry = PoseBuffer()
        self.reset()

    def reset(self) -> None:
        """Forget the driver; odometry is kept."""
        self._driver: DriverEstimate | None = None
        self._trail = DriverTrail((0.0, 0.0))  # empty until the driver is seen
        self._search: DriverSearch | None = None

    def add_odometry(self, odometry: Odometry) -> None:
        """The newest reading of the wheels.

        Raises:
            SensorDataError: it is not finite, runs back in time or has jumped. The driver is forgotten then: what the
                robot did meanwhile is not known, and the trail is no longer where it was.
        """
        try:
            self._odometry.add(odometry)
        except SensorDataError:
            self.reset()
            raise

    def step(
        self,
        now: float,
        observation: MarkerObservation | None,
        odometry: Odometry | None,
        gap_m: float,
        feed_forward_mps: float = 0.0,
        told_at: float | None = None,
        T_driver_marker: Pose2D = USUAL_MARKER,
    ) -> FollowDecision:
        """The command at time ``now``.

        Args:
            now: in s, on the clock of the stamps.
            observation: of the driver's marker in the newest image, which may be older than ``now``; None when it is
                not in it, or there is no new image.
            odometry: the newest reading; None when :meth:`add_odometry` has it.
            gap_m: the gap to keep.
            feed_forward_mps: the speed that the driver has told last; without ``told_at``, 0 is none.
            told_at: when it did, on the clock of the stamps. It counts once.
            T_driver_marker: where the marker is mounted, in the driver's ``base_footprint``.

        Raises:
            SensorDataError: as :meth:`add_odometry`.
        """
        p = self._params
        if odometry is not None:
            self.add_odometry(odometry)
        if observation is not None:
            self._see(observation, T_driver_marker)
            self._hear(feed_forward_mps, told_at)
        age = now - self._odometry.newest.stamp if self._odometry else math.inf
        if not age <= p.odometry_timeout_s:
            return FollowDecision(
                Twist2D(), "stopped", "no odometry" if math.isinf(age) else f"odometry is {age:.2f} s old"
            )
        driver = self._driver
        if driver is None:
            return self._seek_driver(now)
        if now - driver.stamp > p.lost_timeout_s:
            return self._search_driver(now, driver, T_driver_marker)
        return self._follow(now, driver, gap_m)

    def _follow(self, now: float, driver: DriverEstimate, gap_m: float) -> FollowDecision:
        own = self._odometry.get(now)
        if own is None:  # beyond its reach both are taken as when it was new
            own, now = self._odometry.newest.pose, self._odometry.newest.stamp
        target = self._target(now, own, driver)
        v, omega = self._law.velocities(LawInput(own, self._trail, target, driver.speed), gap_m)
        wanted = saturate(v, omega, self._limits.max_speed_mps, self._max_omega)
        omega = self._keep_in_view(wanted, target)
        twist = saturate(wanted.v, omega, self._limits.max_speed_mps, self._max_omega)
        return FollowDecision(twist, "following", "", target.gap, target.bearing)

    def _seek_driver(self, now: float) -> FollowDecision:
        """Look ahead for a while, then to both sides, since nothing is known of the driver yet."""
        if self._search is None:
            self._search = DriverSearch(self._params, self._limits, Departure(0.0, 0.0, 0.0), now)
        twist, state = self._search.step(now, self._odometry.newest.pose, self._trail, 0.0)
        return FollowDecision(twist, "searching" if state == "looking" else state, "marker not seen yet")

    def _search_driver(self, now: float, driver: DriverEstimate, T_driver_marker: Pose2D) -> FollowDecision:
        own = self._odometry.newest.pose
        if self._search is None:
            last = driver.stamp + self._params.lost_timeout_s
            then = self._odometry.get(last) or own
            bearing = self._target(last, then, driver).bearing
            turned = wrap_angle(driver.heading - then.theta)
            departure = Departure(max(self._odometry.newest.twist.v, 0.0), bearing, turned)
            self._search = DriverSearch(self._params, self._limits, departure, now)
        place = self._trail.advance(own.x, own.y)
        ahead = self._camera.x - T_driver_marker.x + self._params.coast_stop_m
        twist, state = self._search.step(now, own, self._trail, self._trail.length - place - ahead)
        return FollowDecision(twist, state, f"marker not seen for {now - driver.stamp:.2f} s")

    def _target(self, now: float, own: Pose2D, driver: DriverEstimate) -> Target:
        camera, marker = compose(own, Pose2D(self._camera.x, self._camera.y)), driver.marker_at(now)
        dx, dy = marker[0] - camera.x, marker[1] - camera.y
        c, s = math.cos(own.theta), math.sin(own.theta)
        heading = driver.heading - own.theta
        return Target(
            c * dx + s * dy,
            c * dy - s * dx,
            driver.speed * math.cos(heading),
            driver.speed * math.sin(heading),
            self._camera.x,
            self._camera.y,
        )

    def _see(self, observation: MarkerObservation, T_driver_marker: Pose2D) -> None:
        own = self.pose_at(observation.stamp)
        if own is None or not observation.pose.is_finite() or not np.isfinite(observation.covariance).all():
            return
        p = self._params
        marker = compose(own, observation.pose)
        self._search = None
        if self._driver is None:
            self._driver = DriverEstimate(p, observation.stamp, marker, observation.covariance, T_driver_marker)
            self._trail = DriverTrail((own.x, own.y), self._driver.axle)
        elif observation.stamp > self._driver.stamp:
            if observation.stamp - self._driver.stamp > p.lost_timeout_s:
                # Nobody saw what it did meanwhile: its speed is unknown again, and the way to it is taken as straight.
                self._driver = DriverEstimate(p, observation.stamp, marker, observation.covariance, T_driver_marker)
                place = self._trail.at(self._trail.advance(own.x, own.y))
                if math.hypot(place[0] - own.x, place[1] - own.y) > STRAY_M:  # it went its own way meanwhile
                    self._trail = DriverTrail((own.x, own.y), self._driver.axle)
            else:
                self._driver.update(observation.stamp, marker, observation.covariance)
            self._trail.extend(self._driver.axle, self._driver.heading, p.trail_step_m)

    def _hear(self, speed_mps: float, told_at: float | None) -> None:
        if self._driver is not None and (speed_mps > 0.0 or told_at is not None):
            self._driver.tell_speed(speed_mps, told_at)

    def _keep_in_view(self, wanted: Twist2D, target: Target) -> float:
        """The yaw rate nearest to that of ``wanted`` with which the bearing nears its limit no faster than
        exponentially.

        The bearing's rate is drift - lever * omega: a camera that is not on the axle is carried sideways when the robot
        turns, by which the marker goes out of view the faster.
        """
        gain, limit = self._params.view_gain, self._params.max_bearing_rad
        bearing, squared = target.bearing - self._camera.theta, max(target.gap, 0.1) ** 2
        drift = (target.x * target.vy - target.y * (target.vx - wanted.v)) / squared
        lever = 1.0 + (target.x * target.camera_x + target.y * target.camera_y) / squared
        lever = max(lever, _LEAST_LEVER)
        least, most = (drift - gain * (limit - bearing)) / lever, (drift + gain * (limit + bearing)) / lever
        return max(least, min(most, wanted.omega))

    def pose_at(self, stamp: float) -> Pose2D | None:
        """Own pose in ``odom`` when an image was taken; None where the odometry does not reach."""
        return self._odometry.get(stamp)
