"""When a path is searched for and when the old one stands."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import GoalBlockedError, OutsideMapError, StaleInputError
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.modules.inputs import NO_PATH, PlanReport
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Health, Level, Refused
from hitchhike_ros.modules.path_planning import PathPlanning, PathPlanningOutputs, PathPlanningParameters
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.protocol.events import GoalCancelled, NavigationReport
from hitchhike_ros.protocol.status import GoalCommand, ModuleSwitches, Status
from plain_files import plain_files

LIMITS = RobotLimits(0.3, 0.1, 0.2, 0.2, 0.2, 1.0, 2.0)
GRID = OccupancyGrid(np.zeros((40, 60)), 0.1)
GOAL = GoalCommand("1", 5.0, 2.0, 0.5)
ON = Status(0.0, "p3dx", goal=GOAL)
OFF = Status(0.0, "p3dx", goal=GOAL, modules=ModuleSwitches(PP=False))
WALL = GRID.with_obstacles([Obstacle("wall", 3.0, 0.0, 0.2, 4.0)])
LENGTH_M = 4.03  # the ends and the middles of cells between them
PARAMS = PathPlanningParameters(retry_s=2.0, pose_age_s=1.0)


def pose(x: float, stamp: float = 0.0) -> PoseEstimate:
    return PoseEstimate(stamp, Pose2D(x, 2.0), np.zeros((3, 3)))


def module(*, always_on: bool = False) -> PathPlanning:
    return PathPlanning(GlobalPlanner(GlobalPlannerParameters(), LIMITS), PARAMS, always_on=always_on)


def hear(its: PathPlanning, now: float, *inputs: object) -> PathPlanningOutputs | None:
    """Hand on inputs and orders at ``now`` and step it as a host would: the outputs, None where it was not due."""
    for x in inputs:
        if isinstance(x, Status):
            its.order(x, now)
        else:
            its.sense(x, now)
    if its.next_due(now) > now:
        return None
    outputs = its.step(now)
    assert its.next_due(now) > now
    return outputs


def silent(outputs: PathPlanningOutputs | None) -> bool:
    """Whether nothing new is published."""
    return outputs is None or (outputs.plan is None and outputs.report is None)


def start(outputs: PathPlanningOutputs | None) -> list[float]:
    """The first point of a plan that has just been made."""
    assert outputs is not None
    assert outputs.plan is not None
    assert outputs.report is not None
    assert outputs.report.state == "planned"
    return outputs.plan.points[0].tolist()


def planned(at: float = 0.0, status: Status = ON, grid: OccupancyGrid = GRID) -> PathPlanning:
    """One that has its plan."""
    its = module()
    assert start(hear(its, at, grid, pose(1.0, at), status)) == [1.0, 2.0]
    return its


def test_at_first_it_says_that_there_is_no_plan() -> None:
    its = module()
    assert its.listens() == frozenset()
    outputs = hear(its, 3.0)
    assert outputs == PathPlanningOutputs(health=Health(Level.OK, "off"), report=PlanReport("", "idle"), plan=NO_PATH)
    assert its.next_due(1e9) == math.inf


def test_a_goal_is_planned_to_at_once_and_the_plan_stands_while_nothing_changes() -> None:
    its = module()
    outputs = hear(its, 0.0, GRID, pose(1.0), ON)
    assert start(outputs) == [1.0, 2.0]
    assert outputs.plan.end == GOAL.pose
    assert outputs.report == PlanReport("1", "planned")
    assert outputs.health == Health(Level.OK, "planned", {"length_m": LENGTH_M})
    assert its.listens() == its.inputs
    for now in (1.0, 2.0, 3.0):
        assert hear(its, now, pose(2.0, now)) is None  # where the robot is now is no reason to plan anew
        assert silent(hear(its, now, ON))
    assert its.next_due(3.0) == 3.0 + ORDER_MAX_AGE_S


@pytest.mark.parametrize(
    "news",
    [
        replace(ON, goal=replace(GOAL, id="2")),
        replace(ON, goal=replace(GOAL, y=1.0)),
        OccupancyGrid(GRID.data + np.eye(40, 60, 50), GRID.resolution),
        OccupancyGrid(GRID.data, 0.11),
        OccupancyGrid(GRID.data, GRID.resolution, Pose2D(0.1)),
        NavigationReport("1", "blocked"),
    ],
    ids=["new id", "moved goal", "new cells", "new resolution", "new origin", "blocked"],
)
def test_what_makes_a_new_plan_from_where_the_robot_is_now(news: object) -> None:
    its = planned()
    hear(its, 3.0, ON)
    assert start(hear(its, 5.0, pose(2.0, 5.0), news)) == [2.0, 2.0]


@pytest.mark.parametrize(
    "news",
    [
        GRID,
        OccupancyGrid(GRID.data.copy(), GRID.resolution),
        NavigationReport("1", "driving"),
        NavigationReport("0", "blocked"),  # of the goal before
        replace(ON, speed_limit_mps=0.2),
        replace(ON, goal=replace(GOAL, tolerance_m=0.5)),
    ],
    ids=["same map", "equal map", "driving", "blocked elsewhere", "new limit", "new tolerance"],
)
def test_what_makes_none(news: object) -> None:
    its = planned()
    hear(its, 3.0, ON)
    assert silent(hear(its, 5.0, pose(2.0, 5.0), news))


def test_while_the_way_is_blocked_it_plans_anew_from_time_to_time() -> None:
    its = planned()
    assert silent(hear(its, 0.5, NavigationReport("1", "blocked")))
    assert its.next_due(0.5) == PARAMS.retry_s
    assert hear(its, 1.9, pose(1.4, 1.9)) is None
    assert start(hear(its, 2.0)) == [1.4, 2.0]
    assert its.next_due(2.0) == ORDER_MAX_AGE_S
    hear(its, 3.0, ON)
    assert its.next_due(3.0) == 4.0
    assert silent(hear(its, 3.5, NavigationReport("1", "driving")))
    assert its.next_due(3.5) == 3.0 + ORDER_MAX_AGE_S


def test_a_plan_that_is_due_anew_waits_for_the_pose_and_the_old_one_stands() -> None:
    its = planned()
    assert silent(hear(its, 1.5, ON, NavigationReport("1", "blocked")))
    assert silent(hear(its, 2.0))  # due, but where is it?
    assert its.next_due(2.0) == 1.5 + ORDER_MAX_AGE_S
    assert silent(hear(its, 2.5, pose(1.4, 1.4)))  # that is too old
    assert start(hear(its, 2.6, pose(1.5, 2.6))) == [1.5, 2.0]


def test_a_failure_says_why_and_is_tried_again() -> None:
    its = module()
    failed = hear(its, 0.0, WALL, pose(1.0), ON)
    assert failed.plan is NO_PATH
    assert (failed.report.goal_id, failed.report.state) == ("1", "failed")
    assert "no way" in failed.report.reason
    assert failed.health == Health(Level.ERROR, failed.report.reason, {"length_m": ""})
    assert its.next_due(0.0) == PARAMS.retry_s
    assert silent(hear(its, 2.0, pose(1.0, 2.0))), "it fails for the same reason: nothing to say"
    assert its.next_due(2.0) == ORDER_MAX_AGE_S
    assert hear(its, 3.0, ON).health.reason == failed.report.reason
    assert its.next_due(3.0) == 4.0
    assert start(hear(its, 3.1, GRID, pose(1.0, 3.1))) == [1.0, 2.0], "a changed map is tried at once"


def test_a_way_that_a_new_obstacle_closes_is_given_up() -> None:
    its = planned()
    outputs = hear(its, 0.1, WALL)
    assert outputs.report.state == "failed"
    assert outputs.plan is NO_PATH


@pytest.mark.parametrize(
    ("there", "reason", "comes"),
    [
        ([pose(1.0, 9.9)], "no map received", GRID),
        (
            [Refused(OccupancyGrid, "map has 0 x 0 cells", "/map_server"), pose(1.0, 9.9)],
            "no map received, only one that was refused: map has 0 x 0 cells",
            GRID,
        ),
        ([GRID], "no recent pose estimate", pose(1.0, 10.2)),
        ([GRID, pose(1.0, 8.9)], "no recent pose estimate", pose(1.0, 10.2)),
        ([GRID, pose(1.0, 11.5)], "no recent pose estimate", pose(1.0, 10.2)),  # the clock was set back
        ([GRID, replace(pose(1.0, 10.0), pose=Pose2D(math.nan))], "no recent pose estimate", pose(1.0, 10.2)),
    ],
    ids=["no map", "refused map", "no pose", "old pose", "pose to come", "senseless pose"],
)
def test_it_waits_for_what_is_missing(there: list[object], reason: str, comes: object) -> None:
    its = module()
    waiting = hear(its, 10.0, *there, ON)
    assert waiting.report == PlanReport("1", "waiting", reason)
    assert waiting.plan is NO_PATH
    assert (waiting.health.level, waiting.health.reason) == (Level.WARN, reason)
    assert its.next_due(10.0) == 10.0 + ORDER_MAX_AGE_S
    assert silent(hear(its, 10.1, ON))
    assert start(hear(its, 10.2, comes)) == [1.0, 2.0]


def test_another_goal_is_waited_for_too() -> None:
    its = planned()
    other = replace(ON, goal=replace(GOAL, id="2"))
    assert hear(its, 2.0, other).report == PlanReport("2", "waiting", "no recent pose estimate")


def test_a_plan_outlives_a_pause_of_localization() -> None:
    its = planned()
    hear(its, 3.0, ON)
    assert hear(its, 5.0) is None
    assert silent(hear(its, 5.0, ON))


@pytest.mark.parametrize(
    "status",
    [OFF, replace(ON, goal=None), replace(ON, goal=replace(GOAL, along_wall="left"))],
    ids=["off", "no goal", "a turn along a wall"],
)
def test_without_a_goal_there_is_no_plan(status: Status) -> None:
    its = planned()
    idle = hear(its, 0.1, status)
    assert (idle.report, idle.plan) == (PlanReport("", "idle"), NO_PATH)
    assert (idle.health.level, idle.health.reason) == (Level.OK, "off" if status is OFF else "idle")
    assert silent(hear(its, 0.2, status))
    assert its.listens() == (frozenset() if status is OFF else its.inputs)
    assert start(hear(its, 0.3, ON)) == [1.0, 2.0]


def test_off_nothing_makes_it_due() -> None:
    its = planned()
    hear(its, 0.1, OFF)
    assert its.next_due(1e9) == math.inf
    assert hear(its, 100.0, pose(1.0, 100.0)) is None


def test_an_order_that_is_not_repeated_ends_the_plan_and_the_health_says_so() -> None:
    its = planned()
    outputs = hear(its, ORDER_MAX_AGE_S)
    assert (outputs.report, outputs.plan) == (PlanReport("", "idle"), NO_PATH)
    assert outputs.health == Health(Level.ERROR, "no status for 3.5 s", {"length_m": ""})
    assert its.next_due(4.0) == math.inf
    assert its.listens() == its.inputs
    assert start(hear(its, 5.0, pose(1.2, 5.0), ON)) == [1.2, 2.0]


def test_a_cancelled_goal_is_for_hitchhike_comm() -> None:
    its = planned()
    its.order(GoalCancelled(), 1.0)
    assert silent(hear(its, 1.0))


def test_a_clock_set_back_does_not_stop_the_retries() -> None:
    its = planned(100.0)
    its.order(ON, 1.0)
    its.sense(pose(2.0, 1.0), 1.0)
    assert start(hear(its, 1.0, NavigationReport("1", "blocked"))) == [2.0, 2.0]
    assert its.next_due(1.0) == 3.0


def test_a_clock_set_back_is_noticed_without_news() -> None:
    its = planned(100.0)
    assert its.next_due(99.9) <= 99.9
    outputs = its.step(1.0)  # the order is of another time
    assert outputs.report == PlanReport("", "idle")
    assert outputs.health.reason == "no status for 99.0 s"
    assert its.next_due(1.0) == math.inf


@pytest.mark.parametrize(
    ("bad", "counter"),
    [
        (replace(pose(1.0, 0.1), pose=Pose2D(math.nan)), "bad_poses"),
        (Refused(PoseEstimate, "?"), "bad_poses"),
        (Refused(OccupancyGrid, "?"), "bad_maps"),
        (Refused(NavigationReport, "?"), "bad_navigation_status"),
    ],
)
def test_what_is_senseless_is_counted_and_changes_nothing(bad: object, counter: str) -> None:
    its = planned()
    outputs = hear(its, 0.1, bad)
    assert silent(outputs)
    assert outputs.health == Health(Level.OK, "planned", {counter: 1, "length_m": LENGTH_M})
    assert hear(its, 0.2, bad).health.counters[counter] == 2


def test_alone_it_is_on_for_ever_and_obeys_nobody() -> None:
    its = module(always_on=True)
    assert its.listens() == its.inputs
    assert hear(its, 0.0).health.reason == "idle"
    assert silent(hear(its, 1.0, GRID, pose(1.0, 1.0), OFF, ON))
    assert its.on
    assert its.next_due(1e9) == math.inf
    path = its.make_plan(None, GOAL.pose, 0.0, 1.5)
    assert (path[0].tolist(), path[-1].tolist()) == ([1.0, 2.0], [5.0, 2.0])


def test_make_plan_leaves_the_plan_to_the_goal_alone() -> None:
    its = planned()
    path = its.make_plan(Pose2D(0.5, 0.5), Pose2D(0.5, 3.5), 0.0, 0.5)
    assert (path[0].tolist(), path[-1].tolist()) == ([0.5, 0.5], [0.5, 3.5])
    assert silent(hear(its, 1.0, ON))


def test_make_plan_moves_an_occupied_goal_within_the_tolerance() -> None:
    its = planned(grid=GRID.with_obstacles([Obstacle("box", 2.9, 0.4, 0.2, 0.2)]))
    goal = Pose2D(3.0, 0.5)
    assert math.dist(its.make_plan(None, goal, 1.0, 0.0)[-1], (goal.x, goal.y)) <= 1.0
    for tolerance_m in (0.0, 0.1, math.nan, math.inf):
        with pytest.raises(GoalBlockedError):
            its.make_plan(None, goal, tolerance_m, 0.0)
    with pytest.raises(OutsideMapError):
        its.make_plan(None, Pose2D(-3.0), 1.0, 0.0)


@pytest.mark.parametrize(
    ("there", "reason"),
    [
        ([GRID, pose(1.0, 10.0)], "path planning is off"),
        ([ON, pose(1.0, 10.0)], "no map received"),
        ([ON, GRID], "no pose estimate"),
        ([ON, GRID, pose(1.0, 8.0)], "no pose estimate for 2.0 s"),
    ],
)
def test_make_plan_is_refused_for_want_of_what_it_takes(there: list[object], reason: str) -> None:
    its = module()
    hear(its, 10.0, *there)
    with pytest.raises(StaleInputError, match=f"^{reason}$"):
        its.make_plan(None, GOAL.pose, 0.0, 10.0)


def test_it_is_made_of_a_robots_files() -> None:
    its = PathPlanning.build(plain_files("p3dx", path_planning={"retry_s": 0.5}))
    hear(its, 0.0, WALL, pose(1.0), ON)
    assert its.next_due(0.0) == 0.5
    posts = (Obstacle(f"post at {y:.1f}", 3.0, y, 0.1, 0.1) for y in np.arange(0.0, 4.0, 0.4))
    gaps = GRID.with_obstacles(posts)  # the robot is wider than those
    assert start(hear(its, 0.1, GRID)) == [1.0, 2.0]
    assert hear(its, 0.2, gaps).report.state == "failed"
    assert PathPlanning.build(plain_files("p3dx"), always_on=True).on


statuses = st.sampled_from([ON, OFF, replace(ON, goal=None), replace(ON, goal=replace(GOAL, id="2"))])
reports = st.builds(NavigationReport, st.sampled_from("12"), st.sampled_from(["blocked", "driving"]))
pauses = st.floats(0.0, 4.0) | st.sampled_from([PARAMS.retry_s, ORDER_MAX_AGE_S, -1000.0])
ages = st.sampled_from([-0.5, 0.0, 0.5, PARAMS.pose_age_s, 2.0])
news = st.sampled_from([GRID, WALL, Refused(PoseEstimate, "?")]) | statuses | reports | ages


@given(st.lists(st.tuples(pauses, st.floats(0.0, 0.99), news), max_size=20))
def test_nothing_happens_before_it_is_due_and_then_it_is_done(events: list[tuple[float, float, object]]) -> None:
    its, now = module(), 50.0
    hear(its, now)
    for pause, share, x in events:
        due = its.next_due(now)
        early = now + share * (min(due, now + 5.0) - now)
        assert silent(its.step(early))
        assert its.next_due(early) == due
        now = early + pause
        hear(its, now, pose(1.0, now - x) if isinstance(x, float) else x)  # which asserts that it is due no more
