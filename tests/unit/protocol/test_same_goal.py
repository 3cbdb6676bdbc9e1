"""Robots that want to stand at the same place (P17 §3.1, P18 §5): real agents in the grid simulator, one corridor."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import HitchhikingPoint, Pose2D
from hitchhike_ros.core.geometry import compose, distance
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.robot import Errand, GridRobot
from hitchhike_ros.simulation.grid.world import GridWorld
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters

_RADIUS = 0.2  # of the grid's robots
POINT = Pose2D(8.0, 4.0)
GOAL = Pose2D(42.0, 4.0)


def _world(**network: Any) -> GridWorld:
    """A corridor along x from 2 to 50, y from 2 to 6, with a hitchhiking point."""
    data = np.full((32, 208), 100, dtype=np.int8)
    data[8:24, 8:200] = 0
    x, y = POINT.x, POINT.y
    area = ((x - 4, y - 2), (x + 4, y - 2), (x + 4, y + 2), (x - 4, y + 2))
    sites = Sites((), (HitchhikingPoint("west", area, compose(POINT, Pose2D(1.2)), POINT),))
    params = GridWorldParameters(position_sigma_m=0.0, heading_sigma_rad=0.0)
    return GridWorld(OccupancyGrid(data, 0.25), sites, NetworkModel(NetworkParameters(**network)), params)


def _add(
    world: GridWorld, name: str, start: Pose2D, goal: Pose2D | None, at_s: float = 1.0, **hitchhiking: Any
) -> GridRobot:
    params = HitchhikingParameters(**{"marker_id": len(world.robots), **hitchhiking})
    return world.add_robot(name, start, params, [] if goal is None else [Errand(goal, at_s)])


def _run(world: GridWorld, limit_s: float = 400.0) -> None:
    assert world.run(limit_s, world.idle), [robot.status for robot in world.robots.values()]
    for one, other in combinations(world.robots, 2):
        assert distance(world.pose(one), world.pose(other)) >= 2 * _RADIUS, (one, other)


def _end(robot: GridRobot) -> tuple[bool, str]:
    trip = robot.trips[-1]
    return trip.reached, str(trip.reason)


def _pair(mode: str, rider_goal: Pose2D, driver_goal: Pose2D, **rider: Any) -> tuple[GridWorld, GridRobot, GridRobot]:
    """A driver that comes by the point, where a hitchhiker waits."""
    world = _world()
    driver = _add(world, "p3dx", Pose2D(4.0, 4.0), driver_goal, 0.0, mode=mode, profile=90.0, may_ride=False)
    hitchhiker = _add(world, "turtlebot", POINT, rider_goal, mode=mode, profile=40.0, may_drive=False, **rider)
    return world, driver, hitchhiker


@pytest.mark.parametrize("mode", ["local", "network"])
@pytest.mark.parametrize("apart_m", [-0.4, -0.2, 0.0, 0.2, 0.4])
def test_a_goal_of_both_is_the_drivers(mode: str, apart_m: float) -> None:
    world, driver, rider = _pair(mode, GOAL, Pose2D(GOAL.x + apart_m, GOAL.y))
    _run(world)
    assert _end(driver) == (True, "Goal reached")
    at, goal = world.pose("turtlebot"), rider.trips[0].goal
    assert _end(rider) == (True, f"goal taken by p3dx, {distance(at, goal):.1f} m before it")
    assert 2 * _RADIUS + 0.05 <= distance(at, world.pose("p3dx")) <= 1.6
    assert rider.trips[0].ridden_m > 25.0
    assert rider.trips[0].driven_m - rider.trips[0].ridden_m < 1.5, "it drives to the place, and no farther"
    told = [(time, report.text) for time, report in rider.reports if report.reason is Reason.SAME_GOAL]
    (when, text), couples = told[0], next(t for t, state, _ in rider.history if state == "coupling")
    assert len(told) == 1 and when < couples and text == "Same goal: p3dx keeps it, turtlebot ends behind it"
    assert [report.text for _, report in driver.reports if report.reason is Reason.SAME_GOAL] == [text]


@pytest.mark.parametrize("mode", ["local", "network"])
@pytest.mark.parametrize("apart_m", [-1.0, -0.5, 0.5, 1.0, 5.0])
def test_goals_that_leave_room_are_both_reached(mode: str, apart_m: float) -> None:
    world, driver, rider = _pair(mode, GOAL, Pose2D(GOAL.x + apart_m, GOAL.y))
    _run(world)
    assert _end(driver) == _end(rider) == (True, "Goal reached")
    assert distance(world.pose("turtlebot"), GOAL) < 0.15
    assert not [report for _, report in rider.reports if report.reason is Reason.SAME_GOAL]


def test_where_the_driver_stands_on_the_goal_nothing_is_driven_after_the_ride() -> None:
    """P17 Algorithm 2, line 14."""
    world, _, rider = _pair("local", GOAL, GOAL)
    _run(world)
    left = next(time for time, state, _ in rider.history if state == "relocalizing")
    states = [state for time, state, _ in rider.history if time >= left]
    assert states == ["relocalizing", "idle"]
    assert rider.trips[0].driven_m == pytest.approx(rider.trips[0].ridden_m, abs=0.05)


@pytest.mark.parametrize("names", [("a", "b", "c"), ("c", "a", "b")])
@pytest.mark.parametrize("ahead_m", [0.0, 0.1, 1.0])
def test_of_three_alone_to_one_goal_the_nearest_has_it(names: tuple[str, str, str], ahead_m: float) -> None:
    world = _world()
    for k, name in enumerate(names):
        _add(world, name, Pose2D(GOAL.x - 15.0 - k * (ahead_m + 1e-3), 3.0 + k), GOAL, may_ride=False)
    _run(world)
    away = {name: distance(world.pose(name), GOAL) for name in names}
    assert all(_end(robot)[0] for robot in world.robots.values())
    holder = min(away, key=away.__getitem__)
    assert away[holder] < 0.15 and _end(world.robots[holder])[1] == "Goal reached"
    for name in set(names) - {holder}:
        assert _end(world.robots[name])[1].startswith("goal taken by ")
        assert away[name] < 2.5
    if ahead_m == 1.0:
        assert holder == names[0]


@pytest.mark.parametrize("goal", [GOAL, Pose2D(42.0, 2.5), Pose2D(49.5, 5.5)])
@pytest.mark.parametrize("apart_m", [0.0, 0.2, 0.4])
def test_a_robot_that_is_parked_on_the_goal_keeps_it(goal: Pose2D, apart_m: float) -> None:
    """In the middle, beside a wall, in a corner."""
    world = _world()
    parked = _add(world, "parked", Pose2D(goal.x - apart_m, goal.y), None)
    robot = _add(world, "robot", Pose2D(10.0, 4.0), goal, may_ride=False)
    _run(world)
    reached, text = _end(robot)
    assert reached
    assert text == f"goal taken by parked, {distance(world.pose('robot'), goal):.1f} m before it"
    assert distance(world.pose("robot"), parked.body.pose) == pytest.approx(2 * _RADIUS + 0.3, abs=0.25)


@pytest.mark.parametrize("leaves_s", [None, 75.0])
def test_who_wants_exactly_this_place_waits_a_while(leaves_s: float | None) -> None:
    world = _world()
    _add(world, "parked", GOAL, None if leaves_s is None else Pose2D(12.0, 5.0), leaves_s or 0.0, may_ride=False)
    robot = _add(world, "robot", Pose2D(10.0, 4.0), GOAL, exact_goal=True, exact_goal_wait_s=40.0, may_ride=False)
    _run(world)
    waited_s = next(t for t, state, _ in robot.history if state == "yielding")
    if leaves_s is None:
        assert _end(robot) == (False, "Goal did not become free: taken by parked, 0.7 m before it")
        assert 40.0 <= robot.trips[0].ended_s - waited_s <= 55.0  # type: ignore[operator]
    else:
        assert _end(robot) == (True, "Goal reached")
        assert distance(world.pose("robot"), GOAL) < 0.15


def test_a_hitchhiker_that_wants_exactly_this_place_gets_none_of_its_drivers() -> None:
    world, driver, rider = _pair("local", GOAL, GOAL, exact_goal=True, exact_goal_wait_s=20.0)
    _run(world)
    assert _end(driver) == (True, "Goal reached")
    reached, text = _end(rider)
    assert not reached and text.startswith("Goal did not become free: taken by p3dx")


@pytest.mark.parametrize("mode", ["local", "network"])
def test_a_convoy_to_one_goal_stands_in_line(mode: str) -> None:
    world = _world()
    _add(world, "p3dx", Pose2D(4.0, 4.0), GOAL, 0.0, mode=mode, profile=90.0, may_ride=False, places=2)
    common: dict[str, Any] = {"mode": mode, "profile": 40.0, "may_drive": False}
    _add(world, "one", POINT, GOAL, **common)
    _add(world, "two", compose(POINT, Pose2D(-1.2)), GOAL, **common)
    _run(world)
    assert all(_end(robot)[0] for robot in world.robots.values())
    assert _end(world.robots["p3dx"])[1] == "Goal reached"
    assert all(_end(world.robots[name])[1].startswith("goal taken by ") for name in ("one", "two"))
    assert sum(robot.ridden_m > 20.0 for robot in world.robots.values()) >= 1


@pytest.mark.parametrize("mode", ["local", "network"])
def test_a_ride_ends_before_a_robot_that_is_parked_on_its_goal(mode: str) -> None:
    world, driver, rider = _pair(mode, GOAL, GOAL)
    _add(world, "parked", GOAL, None)
    _run(world)
    for robot in (driver, rider):
        reached, text = _end(robot)
        assert reached and text.startswith("goal taken by "), text
    assert rider.ridden_m > 25.0
    assert math.isclose(distance(world.pose("p3dx"), GOAL), 0.75, abs_tol=0.4)
