"""Who rides behind a marker does not run into what comes between: commands from which the robot could not brake are
slowed down. Obstacle avoidance is off during a ride (P17 Table 3); this looks at no map and plans nothing (chosen)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchhike_ros.control.clearance import ClearanceField, Footprint
from hitchhike_ros.control.dynamic_window import brake, roll_out
from hitchhike_ros.control.obstacle_memory import scan_points
from hitchhike_ros.datatypes import FloatArray, LaserScan, Pose2D, Twist2D
from hitchhike_ros.errors import SensorDataError
from hitchhike_ros.geometry import transform_points
from hitchhike_ros.robot_model import RobotLimits

# A scan older than this says nothing; between scan and command pass so many seconds (chosen).
_MAX_AGE_S, _REACTION_S = 0.5, 0.2
# So near it comes on purpose; a field of distances is right to 2.5 cm (chosen).
_MARGIN_M = 0.06
_MAX_NAN_FRACTION = 0.1
_SHARES = np.array([1.0, 0.75, 0.5, 0.25])
# The wheels brake harder than they speed up: velocity_mux lets them (chosen: what every base of the package can do).
_BRAKING = 2.0


class Guard:
    """Keeps the newest scan and limits commands by it; without a fresh scan it lets everything pass."""

    def __init__(self, limits: RobotLimits, T_base_laser: Pose2D) -> None:
        self._limits, self._T_base_laser = limits, T_base_laser
        self._braking = replace(
            limits,
            max_acceleration_mps2=_BRAKING * limits.max_acceleration_mps2,
            max_yaw_acceleration_rps2=_BRAKING * limits.max_yaw_acceleration_rps2,
        )
        self._footprint = Footprint(limits)
        self._field: ClearanceField | None = None
        self._stamp = -math.inf

    def see(self, scan: LaserScan) -> None:
        """The newest scan; one that cannot be used counts as none."""
        try:
            points = scan_points(scan, _MAX_NAN_FRACTION)
        except SensorDataError:
            self._field = None
            return
        self._field, self._stamp = ClearanceField(transform_points(self._T_base_laser, points)), scan.stamp

    def limit(self, now: float, twist: Twist2D) -> tuple[Twist2D, bool]:
        """``twist`` scaled down until the robot can brake before contact, and whether that was needed.

        Nearer than the margin to something, what comes no closer is still allowed.
        """
        if self._field is None or not now - self._stamp <= _MAX_AGE_S or twist == Twist2D():
            return twist, False
        clearance = float(self._field.clearance(self._footprint, np.zeros(3)))
        floor = min(_MARGIN_M, clearance - 0.005)
        targets = _SHARES[:, None] * np.array([twist.v, twist.omega])
        safe = np.flatnonzero([self._stops_clear(self._field, target, floor) for target in targets])
        share = float(_SHARES[safe[0]]) if len(safe) else 0.0
        return Twist2D(share * twist.v, share * twist.omega), share < 1.0

    def _stops_clear(self, field: ClearanceField, velocity: FloatArray, floor: float) -> bool:
        """Whether a robot that drives at ``velocity`` (2,) can brake to a stand and stay ``floor`` m clear."""
        times = np.array([0.5, 1.0]) * _REACTION_S
        committed, velocities = roll_out(Twist2D(*velocity.tolist()), velocity[None], self._braking, times)
        stopping = brake(committed[:, -1], velocities[:, -1], self._braking, 6)
        poses = np.concatenate([committed, stopping], axis=1)
        return float(field.clearance(self._footprint, poses).min()) >= floor
