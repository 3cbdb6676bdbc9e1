"""What it decides on, when, and for want of what it stands."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flat_world import LASER, TURTLEBOT, FlatWorld
from hitchhike_ros.control.leg import Decision
from hitchhike_ros.control.local_planner import LocalPlanner
from hitchhike_ros.control.teleop_authority import TeleopAuthorityParameters
from hitchhike_ros.control.wall_alignment import WallAlignmentParameters
from hitchhike_ros.control.wheel_watch import STANDING
from hitchhike_ros.core.datatypes import LaserScan, Odometry, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import compose, distance
from hitchhike_ros.modules import obstacle_avoidance
from hitchhike_ros.modules.inputs import NO_PATH, NavigationCommand, PlannedPath, TeleopActive, TeleopCommand
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Health, Level, Refused
from hitchhike_ros.modules.obstacle_avoidance import (
    ObstacleAvoidance,
    ObstacleAvoidanceOutputs,
    ObstacleAvoidanceParameters,
    leads_to,
)
from hitchhike_ros.protocol.events import GoalCancelled, NavigationReport
from hitchhike_ros.protocol.status import GoalCommand, KnownRobot, ModuleSwitches, Status
from plain_files import plain_files

PARAMS = ObstacleAvoidanceParameters()
MAX_AGE_S, WAIT_S = PARAMS.max_age_s, PARAMS.pose_wait_s
GOAL = GoalCommand("1", 5.0, 1.5, 0.0, tolerance_m=0.12, tolerance_rad=0.1)
ON = Status(0.0, "p3dx", state="navigating", goal=GOAL)
IDLE = Status(0.0, "p3dx")
OFF = replace(ON, modules=ModuleSwitches(OBS=False))
HERE, STAND = Pose2D(2.0, 1.5), NavigationCommand(Twist2D())
PLAN = PlannedPath(np.array([(2.0, 1.5), (3.5, 1.5), (5.0, 1.5)]), GOAL.pose)
# A corridor along x, 3 m wide.
WALLS = ((0.0, 3.0, 30.0, 0.2), (0.0, -0.2, 30.0, 0.2))
AHEAD = Twist2D(0.3, 0.1)


def scan(stamp: float, pose: Pose2D = HERE) -> LaserScan:
    return replace(FlatWorld(TURTLEBOT, WALLS, pose).scan(), stamp=stamp)


def pose(stamp: float, at: Pose2D = HERE) -> PoseEstimate:
    return PoseEstimate(stamp, at, np.zeros((3, 3)))


def odometry(stamp: float, at: Pose2D = HERE, twist: Twist2D = Twist2D()) -> Odometry:  # noqa: B008  (frozen)
    return Odometry(stamp, at, twist)


@dataclass
class Recorder:
    """In place of the local planner: does as it is told, and keeps what it was given."""

    decision: Decision = field(default_factory=lambda: Decision(AHEAD, "driving"))
    paths: list[tuple[Any, ...]] = field(default_factory=list)
    steps: list[tuple[Any, ...]] = field(default_factory=list)
    cleared: int = 0
    refuses: bool = False

    def set_path(self, *path: Any) -> None:
        if self.refuses:
            raise PlanningError("path ends 3.00 m from the goal")
        self.paths.append(path)

    def clear(self) -> None:
        self.cleared += 1

    def step(self, *given: Any) -> Decision:
        self.steps.append(given)
        return self.decision


def make(planner: Any) -> ObstacleAvoidance:
    limits = TURTLEBOT
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(obstacle_avoidance, "LocalPlanner", lambda *_: planner)
        return ObstacleAvoidance(
            PARAMS, WallAlignmentParameters(), TeleopAuthorityParameters(), limits, LASER[TURTLEBOT]
        )


def hear(its: ObstacleAvoidance, now: float, *inputs: object) -> ObstacleAvoidanceOutputs | None:
    """Hand on inputs and orders at ``now`` and step it as a host would: the outputs, None where it was not due."""
    for x in inputs:
        if isinstance(x, Status):
            its.order(x, now)
        elif (x.what if isinstance(x, Refused) else type(x)) in its.listens():
            its.sense(x, now)
    if its.next_due(now) > now:
        return None
    outputs = its.step(now)
    assert its.next_due(now) > now
    return outputs


def silent(outputs: ObstacleAvoidanceOutputs | None) -> bool:
    """Whether nothing new is published."""
    return outputs is None or (outputs.command is None and outputs.report is None)


def frame(its: ObstacleAvoidance, now: float, *others: object) -> ObstacleAvoidanceOutputs:
    """All that comes with a scan at ``now``."""
    outputs = hear(its, now, odometry(now), pose(now), *others, scan(now))
    assert outputs is not None
    assert outputs.answered == now
    return outputs


@pytest.fixture
def planner() -> Recorder:
    return Recorder()


@pytest.fixture
def its(planner: Recorder) -> ObstacleAvoidance:
    """One that is on its way at 10 s."""
    module = make(planner)
    hear(module, 9.9, ON, PLAN)
    assert frame(module, 10.0).report == NavigationReport("1", "driving")
    return module


# On, off and idle.


def test_at_first_it_is_off_and_idle(planner: Recorder) -> None:
    module = make(planner)
    assert module.listens() == frozenset()
    outputs = hear(module, 3.0)
    assert outputs == ObstacleAvoidanceOutputs(health=Health(Level.OK, "off"), report=NavigationReport("", "idle"))
    assert module.next_due(1e9) == math.inf
    assert hear(module, 4.0, scan(4.0)) is None


def test_without_a_goal_a_scan_is_answered_and_nothing_else(planner: Recorder) -> None:
    module = make(planner)
    hear(module, 3.0)
    hear(module, 3.0, IDLE)
    assert module.listens() == module.inputs
    outputs = hear(module, 3.1, odometry(3.1), scan(3.1))
    assert silent(outputs)
    assert (outputs.answered, outputs.health) == (3.1, Health(Level.OK, "idle"))
    assert module.next_due(3.1) == 3.0 + ORDER_MAX_AGE_S


@pytest.mark.parametrize("status", [OFF, replace(ON, goal=None)])
def test_when_the_goal_ends_it_stands_once_and_says_so(
    its: ObstacleAvoidance, planner: Recorder, status: Status
) -> None:
    cleared = planner.cleared
    outputs = hear(its, 10.05, status)
    assert (outputs.command, outputs.report) == (STAND, NavigationReport("", "idle"))
    assert outputs.health == Health(Level.OK, "off" if status is OFF else "idle")
    assert planner.cleared > cleared
    assert silent(hear(its, 10.1, status))
    assert its.next_due(10.1) == (math.inf if status is OFF else 10.1 + ORDER_MAX_AGE_S)


def test_a_scan_that_waits_is_answered_when_the_goal_ends(its: ObstacleAvoidance) -> None:
    assert hear(its, 10.1, scan(10.1)) is None
    assert hear(its, 10.12, replace(ON, goal=None)).answered == 10.1


def test_what_was_seen_before_it_was_off_says_nothing_about_now(its: ObstacleAvoidance) -> None:
    assert hear(its, 10.1, Refused(Odometry, "not finite")).report.reason == "not finite"
    hear(its, 10.15, OFF)
    hear(its, 10.2, ON)
    assert hear(its, 10.21, scan(10.21), pose(10.21)).report == NavigationReport("1", "blocked", "no odometry")
    assert hear(its, 10.22, odometry(10.22), scan(10.22), pose(10.22)).report.reason == "no plan to the goal"
    hear(its, 10.25, OFF)
    hear(its, 10.3, ON)
    hear(its, 10.31, odometry(10.31), scan(10.31))
    assert hear(its, 10.31 + WAIT_S).report == NavigationReport("1", "blocked", "no pose")


def test_what_was_silent_while_it_was_off_is_not_silent_now(its: ObstacleAvoidance) -> None:
    outputs = hear(its, 15.0, OFF, ON)  # together: it has been off for less than a step
    assert silent(outputs)
    assert its.next_due(15.0) == 15.0 + MAX_AGE_S


def test_a_status_that_changes_nothing_forgets_nothing(its: ObstacleAvoidance, planner: Recorder) -> None:
    assert silent(hear(its, 10.05, ON))
    assert frame(its, 10.1).command == NavigationCommand(AHEAD)
    assert len(planner.paths) == 1


# Along a plan.


def test_it_drives_to_the_goal_and_stays_there() -> None:
    world = FlatWorld(TURTLEBOT, WALLS, HERE, now=10.0)
    planner = LocalPlanner(TURTLEBOT, PARAMS)
    module = make(planner)
    hear(module, 10.0, ON, PLAN)
    reports = []
    while world.now < 40.0:
        hear(module, world.now, replace(ON, time_stamp=world.now), odometry(world.now, world.pose, world.twist))
        outputs = hear(module, world.now, world.scan(), pose(world.now, world.pose))
        assert outputs.answered == world.now
        assert outputs.command is not None
        reports += [] if outputs.report is None else [outputs.report]
        world.drive(outputs.command.twist)
    assert reports == [NavigationReport("1", "driving"), NavigationReport("1", "arrived")]
    assert outputs.health == Health(Level.OK, "arrived")
    assert outputs.command == STAND
    assert distance(world.pose, GOAL.pose) <= GOAL.tolerance_m
    # Nothing that goes wrong makes it less there.
    assert silent(hear(module, world.now, Refused(Odometry, "not finite")))
    assert hear(module, world.now, pose(world.now), scan(world.now)).command == STAND
    assert silent(hear(module, world.now + MAX_AGE_S))


def test_what_the_local_planner_is_given(its: ObstacleAvoidance, planner: Recorder) -> None:
    (path,) = planner.paths
    assert path == (PLAN.points, GOAL.pose, GOAL.tolerance_m, GOAL.tolerance_rad)
    now, at, twist, seen, T_base_laser, limit, gentle, others, hand = planner.steps[-1]
    assert (now, at, twist, seen.stamp, T_base_laser) == (10.0, HERE, Twist2D(), 10.0, LASER[TURTLEBOT])
    assert (limit, gentle, others, hand) == (TURTLEBOT.max_speed_mps, False, [], None)
    robot = KnownRobot(4.0, 1.0, 0.3)
    status = replace(ON, role="driver", state="driving", speed_limit_mps=0.2, robots=(robot,))
    hear(its, 10.05, odometry(10.05, twist=AHEAD), status)
    hear(its, 10.1, pose(10.1), scan(10.1))
    assert planner.steps[-1][2] == AHEAD
    assert planner.steps[-1][5:8] == (0.2, True, [(Pose2D(4.0, 1.0), 0.3)])


def test_a_decision_is_passed_on_and_reported_when_it_changes(its: ObstacleAvoidance, planner: Recorder) -> None:
    outputs = frame(its, 10.1)
    assert (outputs.command, outputs.report) == (NavigationCommand(AHEAD), None)
    assert outputs.health == Health(Level.OK, "driving")
    planner.decision = Decision(Twist2D(0.0, 0.5), "blocked", "no way; turning to look")
    outputs = frame(its, 10.2)
    assert outputs.command == NavigationCommand(Twist2D(0.0, 0.5))
    assert outputs.report == NavigationReport("1", "blocked", "no way; turning to look")
    assert outputs.health == Health(Level.ERROR, "blocked: no way; turning to look")


def test_wheels_that_stand_against_the_command_are_reported_within_a_second(its: ObstacleAvoidance) -> None:
    said = [frame(its, 10.0 + 0.1 * k) for k in range(1, 13)]
    assert all(outputs.command == NavigationCommand(AHEAD) for outputs in said), "it goes on as soon as it can"
    reports = [outputs.report for outputs in said if outputs.report is not None]
    assert reports == [NavigationReport("1", "blocked", STANDING)]
    assert said[-1].health == Health(Level.ERROR, f"blocked: {STANDING}")
    assert [outputs.report is not None for outputs in said].index(True) <= 10
    hear(its, 11.3, odometry(11.3, twist=AHEAD), pose(11.3))
    outputs = hear(its, 11.3, scan(11.3))
    assert outputs is not None
    assert outputs.report == NavigationReport("1", "driving")


def test_who_stands_because_of_something_else_is_not_told_that_its_wheels_do(its: ObstacleAvoidance) -> None:
    frame(its, 10.1)
    stands(hear(its, 10.2, Refused(LaserScan, "empty", "/laser", 10.2)), "empty")
    hear(its, 11.5, ON)
    assert frame(its, 11.6).report == NavigationReport("1", "driving")


def test_a_new_plan_and_a_new_goal_are_taken_up_once(its: ObstacleAvoidance, planner: Recorder) -> None:
    frame(its, 10.1)
    assert len(planner.paths) == 1
    frame(its, 10.2, replace(PLAN))
    assert len(planner.paths) == 2
    frame(its, 10.3, replace(ON, goal=replace(GOAL, id="2")))
    assert len(planner.paths) == 3
    frame(its, 10.4)
    assert len(planner.paths) == 3


@pytest.mark.parametrize(
    ("end", "leads"),
    [
        (GOAL.pose, True),
        (Pose2D(5.19, 1.5), True),
        (Pose2D(5.0, 1.71), False),
        (Pose2D(5.0, 1.5, 0.019), True),
        (Pose2D(5.0, 1.5, -0.021), False),
        (Pose2D(5.0, 1.5, math.tau), True),
        (Pose2D(5.0, 1.5, math.nan), False),
        (None, False),
    ],
)
def test_a_plan_to_another_goal_is_not_followed(end: Pose2D | None, leads: bool) -> None:
    assert leads_to(replace(PLAN, end=end), GOAL) == leads


@pytest.mark.parametrize("plan", [None, NO_PATH, replace(PLAN, end=Pose2D(5.0, 2.5))])
def test_without_a_plan_to_the_goal_it_stands(planner: Recorder, plan: PlannedPath | None) -> None:
    module = make(planner)
    hear(module, 9.9, ON)
    outputs = frame(module, 10.0, *([] if plan is None else [plan]))
    assert outputs.command == STAND
    assert outputs.report == NavigationReport("1", "idle", "no plan to the goal")
    assert outputs.health == Health(Level.WARN, "idle: no plan to the goal")
    assert planner.steps == []


@pytest.mark.parametrize("gone", [NO_PATH, Refused(PlannedPath, "?")])
def test_a_plan_that_is_withdrawn_is_followed_no_more(its: ObstacleAvoidance, planner: Recorder, gone: object) -> None:
    cleared = planner.cleared
    assert frame(its, 10.1, gone).report.reason == "no plan to the goal"
    assert planner.cleared > cleared
    frame(its, 10.2, PLAN)
    assert len(planner.paths) == 2


def test_a_plan_that_cannot_be_used_is_no_reason_to_drive(planner: Recorder) -> None:
    planner.refuses = True
    module = make(planner)
    hear(module, 9.9, ON, PLAN)
    outputs = frame(module, 10.0)
    assert outputs.report == NavigationReport("1", "blocked", "path ends 3.00 m from the goal")
    assert (outputs.command, outputs.health.level) == (STAND, Level.ERROR)
    planner.refuses = False
    assert frame(module, 10.1).command == NavigationCommand(AHEAD)


# Parallel to a wall.


def test_a_turn_along_a_wall_needs_no_plan_and_is_taken_up_once(planner: Recorder) -> None:
    module = make(planner)
    hear(module, 9.9, replace(ON, goal=replace(GOAL, theta=0.2, along_wall="left")))
    assert frame(module, 10.0).command == NavigationCommand(AHEAD)
    ((path, end, tolerance_m, tolerance_rad),) = planner.paths
    assert path.tolist() == [[HERE.x, HERE.y]]
    assert (end.x, end.y) == (HERE.x, HERE.y)
    assert end.theta == pytest.approx(0.0, abs=0.02)
    assert (tolerance_m, tolerance_rad) == (GOAL.tolerance_m, GOAL.tolerance_rad)
    frame(module, 10.1)
    assert len(planner.paths) == 1
    frame(module, 10.2, replace(ON, goal=replace(GOAL, id="2", along_wall="left")))
    assert len(planner.paths) == 2


def test_the_same_turn_is_taken_up_anew_after_the_goal_has_ended(planner: Recorder) -> None:
    module, along = make(planner), replace(ON, goal=replace(GOAL, along_wall="left"))
    hear(module, 9.9, along)
    frame(module, 10.0)
    hear(module, 10.05, replace(ON, goal=None))
    hear(module, 10.06, along)
    frame(module, 10.1)
    assert len(planner.paths) == 2


def test_without_a_wall_it_stands_and_looks_again(planner: Recorder) -> None:
    module = make(planner)
    hear(module, 9.9, replace(ON, goal=replace(GOAL, along_wall="left")))
    far = replace(scan(10.0), ranges=np.full(271, np.inf))
    outputs = hear(module, 10.0, odometry(10.0), pose(10.0), far)
    assert outputs.report == NavigationReport("1", "blocked", "no wall on the left along 0°")
    assert outputs.command == STAND
    assert frame(module, 10.1).command == NavigationCommand(AHEAD)


# The pose of a scan.


def test_a_scan_waits_for_its_pose(its: ObstacleAvoidance, planner: Recorder) -> None:
    hear(its, 10.1, odometry(10.1))
    assert hear(its, 10.1, scan(10.1)) is None
    assert its.next_due(10.1) == 10.1 + WAIT_S
    assert hear(its, 10.12, pose(10.05)) is None  # of another moment
    there = Pose2D(2.05, 1.5)
    outputs = hear(its, 10.14, pose(10.1, there))
    assert (outputs.answered, outputs.command) == (10.1, NavigationCommand(AHEAD))
    assert planner.steps[-1][:2] == (10.14, there)


@pytest.mark.parametrize("late", [0.05, 0.2])
def test_a_pose_of_another_moment_is_carried_on_by_odometry(
    its: ObstacleAvoidance, planner: Recorder, late: float
) -> None:
    twist = Twist2D(0.5, 0.4)
    start = Pose2D(0.3, -0.2, 0.7)  # in odom
    move = Pose2D(0.02, 0.0, 0.016)
    hear(its, 10.1, Refused(Odometry, "begins anew"))
    for i in range(8):
        hear(its, 10.1 + 0.04 * i, odometry(10.1 + 0.04 * i, start, twist))
        start = compose(start, move)
    hear(its, 10.4, pose(10.4 - late, Pose2D(3.0, 1.0, 0.5)))
    hear(its, 10.4, scan(10.4))
    outputs = hear(its, 10.4 + WAIT_S)
    assert outputs.answered == 10.4
    carried = Pose2D(3.0, 1.0, 0.5)
    for _ in range(round(late / 0.001)):
        carried = compose(carried, Pose2D(0.0005, 0.0, 0.0004))
    at = planner.steps[-1][1]
    assert distance(at, carried) < 1e-3
    assert at.theta == pytest.approx(carried.theta, abs=1e-3)


def test_a_pose_that_does_not_come_is_awaited_once(its: ObstacleAvoidance) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    assert hear(its, 10.1 + WAIT_S - 1e-6) is None
    assert hear(its, 10.1 + WAIT_S).answered == 10.1
    assert hear(its, 10.21, odometry(10.21), scan(10.21)).answered == 10.21  # at once
    hear(its, 10.25, pose(10.21))
    assert hear(its, 10.3, odometry(10.3), scan(10.3)) is None  # now they come again


@pytest.mark.parametrize("trouble", [Refused(Odometry, "not finite"), None])
def test_no_pose_is_awaited_that_would_not_help(its: ObstacleAvoidance, trouble: Refused | None) -> None:
    now = 10.1 if trouble else 10.0 + MAX_AGE_S + 0.05  # odometry has not come since 10.0
    hear(its, now, *([trouble] if trouble else []), pose(now - 0.1))
    outputs = hear(its, now, scan(now))
    assert (outputs.answered, outputs.command) == (now, STAND)
    assert hear(its, now + 0.1, odometry(now + 0.1), scan(now + 0.1)) is None  # that one is waited for again


def test_a_newer_scan_takes_the_place_of_one_that_waits_but_waits_no_longer(its: ObstacleAvoidance) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    assert hear(its, 10.17, scan(10.17)) is None
    assert its.next_due(10.17) == 10.1 + WAIT_S
    assert hear(its, 10.1 + WAIT_S).answered == 10.17
    hear(its, 10.25, pose(10.17))
    hear(its, 10.3, scan(10.3))
    assert its.next_due(10.3) == 10.3 + WAIT_S


# For want of what it stands.


def stands(outputs: ObstacleAvoidanceOutputs | None, reason: str) -> None:
    assert outputs is not None
    assert outputs.command == STAND
    assert outputs.report == NavigationReport("1", "blocked", reason)
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, f"blocked: {reason}")


@pytest.mark.parametrize(
    ("refused", "counter"),
    [(Refused(LaserScan, "5 NaN beams", stamp=10.1), "bad_scans"), (Refused(Odometry, "not finite"), "bad_odometry")],
)
def test_it_stands_at_once_when_a_sensor_talks_nonsense(its: ObstacleAvoidance, refused: Refused, counter: str) -> None:
    outputs = hear(its, 10.1, refused)
    stands(outputs, refused.reason)
    assert outputs.health.counters == {counter: 1}
    assert outputs.answered == refused.stamp
    assert frame(its, 10.2).command == NavigationCommand(AHEAD)
    assert hear(its, 10.3, refused).health.counters == {counter: 2}


def test_bad_beams_are_left_out_and_their_share_is_told(its: ObstacleAvoidance) -> None:
    ranges = scan(10.1).ranges.copy()
    ranges[::4] = np.nan
    outputs = hear(its, 10.1, odometry(10.1), pose(10.1), replace(scan(10.1), ranges=ranges))
    assert (outputs.command, outputs.health.level) == (NavigationCommand(AHEAD), Level.OK)
    assert outputs.health.counters == {"bad_beam_share": pytest.approx(0.25, abs=0.002)}
    assert frame(its, 10.2).health.counters == {}


def test_a_scan_of_bad_beams_is_refused_whether_or_not_there_is_a_pose(its: ObstacleAvoidance) -> None:
    """Its pose does not come either, as slam cannot use it: that is not the reason to be told."""
    n = scan(10.1).ranges.size
    outputs = hear(its, 10.1, odometry(10.1), replace(scan(10.1), ranges=np.full(n, np.nan)))
    stands(
        outputs, f"scan: {n} of {n} beams are NaN or below range_min 0.02 m, expected at most 90% (scan/max_bad_share)"
    )
    assert outputs.health.counters == {"bad_beam_share": 1.0, "bad_scans": 1}
    assert outputs.answered == 10.1


def test_nonsense_is_no_scan_to_decide_on(its: ObstacleAvoidance) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    stands(hear(its, 10.12, Refused(LaserScan, "NaN", stamp=10.12)), "NaN")
    assert its.next_due(10.12) == 10.12 + MAX_AGE_S  # of silence: it has been heard


def test_after_senseless_odometry_no_scan_is_driven_by_until_it_is_well_again(its: ObstacleAvoidance) -> None:
    hear(its, 10.05, Refused(Odometry, "not finite"))
    outputs = hear(its, 10.1, pose(10.1), scan(10.1))
    assert (outputs.command, outputs.report) == (STAND, None)
    assert outputs.health.reason == "blocked: not finite"
    hear(its, 10.15, odometry(10.15))
    assert frame(its, 10.2).report == NavigationReport("1", "driving")


def test_odometry_that_jumps_is_senseless(its: ObstacleAvoidance) -> None:
    outputs = hear(its, 10.1, odometry(10.1, Pose2D(50.0)))
    assert outputs.command == STAND
    assert "jumped" in outputs.report.reason
    assert outputs.health.counters == {"bad_odometry": 1}


@pytest.mark.parametrize("bad", [Refused(PoseEstimate, "pose is not finite"), pose(10.1, Pose2D(math.nan))])
def test_a_senseless_pose_ends_the_wait_for_it_and_the_one_before(its: ObstacleAvoidance, bad: object) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    outputs = hear(its, 10.12, bad)
    stands(outputs, "pose is not finite")
    assert (outputs.answered, outputs.health.counters) == (10.1, {"bad_poses": 1})
    assert frame(its, 10.2).command == NavigationCommand(AHEAD)


@pytest.mark.parametrize(
    ("inputs", "reason"),
    [
        ([pose(10.0), scan(10.0)], "no odometry"),
        ([odometry(9.7), pose(10.0), scan(10.0)], f"odometry is more than {MAX_AGE_S} s off the scan"),
        ([odometry(10.3), pose(10.0), scan(10.0)], f"odometry is more than {MAX_AGE_S} s off the scan"),
        ([odometry(10.0), scan(10.0)], "no pose"),
        ([odometry(9.7), odometry(10.0), pose(9.7), scan(10.0)], f"pose is more than {MAX_AGE_S} s off the scan"),
        ([odometry(10.0), pose(10.3), scan(10.0)], f"pose is more than {MAX_AGE_S} s off the scan"),
        ([odometry(10.0), pose(10.2), scan(10.0)], None),
    ],
    ids=["no odometry", "old odometry", "odometry to come", "no pose", "old pose", "pose to come", "all there"],
)
def test_what_is_missing_or_old(planner: Recorder, inputs: list[object], reason: str | None) -> None:
    module = make(planner)
    hear(module, 9.9, ON, PLAN)
    outputs = hear(module, 10.0, *inputs)
    outputs = hear(module, 10.0 + WAIT_S) if outputs is None else outputs
    assert outputs.answered == 10.0
    if reason is None:
        assert outputs.command == NavigationCommand(AHEAD)
    else:
        stands(outputs, reason)
        assert planner.steps == []


def test_a_pose_from_before_the_odometry_is_not_carried_on(planner: Recorder) -> None:
    module = make(planner)
    hear(module, 9.9, ON, PLAN)
    hear(module, 10.0, odometry(10.0), pose(9.78), scan(10.0))
    outputs = hear(module, 10.0 + WAIT_S)
    assert outputs.command == STAND
    assert "pose or scan at 9.78 s, but odometry from 10.00 s" in outputs.report.reason


def test_without_scans_it_stands_and_goes_on_standing(its: ObstacleAvoidance) -> None:
    assert its.next_due(10.0) == 10.0 + MAX_AGE_S
    assert hear(its, 10.2, odometry(10.2), pose(10.2)) is None
    reason = f"no scan for {MAX_AGE_S} s"
    stands(hear(its, 10.0 + MAX_AGE_S), reason)
    outputs = hear(its, 10.0 + 2 * MAX_AGE_S)
    assert (outputs.command, outputs.report) == (STAND, None)
    assert frame(its, 10.7).command == NavigationCommand(AHEAD)


def test_a_scan_that_is_decided_on_late_is_no_silence(its: ObstacleAvoidance, planner: Recorder) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    assert hear(its, 10.1 + MAX_AGE_S).command == NavigationCommand(AHEAD)
    stands(hear(its, 10.1 + 2 * MAX_AGE_S), f"no scan for {MAX_AGE_S} s")


def test_silence_counts_from_a_new_goal(planner: Recorder) -> None:
    module = make(planner)
    hear(module, 5.0, IDLE)
    assert silent(hear(module, 8.0, ON))
    assert module.next_due(8.0) == 8.0 + MAX_AGE_S
    assert silent(hear(module, 8.2, ON))
    assert module.next_due(8.2) == 8.0 + MAX_AGE_S
    assert silent(hear(module, 8.24, replace(ON, goal=replace(GOAL, id="2"))))
    assert module.next_due(8.24) == 8.24 + MAX_AGE_S


def test_an_order_that_is_not_repeated_ends_and_scans_are_only_answered(
    its: ObstacleAvoidance, planner: Recorder
) -> None:
    now, end = 10.1, 9.9 + ORDER_MAX_AGE_S
    while now < end:
        frame(its, now)
        now += 0.1
    assert its.next_due(now - 0.1) == end
    stands(hear(its, end), f"no status for {ORDER_MAX_AGE_S} s")
    steps = len(planner.steps)
    outputs = frame(its, now)
    assert (outputs.command, outputs.report) == (STAND, None)
    assert len(planner.steps) == steps
    assert its.next_due(now) == math.inf
    its.order(GoalCancelled(), now)
    assert hear(its, now) is None
    assert silent(hear(its, now, ON))
    assert frame(its, now + 0.1).command == NavigationCommand(AHEAD)


def test_without_a_goal_the_health_says_that_orders_have_ceased(planner: Recorder) -> None:
    module = make(planner)
    hear(module, 5.0, IDLE)
    outputs = hear(module, 5.0 + ORDER_MAX_AGE_S)
    assert silent(outputs)
    assert outputs.health == Health(Level.ERROR, f"no status for {ORDER_MAX_AGE_S} s")
    assert module.next_due(9.0) == math.inf


def test_when_the_clock_is_set_back_it_begins_anew(its: ObstacleAvoidance, planner: Recorder) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    assert its.next_due(2.0) <= 2.0
    hear(its, 2.0, ON, odometry(2.0))  # which runs back in time
    assert its.next_due(2.0) == 2.0 + MAX_AGE_S
    hear(its, 2.05, odometry(2.05))
    assert hear(its, 2.1, scan(2.1), pose(2.1), odometry(2.1)).command == NavigationCommand(AHEAD)
    hear(its, 2.2, scan(2.2))
    assert its.next_due(2.2) == 2.2 + WAIT_S


def test_a_scan_from_before_the_clock_was_set_back_is_answered(its: ObstacleAvoidance) -> None:
    hear(its, 10.1, odometry(10.1), scan(10.1))
    assert its.step(2.0).answered == 10.1
    assert its.next_due(2.0) > 2.0


# A human who drives.


def hand(planner: Recorder) -> Twist2D | None:
    return planner.steps[-1][-1]


def test_a_human_is_followed_where_the_status_lets_him(its: ObstacleAvoidance, planner: Recorder) -> None:
    assert hear(its, 10.05, TeleopCommand(AHEAD)) is None
    frame(its, 10.1)
    assert hand(planner) == AHEAD
    frame(its, 10.2, replace(ON, role="driver", state="aligning"))
    assert hand(planner) is None
    frame(its, 10.3, ON)
    assert hand(planner) == AHEAD
    frame(its, 10.6)
    assert hand(planner) is None  # that was long ago, and nobody has it in hand


def test_in_hand_it_stands_until_it_is_told_to_go_or_is_given_back(its: ObstacleAvoidance, planner: Recorder) -> None:
    assert hear(its, 10.05, TeleopActive(True)) is None
    frame(its, 10.1)
    assert hand(planner) == Twist2D()
    hear(its, 10.15, TeleopActive(False))
    frame(its, 10.2)
    assert hand(planner) is None


def test_it_stands_when_the_human_is_out_of_reach(its: ObstacleAvoidance) -> None:
    hear(its, 10.05, TeleopActive(True))
    now = 10.1
    while now < 12.0:
        frame(its, now)
        now += 0.1
    stands(frame(its, 12.1), "the human who drives is out of reach")


def test_each_status_tells_of_the_rider(its: ObstacleAvoidance, planner: Recorder) -> None:
    rides = replace(ON, role="driver", state="driving")
    hear(its, 10.05, rides)
    for i in range(1, 8):
        now, there = 10.0 + 0.1 * i, Pose2D(2.0 + 0.25 * i, 1.5)
        orders = [rides] if i == 4 else []
        inputs = (TeleopCommand(AHEAD), odometry(now, there), pose(now, there), scan(now))
        assert hear(its, now, *orders, *inputs).command == NavigationCommand(AHEAD)
    stands(
        hear(
            its, 10.9, TeleopCommand(AHEAD), odometry(10.9, Pose2D(4.3, 1.5)), pose(10.9, Pose2D(4.3, 1.5)), scan(10.9)
        ),
        "hhike_msg/status does not tell of the rider",
    )


@pytest.mark.parametrize("bad", [TeleopCommand(Twist2D(math.nan)), Refused(TeleopCommand, "too short")])
def test_a_senseless_word_is_counted_and_ends_the_one_before(
    its: ObstacleAvoidance, planner: Recorder, bad: object
) -> None:
    hear(its, 10.05, TeleopCommand(AHEAD))
    outputs = hear(its, 10.06, bad)
    assert silent(outputs)
    assert outputs.health.counters == {"bad_teleop": 1}
    frame(its, 10.1)
    assert hand(planner) is None


def test_a_message_that_does_not_tell_who_has_it_in_hand_is_counted(its: ObstacleAvoidance) -> None:
    assert hear(its, 10.05, Refused(TeleopActive, "?")).health.counters == {"bad_teleop": 1}


def test_it_is_made_of_a_robots_files() -> None:
    changes = {"obstacle_avoidance": {"pose_wait_s": 0.2}, "teleop_authority": {"command_timeout_s": 0.05}}
    module = ObstacleAvoidance.build(plain_files("turtlebot", **changes))
    hear(module, 9.9, ON, PLAN)
    assert frame(module, 10.0).report == NavigationReport("1", "driving")
    hear(module, 10.1, scan(10.1))
    assert module.next_due(10.1) == pytest.approx(10.3)
    driven = hear(module, 10.12, pose(10.1)).command.twist.v
    stopped = frame(module, 10.2, TeleopCommand(Twist2D())).command.twist.v
    again = frame(module, 10.3).command.twist.v  # the word is too old by now
    assert stopped < driven
    assert stopped < again


# Pace.

inputs = st.sampled_from(
    [ON, OFF, replace(ON, goal=None), replace(ON, goal=replace(GOAL, id="2")), PLAN, NO_PATH]
    + [Refused(LaserScan, "?", stamp=0.0), Refused(Odometry, "?"), TeleopCommand(AHEAD), TeleopActive(True)]
)
sensed = st.sampled_from(["scan", "pose", "odometry", "all"])
pauses = st.floats(0.0, 0.3) | st.sampled_from([0.0, WAIT_S, MAX_AGE_S, ORDER_MAX_AGE_S, -1000.0])


@given(st.lists(st.tuples(pauses, st.floats(0.0, 0.99), inputs | sensed), max_size=30))
def test_nothing_happens_before_it_is_due_and_then_it_is_done(events: list[tuple[float, float, object]]) -> None:
    module, now, seen = make(Recorder()), 50.0, scan(0.0)
    hear(module, now)
    for pause, share, x in events:
        due = module.next_due(now)
        early = now + share * (min(due, now + 5.0) - now)
        outputs = module.step(early)
        assert silent(outputs) or (outputs.report is None and "no status" in outputs.health.reason)  # it stands on
        assert module.next_due(early) == due
        now = early + pause
        made = {"scan": replace(seen, stamp=now), "pose": pose(now), "odometry": odometry(now)}
        hear(module, now, *(made.values() if x == "all" else [made.get(x, x) if isinstance(x, str) else x]))


@given(st.lists(st.tuples(st.floats(0.0, 0.12), sensed), min_size=1, max_size=30))
def test_every_scan_is_answered_in_time(events: list[tuple[float, str]]) -> None:
    """For lock-step: by the next scan, or when its pose has been awaited."""
    module, now, seen = make(Recorder()), 50.0, scan(0.0)
    hear(module, now, ON, PLAN)
    waits: list[float] = []
    for pause, what in events:
        end = now + pause
        while (due := max(module.next_due(now), now)) <= end:
            now, answered = due, module.step(due).answered
            waits = [stamp for stamp in waits if answered is None or stamp > answered]
        now = end
        assert all(now < stamp + WAIT_S for stamp in waits)
        made = {"scan": replace(seen, stamp=now), "pose": pose(now), "odometry": odometry(now)}
        chosen = list(made.values()) if what == "all" else [made[what]]
        waits += [now] if what in ("scan", "all") else []
        outputs = hear(module, now, *chosen)
        if outputs is not None and outputs.answered is not None:
            waits = [stamp for stamp in waits if stamp > outputs.answered]
