"""What all localizers share: odometry, messages that come late, the markers of the map."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from hitchhike_ros.core.datatypes import (
    FloatArray,
    LaserScan,
    Marker,
    MarkerObservation,
    Odometry,
    Pose2D,
    PoseEstimate,
    Twist2D,
    UnitInterval,
)
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, compose, compose_jacobians, move
from hitchhike_ros.core.pose_buffer import PoseBuffer, PoseBufferParameters
from hitchhike_ros.localization.ekf import EkfParameters, check_gaussian
from hitchhike_ros.localization.landmarks import CornerParameters
from hitchhike_ros.localization.motion import carried
from hitchhike_ros.localization.particle_filter import ParticleParameters
from hitchhike_ros.localization.scan_alignment import AlignmentParameters, Count, Sight
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise, check_scan, end_points


@dataclass(frozen=True)
class LocalizerParameters:
    """Section ``localization`` of a robot's parameter file."""

    ekf: EkfParameters = field(default_factory=EkfParameters)
    laser: LaserNoise = field(default_factory=LaserNoise)
    corners: CornerParameters = field(default_factory=CornerParameters)
    alignment: AlignmentParameters = field(default_factory=AlignmentParameters)
    corner_share: UnitInterval = 0.2  # share of a scan's information that its corners carry; the walls carry the rest
    corners_every: Count = 5  # every so many scans; corners take most of the time and add little to walls
    odometry: PoseBufferParameters = field(default_factory=PoseBufferParameters)
    particles: ParticleParameters = field(default_factory=ParticleParameters)


# By this share of the motion between a pose and the first odometry after it that motion is unknown (chosen).
_BRIDGED = 0.3


class Localizer(ABC):
    """One robot's localization in a known map.

    The state is kept at the time of the newest odometry. A scan or an image that was taken earlier is carried to that
    time by the odometry in between, so the order in which messages arrive does not matter.

    The map's own errors are the same in scan after scan and do not average out as the noise of the sensors does.
    Therefore a filter's state is the pose with respect to the walls as they are drawn, and what the errors of the walls
    in the last scan do to it comes on top of the filter's covariance (a considered parameter; Schmidt, 1966).
    """

    def __init__(self, markers: Iterable[Marker], parameters: LocalizerParameters, T_base_laser: Pose2D) -> None:
        self._parameters, self._T_base_laser = parameters, T_base_laser
        self._markers = {m.id: Pose2D(m.x, m.y, m.yaw) for m in markers}
        self._odometry = PoseBuffer(parameters.odometry)
        self._stamp = 0.0
        self._told_at: float | None = None  # since when the estimate has had no odometry
        self._explained: float | None = None
        self._walls: FloatArray = np.zeros((3, 3))

    @property
    @abstractmethod
    def initialised(self) -> bool:
        """Whether there is an estimate."""

    @property
    def estimate(self) -> PoseEstimate:
        """Pose in ``map`` at the time of the newest odometry.

        Raises:
            RuntimeError: before :meth:`initialise`.
        """
        self._check_initialised()
        pose, covariance = self._gaussian()
        return PoseEstimate(self._stamp, pose, covariance + self._walls)

    @property
    def explained(self) -> float | None:
        """Share of the last scan's beams that lie on walls of the map; None where the scan could not be used."""
        return self._explained

    def restart(self) -> None:
        """Forget estimate and odometry but keep the map, for instance after a pause in which the robot was moved."""
        self._odometry.clear()
        self._stamp = 0.0
        self._start_anew()
        self._forget()

    def initialise(self, estimate: PoseEstimate) -> None:
        """Start, or start again, from a pose that is known from elsewhere.

        Raises:
            ValueError: the pose is not finite or the covariance is no covariance.
        """
        covariance = check_gaussian(estimate.pose, estimate.covariance)
        estimate = PoseEstimate(estimate.stamp, estimate.pose, covariance)
        self._start_anew()
        if not self._odometry:
            self._stamp = self._told_at = estimate.stamp
        else:
            # A pose taken a moment ago: the robot has moved on since.
            estimate = self._bridged(estimate, self._odometry.oldest)
            newest = self._odometry.newest.stamp
            stamp = min(max(estimate.stamp, self._odometry.oldest.stamp), newest)
            estimate = carried(estimate, self._odometry.motion(stamp, newest), newest)
        self._begin(estimate.pose, estimate.covariance)

    @property
    def twist(self) -> Twist2D:
        """Of the newest odometry; IndexError where there is none."""
        return self._odometry.newest.twist

    def predict(self, odometry: Odometry) -> None:
        """Move by the difference to the odometry before. A robot that stands keeps its estimate (P18 Eq. 10).

        Raises:
            SensorDataError: the odometry is not finite, runs back in time or has jumped. The estimate stays as it was;
                after a jump, in time or in space, the next odometry counts from this one.
        """
        try:
            motion = self._odometry.add(odometry)
        finally:
            if self._odometry:
                self._stamp = self._odometry.newest.stamp
        if self._told_at is not None and self.initialised:
            started = PoseEstimate(self._told_at, *self._gaussian())
            bridged, self._told_at = self._bridged(started, self._odometry.newest), None
            if bridged is not started:
                self._begin(bridged.pose, bridged.covariance)
        if motion is not None and motion[0] != Twist2D() and self.initialised:
            self._move(*motion)

    def update_scan(self, scan: LaserScan) -> bool:
        """Correct by a scan; False where it shows too little of the map.

        Raises:
            SensorDataError: the scan is senseless, or too old or too new for the odometry. Nothing has changed then.
            RuntimeError: before :meth:`initialise`.
        """
        self._check_initialised()
        check_scan(scan)
        T_now_laser = compose(self._seen_from_now(scan.stamp, "scan"), self._T_base_laser)
        origin = np.array([T_now_laser.x, T_now_laser.y])
        sight = self._correct_by_scan(end_points(scan, T_now_laser), origin)
        self._explained = sight.explained if sight else None
        if sight is None:
            return False
        self._walls = sight.walls
        return True

    def update_markers(self, observations: Iterable[MarkerObservation]) -> int:
        """Correct by markers; those that are not in the map are ignored. Returns how many were used.

        Raises:
            SensorDataError: an observation is not finite, or too old or too new for the odometry.
            RuntimeError: before :meth:`initialise`.
        """
        self._check_initialised()
        used = 0
        for seen in observations:
            if seen.marker_id not in self._markers:
                continue
            if not (seen.pose.is_finite() and np.isfinite(seen.covariance).all()):
                raise SensorDataError(f"marker {seen.marker_id} at {seen.stamp:.2f} s is not finite")
            T_now_then = self._seen_from_now(seen.stamp, "image")
            _, J = compose_jacobians(T_now_then, seen.pose)
            T_now_marker, covariance = compose(T_now_then, seen.pose), J @ seen.covariance @ J.T
            now = MarkerObservation(self._stamp, seen.marker_id, T_now_marker, covariance)
            used += self._correct_by_marker(now, self._markers[seen.marker_id])
        return used

    def estimate_at(self, stamp: float) -> PoseEstimate:
        """The estimate carried by odometry to another time, such as that of a scan.

        Raises:
            SensorDataError: the time is too old or too new for the odometry.
            RuntimeError: before :meth:`initialise`.
        """
        now = self.estimate
        T_now_then = self._seen_from_now(stamp)
        J, _ = compose_jacobians(now.pose, T_now_then)
        return PoseEstimate(stamp, compose(now.pose, T_now_then), J @ now.covariance @ J.T)

    def odometry_at(self, stamp: float) -> Pose2D:
        """Pose in the robot's ``odom`` frame at ``stamp``; raises as :meth:`estimate_at`."""
        return self._odometry.at(stamp)

    def _bridged(self, told: PoseEstimate, first: Odometry) -> PoseEstimate:
        """A pose of a time before all odometry, at the time of the ``first`` reading.

        A localizer that is switched on hears its first reading a moment after its pose was taken. Until then the robot
        went on as it goes now, more or less; after longer than odometry is kept, nothing is said of it.
        """
        dt_s, twist = first.stamp - told.stamp, first.twist
        if not 0.0 < dt_s <= self._parameters.odometry.history_s or twist == Twist2D():
            return told
        here = carried(told, move(Pose2D(), twist, dt_s), first.stamp)
        unknown = np.square([_BRIDGED * twist.v * dt_s, _BRIDGED * twist.v * dt_s, _BRIDGED * twist.omega * dt_s])
        return PoseEstimate(here.stamp, here.pose, here.covariance + np.diag(unknown))

    def _seen_from_now(self, stamp: float, what: str = "time asked for") -> Pose2D:
        """T_now_then: where the robot was at ``stamp``, seen from where it is at the newest odometry.

        Raises:
            SensorDataError: ``what`` was at that time is too old or too new for the odometry.
        """
        then = self._odometry.at(stamp, what)
        return between(self._odometry.newest.pose, then)

    def _start_anew(self) -> None:
        self._explained, self._walls, self._told_at = None, np.zeros((3, 3)), None

    def _check_initialised(self) -> None:
        if not self.initialised:
            raise RuntimeError("the localizer has no estimate before initialise()")

    @abstractmethod
    def _gaussian(self) -> tuple[Pose2D, FloatArray]:
        """Mean and covariance (3, 3) of the estimate."""

    @abstractmethod
    def _forget(self) -> None:
        """Drop the estimate."""

    @abstractmethod
    def _begin(self, pose: Pose2D, covariance: FloatArray) -> None:
        """Start from a Gaussian that has been checked."""

    @abstractmethod
    def _move(self, twist: Twist2D, dt_s: float) -> None:
        """The robot held ``twist`` for ``dt_s`` > 0."""

    @abstractmethod
    def _correct_by_scan(self, ends: EndPoints, origin: FloatArray) -> Sight | None:
        """Correct by end points seen from ``origin`` (2,), both in ``base_footprint``; None if they say too little."""

    @abstractmethod
    def _correct_by_marker(self, seen: MarkerObservation, T_map_marker: Pose2D) -> bool:
        """Correct by a marker of the map as seen now; False when it is outside the gate."""
