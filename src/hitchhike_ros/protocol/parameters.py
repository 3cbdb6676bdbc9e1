"""Parameters of hitchhiking, section ``hitchhiking`` of a robot's file. Symbols of the papers stand beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hitchhike_ros.datatypes import FloatArray, NonNegative, Positive
from hitchhike_ros.protocol.messages import Priority, Profile

TIME_CRITICAL_PRIORITY = 16  # P18 §2.1: 16-20 neither gives nor takes a ride


@dataclass(frozen=True)
class HitchhikingParameters:
    """What one robot offers, asks for and waits for. Values without a symbol of the papers are chosen."""

    profile: Profile = 50.0  # P, score of sensors, odometry and SLAM
    priority: Priority = 10  # T, 16-20 is time critical
    may_ride: bool = True
    may_drive: bool = True

    max_wait_s: Positive = 60.0  # T_hwait
    max_align_s: Positive = 30.0  # T_align
    max_couple_s: Positive = 20.0  # T_coupling
    min_ride_m: Positive = 20.0  # T_dhh
    update_period_s: Positive = 0.5  # δ
    award_rate: NonNegative = 0.4  # κ, points per metre

    beacon_period_s: Positive = 1.0
    request_period_s: Positive = 1.0
    repeat_period_s: Positive = 0.5  # of whatever is not yet acknowledged
    confirm_timeout_s: Positive = 3.0  # of an offer or a lock
    ack_timeout_s: Positive = 1.5  # the driver stops when acknowledgements are missing for so long
    lost_timeout_s: Positive = 40.0  # T_lost: then the driver goes on without its rider
    message_timeout_s: Positive = 5.0  # the rider gives up when the driver says nothing for so long
    seek_timeout_s: Positive = 8.0  # for finding the marker again by coasting and turning
    catch_up_timeout_s: Positive = 20.0  # for driving up behind a driver that waits
    look_s: Positive = 2.0  # for seeing its marker from a place behind it
    part_s: Positive = 6.0  # the rider stands so long when a ride breaks off, while the driver goes
    decouple_timeout_s: Positive = 10.0
    settle_timeout_s: Positive = 3.0  # for standing still before the relative pose is taken
    localize_timeout_s: Positive = 5.0
    stuck_timeout_s: Positive = 30.0  # navigation that is blocked for so long has failed
    planner_patience_s: Positive = 5.0  # or that has no path for so long; the name and value are move_base's
    robot_timeout_s: Positive = 3.0  # another robot is forgotten when it says nothing for so long

    gap_m: Positive = 0.8  # d2, camera to marker
    gap_tolerance_m: Positive = 0.10
    standstill_mps: Positive = 0.02
    cruise_speed_mps: Positive = 0.6
    ride_speed_mps: Positive = 0.5
    overlap_tolerance_m: Positive = 0.3  # two plans that go the same way rarely share their cells
    handover: Literal["paper", "measured"] = "measured"
    mounting_sigma_m: NonNegative = 0.001  # how well one knows where camera and plate are mounted (chosen)
    mounting_sigma_rad: NonNegative = 0.002
    marker_id: int = 0  # on the own back
    marker_size_m: Positive = 0.16

    @property
    def mounting(self) -> FloatArray:
        """Covariance (3, 3) in (x, y, theta) of where a plate is mounted."""
        return np.diag(np.square([self.mounting_sigma_m, self.mounting_sigma_m, self.mounting_sigma_rad]))
