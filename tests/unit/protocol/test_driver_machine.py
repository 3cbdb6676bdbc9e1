"""The driver's table: P17 Algorithm 1 with its denials, timeouts and losses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import UnreachableError
from hitchhike_ros.core.geometry import compose
from hitchhike_ros.protocol.driver.facts import ENGAGED, WITH_RIDER
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import Award, GoalCancelled, GoalGiven, Tick
from hitchhike_ros.protocol.messages import (
    MESSAGE_TYPES,
    Accept,
    Ack,
    Aligned,
    Coupled,
    Decouple,
    Deny,
    Driver,
    Lock,
    Message,
    Request,
    RequestCancel,
    Terminate,
)
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.protocol.status import ANY_MARKER, ModuleSwitches, ServoCommand
from protocol_helpers import BOXES, DRIVER, DRIVER_GOAL, RIDER, SIGMA, SITES, Bench, corridor_path, driver_in, messages

S = DriverState


def _walled(_start: Pose2D, _goal: Pose2D) -> FloatArray:
    raise UnreachableError("no way")


# Handshake.


@pytest.mark.parametrize(
    ("params", "request_changes", "driver_pose", "goal", "planner", "reason"),
    [
        ({}, {}, Pose2D(10.0, 5.72), DRIVER_GOAL, corridor_path, str(Reason.INVALID_PLACE)),
        ({}, {"x": 10.0}, None, DRIVER_GOAL, corridor_path, str(Reason.INVALID_PLACE)),
        ({}, {"goal": Pose2D(20.0, 5.72)}, None, DRIVER_GOAL, corridor_path, str(Reason.PATH_TOO_SHORT)),
        ({}, {}, None, Pose2D(22.0, 5.72), corridor_path, str(Reason.PATH_TOO_SHORT)),
        ({}, {"goal": Pose2D(-25.0, 5.72)}, None, DRIVER_GOAL, corridor_path, str(Reason.PATH_TOO_SHORT)),
        ({}, {}, None, None, corridor_path, str(Reason.DRIVES_NOWHERE)),
        ({}, {}, None, DRIVER_GOAL, _walled, str(Reason.PATH_TOO_SHORT)),
        ({"profile": 58.0}, {"profile": 90.0}, None, DRIVER_GOAL, corridor_path, str(Reason.PROFILE_MISMATCH)),
        ({"priority": 16}, {}, None, DRIVER_GOAL, corridor_path, str(Reason.HIGH_PRIORITY)),
        ({}, {"priority": 16}, None, DRIVER_GOAL, corridor_path, str(Reason.HIGH_PRIORITY)),
        ({"may_drive": False}, {}, None, DRIVER_GOAL, corridor_path, str(Reason.NO_DRIVER)),
    ],
)
def test_denials_give_their_reason(
    params: dict[str, Any],
    request_changes: dict[str, Any],
    driver_pose: Pose2D | None,
    goal: Pose2D | None,
    planner: Any,
    reason: str,
) -> None:
    bench = driver_in(S.IDLE, planner, **params)
    bench.pose = driver_pose or bench.pose
    if goal is not None:
        bench.step(GoalGiven(goal))
    bench.wait()
    state = bench.machine.state
    bench.hear(Request, **request_changes)
    (denial,) = bench.take(Message)
    assert (type(denial), denial.to, denial.ride_id, denial.reason) == (Deny, RIDER, "ride", reason)
    assert bench.machine.state is state
    assert bench.machine.offer is None


def test_the_papers_texts_of_denial() -> None:
    assert str(Reason.INVALID_PLACE) == "Invalid HH place"
    assert str(Reason.PATH_TOO_SHORT) == "Path too short"
    assert str(Reason.PROFILE_MISMATCH) == "Profile mismatch"
    assert str(Reason.UNABLE_TO_ALIGN) == "Unable to align"
    assert str(Reason.LARGE_COUPLE_TIME) == "Large couple_time"


@pytest.mark.parametrize(
    ("params", "request_changes"),
    [({"priority": 15}, {"priority": 15}), ({"profile": 58.0}, {"profile": 58.0}), ({"min_ride_m": 21.5}, {})],
)
def test_what_is_just_allowed_is_offered(params: dict[str, Any], request_changes: dict[str, Any]) -> None:
    bench = driver_in(S.NAVIGATING, **params)
    bench.hear(Request, **request_changes)
    (offer,) = bench.take(Message)
    assert isinstance(offer, Accept)
    assert offer.ride_m == pytest.approx(22.0, abs=0.5)  # from the aligning pose to where the ways part
    assert offer.decouple_point == pytest.approx((25.0, 5.72), abs=0.5)
    assert bench.machine.state is S.OFFERING
    assert bench.machine.goal is None  # it waits for the answer


def test_without_a_pose_the_place_is_not_valid() -> None:
    bench = driver_in(S.NAVIGATING)
    bench.pose = None
    bench.wait()
    bench.hear(Request)
    assert [denial.reason for denial in bench.take(Deny)] == [str(Reason.INVALID_PLACE)]


@pytest.mark.parametrize("state", ENGAGED)
def test_others_are_denied_while_engaged(state: DriverState) -> None:
    bench = driver_in(state)
    bench.hear(Request, robot_id="other", ride_id="other-1")
    (denial,) = bench.take(Message)
    assert (denial.to, denial.ride_id, denial.reason) == ("other", "other-1", str(Reason.ALREADY_DRIVING))
    assert bench.machine.state is state


@pytest.mark.parametrize("state", ENGAGED)
def test_a_hitchhiker_that_begins_anew_ends_the_old_ride(state: DriverState) -> None:
    bench = driver_in(state)
    bench.hear(Request, ride_id="ride-2")
    assert [offer.ride_id for offer in bench.take(Accept)] == ["ride-2"]
    assert (bench.machine.state, bench.machine.offer.ride_id) == (S.OFFERING, "ride-2")


def test_an_acceptance_is_repeated_until_it_is_taken_though_nobody_asks_again() -> None:
    bench = driver_in(S.NAVIGATING)
    bench.hear(Request)
    bench.wait(2.1)
    offers = bench.take(Accept)
    assert len(offers) == 5  # at once, and every half second
    assert {(offer.to, offer.ride_id, offer.ride_m) for offer in offers} == {("turtlebot", "ride", offers[0].ride_m)}
    bench.hear(Lock)
    bench.wait(2.0)
    assert not bench.take(Accept)


def test_a_lost_acceptance_is_sent_again_but_only_until_the_lock() -> None:
    bench = driver_in(S.OFFERING)
    bench.hear(Request)
    assert len(bench.take(Accept)) == 1
    bench.hear(Lock)
    bench.clear()
    bench.hear(Request)
    assert bench.take(Message) == []


# Timeouts: every state that waits ends by itself.


@pytest.mark.parametrize(
    ("state", "limit", "reason"),
    [
        (S.OFFERING, "confirm_timeout_s", "Offer not taken"),
        (S.ALIGNING, "max_align_s", "Unable to align"),
        (S.ALIGNED, "max_couple_s", "Large couple_time"),
        (S.WAITING_FOR_RIDER, "lost_timeout_s", str(Reason.RIDER_LOST)),
        (S.DECOUPLING, "decouple_timeout_s", str(Reason.NO_HANDOVER)),
    ],
)
def test_timeouts_tell_the_hitchhiker_and_the_driver_goes_on(state: DriverState, limit: str, reason: str) -> None:
    bench = driver_in(state)
    limit_s = getattr(bench.machine.params, limit)
    bench.wait(limit_s - 0.5)
    assert bench.machine.state is state
    bench.clear()
    bench.wait(0.8)
    assert {(end.to, end.ride_id, end.reason) for end in bench.take(Terminate)} == {(RIDER, "ride", reason)}
    assert (bench.machine.state, str(bench.machine.ending)) == (S.NAVIGATING, reason)
    assert bench.machine.goal.pose == DRIVER_GOAL


def test_the_end_is_told_for_a_while_and_not_to_a_new_offer() -> None:
    bench = driver_in(S.DRIVING)
    bench.step(GoalCancelled())
    bench.wait(20.0)
    assert 5 <= len(bench.take(Terminate)) <= 8
    bench = driver_in(S.OFFERING)
    bench.wait(bench.machine.params.confirm_timeout_s + 0.2)
    bench.hear(Request)
    bench.clear()
    bench.wait(2.0)
    assert (bench.machine.state, bench.take(Terminate)) == (S.OFFERING, [])


@pytest.mark.parametrize("report", ["blocked", "failed"])
@pytest.mark.parametrize(
    ("state", "then", "reason"),
    [
        (S.NAVIGATING, S.IDLE, "Navigation failed"),
        (S.ALIGNING, S.NAVIGATING, "Unable to align"),
        (S.DRIVING, S.NAVIGATING, "Navigation failed"),
    ],
)
def test_navigation_that_stays_stuck_ends_what_it_was_for(
    report: str, state: DriverState, then: DriverState, reason: str
) -> None:
    bench = driver_in(state, stuck_timeout_s=10.0, planner_patience_s=10.0, ack_timeout_s=20.0)
    for navigation in (report, "driving", report, "driving"):  # who says something else stands there all the same
        bench.navigation = navigation
        bench.wait(4.7)
        bench.hear(Ack)
        assert bench.machine.state is state
    bench.navigation = report
    bench.clear()
    bench.wait(0.9)
    assert (bench.machine.state, str(bench.machine.ending)) == (then, reason)
    assert [end.reason for end in bench.take(Terminate)] == ([reason] if state is not S.NAVIGATING else [])


@pytest.mark.parametrize("state", [S.NAVIGATING, S.DRIVING])
def test_who_has_come_nearer_to_the_goal_is_not_stuck(state: DriverState) -> None:
    bench = driver_in(state, stuck_timeout_s=10.0, ack_timeout_s=20.0)
    bench.navigation = "blocked"
    for x in (3.0, 4.0, 5.0, 6.0):
        bench.pose = Pose2D(x, 5.72)
        bench.wait(9.0)
        bench.hear(Ack)
        assert bench.machine.state is state
    for x in (5.0, 6.0, 5.0, 6.0):  # back and on again is not nearer
        bench.pose = Pose2D(x, 5.72)
        bench.wait(0.6)
        bench.hear(Ack)
    assert bench.machine.state is not state


@pytest.mark.parametrize("navigation", ["driving", "idle", None])
def test_driving_that_gets_nowhere_has_an_end_whatever_navigation_says(navigation: str | None) -> None:
    bench = driver_in(S.NAVIGATING, progress_timeout_s=40.0)
    bench.navigation = navigation
    bench.wait(39.5)
    assert bench.machine.state is S.NAVIGATING
    bench.wait(1.0)
    assert (bench.machine.state, str(bench.machine.ending)) == (S.IDLE, "Navigation failed: no nearer for 40 s")


def test_without_a_path_it_gives_up_sooner_than_before_an_obstacle() -> None:
    bench = driver_in(S.NAVIGATING, stuck_timeout_s=20.0, planner_patience_s=5.0)
    for navigation in ("blocked", "failed"):  # being blocked before takes nothing off the planner's time
        bench.navigation = navigation
        bench.wait(4.5)
        assert bench.machine.state is S.NAVIGATING
    bench.wait(1.0)
    assert bench.machine.state is S.IDLE


def test_alone_it_stops_at_its_goal() -> None:
    bench = driver_in(S.NAVIGATING)
    bench.navigation = "arrived"
    bench.wait()
    assert (bench.machine.state, bench.machine.goal) == (S.IDLE, None)
    assert bench.take(Award) == []


# Coupling and the ride.


def test_each_order_has_an_id_of_its_own_and_old_reports_do_not_count() -> None:
    bench = driver_in(S.NAVIGATING)
    ids = [bench.machine.goal.id]
    bench.step(GoalGiven(DRIVER_GOAL))
    ids.append(bench.machine.goal.id)
    bench.hear(Request)
    bench.hear(Lock)
    ids.append(bench.machine.goal.id)
    bench.navigation = "arrived"
    report = bench.situation()
    bench.step(Tick(report))
    bench.hear(Coupled)
    ids.append(bench.machine.goal.id)
    for _ in range(10):  # what obstacle avoidance said of the aligning pose is not the end of the ride
        bench.step(Tick(report))
    assert bench.machine.state is S.DRIVING
    bench.step(GoalCancelled())
    bench.step(GoalGiven(DRIVER_GOAL))
    ids.append(bench.machine.goal.id)
    assert len(set(ids)) == len(ids)
    later = Bench(DriverMachine(DRIVER, bench.machine.params, SITES, corridor_path, Pose2D()), now=bench.now + 5.0)
    later.step(GoalGiven(DRIVER_GOAL))
    assert later.machine.goal.id not in ids  # a restarted node does not take an old report for its own


def test_the_lock_is_confirmed_as_often_as_it_comes() -> None:
    bench = driver_in(S.OFFERING)
    for seq in (3, 4, 5):
        bench.hear(Lock, seq=seq)
    assert [(ack.of, ack.acknowledges) for ack in bench.take(Ack)] == [("lock", 3), ("lock", 4), ("lock", 5)]
    assert bench.machine.state is S.ALIGNING
    assert bench.machine.goal.pose == SITES.hitchhiking_points[0].aligning_pose


def test_aligned_is_repeated_until_coupled_and_coupled_is_answered_each_time() -> None:
    bench = driver_in(S.ALIGNED)
    bench.wait(2.0)
    assert 3 <= len(bench.take(Aligned)) <= 5
    for _ in range(3):
        bench.hear(Coupled)
    assert (len(bench.take(Driver)), bench.machine.state) == (3, S.DRIVING)


def test_driver_messages_carry_pose_covariance_and_boxes_every_delta() -> None:
    bench = driver_in(S.DRIVING, update_period_s=0.5)
    bench.pose, bench.obstacles, bench.speed = Pose2D(9.0, 5.7, 0.1), BOXES, 0.4
    for _ in range(10):
        bench.wait(1.0)
        bench.hear(Ack)
    sent = bench.take(Driver)
    assert 19 <= len(sent) <= 21
    assert (sent[-1].pose, sent[-1].new_obstacles.obstacles, sent[-1].v) == (bench.pose, BOXES, 0.4)
    assert sent[-1].sigma[0][0] == 0.01


def test_an_unknown_speed_is_not_sent() -> None:
    bench = driver_in(S.DRIVING)
    bench.speed = math.inf
    bench.wait(1.0)
    assert {message.v for message in bench.take(Driver)} == {0.0}


@pytest.mark.parametrize("following", [True, False])
def test_it_stops_for_a_hitchhiker_that_falls_behind_and_goes_on_when_it_is_back(following: bool) -> None:
    bench = driver_in(S.DRIVING)
    goal = bench.machine.goal
    if following:
        bench.wait(bench.machine.params.ack_timeout_s + 0.2)  # its acknowledgements are missing
    else:
        bench.hear(Ack, following=False)
        bench.wait()
    assert (bench.machine.state, bench.machine.goal) == (S.WAITING_FOR_RIDER, None)
    bench.hear(Ack, of="decouple")
    bench.wait()
    assert bench.machine.state is S.WAITING_FOR_RIDER
    bench.hear(Ack)
    bench.wait()
    assert (bench.machine.state, bench.machine.goal) == (S.DRIVING, goal)


def test_it_goes_on_when_its_rider_is_near_again() -> None:
    """P17 §4: until it has caught up."""
    bench = driver_in(S.WAITING_FOR_RIDER)
    bench.hear(Ack, gap_m=1.5)
    bench.wait()
    assert bench.machine.state is S.WAITING_FOR_RIDER
    bench.hear(Ack, gap_m=1.0)
    bench.wait()
    assert bench.machine.state is S.DRIVING


def test_it_does_not_wait_for_ever_for_one_that_follows_from_afar() -> None:
    bench = driver_in(S.WAITING_FOR_RIDER)
    for _ in range(round(bench.machine.params.lost_timeout_s) + 1):
        bench.hear(Ack, gap_m=1.5)
        bench.wait(1.0)
    assert (bench.machine.state, str(bench.machine.ending)) == (S.NAVIGATING, str(Reason.RIDER_LOST))


def test_it_keeps_talking_while_it_waits() -> None:
    bench = driver_in(S.WAITING_FOR_RIDER)
    bench.wait(5.0)
    assert len(bench.take(Driver)) >= 9


# Decoupling and the award.


def test_it_hands_over_standing_and_repeats_until_acknowledged() -> None:
    bench = driver_in(S.DECOUPLING)
    bench.speed = 0.3
    bench.wait(1.0)
    assert bench.take(Decouple) == []
    bench.speed, bench.obstacles = 0.0, BOXES
    bench.wait(2.0)
    sent = bench.take(Decouple)
    assert 3 <= len(sent) <= 5
    assert sent[-1].new_obstacles.obstacles == BOXES
    bench.hear(Ack, of="driver")
    assert bench.machine.state is S.DECOUPLING
    bench.hear(Ack, of="decouple")
    assert (bench.machine.state, str(bench.machine.ending)) == (S.NAVIGATING, "Ride completed")
    assert bench.take(Terminate) == []


@pytest.mark.parametrize("yaw_rate", [0.06, -0.5])
def test_a_driver_that_turns_on_the_spot_does_not_stand(yaw_rate: float) -> None:
    """Half a second later its rider would pair a heading 14 degrees off with what it sees."""
    bench = driver_in(S.DECOUPLING)
    bench.yaw_rate = yaw_rate
    bench.wait(1.0)
    assert bench.take(Decouple) == []
    bench.yaw_rate = 0.0
    bench.wait(1.0)
    assert bench.take(Decouple)


@pytest.mark.parametrize("age_s", [0.0, 0.25])
def test_its_messages_tell_how_old_the_pose_in_them_is(age_s: float) -> None:
    bench = driver_in(S.DRIVING)
    situation = replace(bench.situation(), estimate=PoseEstimate(bench.now - age_s, Pose2D(5.0, 5.72), np.array(SIGMA)))
    bench.step(Tick(situation))
    bench.clear()
    bench.now += 0.5
    bench.step(Tick(replace(situation, estimate=replace(situation.estimate, stamp=bench.now - age_s))))
    assert [told.age_s for told in bench.take(Driver)] == [pytest.approx(age_s)]


def test_metres_are_credited_once() -> None:
    bench = driver_in(S.DRIVING, award_rate=0.4)
    for x in np.arange(3.0, 23.4 + 1e-9, 0.05):
        bench.pose = Pose2D(float(x), 5.72)
        bench.wait()
        bench.hear(Ack)
    bench.navigation = "arrived"
    bench.wait()
    bench.navigation = None
    bench.clear()
    ack = replace(messages(RIDER, DRIVER)[Ack], of="decouple")
    bench.step(ack)
    bench.step(ack)  # replayed
    bench.wait(20.0)
    (award,) = bench.take(Award)
    assert (award.hitchhiker, award.ride_id) == (RIDER, "ride")
    assert award.ride_m == pytest.approx(20.4, abs=0.05)
    assert award.points == pytest.approx(8.2, abs=0.05)  # P17 Exp. 1


def test_the_drivers_metres_are_not_rounded() -> None:
    bench = driver_in(S.DRIVING, award_rate=0.4)
    bench.ride(12.34)
    assert bench.machine.ride.ridden_m == 12.34
    bench.wait(bench.machine.params.update_period_s + 0.1)
    assert {message.ridden_m for message in bench.take(Driver)} == {12.34}
    bench.hear(Terminate)
    (award,) = bench.take(Award)
    assert (award.ride_m, award.points) == (12.34, pytest.approx(0.4 * 12.34))


def test_noise_of_a_standing_robot_earns_nothing() -> None:
    bench = driver_in(S.DRIVING)
    rng = np.random.default_rng(1)
    for _ in range(200):
        bench.pose = Pose2D(3.0 + rng.normal(0.0, 0.02), 5.72)
        bench.wait()
        bench.hear(Ack)
    bench.hear(Terminate)
    assert bench.take(Award) == []


@pytest.mark.parametrize("state", ENGAGED)
@pytest.mark.parametrize(
    ("event", "then"),
    [(GoalCancelled(), S.IDLE), (GoalGiven(Pose2D(9.0, 5.72)), S.NAVIGATING), (Terminate, S.NAVIGATING)],
)
def test_a_ride_can_end_in_every_state(state: DriverState, event: Any, then: DriverState) -> None:
    bench = driver_in(state)
    if state in WITH_RIDER:
        bench.ride(5.0)
    bench.hear(event) if event is Terminate else bench.step(event)
    bench.wait()
    assert (bench.machine.state, bench.machine.offer) == (then, None)
    ends = bench.take((Award, Terminate))
    assert [type(e) for e in ends] == [Terminate] * (event is not Terminate) + [Award] * (state in WITH_RIDER)


@pytest.mark.parametrize(("aside", "farther_m"), [((0.2, 0.05), 0.2), ((-0.3, 0.0), 0.0), ((2.0, 0.0), 0.5)])
def test_the_driver_aligns_ahead_of_where_the_hitchhiker_stands(aside: tuple[float, float], farther_m: float) -> None:
    """The gap has to open ahead of it: it does not go back. What is missing behind, it closes by itself."""
    bench, place = driver_in(S.NAVIGATING), SITES.hitchhiking_points[0]
    here = compose(place.waiting_pose, Pose2D(*aside))
    bench.hear(Request, x=here.x, y=here.y, theta=here.theta)
    bench.hear(Lock)
    assert bench.machine.state is S.ALIGNING
    assert bench.machine.goal.pose == compose(place.aligning_pose, Pose2D(farther_m))


@pytest.mark.parametrize("state", [S.OFFERING, S.ALIGNING, S.ALIGNED])
def test_the_hitchhiker_may_withdraw_before_it_is_coupled(state: DriverState) -> None:
    bench = driver_in(state)
    bench.hear(RequestCancel)
    assert (bench.machine.state, str(bench.machine.ending)) == (S.NAVIGATING, "Request cancelled")


@pytest.mark.parametrize("state", ENGAGED)
def test_only_its_own_hitchhiker_is_heard(state: DriverState) -> None:
    bench = driver_in(state)
    for cls in MESSAGE_TYPES.values():
        if cls not in (Request, Lock):
            bench.hear(cls, robot_id="other")
            bench.hear(cls, ride_id="ride-0")
    assert bench.machine.state is state
    assert bench.take(Message) == []


@pytest.mark.parametrize("state", S)
def test_a_lock_that_nobody_asked_for_is_denied_and_counted(state: DriverState) -> None:
    bench = driver_in(state)
    bench.hear(Lock, robot_id="other")
    (denial,) = bench.take(Message)
    assert (type(denial), denial.to, denial.ride_id) == (Deny, "other", "ride")
    assert denial.reason in (str(Reason.NOT_OFFERED), str(Reason.ALREADY_DRIVING))
    assert (bench.machine.refused, bench.machine.state) == (1, state)


# What the modules are told (P17 Table 3).


@pytest.mark.parametrize("state", S)
def test_the_modules_of_each_state(state: DriverState) -> None:
    machine = driver_in(state, ride_speed_mps=0.4).machine
    assert machine.modules == ModuleSwitches(VS=state is S.ALIGNING)
    assert (machine.servo is not None) == (state is S.ALIGNING)
    assert (machine.goal is not None) == (state in (S.NAVIGATING, S.YIELDING, S.ALIGNING, S.DRIVING))
    assert (machine.ride is not None) == (state in ENGAGED)
    params = machine.params
    assert machine.speed_limit_mps == (0.4 if state in WITH_RIDER else params.cruise_speed_mps)
    assert params.cruise_speed_mps != 0.4


@pytest.mark.parametrize("state", S)
@pytest.mark.parametrize("cls", MESSAGE_TYPES.values())
def test_no_message_and_no_lack_of_knowledge_raises(state: DriverState, cls: type[Message]) -> None:
    for pose in (None, Pose2D(3.0, 5.72), Pose2D(1e300, -1e300)):
        bench = driver_in(state)
        bench.pose = pose
        bench.wait()
        bench.hear(cls)
        bench.hear(cls, ride_id="")
        bench.wait(1.0)
        assert bench.machine.state in S


def test_the_camera_looks_for_markers_on_the_way_when_it_is_to() -> None:
    machine = driver_in(S.NAVIGATING, watch_markers=True).machine
    assert machine.servo == ServoCommand("observe", ANY_MARKER)
    assert machine.modules.VS
    assert driver_in(S.DRIVING, watch_markers=True).machine.servo is None
