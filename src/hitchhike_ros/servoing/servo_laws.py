"""Servo laws: velocities of a unicycle behind a marker, one class each behind :class:`ServoLaw`.

``trail`` drives the driver's track. ``image`` and ``position`` go straight to the marker; they are task functions e of
two components, regulated exactly: with the interaction matrix J of the own velocities (v, omega) and the drift d that
the driver's own motion adds, de/dt = J (v, omega) + d is made -lambda e. Which of them is meant is a parameter.

The planar camera frame is x forward, y left, at the camera; what is in it is in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Twist2D
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.servoing.driver_trail import DriverTrail
from hitchhike_ros.servoing.follow_parameters import FollowParameters

# A marker nearer than this is taken to be this far, where a formula has a pole at the camera (chosen).
_NEAREST_M = 0.1


@dataclass(frozen=True)
class Target:
    """The driver's marker now: place (x, y) and velocity over ground (vx, vy), both in the planar camera frame.

    ``camera_x`` is how far that frame is ahead of the own axle, ``camera_y`` how far to the left of its middle.
    """

    x: float
    y: float
    vx: float = 0.0
    vy: float = 0.0
    camera_x: float = 0.0
    camera_y: float = 0.0

    @property
    def gap(self) -> float:
        """Horizontal distance from camera to marker."""
        return math.hypot(self.x, self.y)

    @property
    def bearing(self) -> float:
        """Direction to the marker; positive to the left."""
        return math.atan2(self.y, self.x)

    @property
    def speed(self) -> float:
        """Speed of the driver over ground."""
        return math.hypot(self.vx, self.vy)


@dataclass(frozen=True, eq=False)
class LawInput:
    """What a law acts upon: own pose and the driver's trail in ``odom``, the target, and the driver's signed speed."""

    own: Pose2D
    trail: DriverTrail
    target: Target
    driver_speed: float


class ServoLaw(Protocol):
    """One way to follow."""

    def velocities(self, view: LawInput, gap_m: float) -> tuple[float, float]:
        """(v, omega) that keep the marker at ``gap_m``, not yet limited."""


class TrailLaw:
    """Pure pursuit along the driver's trail; the speed holds the gap. Boxes that the driver went around are not cut."""

    def __init__(self, params: FollowParameters, limits: RobotLimits) -> None:
        self._params, self._limits = params, limits

    def velocities(self, view: LawInput, gap_m: float) -> tuple[float, float]:
        """As :class:`ServoLaw`."""
        error = view.target.gap - gap_m
        v = view.driver_speed + closing_gain(self._params, self._limits, error) * error
        v = max(0.0, v)
        return v, v * self.curvature(view.own, view.trail)

    def curvature(self, own: Pose2D, trail: DriverTrail) -> float:
        """Curvature in 1/m of the arc to the point of the trail that is aimed at."""
        s = trail.advance(own.x, own.y)
        target = trail.at(s + self._params.lookahead_m)
        dx, dy = target[0] - own.x, target[1] - own.y
        lateral = -math.sin(own.theta) * dx + math.cos(own.theta) * dy
        return 2.0 * lateral / max(dx * dx + dy * dy, 0.04)


class Task(Protocol):
    """A task function e (2,) of the target: across the view, and along it."""

    def error(self, target: Target, gap_m: float) -> FloatArray:
        """e, (2,)."""

    def jacobian(self, target: Target) -> FloatArray:
        """de/d(v, omega), (2, 2): the interaction matrix for a unicycle."""

    def drift(self, target: Target) -> FloatArray:
        """de/dt, (2,), that the driver's motion makes while the follower stands."""


class ImageTask:
    """e = (x, log(Z / Z*)): the marker's normalised image coordinate, positive to the right, and its relative depth.

    Chaumette & Hutchinson, Visual Servo Control I (2006), Eq. 11, for a camera ``camera_x`` ahead of the axle of a
    unicycle and ``camera_y`` beside its middle; the height in the image plays no part, as the camera neither pitches
    nor rolls.
    """

    def error(self, target: Target, gap_m: float) -> FloatArray:
        """As :class:`Task`."""
        Z = max(target.x, _NEAREST_M)
        return np.array([-target.y / Z, math.log(Z / gap_m)])

    def jacobian(self, target: Target) -> FloatArray:
        """As :class:`Task`; its determinant is (1 + camera_x / Z) / Z, never 0 with a camera ahead of the axle."""
        Z = max(target.x, _NEAREST_M)
        x = -target.y / Z
        aside = target.camera_y / Z
        return np.array([[x / Z, 1.0 + x * x + target.camera_x / Z - x * aside], [-1.0 / Z, aside - x]])

    def drift(self, target: Target) -> FloatArray:
        """As :class:`Task`."""
        Z = max(target.x, _NEAREST_M)
        x = -target.y / Z
        return np.array([(-target.vy - x * target.vx) / Z, target.vx / Z])


class PositionTask:
    """e = (-y, x - gap): the marker's place in the camera frame, off the place straight ahead at the gap."""

    def error(self, target: Target, gap_m: float) -> FloatArray:
        """As :class:`Task`."""
        return np.array([-target.y, target.x - gap_m])

    def jacobian(self, target: Target) -> FloatArray:
        """As :class:`Task`; its determinant is x + camera_x."""
        return np.array([[0.0, max(target.x, _NEAREST_M) + target.camera_x], [-1.0, target.y + target.camera_y]])

    def drift(self, target: Target) -> FloatArray:
        """As :class:`Task`."""
        return np.array([-target.vy, target.vx])


class TaskLaw:
    """Regulates a task function: (v, omega) = J^-1 (-lambda e - d)."""

    def __init__(self, task: Task, params: FollowParameters, limits: RobotLimits) -> None:
        self._task, self._params, self._limits = task, params, limits

    def velocities(self, view: LawInput, gap_m: float) -> tuple[float, float]:
        """As :class:`ServoLaw`."""
        target = view.target
        gains = (self._params.bearing_gain, closing_gain(self._params, self._limits, target.x - gap_m))
        wanted = -np.array(gains) * self._task.error(target, gap_m) - self._task.drift(target)
        v, omega = np.linalg.solve(self._task.jacobian(target), wanted)
        return max(0.0, float(v)), float(omega)  # it sees nothing behind itself


def make_law(params: FollowParameters, limits: RobotLimits) -> ServoLaw:
    """The law that the parameters name."""
    if params.law == "trail":
        return TrailLaw(params, limits)
    return TaskLaw(ImageTask() if params.law == "image" else PositionTask(), params, limits)


def closing_gain(params: FollowParameters, limits: RobotLimits, error: float) -> float:
    """1/s for a gap error in m: closes no faster than half the own acceleration brakes, as the driver may brake too."""
    if error <= 0.0:
        return params.gap_gain
    return min(params.gap_gain, math.sqrt(limits.max_acceleration_mps2 / error))


def saturate(v: float, omega: float, max_v: float, max_omega: float) -> Twist2D:
    """Scale both together, which keeps the curvature of the motion."""
    scale = max(1.0, abs(v) / max_v, abs(omega) / max_omega)
    return Twist2D(v / scale, omega / scale)
