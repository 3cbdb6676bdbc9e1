"""Parameters of the local planner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import msgspec

from hitchhike_ros.core.datatypes import FloatArray, NonNegative, Positive

Samples = Annotated[int, msgspec.Meta(ge=2)]


@dataclass(frozen=True)
class LocalPlannerParameters:
    """Section ``obstacle_avoidance``. All values are chosen; the papers name no controller."""

    goal_tolerance_m: Positive = 0.10
    goal_tolerance_rad: Positive = 0.087  # 5°
    max_age_s: Positive = 0.25  # an older scan is no basis for motion
    margin_m: NonNegative = 0.05  # the footprint never comes closer than this on purpose
    comfort_m: Positive = 0.35  # closer than this costs
    reaction_s: Positive = 0.25  # from a scan until the next command acts
    window_s: Positive = 0.8
    horizon_s: Positive = 2.0
    rollout_step_s: Positive = 0.2
    speed_samples: Samples = 5
    yaw_rate_samples: Samples = 19
    turn_start_rad: Positive = 1.05  # 60°; farther off the path's heading than this, turn standing
    turn_stop_rad: Positive = 0.21  # 12°
    approach_m: NonNegative = 1.5  # nearer to the goal than this, a curve to its pose is planned
    approach_backwards_m: NonNegative = 1.0  # it goes backwards no farther than this: the laser does not look there
    approach_backwards_mps: Positive = 0.4
    stand_off_m: NonNegative = 0.3  # stop this much before the last free place of a blocked way
    max_off_path_m: Positive = 1.2
    memory_s: Positive = 3.0
    near_memory_s: Positive = 15.0  # for what the turning footprint could touch
    blocked_after_s: Positive = 1.0  # standing without a way on
    # Within this distance for this long, however busily, is no progress; move_base calls it oscillation.
    no_progress_m: Positive = 0.5
    no_progress_s: Positive = 15.0
    # Recovery, step by step; a person has often passed while it waits.
    recovery_wait_s: Positive = 5.0
    recovery_clear_s: Positive = 1.0
    recovery_turn_s: Positive = 8.0  # once round
    recovery_yaw_rate_rps: Positive = 0.8
    recovery_replan_s: Positive = 4.0  # longer than path_planning takes to try again
    recovery_withdraw_s: Positive = 8.0  # enough to turn and to go back so far:
    recovery_withdraw_m: Positive = 1.0
    recovery_backwards_mps: Positive = 0.2
    recovery_calm_s: Positive = 3.0  # after driving for so long the next block is a new one
    guided_ends_m: NonNegative = 1.0  # nearer to the goal than this, a robot that a human drives parks by itself
    progress_weight: NonNegative = 1.0
    lateral_weight: NonNegative = 0.6
    heading_weight: NonNegative = 0.4
    clearance_weight: NonNegative = 0.5
    contact_weight: NonNegative = 1.0
    smoothness_weight: NonNegative = 0.3
    # With a hitchhiker behind: a camera of 60° must keep the marker 0.8 m ahead of it in view.
    rider_speed_mps: Positive = 0.6
    rider_yaw_rate_rps: Positive = 0.5
    rider_acceleration_mps2: Positive = 0.3
    rider_yaw_acceleration_rps2: Positive = 0.8
    rider_curvature_per_m: Positive = 1.2
    rider_turn_rps: NonNegative = 0.1  # and this much on the spot

    def in_view_rps(self, v: FloatArray) -> FloatArray:
        """The fastest turn, rad/s, that keeps the marker in a rider's view at forward speeds ``v`` in m/s."""
        return self.rider_curvature_per_m * v + self.rider_turn_rps
