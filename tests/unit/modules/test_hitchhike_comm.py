"""What hitchhike_comm makes of its inputs, when it steps, and what it says."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from flat_world import TURTLEBOT
from hitchhike_ros.core.datatypes import Odometry, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.geometry import move
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.modules.hitchhike_comm import HitchhikeComm, HitchhikeCommOutputs, Outcome
from hitchhike_ros.modules.inputs import NetworkText, PlanReport
from hitchhike_ros.modules.module import Level, Refused
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven, NavigationReport
from hitchhike_ros.protocol.messages import Ack, Beacon, Driver, Request, decode, encode
from hitchhike_ros.protocol.observations import Observations
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from protocol_helpers import CAMERA, MARKER_POSE, SITES, messages

GRID = OccupancyGrid(np.zeros((120, 300), dtype=np.int8), 0.1, Pose2D())
HERE, NEAR, FAR = Pose2D(2.0, 5.0, 0.0), Pose2D(8.0, 5.0, 0.0), Pose2D(28.0, 5.0, 0.0)


def comm(**params: object) -> HitchhikeComm:
    return HitchhikeComm(
        "turtlebot",
        HitchhikingParameters(marker_id=1, **params),  # type: ignore[arg-type]
        SITES,
        GlobalPlanner(GlobalPlannerParameters(), TURTLEBOT),
        MARKER_POSE,
        Pose2D(*CAMERA),
        TURTLEBOT.circumscribed_m,
        first_seq=1000,
    )


def estimate(stamp: float, pose: Pose2D = HERE) -> PoseEstimate:
    return PoseEstimate(stamp, pose, 1e-4 * np.eye(3))


def placed(now: float = 10.0, **params: object) -> HitchhikeComm:
    """One that knows its map and its pose, and has stepped once."""
    module = comm(**params)
    module.sense(GRID, now)
    module.sense(estimate(now), now)
    module.step(now)
    return module


def sent(outputs: HitchhikeCommOutputs, cls: type) -> list:
    return [message for message in map(decode, outputs.messages) if isinstance(message, cls)]


def text(message: object, robot_id: str = "p3dx", seq: int = 1, stamp: float = 10.0) -> NetworkText:
    return NetworkText(encode(replace(message, robot_id=robot_id, seq=seq, time_stamp=stamp)), "/p3dx/comm")  # type: ignore[type-var]


def test_it_steps_at_once_when_it_is_new_and_after_time_jumped_back() -> None:
    module = comm()
    assert module.next_due(5.0) <= 5.0
    module.step(5.0)
    assert 5.1 < module.next_due(5.0) <= 5.2
    assert module.next_due(1.0) <= 1.0
    module.step(1.0)
    assert module.next_due(1.0) > 1.0


def test_it_steps_when_its_agent_looks_a_little_early_and_when_a_deadline_is_over() -> None:
    module = placed(10.0, idle_look_period_s=0.7, max_wait_s=5.0)
    assert module.next_due(10.0) == pytest.approx(10.7, abs=0.002)
    module.order(GoalGiven(FAR), 10.0)
    states, now = {}, 10.0
    for _ in range(12):
        now = max(now, module.next_due(now))
        module.sense(estimate(now), now)
        status = module.step(now).status
        if status is not None:
            states.setdefault(status.state, now)
    assert states["requesting"] == 10.0
    assert 15.0 <= states["navigating"] < 15.003


def test_it_steps_at_once_when_servoing_begins_or_ceases_to_follow() -> None:
    module, now = placed(10.0), 10.01
    for stamp, following, at_once in ((10.0, "following", True), (10.1, "following", False), (10.2, "coasting", True)):
        module.sense(Observations(stamp, (), following), now)
        assert (module.next_due(now) <= now) == at_once
        module.step(now)


@pytest.mark.parametrize(
    ("message", "at_once"),
    [
        (Request(robot_id="p3dx", profile=50.0, to="turtlebot", ride_id="r", goal=FAR, x=1.0, y=1.0, theta=0.0), True),
        (Beacon(robot_id="p3dx", profile=50.0, state="idle", priority=10, pose=NEAR), False),
        (Ack(robot_id="p3dx", to="turtlebot", ride_id="r", of="driver", acknowledges=1), False),
    ],
)
def test_a_message_that_wants_an_answer_is_answered_at_once_and_one_that_is_repeated_waits(
    message: object, at_once: bool
) -> None:
    module = placed(10.0)
    module.sense(text(message), 10.01)
    assert (module.next_due(10.01) <= 10.01) == at_once
    assert module.next_due(10.01) <= 10.1
    module.step(module.next_due(10.01))
    assert module.next_due(10.1) > 10.1


def test_messages_carry_numbers_that_count_up_from_the_first_one() -> None:
    module = placed(10.0)
    module.order(GoalGiven(FAR), 10.0)
    seqs, now = [], 10.0
    for _ in range(60):
        now = max(now, module.next_due(now))
        seqs += [decode(message).seq for message in module.step(now).messages]
    assert len(seqs) > 3
    assert seqs == list(range(seqs[0], seqs[0] + len(seqs)))
    assert seqs[0] > 1000


def test_a_goal_is_taken_at_once_and_a_long_way_is_asked_for() -> None:
    module = placed(10.0)
    module.order(GoalGiven(FAR), 10.05)
    assert module.next_due(10.05) <= 10.05
    outputs = module.step(10.05)
    assert [request.goal for request in sent(outputs, Request)] == [FAR]
    assert outputs.status is not None
    assert outputs.status.state == "requesting"


def test_an_old_estimate_is_no_pose() -> None:
    module = placed(10.0)
    module.order(GoalGiven(FAR), 11.5)
    outputs = module.step(11.5)
    assert not sent(outputs, Request)
    assert sent(module.step(11.6), Beacon) == []
    module.sense(estimate(11.65), 11.7)
    assert sent(module.step(11.7), Request)


def test_the_status_comes_when_it_changes_and_once_a_second() -> None:
    module, published, now = placed(10.0), [], 10.0
    for _ in range(30):
        now = module.next_due(now)
        published += [now] if module.step(now).status is not None else []
    assert np.diff(published) == pytest.approx(1.0, abs=0.2)
    module.order(GoalGiven(FAR), now)
    assert module.step(now).status is not None


def test_without_a_plan_the_failure_of_planning_is_what_navigation_says() -> None:
    module = placed(10.0, may_ride=False)
    module.order(GoalGiven(NEAR), 10.0)
    status = module.step(10.0).status
    assert status is not None
    assert status.goal is not None
    goal_id, outcome, now = status.goal.id, None, 10.0
    while outcome is None and now < 60.0:
        now = module.next_due(now)
        module.sense(estimate(now), now)
        module.sense(NavigationReport(goal_id, "driving"), now)
        module.sense(PlanReport(goal_id, "failed", "no way at all"), now)
        outcome = module.step(now).outcome
    assert outcome == Outcome(False, "Navigation failed: no way at all")


def test_a_goal_that_is_reached_has_an_outcome_and_one_that_is_cancelled_too() -> None:
    module = placed(10.0, may_ride=False)
    module.order(GoalGiven(NEAR), 10.0)
    status = module.step(10.0).status
    assert status is not None
    assert status.goal is not None
    module.sense(NavigationReport(status.goal.id, "arrived"), 10.1)
    assert module.step(10.1).outcome == Outcome(True, "Goal reached")
    module.order(GoalGiven(NEAR), 10.2)
    assert module.step(10.2).outcome is None
    module.order(GoalCancelled(), 10.3)
    outcome = module.step(10.3).outcome
    assert outcome is not None
    assert not outcome.reached


def test_a_pose_is_told_once() -> None:
    module = comm()
    module.sense(estimate(10.0), 10.0)
    pose = module.step(10.0).pose
    assert pose is not None
    assert pose.pose == HERE
    assert module.step(10.1).pose is None


def test_a_bad_message_is_counted_each_time_and_reported_once_per_sender_and_period() -> None:
    module = placed(10.0)
    for now in (10.1, 10.2):
        module.sense(NetworkText("{", "/ghost"), now)
    module.sense(NetworkText("{", "/other"), 10.2)
    outputs = module.step(10.3)
    assert [warning.split(":")[0] for warning in outputs.warnings] == ["from /ghost", "from /other"]
    assert outputs.health.counters["dropped"] == outputs.health.counters["dropped_unreadable"] == 3
    module.sense(NetworkText("{", "/ghost"), 20.2)
    assert len(module.step(20.3).warnings) == 1


def test_odometry_that_cannot_be_read_means_that_the_speed_is_unknown() -> None:
    module = placed(10.0)
    module.sense(Odometry(10.0, Pose2D(), Twist2D()), 10.0)
    assert module._situation(10.0).speed_mps == 0.0
    assert module._situation(10.0).odom_pose == Pose2D()
    module.sense(Refused(Odometry, "odometry is not finite", "/base"), 10.1)
    assert module._situation(10.1).speed_mps == math.inf
    assert module._situation(10.1).odom_pose is None


def test_a_driver_that_tells_no_twist_is_named_once_and_the_speed_is_that_of_its_poses() -> None:
    module = placed(10.0)
    warnings: list[str] = []
    for k in range(8):
        module.sense(Odometry(10.0 + 0.1 * k, Pose2D(0.04 * k), Twist2D()), 10.0 + 0.1 * k)
        warnings += module.step(10.0 + 0.1 * k).warnings
    assert warnings == ["odom: no twist in it though the pose moves; it is derived from the poses"]
    assert module._situation(10.7).speed_mps == pytest.approx(0.4)


def test_a_robot_tells_of_no_speed_that_it_cannot_go() -> None:
    class Files:
        robot_id, sites, first_seq = "turtlebot", SITES, 1000

        def load(self, cls: type, section: str) -> object:
            return {RobotLimits: TURTLEBOT, HitchhikingParameters: HitchhikingParameters(**fast)}.get(cls) or cls()

        def mount(self, link: str) -> np.ndarray:
            return np.eye(4)

    fast = {"safe_speed_mps": 3.0, "cruise_speed_mps": 2.0, "ride_speed_mps": 1.9, "may_ride": False, "mode": "network"}
    module = HitchhikeComm.build(Files())  # type: ignore[arg-type]
    for what in (GRID, estimate(10.0)):
        module.sense(what, 10.0)
    module.step(10.0)
    module.order(GoalGiven(FAR), 10.5)
    module.sense(estimate(11.5), 11.5)
    module.step(11.5)
    module.sense(estimate(13.0), 13.0)
    (beacon,) = sent(module.step(13.0), Beacon)
    most_mps = TURTLEBOT.max_speed_mps
    assert beacon.safe_speed_mps == most_mps < 1.0
    (x0, _, t0), *_, (x1, _, t1) = beacon.path
    assert (x1 - x0) / (t1 - t0) == pytest.approx(most_mps)


def test_without_a_map_its_health_says_so() -> None:
    assert comm().step(1.0).health.level is Level.ERROR
    assert placed().step(11.0).health.level is Level.OK


@pytest.mark.parametrize("since_s", [0.05, 0.15, 0.9])
def test_the_pose_that_it_tells_is_of_now_and_not_of_the_last_scan(since_s: float) -> None:
    """At 0.5 m/s in a bend, the pose of a scan of 0.15 s ago was 8 cm off."""
    module, start, twist = comm(beacon_period_s=0.1), Pose2D(5.0, 7.0, 1.0), Twist2D(0.5, 0.6)
    module.sense(GRID, 10.0)
    module.sense(estimate(10.0), 10.0)
    for k in range(round(since_s / 0.05) + 1):
        stamp = 10.0 + 0.05 * k
        module.sense(Odometry(stamp, move(start, twist, stamp - 10.0), twist), stamp)
    (beacon,) = sent(module.step(10.0 + since_s), Beacon)
    expected = move(HERE, twist, since_s)
    assert (beacon.pose.x, beacon.pose.y, beacon.pose.theta) == pytest.approx(astuple(expected), abs=1e-6)


def test_without_odometry_the_pose_is_that_of_the_last_scan() -> None:
    module = comm()
    module.sense(GRID, 10.0)
    module.sense(estimate(9.8), 10.0)
    (beacon,) = sent(module.step(10.0), Beacon)
    assert beacon.pose == HERE


def test_a_message_that_waits_for_the_next_step_is_older_then() -> None:
    module, heard = placed(), []
    step = module._agent.step
    module._agent.step = lambda event, now: [heard.append(event), *step(event, now)][1:]  # type: ignore[method-assign]
    told, ack = replace(messages()[Driver], age_s=0.1), replace(messages()[Ack], seen_age_s=0.2)
    module.sense(text(told, seq=1), 10.02)
    module.sense(text(ack, seq=2), 10.06)
    module.step(10.1)
    assert [m.age_s for m in heard if isinstance(m, Driver)] == [pytest.approx(0.18)]
    assert [m.seen_age_s for m in heard if isinstance(m, Ack)] == [pytest.approx(0.24)]
