"""Who rides behind a marker does not run into what comes between: commands from which the robot could not brake are
slowed down. Obstacle avoidance is off during a ride (P17 Table 3); this looks at no map and plans nothing (chosen)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchhike_ros.control.clearance import ClearanceField, Footprint
from hitchhike_ros.control.dynamic_window import brake, roll_out
from hitchhike_ros.control.near_beams import NearBeams
from hitchhike_ros.control.obstacle_memory import scan_points
from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Pose2D, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.laser import ScanParameters, check_scan

# For so long after a scan the next one is awaited: of a laser at 5 Hz one may come late, and the robot is told to stop
# within half a second of the last one. However it arrived, a scan that was taken longer ago says nothing. Between scan
# and command pass so many seconds (all chosen).
SILENCE_S, MAX_AGE_S, _REACTION_S = 0.35, 0.6, 0.2
# So near it comes on purpose (chosen); a field of distances is right to half a cell, 2.5 cm, and so is where it stands.
_MARGIN_M, _GRID_M = 0.06, 0.05
_SHARES = (1.0, 0.75, 0.5, 0.25)
# The wheels brake harder than they speed up: velocity_mux lets them (chosen: what every base of the package can do).
_BRAKING = 2.0


class SafetyLimiter:
    """Keeps the newest scan and limits commands by it; without a fresh scan it lets nothing pass."""

    def __init__(
        self,
        limits: RobotLimits,
        T_base_laser: Pose2D,
        scan_params: ScanParameters | None = None,
        *,
        upside_down: bool = False,
    ) -> None:
        self._limits, self._T_base_laser, self._upside_down = limits, T_base_laser, upside_down
        self._scan_params = scan_params or ScanParameters()
        self._problem = ""  # of the newest scan
        self._arrived = -math.inf
        self._near = NearBeams()
        self.bad_share = 0.0  # of the newest scan's beams
        self._braking = replace(
            limits,
            max_acceleration_mps2=_BRAKING * limits.max_acceleration_mps2,
            max_yaw_acceleration_rps2=_BRAKING * limits.max_yaw_acceleration_rps2,
        )
        self._footprint = Footprint(limits)
        self._apart_m = limits.circumscribed_m + _MARGIN_M + _GRID_M
        self._mount_m = math.hypot(T_base_laser.x, T_base_laser.y)
        self._scan: LaserScan | None = None
        self._nearest_m = math.inf  # its shortest beam
        self._points: FloatArray | None = None  # (N, 2) of the newest scan in the base frame, once they are needed,
        self._field: ClearanceField | None = None  # and how far from them everything is

    def see(self, scan: LaserScan, now: float) -> bool:
        """Take in the newest scan, which arrives at ``now``; False where it cannot be used, which counts as none."""
        scan = scan.mirrored() if self._upside_down else scan
        self.bad_share = scan.bad_share()
        try:
            check_scan(scan, self._scan_params.max_bad_share)
        except SensorDataError as exc:
            self.refuse(str(exc))
            return False
        self._scan, self._points, self._field, self._problem = self._near.fill(scan), None, None, ""
        self._arrived = now
        self._nearest_m = float(np.fmin.reduce(self._scan.ranges, initial=math.inf))
        return True

    def refuse(self, problem: str) -> None:
        """The newest scan is none; ``problem`` says why, and which value was expected."""
        self._scan, self._points, self._field, self._problem = None, None, None, problem

    def forget(self) -> None:
        """What was seen before a pause says nothing about now."""
        self.refuse("no scan yet")
        self._near.clear()
        self.bad_share = 0.0

    def expires(self) -> float:
        """When the newest scan becomes too old, s; minus infinity without one."""
        if self._scan is None:
            return -math.inf
        return min(self._arrived + SILENCE_S, self._scan.stamp + MAX_AGE_S)

    def problem(self, now: float) -> str:
        """Why nothing passes at ``now``; empty: there is a fresh scan."""
        if self._scan is None:
            return self._problem or "no scan yet"
        silent, age = now - self._arrived, now - self._scan.stamp
        if min(silent, age) < -SILENCE_S:
            return f"scan: stamp is {-min(silent, age):.1f} s ahead, expected the past"
        if silent >= SILENCE_S:
            return f"no scan for {silent:.1f} s"
        return f"scan is {age:.1f} s old, expected less than {MAX_AGE_S} s" if now >= self.expires() else ""

    def limit(self, now: float, twist: Twist2D) -> tuple[Twist2D, bool]:
        """``twist`` scaled down until the robot can brake before contact, and whether that was needed.

        Nearer than the margin to something, what comes no closer is still allowed. Without a fresh scan the robot
        stands; :meth:`problem` says why.
        """
        if twist == Twist2D():
            return twist, False
        if self._scan is None or self.problem(now):
            return Twist2D(), True
        travel, apart = self._way(twist)
        if self._nearest_m > self._mount_m + travel + apart:  # as a rule, and nothing more is to be computed
            return twist, False
        if self._points is None:
            self._points = transform_points(self._T_base_laser, scan_points(self._scan))
        if _are_beside(self._points, math.copysign(travel, twist.v), apart):
            return twist, False
        if self._field is None:
            self._field = ClearanceField(self._points)
        clearance = float(self._field.clearance(self._footprint, np.zeros(3)))
        floor = min(_MARGIN_M, clearance - 0.005)
        velocity = np.array([twist.v, twist.omega])
        share = next((share for share in _SHARES if self._stops_clear(self._field, share * velocity, floor)), 0.0)
        return Twist2D(share * twist.v, share * twist.omega), share < 1.0

    def _way(self, twist: Twist2D) -> tuple[float, float]:
        """How far straight on the robot may come until it stands, and how near to that what it could touch is, m:
        whichever way it turns, and however it leaves the straight way aside."""
        braking = self._braking
        travel = abs(twist.v) * _REACTION_S + twist.v**2 / (2.0 * braking.max_acceleration_mps2)
        turn = abs(twist.omega) * _REACTION_S + twist.omega**2 / (2.0 * braking.max_yaw_acceleration_rps2)
        return travel, self._apart_m + travel * min(turn, 1.0)

    def _stops_clear(self, field: ClearanceField, velocity: FloatArray, floor: float) -> bool:
        """Whether a robot that drives at ``velocity`` (2,) can brake to a stand and stay ``floor`` m clear."""
        times = np.array([0.5, 1.0]) * _REACTION_S
        committed, velocities = roll_out(Twist2D(*velocity.tolist()), velocity[None], self._braking, times)
        stopping = brake(committed[:, -1], velocities[:, -1], self._braking, 6)
        poses = np.concatenate([committed, stopping], axis=1)
        return float(field.clearance(self._footprint, poses).min()) >= floor


def _are_beside(points: FloatArray, travel: float, apart: float) -> bool:
    """Whether points (N, 2) are all farther than ``apart`` m from the way from the origin to (travel, 0)."""
    x, y = math.copysign(1.0, travel) * points[:, 0], points[:, 1]
    past = x - np.minimum(np.maximum(x, 0.0), abs(travel))  # the ends of the way
    return float((past * past + y * y).min(initial=math.inf)) > apart**2
