"""Parameters of following a driver, section ``follow``; all values are chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hitchhike_ros.core.datatypes import Positive

LawName = Literal["trail", "image", "position"]


@dataclass(frozen=True)
class FollowParameters:
    """Section ``follow``; all values are chosen."""

    law: LawName = "trail"
    """``trail`` drives the driver's track; ``image`` and ``position`` drive straight to the marker."""
    gap_gain: Positive = 1.2
    """Closing speed for each metre of gap error, 1/s."""
    bearing_gain: Positive = 2.0
    """How fast ``image`` and ``position`` bring the marker to the middle of the view, 1/s."""
    lookahead_m: Positive = 0.5
    """Pure pursuit aims at the point of the trail this far ahead."""
    max_bearing_rad: Positive = 0.35
    """The heading keeps the marker's bearing within this; half the view is 0.52, half a marker at 0.8 m 0.1."""
    view_gain: Positive = 3.0
    """How fast the bearing may approach that limit, 1/s."""
    max_yaw_rate_rps: Positive = 1.2
    lost_timeout_s: Positive = 0.5
    """Without an observation for longer than this the driver counts as out of sight, and the search begins."""
    coast_s: Positive = 2.0
    """A robot that coasts along the trail has slowed down to a stand after so long."""
    coast_stop_m: Positive = 0.35
    """So far short of where the marker was seen last the camera stops: the driver may be standing there."""
    look_s: Positive = 1.5
    """How long it looks to where the marker was covered before it turns."""
    search_angle_rad: Positive = 0.9
    """How far it turns to either side; the camera sees another 0.4 rad."""
    search_yaw_rate_rps: Positive = 0.8
    search_timeout_s: Positive = 8.0
    """For turning to both sides and back."""
    odometry_timeout_s: Positive = 0.4
    trail_step_m: Positive = 0.03
    """Distance of the trail's points."""
    driver_acceleration_mps2: Positive = 1.2
    """Standard deviation of the driver's acceleration, for the estimate of its speed."""
    driver_yaw_rate_rps: Positive = 0.5
    """Standard deviation of the driver's yaw rate, for the estimate of its heading."""
    feed_forward_sigma_mps: Positive = 0.3
    """Trust in the speed that the driver tells, when it tells it; older, it counts less."""
