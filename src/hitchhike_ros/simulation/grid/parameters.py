"""What is the same for all robots of the grid simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import NonNegative, Pose2D, Positive


@dataclass(frozen=True)
class GridWorldParameters:
    """All values are chosen, where the papers name none."""

    radius_m: Positive = 0.2
    margin_m: NonNegative = 0.05  # free room beside a robot under way
    clearance_weight: NonNegative = 0.0  # above 0, paths keep to the middle of passages
    perception_m: Positive = 3.0  # new boxes are seen from so far
    position_sigma_m: NonNegative = 0.02  # noise and covariance of what localization says
    heading_sigma_rad: NonNegative = 0.01
    camera_x_m: float = 0.15
    camera_range_m: Positive = 4.0
    camera_nearest_m: NonNegative = 0.2
    camera_view_rad: Positive = 1.05
    marker_view_rad: Positive = 1.3  # a marker seen from farther to the side is not read
    marker_x_m: float = -0.2  # the rear marker, which faces backwards
    marker_sigma_m: NonNegative = 0.005
    marker_sigma_rad: NonNegative = 0.01
    # A follower that lags behind catches up by this much faster than rides are driven.
    follow_factor: Positive = 1.3
    # Positions for the radio are not older than this; 0: they are those of now.
    radio_refresh_s: NonNegative = 0.0
    json_messages: bool = True  # as text through the robots' inboxes, or as objects past them
    trace_events: int = 500  # so many of the last events are kept
    seed: int = 0

    @property
    def marker_pose(self) -> Pose2D:
        return Pose2D(self.marker_x_m, 0.0, math.pi)
