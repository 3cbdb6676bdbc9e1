"""What drives through the corridor of P17 Experiment 1 share: its boxes, a marker on its wall, the wheels' readings."""

from __future__ import annotations

import math

from hitchhike_ros.core.datatypes import Marker, Obstacle, Odometry, Pose2D, Twist2D

BOXES = [
    Obstacle("obs1", 9.24, 6.08, 0.28, 0.16),
    Obstacle("obs2", 12.32, 5.16, 0.40, 0.44),
    Obstacle("obs3", 15.04, 6.00, 0.44, 0.28),
]
MARKER = Marker(id=10, x=5.2, y=6.62, z=0.34, yaw=math.pi)


def odometry(stamp: float, x: float = 0.0, y: float = 0.0, theta: float = 0.0, v: float = 0.0) -> Odometry:
    return Odometry(stamp, Pose2D(x, y, theta), Twist2D(v, 0.0))
