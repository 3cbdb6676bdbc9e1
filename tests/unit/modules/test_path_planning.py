"""When a plan is made anew and when the old one stands."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.planning.replanner import Order, Replanner, ReplannerParameters

LIMITS = RobotLimits(0.3, 0.1, 0.2, 0.2, 0.2, 1.0, 2.0)
GRID = OccupancyGrid(np.zeros((40, 60)), 0.1)
ORDER = Order("1", Pose2D(5.0, 2.0))
WALL = GRID.with_obstacles([Obstacle("wall", 3.0, 0.0, 0.2, 4.0)])


def replanner() -> Replanner:
    return Replanner(GlobalPlanner(GlobalPlannerParameters(), LIMITS), ReplannerParameters(retry_s=2.0, pose_age_s=1.0))


def at(x: float, stamp: float = 0.0) -> PoseEstimate:
    return PoseEstimate(stamp, Pose2D(x, 2.0), np.zeros((3, 3)))


def test_a_plan_stands_while_nothing_changes():
    its = replanner()
    plan = its.step(0.0, ORDER, GRID, at(1.0), False)
    assert (plan.state, plan.order, plan.reason) == ("planned", ORDER, "")
    assert plan.path[0].tolist() == [1.0, 2.0]
    assert its.step(5.0, ORDER, GRID, at(2.0, 5.0), False) is plan


@pytest.mark.parametrize(
    ("order", "grid", "blocked"),
    [
        (Order("2", ORDER.goal), GRID, False),
        (Order("1", Pose2D(5.0, 1.0)), GRID, False),
        (ORDER, GRID.with_obstacles([]), False),
        (ORDER, GRID, True),
    ],
    ids=["new order", "moved goal", "new map", "blocked"],
)
def test_what_makes_a_new_plan_from_where_the_robot_is_now(order, grid, blocked):
    its = replanner()
    its.step(0.0, ORDER, GRID, at(1.0), False)
    plan = its.step(5.0, order, grid, at(2.0, 5.0), blocked)
    assert plan.state == "planned"
    assert plan.path[0].tolist() == [2.0, 2.0]
    assert plan.path[-1].tolist() == [order.goal.x, order.goal.y]


def test_a_blocked_way_is_replanned_no_more_often_than_every_retry():
    its = replanner()
    first = its.step(10.0, ORDER, GRID, at(1.0, 10.0), False)
    assert its.step(11.9, ORDER, GRID, at(1.5, 11.9), True) is first
    second = its.step(12.0, ORDER, GRID, at(1.5, 12.0), True)
    assert second is not first
    assert its.step(12.1, ORDER, GRID, at(1.6, 12.1), True) is second


def test_a_failure_says_why_and_is_tried_again():
    its = replanner()
    failed = its.step(0.0, ORDER, WALL, at(1.0), False)
    assert (failed.state, len(failed.path)) == ("failed", 0)
    assert "no way" in failed.reason
    assert its.step(3.0, ORDER, WALL, at(1.0, 3.0), False) is failed, "it fails for the same reason: nothing to say"
    assert its.step(3.1, ORDER, GRID, at(1.0, 3.1), False).state == "planned", "a changed map is tried at once"


def test_a_way_that_a_new_obstacle_closes_is_given_up():
    its = replanner()
    assert its.step(0.0, ORDER, GRID, at(1.0), False).state == "planned"
    assert its.step(0.1, ORDER, WALL, at(1.0, 0.1), False).state == "failed"


@pytest.mark.parametrize(
    ("grid", "estimate", "reason"),
    [(None, at(1.0, 9.9), "map"), (GRID, None, "pose"), (GRID, at(1.0, 8.9), "pose")],
    ids=["no map", "no pose", "old pose"],
)
def test_it_waits_for_what_is_missing(grid, estimate, reason):
    its = replanner()
    waiting = its.step(10.0, ORDER, grid, estimate, False)
    assert waiting.state == "waiting"
    assert reason in waiting.reason
    assert its.step(10.1, ORDER, grid, estimate, False) is waiting
    assert its.step(10.2, ORDER, GRID, at(1.0, 10.2), False).state == "planned"


def test_a_plan_outlives_a_pause_of_localization():
    its = replanner()
    plan = its.step(0.0, ORDER, GRID, at(1.0), False)
    assert its.step(5.0, ORDER, GRID, None, False) is plan


def test_without_an_order_there_is_no_plan():
    its = replanner()
    its.step(0.0, ORDER, GRID, at(1.0), False)
    idle = its.step(0.1, None, GRID, at(1.0, 0.1), False)
    assert (idle.state, len(idle.path)) == ("idle", 0)
    assert its.step(0.2, None, GRID, at(1.0, 0.2), False) is idle
    assert its.step(0.3, ORDER, GRID, at(1.0, 0.3), False).state == "planned"


def test_a_clock_set_back_does_not_stop_the_retries():
    its = replanner()
    its.step(100.0, ORDER, GRID, at(1.0, 100.0), False)
    assert its.step(1.0, ORDER, GRID, at(2.0, 1.0), True).path[0].tolist() == [2.0, 2.0]
