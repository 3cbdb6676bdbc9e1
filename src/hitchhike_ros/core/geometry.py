"""SE(2) and SE(3) in the notation ``T_a_b``: coordinates in b become coordinates in a."""

from __future__ import annotations

import math

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D, Twist2D


def wrap_angle(angle: float) -> float:
    """The same direction in (-pi, pi]."""
    wrapped = math.remainder(angle, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles: FloatArray) -> FloatArray:
    """As :func:`wrap_angle`, for an array of any shape."""
    return -((np.pi - np.asarray(angles, dtype=float)) % (2.0 * np.pi) - np.pi)


def compose(T_a_b: Pose2D, T_b_c: Pose2D) -> Pose2D:
    """T_a_c = T_a_b @ T_b_c, theta wrapped."""
    c, s = math.cos(T_a_b.theta), math.sin(T_a_b.theta)
    return Pose2D(
        T_a_b.x + c * T_b_c.x - s * T_b_c.y,
        T_a_b.y + s * T_b_c.x + c * T_b_c.y,
        wrap_angle(T_a_b.theta + T_b_c.theta),
    )


def inverse(T_a_b: Pose2D) -> Pose2D:
    """T_b_a."""
    c, s = math.cos(T_a_b.theta), math.sin(T_a_b.theta)
    return Pose2D(-c * T_a_b.x - s * T_a_b.y, s * T_a_b.x - c * T_a_b.y, wrap_angle(-T_a_b.theta))


def between(T_a_b: Pose2D, T_a_c: Pose2D) -> Pose2D:
    """T_b_c."""
    return compose(inverse(T_a_b), T_a_c)


def distance(a: Pose2D, b: Pose2D) -> float:
    """Distance of two positions in m."""
    return math.hypot(a.x - b.x, a.y - b.y)


def move(pose: Pose2D, twist: Twist2D, dt_s: float) -> Pose2D:
    """The pose after ``twist`` was held for ``dt_s``: an arc, continuous at omega = 0 (P18 Eq. 11)."""
    s, c, _, _ = arc(twist.omega * dt_s)
    return compose(pose, Pose2D(twist.v * dt_s * s, twist.v * dt_s * c, twist.omega * dt_s))


def twist_between(before: Pose2D, after: Pose2D, dt_s: float) -> Twist2D:
    """The twist whose arc leads from one odometry pose to the next within ``dt_s`` > 0; it undoes :func:`move`.

    Where no single arc joins the two (the wheels changed speed in between), the arc has the turn of the two poses and
    the length of the chord's projection on it.
    """
    step = between(before, after)
    s, c, _, _ = arc(step.theta)
    return Twist2D((step.x * s + step.y * c) / (s * s + c * c) / dt_s, step.theta / dt_s)


def interpolate(T_a_b: Pose2D, T_a_c: Pose2D, share: float) -> Pose2D:
    """The pose at a ``share`` of the way from b to c at a constant velocity in the body's frame (a planar screw).

    0 gives b and 1 gives c; less or more carries the motion on to either side. A differential drive at a constant
    twist moves exactly so; a pose that also slides sideways is joined without a jump.

    >>> interpolate(Pose2D(), Pose2D(1.0, 1.0, math.pi / 2), 0.5)  # a quarter of a circle about (0, 1)
    Pose2D(x=0.707..., y=0.292..., theta=0.785...)
    """
    step = between(T_a_b, T_a_c)
    s, c, _, _ = arc(step.theta)
    along, across = (step.x * s + step.y * c) / (s * s + c * c), (step.y * s - step.x * c) / (s * s + c * c)
    turn = share * step.theta
    s, c, _, _ = arc(turn)
    return compose(T_a_b, Pose2D(share * (along * s - across * c), share * (along * c + across * s), turn))


def arc(turn: float) -> tuple[float, float, float, float]:
    """sin(b)/b and (1 - cos b)/b of a ``turn`` b in rad, then their derivatives by b; continuous at b = 0.

    A robot that drives an arc of length l and turns by b comes to l sin(b)/b ahead and l (1 - cos b)/b to the left.
    """
    if abs(turn) < 1e-2:
        b2 = turn * turn
        return (
            1.0 - b2 / 6.0 + b2 * b2 / 120.0,
            turn * (0.5 - b2 / 24.0 + b2 * b2 / 720.0),
            turn * (-1.0 / 3.0 + b2 / 30.0),
            0.5 - b2 / 8.0 + b2 * b2 / 144.0,
        )
    sin, cos = math.sin(turn), math.cos(turn)
    s, c = sin / turn, (1.0 - cos) / turn
    return s, c, (cos - s) / turn, (sin - c) / turn


def transform_points(T_a_b: Pose2D, points_b: FloatArray) -> FloatArray:
    """Points (N, 2) in b as points (N, 2) in a."""
    c, s = math.cos(T_a_b.theta), math.sin(T_a_b.theta)
    return points_b @ np.array([[c, s], [-s, c]]) + np.array([T_a_b.x, T_a_b.y])


def compose_jacobians(T_a_b: Pose2D, T_b_c: Pose2D) -> tuple[FloatArray, FloatArray]:
    """d(T_a_c)/d(T_a_b) and d(T_a_c)/d(T_b_c), both (3, 3) in (x, y, theta)."""
    c, s = math.cos(T_a_b.theta), math.sin(T_a_b.theta)
    J_ab = np.array([[1.0, 0.0, -s * T_b_c.x - c * T_b_c.y], [0.0, 1.0, c * T_b_c.x - s * T_b_c.y], [0.0, 0.0, 1.0]])
    J_bc = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return J_ab, J_bc


def inverse_jacobian(T_a_b: Pose2D) -> FloatArray:
    """d(T_b_a)/d(T_a_b), (3, 3) in (x, y, theta)."""
    c, s = math.cos(T_a_b.theta), math.sin(T_a_b.theta)
    x, y = T_a_b.x, T_a_b.y
    return np.array([[-c, -s, s * x - c * y], [s, -c, c * x + s * y], [0.0, 0.0, -1.0]])


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """R (3, 3) of fixed-axis roll, pitch, yaw, as in URDF."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def matrix_from_xyz_rpy(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> FloatArray:
    """Homogeneous T (4, 4) of a URDF origin."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_rpy(*rpy)
    T[:3, 3] = xyz
    return T


def pose_from_matrix(T: FloatArray) -> Pose2D:
    """Planar part of T (4, 4): x, y and the yaw of its x axis."""
    return Pose2D(float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0]))


def path_length(points: FloatArray) -> float:
    """Length in m of the polyline through points (N, 2)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()) if len(points) > 1 else 0.0


def point_in_polygon(x: float, y: float, polygon: tuple[tuple[float, float], ...]) -> bool:
    """Whether (x, y) is inside the simple polygon (even-odd rule)."""
    inside = False
    for (x1, y1), (x2, y2) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if (y1 > y) != (y2 > y) and x < (x2 - x1) * (y - y1) / (y2 - y1) + x1:
            inside = not inside
    return inside


def nearest_in_box(x: float, y: float, box: Obstacle) -> tuple[float, float]:
    """The point of the box that is nearest to (x, y): (x, y) itself where that is inside."""
    return min(max(x, box.x), box.x + box.w), min(max(y, box.y), box.y + box.b)


def distance_to_box(x: float, y: float, box: Obstacle) -> float:
    """Distance in m of the point (x, y) to the box; 0 inside."""
    return math.dist((x, y), nearest_in_box(x, y, box))
