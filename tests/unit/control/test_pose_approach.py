"""Curves to a pose: they end there, as the base can drive them, and a driver in front of a rider takes a short one."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flat_world import CORRIDOR, LASER, P3DX, TURTLEBOT, FlatWorld
from hitchhike_ros.control.local_planner import LocalPlanner
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.pose_approach import CURVES, PERIOD_S, roll_out_approach
from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import wrap_angle, wrap_angles

NEAR_M, REVERSE_MPS = 0.05, 0.4


@settings(max_examples=60)
@given(
    st.floats(0.2, 1.5),
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi, math.pi),
    st.floats(0.0, 0.6),
    st.sampled_from([P3DX, TURTLEBOT]),
)
def test_every_curve_that_arrives_is_one_that_the_base_can_drive(r, bearing, heading, v, limits) -> None:
    goal = Pose2D(r * math.cos(bearing), r * math.sin(bearing), heading)
    plan = roll_out_approach(goal, Twist2D(v, 0.0), CURVES, limits, REVERSE_MPS, NEAR_M)
    arrived = np.isfinite(plan.seconds)
    assert arrived.any()
    ends = plan.poses[arrived, -1]
    assert (np.hypot(ends[:, 0] - goal.x, ends[:, 1] - goal.y) <= NEAR_M + 0.05).all()
    start = np.zeros((len(CURVES), 1, 3))
    steps = np.diff(np.concatenate([start, plan.poses], axis=1), axis=1)
    lengths = np.hypot(steps[..., 0], steps[..., 1])
    assert lengths.max() <= max(limits.max_speed_mps, v) * PERIOD_S + 1e-9
    assert np.abs(wrap_angles(steps[..., 2])).max() <= limits.max_yaw_rate_rps * PERIOD_S + 1e-9
    # A way's change of length from step to step is what the wheels' acceleration allows; braking to a stand included.
    assert np.abs(np.diff(lengths, axis=1)).max() <= limits.max_acceleration_mps2 * PERIOD_S**2 + 1e-3
    backwards = np.array([curve.sense < 0 for curve in CURVES])
    assert (plan.backwards_m[~backwards] <= 0.05).all()


def approach(start: Pose2D, goal: Pose2D, twist: Twist2D, boxes: tuple = ()) -> tuple[FlatWorld, list[Pose2D]]:
    """The P3DX driven to ``goal`` by its controller; the way it takes."""
    world = FlatWorld(P3DX, CORRIDOR + boxes, start, 0)
    world.twist = twist
    controller = LocalPlanner(P3DX, LocalPlannerParameters())
    controller.set_path(np.array([(start.x, start.y), (goal.x, goal.y)]), goal, 0.08, 0.06)
    poses = [start]
    while world.now < 20.0:
        decision = controller.step(world.now, world.pose, world.twist, world.scan(), LASER[P3DX], 0.6)
        world.drive(decision.twist)
        poses.append(world.pose)
        assert not world.touched
        if decision.state == "arrived":
            break
    assert math.hypot(world.pose.x - goal.x, world.pose.y - goal.y) <= 0.10
    assert abs(wrap_angle(world.pose.theta - goal.theta)) <= 0.08
    return world, poses


def test_a_driver_that_comes_from_the_side_backs_into_line_in_front_of_its_rider() -> None:
    goal = Pose2D(3.2, 5.72, 0.0)
    world, _ = approach(Pose2D(3.54, 4.97, 0.93), goal, Twist2D(0.6, -0.22))
    assert world.now <= 5.5


def test_it_backs_no_way_that_an_obstacle_blocks() -> None:
    # A box beside the robot, over which the shortest way back would lead.
    box = ((3.75, 5.45, 0.35, 0.3),)
    goal = Pose2D(3.2, 5.72, 0.0)
    _, poses = approach(Pose2D(4.6, 5.1, 0.6), goal, Twist2D(0.0, 0.0), box)
    assert len(poses) > 20


def test_it_does_not_back_farther_than_it_may() -> None:
    start = Pose2D(6.0, 5.72, 0.0)
    _, poses = approach(start, Pose2D(4.7, 5.72, 0.0), Twist2D(0.0, 0.0))
    assert any(abs(pose.theta) > 2.0 for pose in poses)  # it turned round
