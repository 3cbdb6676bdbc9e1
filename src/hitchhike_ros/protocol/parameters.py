"""Parameters of hitchhiking, section ``hitchhiking`` of a robot's file. Symbols of the papers stand beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal, Self

import msgspec
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, NonNegative, Positive
from hitchhike_ros.protocol.messages import Priority, Profile

TIME_CRITICAL_PRIORITY = 16  # P18 §2.1: 16-20 neither gives nor takes a ride
USUAL_PRIORITY = 10

Mode = Literal["local", "network"]
Policy = Literal["profile", "proximity", "arrival"]


@dataclass(frozen=True)
class HitchhikingParameters:
    """What one robot offers, asks for and waits for. Values without a symbol of the papers are chosen."""

    profile: Profile = 50.0  # P, score of sensors, odometry and SLAM
    priority: Priority = 10  # T, 16-20 is time critical
    may_ride: bool = True
    may_drive: bool = True
    watch_markers: bool = False  # with the camera also while it drives by itself, for its localization

    mode: Mode = "local"  # P17: first come first served at a hitchhiking point; network: P18, from afar
    policy: Policy = "profile"  # by which a hitchhiker chooses its driver in a network
    places: Annotated[int, msgspec.Meta(ge=1, le=20)] = 1  # hitchhikers behind one another
    role_reversal: bool = True  # in a network: asked by a better profile, ask it for a ride instead

    max_wait_s: Positive = 60.0  # T_hwait
    max_align_s: Positive = 30.0  # T_align
    max_couple_s: Positive = 20.0  # T_coupling
    min_ride_m: Positive = 20.0  # T_dhh
    update_period_s: Positive = 0.5  # δ
    award_rate: NonNegative = 0.4  # κ, points per metre

    offer_window_s: Positive = 3.0  # in a network, for offers to come in
    max_asks: Annotated[int, msgspec.Meta(ge=1)] = 8  # rides asked for on the way to one goal
    board_anywhere: bool = False  # in a network: at any place of the driver's path, not at hitchhiking points alone
    couple_s: NonNegative = 6.0  # what an itinerary counts for coupling
    decouple_s: NonNegative = 3.0

    exact_goal: bool = False  # one that another robot stands on is not reached before it, but waited for
    exact_goal_wait_s: Positive = 60.0  # and given up after so long

    # While nothing arrives it looks so often what its modules say: that it is at its goal, or sees its driver.
    look_period_s: Positive = 0.1
    idle_look_period_s: Positive = 0.2  # without a goal, and while it asks: all else arrives or is a deadline
    riding_look_period_s: Positive = 0.3  # while it follows steadily; when servoing no longer does, that arrives

    beacon_period_s: Positive = 1.0
    request_period_s: Positive = 1.0
    repeat_period_s: Positive = 0.5  # of whatever is not yet acknowledged
    confirm_timeout_s: Positive = 3.0  # of an offer or a lock
    ack_timeout_s: Positive = 1.5  # the driver stops when acknowledgements are missing for so long
    lost_timeout_s: Positive = 40.0  # T_lost: then the driver goes on without its rider
    contact_timeout_s: Positive = 15.0  # who is on the way to the other and hears nothing for so long gives up
    message_timeout_s: Positive = 5.0  # the rider gives up when the driver says nothing for so long
    seek_timeout_s: Positive = 8.0  # for finding the marker again by coasting and turning
    catch_up_timeout_s: Positive = 20.0  # for driving up behind a driver that waits
    look_s: Positive = 2.0  # for seeing its marker from a place behind it
    part_s: Positive = 6.0  # the rider stands so long when a ride breaks off, while the driver goes
    decouple_timeout_s: Positive = 10.0
    settle_timeout_s: Positive = 3.0  # for standing still before the relative pose is taken
    localize_timeout_s: Positive = 5.0
    stuck_timeout_s: Positive = 30.0  # navigation that was blocked for so long since it last came nearer has failed
    progress_timeout_s: Positive = 120.0  # and one that came no nearer to its goal for so long, whatever it says
    planner_patience_s: Positive = 5.0  # or that has no path for so long; the name and value are move_base's
    robot_timeout_s: Positive = 3.0  # another robot is forgotten when it says nothing for so long

    gap_m: Positive = 0.8  # d2, camera to marker
    gap_tolerance_m: Positive = 0.10
    standstill_mps: Positive = 0.02
    standstill_rps: Positive = 0.05  # at 0.5 s between messages, 1.4 degrees
    cruise_speed_mps: Positive = 0.6
    ride_speed_mps: Positive = 0.6
    safe_speed_mps: Positive = 1.0  # most of a driver towards a hitchhiker (velocity tuning, P18 §8.1.3), if it can
    overlap_tolerance_m: Positive = 0.3  # two plans that go the same way rarely share their cells
    handover: Literal["paper", "measured"] = "measured"
    mounting_sigma_m: NonNegative = 0.001  # how well one knows where camera and rear marker are mounted (chosen)
    mounting_sigma_rad: NonNegative = 0.002
    marker_id: int = 0  # of the own rear marker
    marker_size_m: Positive = 0.16

    def within(self, max_speed_mps: float) -> Self:
        """The same of a robot that goes no faster: what it tells others of its speeds, it keeps."""
        return replace(
            self,
            cruise_speed_mps=min(self.cruise_speed_mps, max_speed_mps),
            ride_speed_mps=min(self.ride_speed_mps, max_speed_mps),
            safe_speed_mps=min(self.safe_speed_mps, max_speed_mps),
        )

    @property
    def patience_s(self) -> float:
        """T_hwait, which shrinks with the own priority and grows without it (P18 §4)."""
        return self.max_wait_s * (2.0 - self.priority / USUAL_PRIORITY) if self.mode == "network" else self.max_wait_s

    @property
    def own_policy(self) -> Policy:
        """Who is in a hurry takes the nearest driver (P18 §4)."""
        return "proximity" if self.priority > USUAL_PRIORITY else self.policy

    @cached_property
    def mounting(self) -> FloatArray:
        """Covariance (3, 3) in (x, y, theta) of where a rear marker is mounted."""
        return np.diag(np.square([self.mounting_sigma_m, self.mounting_sigma_m, self.mounting_sigma_rad]))
