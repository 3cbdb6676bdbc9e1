"""A world of rectangles and a robot that moves by kinematics alone, to drive the controllers in tests."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D, Twist2D
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.core.robot_model import RobotLimits

P3DX = RobotLimits(
    wheel_separation_m=0.316,
    wheel_radius_m=0.09,
    front_m=0.21,
    rear_m=0.301,
    half_width_m=0.2125,
    max_speed_mps=1.0,
    max_yaw_rate_rps=1.5,
)
TURTLEBOT = RobotLimits(
    wheel_separation_m=0.23,
    wheel_radius_m=0.035,
    front_m=0.176,
    rear_m=0.176,
    half_width_m=0.176,
    max_speed_mps=0.7,
    max_yaw_rate_rps=math.pi,
    radius_m=0.176,
)
LASER = {P3DX: Pose2D(0.17), TURTLEBOT: Pose2D(0.12)}

Rectangle = tuple[float, float, float, float]  # x, y of the least corner, width, breadth

# P17 Exp. 1 at 0.04 m a pixel: a corridor 2.24 m wide with a side door, a passage across its end, and three boxes.
CORRIDOR: tuple[Rectangle, ...] = (
    (0.0, 4.4, 2.2, 0.2),
    (3.8, 4.4, 20.2, 0.2),
    (0.0, 6.84, 24.0, 0.2),
    (0.8, 0.8, 0.2, 6.2),
    (5.0, 0.8, 0.2, 3.6),
    (0.8, 0.8, 4.4, 0.2),
    (24.0, 6.84, 0.2, 4.2),
    (23.8, 1.0, 0.2, 3.4),
    (26.0, 1.0, 0.2, 10.0),
)
BOXES: tuple[Rectangle, ...] = ((9.24, 6.08, 0.28, 0.16), (12.32, 5.16, 0.40, 0.44), (15.04, 6.00, 0.44, 0.28))


def cast(origin: Pose2D, angles: FloatArray, rectangles: FloatArray) -> FloatArray:
    """Range (N,) of each ray from ``origin`` to the nearest rectangle (M, 4), +inf where there is none."""
    c, s = np.cos(origin.theta + angles)[:, None], np.sin(origin.theta + angles)[:, None]
    low = rectangles[:, :2] - (origin.x, origin.y)
    high = low + rectangles[:, 2:]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        x1, x2, y1, y2 = low[:, 0] / c, high[:, 0] / c, low[:, 1] / s, high[:, 1] / s
    enter = np.maximum(np.minimum(x1, x2), np.minimum(y1, y2))
    leave = np.minimum(np.maximum(x1, x2), np.maximum(y1, y2))
    return np.where((enter <= leave) & (leave > 0), np.maximum(enter, 0.0), np.inf).min(axis=1, initial=np.inf)


def overlaps(limits: RobotLimits, pose: Pose2D, rectangles: FloatArray) -> bool:
    """Whether the footprint at ``pose`` shares a place with any of the rectangles (M, 4)."""
    low, high = rectangles[:, :2], rectangles[:, :2] + rectangles[:, 2:]
    if limits.radius_m is not None:
        gaps = np.maximum(np.maximum(low - (pose.x, pose.y), (pose.x, pose.y) - high), 0.0)
        return bool((np.hypot(gaps[:, 0], gaps[:, 1]) < limits.radius_m).any())
    body = [(x, y) for x in (-limits.rear_m, limits.front_m) for y in (-limits.half_width_m, limits.half_width_m)]
    corners = np.array([(p.x, p.y) for p in (compose(pose, Pose2D(*xy)) for xy in body)])
    apart = (corners.min(axis=0) >= high) | (corners.max(axis=0) <= low)
    # The rectangles' corners on the robot's own axes.
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    theirs = np.stack([np.stack([x, y], axis=1) for x in (low[:, 0], high[:, 0]) for y in (low[:, 1], high[:, 1])])
    own = (theirs - (pose.x, pose.y)) @ np.array([[c, -s], [s, c]])
    apart_own = (own.min(axis=0) >= (limits.front_m, limits.half_width_m)) | (
        own.max(axis=0) <= (-limits.rear_m, -limits.half_width_m)
    )
    return bool((~(apart.any(axis=1) | apart_own.any(axis=1))).any())


@dataclass
class FlatWorld:
    """One robot among rectangles; its wheels follow a command within the acceleration limits, one period late."""

    limits: RobotLimits
    rectangles: tuple[Rectangle, ...]
    pose: Pose2D
    seed: int = 0
    beams: int = 271
    noise_m: float = 0.01
    period_s: float = 0.1
    now: float = 0.0
    twist: Twist2D = field(default_factory=Twist2D)
    touched: bool = False

    def __post_init__(self) -> None:
        self._array = np.array(self.rectangles, dtype=float).reshape(-1, 4)
        self._rng = np.random.default_rng(self.seed)
        self._pending = Twist2D()

    def scan(self) -> LaserScan:
        """270° of range readings to 8 m with noise."""
        increment = math.radians(270.0) / (self.beams - 1)
        angles = -math.radians(135.0) + increment * np.arange(self.beams)
        ranges = cast(compose(self.pose, LASER[self.limits]), angles, self._array)
        ranges = np.maximum(ranges + self._rng.normal(0.0, self.noise_m, ranges.shape), 0.02)
        return LaserScan(self.now, float(angles[0]), increment, 0.02, 8.0, np.where(ranges > 8.0, np.inf, ranges))

    def drive(self, command: Twist2D) -> None:
        """One period under the command before this one."""
        steps = 4
        dt = self.period_s / steps
        for step in range(steps):
            dv, dw = self.limits.max_acceleration_mps2 * dt, self.limits.max_yaw_acceleration_rps2 * dt
            v = self.twist.v + min(max(self._pending.v - self.twist.v, -dv), dv)
            omega = self.twist.omega + min(max(self._pending.omega - self.twist.omega, -dw), dw)
            forward, turn = 0.5 * dt * (self.twist.v + v), 0.5 * dt * (self.twist.omega + omega)
            self.pose = compose(self.pose, Pose2D(forward * math.cos(turn / 2), forward * math.sin(turn / 2), turn))
            self.twist = Twist2D(v, omega)
            if step % 2:
                self.touched |= overlaps(self.limits, self.pose, self._array)
        self._pending = command
        self.now += self.period_s
