"""How a follower searches for a driver that is out of sight: it coasts along the trail, turns, and gives up.

    coasting   along the trail, ever slower, to a stand short of where the marker was last
    looking    standing: a marker that was covered straight ahead comes back where it was
    turning    towards the side on which it left the view, then over to the other side, and back
    lost       standing, until the marker is seen again

Every step has a bound in time; coasting has one in metres too. All is chosen; the papers give up at once (P17 §4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.servoing.driver_trail import DriverTrail
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.servo_laws import TrailLaw, saturate

SearchState = Literal["coasting", "looking", "turning", "lost"]

# Slower than this a coasting robot stands; a turn this near to its end has ended (chosen).
_STANDING_MPS, _TURNED_RAD = 0.03, 0.03
# A marker within the first of straight ahead, on a driver that had turned off by less than the second, did not leave
# to a side (chosen).
_AHEAD_RAD, _STRAIGHT_RAD = 0.15, 0.30


@dataclass(frozen=True)
class Departure:
    """The driver when it was seen last: own speed then, bearing of the marker, and how much the driver has turned off
    the own heading, both in rad, positive to the left."""

    speed_mps: float
    bearing_rad: float
    turned_rad: float

    @property
    def side(self) -> float:
        """+1: it left to the left, -1 to the right, 0: straight ahead."""
        if abs(self.bearing_rad) > _AHEAD_RAD:
            return math.copysign(1.0, self.bearing_rad)
        return math.copysign(1.0, self.turned_rad) if abs(self.turned_rad) > _STRAIGHT_RAD else 0.0


class DriverSearch:
    """One search, from the moment that the driver counts as out of sight; stepped with the own pose in ``odom``."""

    def __init__(self, params: FollowParameters, limits: RobotLimits, departure: Departure, now: float) -> None:
        self._params, self._departure = params, departure
        self._pursuit = TrailLaw(params, limits)
        self._deceleration = limits.max_acceleration_mps2
        self._max_omega = min(params.max_yaw_rate_rps, limits.max_yaw_rate_rps)
        self._began = now
        self._state: SearchState = "coasting"
        self._entered = now
        self._heading: float | None = None
        side = departure.side or 1.0
        self._sweep = [side * params.search_angle_rad, -side * params.search_angle_rad, 0.0]

    def step(self, now: float, own: Pose2D, trail: DriverTrail, coast_m: float) -> tuple[Twist2D, SearchState]:
        """The command, and the step that the search is at; ``coast_m`` of the trail may still be driven."""
        p = self._params
        if self._state == "coasting":
            fade = 1.0 - (now - self._began) / p.coast_s
            v = min(self._departure.speed_mps * fade, math.sqrt(2.0 * self._deceleration * max(coast_m, 0.0)))
            if v > _STANDING_MPS:
                return saturate(v, v * self._pursuit.curvature(own, trail), v, self._max_omega), "coasting"
            self._go("turning" if self._departure.side else "looking", now)
        if self._state == "looking" and now - self._entered > p.look_s:
            self._go("turning", now)
        if self._state == "turning":
            omega = self._turn(own)
            if omega != 0.0 and now - self._entered <= p.search_timeout_s:
                return Twist2D(0.0, omega), "turning"
            self._go("lost", now)
        return Twist2D(), self._state

    def _turn(self, own: Pose2D) -> float:
        """Yaw rate towards the next heading of the sweep; 0 at its end."""
        p = self._params
        if self._heading is None:
            self._heading = own.theta
        while self._sweep:
            error = wrap_angle(self._heading + self._sweep[0] - own.theta)
            if abs(error) > _TURNED_RAD:
                rate = min(p.search_yaw_rate_rps, self._max_omega, 2.5 * abs(error) + 0.05)
                return math.copysign(rate, error)
            self._sweep.pop(0)
        return 0.0

    def _go(self, state: SearchState, now: float) -> None:
        self._state, self._entered = state, now
