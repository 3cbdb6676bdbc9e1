"""The hitchhiker's table: P17 Algorithm 2 with its timeouts and losses."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate, Side
from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.core.geometry import between, compose, distance, inverse, wrap_angle
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.events import (
    GoalCancelled,
    GoalGiven,
    NavigationReport,
    Situation,
    TakeObstacles,
    TakePose,
    Tick,
)
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.messages import (
    MESSAGE_TYPES,
    Accept,
    Ack,
    Aligned,
    Beacon,
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
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.status import GoalCommand, ModuleSwitches
from protocol_helpers import (
    BOXES,
    CAMERA,
    DRIVER,
    MARKER_POSE,
    REAR_MARKER,
    RIDER,
    RIDER_GOAL,
    SIGMA,
    SITES,
    WEST,
    Bench,
    messages,
    rider_in,
)

S = HitchhikerState
BEFORE_RIDE = S.of(Phase.ASKING, Phase.MEETING, Phase.COUPLING)
COUPLED = S.of(Phase.COUPLED, Phase.HANDING_OVER)
RETURNING = S.of(Phase.RETURNING)
LOCKED = (S.LOCKING, S.AWAITING_ALIGNED, S.COUPLING)


def _behind(bench: Bench, driver: Pose2D) -> Pose2D:
    """Where the hitchhiker stands when it sees the marker straight ahead."""
    assert bench.gap is not None
    marker = compose(driver, MARKER_POSE)
    back = CAMERA[0] + bench.gap
    return Pose2D(
        marker.x - back * np.cos(driver.theta), marker.y - back * np.sin(driver.theta), wrap_angle(driver.theta)
    )


def _localized(bench: Bench, pose: Pose2D) -> None:
    bench.pose = pose
    bench.wait()


# Handshake.


def test_requests_carry_place_goal_profile_and_priority_and_repeat() -> None:
    bench = rider_in(S.REQUESTING, profile=40.0, priority=9)
    bench.wait(5.0)
    requests = bench.take(Request)
    assert 4 <= len(requests) <= 6
    assert {r.to for r in requests} == {"*"}
    assert len({r.ride_id for r in requests}) == 1
    assert (requests[0].pose, requests[0].goal) == (bench.pose, RIDER_GOAL)
    assert (requests[0].profile, requests[0].priority) == (40.0, 9)


def test_it_does_not_ask_without_knowing_where_it_is() -> None:
    bench = rider_in(S.REQUESTING)
    bench.pose = None
    bench.wait(5.0)
    assert bench.take(Request) == []


@pytest.mark.parametrize("denied", [False, True])
def test_no_driver_within_the_waiting_time(denied: bool) -> None:
    bench = rider_in(S.REQUESTING, max_wait_s=30.0)
    bench.wait(20.0)
    if denied:
        bench.hear(Deny)
    bench.wait(9.0)
    assert bench.machine.state is S.REQUESTING
    bench.wait(2.0)
    assert bench.machine.state is S.IDLE
    assert str(bench.machine.ending) == ("Driver not found (Path too short)" if denied else "Driver not found")
    bench.clear()
    bench.hear(Accept)  # of somebody who has just come, and stands waiting
    assert [(m.to, m.ride_id) for m in bench.take(RequestCancel)] == [(DRIVER, bench.machine.ride_id)]


def test_the_waiting_time_counts_from_the_first_request() -> None:
    bench = rider_in(S.REQUESTING, max_wait_s=30.0, max_align_s=31.0)
    for cls, changes in ((Accept, {}), (Ack, {"of": "lock"})):
        bench.hear(cls, **changes)
    bench.wait(31.0)
    assert bench.machine.state is S.AWAITING_ALIGNED
    bench.clear()
    bench.wait(0.3)
    assert bench.machine.state is S.IDLE
    assert [type(m) for m in bench.take(Message)] == [Terminate]  # and asks nobody just before it gives up


def test_the_first_offer_is_locked_until_confirmed_and_others_are_refused() -> None:
    bench = rider_in(S.REQUESTING)
    bench.hear(Accept)
    bench.wait(1.2)
    locks = bench.take(Lock)
    assert 2 <= len(locks) <= 3
    assert {(m.to, m.ride_id) for m in locks} == {(DRIVER, bench.machine.ride_id)}
    bench.hear(Accept)
    assert bench.take(Message) == []
    bench.hear(Accept, robot_id="other")
    assert [m.to for m in bench.take(RequestCancel)] == ["other"]
    bench.hear(Ack, of="request")
    assert bench.machine.state is S.LOCKING
    bench.hear(Ack, of="lock")
    assert bench.machine.state is S.AWAITING_ALIGNED


@pytest.mark.parametrize("wall", ["left", None])
def test_one_that_is_not_in_line_turns_while_the_driver_aligns(wall: Side | None) -> None:
    bench = rider_in(S.LOCKING, sites=Sites(SITES.markers, (replace(WEST, wall=wall),)))
    own = bench.pose = Pose2D(WEST.waiting_pose.x, WEST.waiting_pose.y, 2.0)
    bench.wait()
    bench.hear(Ack, of=Lock.type)
    way = bench.machine.way
    assert (way.x, way.y, way.theta, way.along_wall) == (own.x, own.y, WEST.waiting_pose.theta, wall)
    bench.hear(Aligned)
    assert bench.machine.way is None


def test_one_that_has_turned_into_line_rests() -> None:
    bench = rider_in(S.LOCKING)
    bench.pose = replace(WEST.waiting_pose, theta=2.0)
    bench.wait()
    bench.hear(Ack, of=Lock.type)
    order = bench.machine.way.id

    def way_after(state: str) -> GoalCommand | None:
        bench.step(Tick(replace(bench.situation(), navigation=NavigationReport(order, state))))
        return bench.machine.way

    assert way_after("driving") is not None
    assert way_after("arrived") is None
    assert (bench.machine.state, way_after("idle")) == (S.AWAITING_ALIGNED, None)


def test_one_that_is_in_line_already_stands() -> None:
    assert rider_in(S.AWAITING_ALIGNED).machine.way is None


def test_aligned_may_overtake_the_lost_confirmation_of_the_lock() -> None:
    bench = rider_in(S.LOCKING)
    bench.hear(Aligned)
    assert bench.machine.state is S.COUPLING


# Meeting from afar.


def _asked_from(bench: Bench, pose: Pose2D) -> float:
    """An offer is taken by a robot that stands at ``pose``; in how many seconds it says then that it will be there."""
    bench.pose = pose
    bench.hear(Accept)
    bench.wait(2.0)
    assert bench.machine.state is S.LOCKING
    return bench.take(Lock)[-1].in_s


def test_a_new_request_is_made_from_where_the_robot_is_now() -> None:
    """A robot that had stood in place for the meeting before said that it was in place for the next one."""
    bench = rider_in(S.REQUESTING, mode="network")
    away = compose(WEST.waiting_pose, Pose2D(-6.0))
    in_s = _asked_from(bench, away)
    assert in_s >= 6.0 / bench.machine.params.cruise_speed_mps
    bench.hear(Ack, of=Lock.type, in_s=5.0)
    bench.wait()
    bench.pose = WEST.waiting_pose
    way = bench.machine.way
    bench.step(Tick(replace(bench.situation(), navigation=NavigationReport(way.id, "arrived"))))
    assert bench.machine.way is None
    bench.hear(Terminate)
    assert _asked_from(bench, away) == in_s
    bench.hear(Aligned)  # of a driver that cannot know that it is not there yet
    assert bench.machine.state is S.LOCKING


@pytest.mark.parametrize("state", S)
def test_a_ride_that_is_over_ends_now(state: HitchhikerState) -> None:
    """While it localized after the ride, it told its next driver that the ride was still to come."""
    over = state in (S.IDLE, S.REQUESTING, S.RELOCALIZING, S.PARTING)
    assert (rider_in(state, mode="network").machine.ride_ends_in_s() == 0.0) is over


# Timeouts: every state that waits ends by itself.


@pytest.mark.parametrize(
    ("state", "limit", "told", "reason"),
    [
        (S.LOCKING, "confirm_timeout_s", RequestCancel, "Lock not confirmed"),
        (S.AWAITING_ALIGNED, "max_align_s", Terminate, "Driver did not align"),
        (S.COUPLING, "max_couple_s", Terminate, "Large couple_time"),
    ],
)
def test_an_offer_that_comes_to_nothing_is_given_back(
    state: HitchhikerState, limit: str, told: type, reason: str
) -> None:
    bench = rider_in(state)
    old = bench.machine.ride_id
    bench.wait(getattr(bench.machine.params, limit) - 0.5)
    assert bench.machine.state is state
    bench.clear()
    bench.wait(5.0)
    assert (bench.machine.state, str(bench.machine.ending)) == (S.REQUESTING, reason)
    sent = bench.take(Message)
    ends, requests = ([m for m in sent if isinstance(m, cls)] for cls in (told, Request))
    assert len(sent) == len(ends) + len(requests)
    assert {(m.to, m.ride_id) for m in ends} == {(DRIVER, old)}
    assert 5 <= len(ends) <= 8  # the driver may not hear it at once
    assert old not in {m.ride_id for m in requests}


@pytest.mark.parametrize("state", LOCKED)
@pytest.mark.parametrize("cls", [Deny, Terminate])
def test_an_offer_that_is_withdrawn_is_followed_by_a_new_request(state: HitchhikerState, cls: type[Message]) -> None:
    bench = rider_in(state)
    old = bench.machine.ride_id
    bench.hear(cls, reason="Unable to align")
    bench.wait()
    assert (bench.machine.state, str(bench.machine.ending)) == (S.REQUESTING, "Unable to align")
    assert [m.ride_id == old for m in bench.take(Request)] == [False]


# Coupling.


@pytest.mark.parametrize(("gap", "speed"), [(None, 0.0), (1.0, 0.0), (0.45, 0.0), (0.8, 0.2)])
def test_it_is_coupled_only_when_it_hardly_moves_at_the_right_distance(gap: float | None, speed: float) -> None:
    bench = rider_in(S.COUPLING)
    bench.gap, bench.speed = gap, speed
    bench.wait(5.0)
    assert bench.machine.state is S.COUPLING
    bench.gap, bench.speed = 0.85, 0.0
    bench.wait(1.0)
    assert bench.machine.state is S.RIDING
    assert bench.take(Coupled)[0].gap_m == pytest.approx(0.85)


def test_one_that_stands_nearer_than_the_gap_is_coupled_as_it_does_not_back_up() -> None:
    bench = rider_in(S.COUPLING)
    bench.gap, bench.speed = 0.65, 0.0
    bench.wait(1.0)
    assert bench.machine.state is S.RIDING


def test_an_old_image_couples_nothing() -> None:
    bench = rider_in(S.COUPLING)
    bench.gap = 0.8
    old = bench.situation()
    bench.gap = None
    for _ in range(50):
        bench.now += 0.1
        bench.step(Tick(replace(bench.situation(), observation=old.observation)))
    assert bench.machine.state is S.COUPLING


def test_another_robots_marker_couples_nothing() -> None:
    bench = rider_in(S.AWAITING_ALIGNED)
    bench.hear(Aligned, ahead=replace(REAR_MARKER, marker_id=3))  # the bench shows marker 0
    bench.gap = 0.8
    bench.wait(5.0)
    assert bench.machine.state is S.COUPLING


def test_coupled_is_repeated_until_the_driver_speaks() -> None:
    bench = rider_in(S.COUPLING)
    bench.gap = 0.8
    bench.wait(2.6)
    assert 3 <= len(bench.take(Coupled)) <= 5
    bench.hear(Driver)
    bench.wait(2.0)
    assert bench.take(Coupled) == []


# The ride.


def test_every_driver_message_is_acknowledged_with_how_it_follows() -> None:
    bench = rider_in(S.RIDING)
    bench.hear(Driver, seq=11)
    bench.gap = None
    bench.wait(1.0)
    bench.hear(Driver, seq=12)
    acks = bench.take(Ack)
    assert [(a.of, a.acknowledges, a.following) for a in acks] == [("driver", 11, True), ("driver", 12, False)]
    assert acks[0].gap_m == pytest.approx(0.8)


def test_the_drivers_speed_is_fed_forward_only_while_it_is_fresh_and_never_into_another_ride() -> None:
    bench = rider_in(S.RIDING)
    bench.hear(Driver, v=0.5)
    assert bench.machine.servo.feed_forward_mps == 0.5
    bench.wait(bench.machine.params.ack_timeout_s + 0.2)
    assert bench.machine.servo.feed_forward_mps == 0.0
    bench.hear(Driver, v=0.5)
    bench.hear(Terminate)
    _localized(bench, Pose2D(1.7, 5.72))
    bench.wait(bench.machine.params.part_s + 0.2)
    assert bench.machine.state is S.IDLE
    bench.step(GoalGiven(RIDER_GOAL))
    for cls in (Accept, Aligned):
        bench.hear(cls)
    assert (bench.machine.state, bench.machine.servo.feed_forward_mps) == (S.COUPLING, 0.0)


@pytest.mark.parametrize(
    ("speed", "told"), [(0.0, 0.0), (0.02, 0.0), (0.03, 0.05), (0.48, 0.5), (0.52, 0.5), (0.6, 0.6), (-0.06, -0.05)]
)
def test_its_modules_are_told_of_the_drivers_speed_in_steps(speed: float, told: float) -> None:
    bench = rider_in(S.RIDING)
    bench.hear(Driver, v=speed)
    assert bench.machine.servo.feed_forward_mps == pytest.approx(told, abs=1e-12)


@pytest.mark.parametrize(("ridden_m", "told_m"), [(0.0, 0.0), (0.99, 0.0), (1.0, 1.0), (12.34, 12.0), (20.4, 20.0)])
def test_its_status_counts_whole_metres_and_the_machine_all(ridden_m: float, told_m: float) -> None:
    bench = rider_in(S.RIDING)
    bench.hear(Driver, ridden_m=ridden_m)
    assert (bench.machine.ride.ridden_m, bench.machine.ridden_m) == (told_m, ridden_m)
    assert bench.machine.ride.ride_m == messages()[Accept].ride_m


def test_its_status_stays_the_same_where_the_driver_does_nearly() -> None:
    bench, said = rider_in(S.RIDING), set()
    for i in range(20):
        bench.hear(Driver, v=0.5 + 0.02 * (-1) ** i, ridden_m=3.0 + 0.04 * i)
        said.add((bench.machine.servo, bench.machine.ride))
    assert len(said) == 1


def test_a_driver_that_falls_silent_leaves_a_rough_pose_and_a_robot_that_goes_on_alone() -> None:
    bench, reason = rider_in(S.RIDING), "No message from the driver"
    at = Pose2D(12.0, 5.72, 0.1)
    expected = _behind(bench, at)
    message = {"x": at.x, "y": at.y, "theta": at.theta}
    bench.hear(Driver, **message)
    bench.clear()
    while bench.machine.state is S.RIDING:
        bench.wait()
    end, pose, boxes = bench.take((Terminate, TakePose, TakeObstacles))
    assert (bench.machine.state, end.reason, boxes.obstacles) == (S.RELOCALIZING, reason, BOXES)
    assert distance(pose.estimate.pose, expected) < 0.01
    silent_m = 0.5 * bench.machine.params.message_timeout_s
    assert np.all(np.sqrt(np.diag(pose.estimate.covariance)) >= [0.5 + silent_m, 0.5 + silent_m, 0.3])  # and it says so
    bench.hear(Driver, **message)  # the driver has not heard that it was lost
    assert [m.reason for m in bench.take(Terminate)] == [reason]
    _localized(bench, expected)
    bench.wait(bench.machine.params.part_s + 0.2)
    assert (bench.machine.state, str(bench.machine.ending), bench.machine.goal) == (S.IDLE, reason, RIDER_GOAL)
    bench.clear()
    bench.hear(Decouple)
    assert [type(m) for m in bench.take(Message)] == [Terminate]  # nothing was handed over, so nothing is acknowledged


def _place_of(robot_id: str, neighbours: Neighbours) -> Pose2D:
    place = neighbours._place(robot_id)
    assert place is not None
    return Pose2D(place[0].x, place[0].y, place[0].theta)


def test_where_the_driver_was_left_is_as_right_as_the_own_pose() -> None:
    """It drives past it: from a rough pose, 9 cm off, it touched it."""
    neighbours = Neighbours()
    bench = rider_in(S.RIDING, neighbours=neighbours)
    neighbours.hear(replace(messages()[Beacon], robot_id=DRIVER, pose=Pose2D(11.0, 5.0)), bench.now)
    bench.hear(Driver, x=12.0, y=5.72, theta=0.1)
    bench.clear()
    while bench.machine.state is S.RIDING:
        bench.wait()
    rough, left_at = bench.take(TakePose)[0].estimate.pose, _place_of(DRIVER, neighbours)
    own = compose(rough, Pose2D(-0.09, 0.02, 0.01))
    _localized(bench, own)
    assert bench.machine.state is S.PARTING
    before, after = between(rough, left_at), between(own, _place_of(DRIVER, neighbours))
    assert (after.x, after.y, after.theta) == pytest.approx((before.x, before.y, before.theta))


# A driver out of sight: seek it, localize, catch up, couple anew; or go on alone.


def _told(bench: Bench, metres: float = 3.0) -> Pose2D:
    """The driver has told of a straight way along x; where it stands at the end."""
    for x in np.arange(10.0, 10.0 + metres, 0.25):
        bench.hear(Driver, x=float(x), y=5.72, theta=0.0)
    return Pose2D(float(x), 5.72)


def test_a_marker_out_of_view_is_sought_by_servoing_and_the_driver_is_told() -> None:
    bench = rider_in(S.RIDING)
    bench.gap = None
    bench.wait(bench.machine.params.repeat_period_s + 0.2)
    assert (bench.machine.state, str(bench.machine.ending)) == (S.SEEKING, "Driver out of sight")
    assert bench.machine.servo.task == "follow"
    bench.clear()
    bench.hear(Driver)
    assert [a.following for a in bench.take(Ack)] == [False]
    bench.gap = 0.7
    bench.wait()
    assert (bench.machine.state, str(bench.machine.ending)) == (S.RIDING, "Driver seen again")
    bench.hear(Driver)
    assert bench.take(Ack)[0].following


def test_a_driver_that_is_not_found_is_caught_up_with_on_its_own_track() -> None:
    bench = rider_in(S.RIDING)
    driver = _told(bench)
    bench.clear()
    bench.lose_driver(S.SEEKING)
    assert bench.take((TakePose, Terminate)) == []  # nobody gives up yet
    expected = compose(compose(driver, MARKER_POSE), Pose2D(0.8 + CAMERA[0], 0.0, np.pi))
    while bench.machine.state is S.SEEKING:
        bench.wait()
        bench.hear(Driver, x=driver.x, y=driver.y, theta=driver.theta)
    pose, boxes = bench.take((TakePose, TakeObstacles))
    assert (bench.machine.state, bench.machine.modules.LZN, boxes.obstacles) == (S.LOCATING, True, BOXES)
    assert distance(pose.estimate.pose, expected) < 0.01
    assert np.sqrt(pose.estimate.covariance[0, 0]) >= 0.5
    assert (bench.machine.servo, bench.machine.way) == (None, None)  # it stands
    _localized(bench, Pose2D(driver.x - 3.0, 5.72))
    bench.wait()
    way = bench.machine.way
    assert (bench.machine.state, bench.machine.servo.task) == (S.CATCHING_UP, "observe")
    assert (way.x, way.y, way.theta) == (pytest.approx(driver.x - 1.6, abs=0.2), 5.72, pytest.approx(0.0))
    assert not any(isinstance(m, Terminate) for m in bench.take(Message))
    bench.gap = 1.3
    bench.wait()
    assert (bench.machine.state, bench.machine.servo.task, bench.machine.way) == (S.RECOUPLING, "follow", None)
    bench.gap = 0.8
    bench.wait(bench.machine.params.repeat_period_s + 0.2)
    assert (bench.machine.state, len(bench.take(Coupled))) == (S.RIDING, 1)


def test_a_driver_that_goes_on_is_followed_to_where_it_goes() -> None:
    bench = rider_in(S.CATCHING_UP)
    _told(bench, 2.0)
    bench.wait()
    first = bench.machine.way
    bench.wait()
    assert bench.machine.way == first  # not a new order each time
    bench.hear(Driver, x=12.5, y=5.72, theta=0.0)
    bench.wait(0.2)
    assert bench.machine.way.id != first.id
    assert bench.machine.way.x > first.x + 0.2


def test_one_that_is_near_its_driver_turns_to_it_and_does_not_go_back() -> None:
    bench = rider_in(S.CATCHING_UP)
    driver = _told(bench)
    bench.pose = Pose2D(driver.x - 1.0, 5.92, 1.5)
    bench.wait(0.2)
    way = bench.machine.way
    assert (way.x, way.y) == (bench.pose.x, bench.pose.y)
    assert way.theta == pytest.approx(np.arctan2(-0.2, 0.75))


def test_a_marker_that_is_seen_far_away_is_driven_up_to_first() -> None:
    bench = rider_in(S.CATCHING_UP)
    bench.gap = 3.0
    bench.wait()
    assert bench.machine.state is S.CATCHING_UP


@pytest.mark.parametrize(
    ("state", "limit", "then", "reason"),
    [
        (S.SEEKING, "seek_timeout_s", S.LOCATING, "Driver lost"),
        (S.LOCATING, "localize_timeout_s", S.PARTING, "Driver lost; localization did not answer"),
        (S.CATCHING_UP, "catch_up_timeout_s", S.PARTING, "Driver not caught up with"),
        (S.RECOUPLING, "max_couple_s", S.PARTING, "Large couple_time"),
    ],
)
def test_every_step_of_the_search_ends_by_itself(
    state: HitchhikerState, limit: str, then: HitchhikerState, reason: str
) -> None:
    bench = rider_in(state)
    limit_s, entered = getattr(bench.machine.params, limit), bench.machine.facts.entered
    bench.pose = None if state is S.LOCATING else bench.pose
    while bench.now - entered < limit_s - 0.2:
        bench.wait()
        bench.hear(Driver)
    assert bench.machine.state is state
    bench.clear()
    bench.wait(0.5)
    assert (bench.machine.state, str(bench.machine.ending), bench.machine.goal) == (then, reason, RIDER_GOAL)
    assert [m.reason for m in bench.take(Terminate)][:1] == ([reason] if then is S.PARTING else [])


@pytest.mark.parametrize("state", [S.SEEKING, S.LOCATING, S.CATCHING_UP, S.RECOUPLING])
@pytest.mark.parametrize("how", ["silence", "terminate", "decouple"])
def test_a_driver_that_does_not_wait_leaves_a_robot_that_goes_on_alone(state: HitchhikerState, how: str) -> None:
    bench = rider_in(state, localize_timeout_s=10.0)
    if how == "silence":
        bench.gap = 1.3 if state is S.RECOUPLING else None
        bench.pose = bench.pose if state not in (S.SEEKING, S.LOCATING) else None
        bench.wait(bench.machine.params.message_timeout_s + 0.2)
    elif how == "terminate":
        bench.hear(Terminate, reason="Hitchhiker lost")
    else:
        bench.hear(Decouple)
        bench.gap = None
        bench.wait(bench.machine.params.settle_timeout_s + 0.2)
    expected = {"silence": "No message from the driver", "terminate": "Hitchhiker lost", "decouple": "Driver lost"}[how]
    if bench.machine.state is not S.PARTING:
        assert bench.machine.state is S.RELOCALIZING
        _localized(bench, Pose2D(1.7, 5.72))
    assert (bench.machine.state, str(bench.machine.ending), bench.machine.goal) == (S.PARTING, expected, RIDER_GOAL)
    assert (bench.machine.servo, bench.machine.way) == (None, None)  # it stands while the driver goes
    bench.wait(bench.machine.params.part_s + 0.2)
    assert (bench.machine.state, str(bench.machine.ending), bench.machine.goal) == (S.IDLE, expected, RIDER_GOAL)


def test_it_looks_for_the_marker_from_one_place_after_the_other() -> None:
    bench = rider_in(S.CATCHING_UP)
    driver = _told(bench)
    bench.pose = Pose2D(driver.x - 3.0, 5.72)

    def way(navigation: str, seconds: float) -> Pose2D | None:
        for _ in range(round(seconds * 10)):
            report = None if bench.machine.way is None else NavigationReport(bench.machine.way.id, navigation)
            bench.now += 0.1
            bench.step(Tick(replace(bench.situation(), navigation=report)))
            bench.hear(Driver, x=driver.x, y=driver.y, theta=driver.theta)
        return None if bench.machine.way is None else bench.machine.way.pose

    first = way("driving", 2.0)
    assert way("arrived", 1.5) == first
    second = way("arrived", 1.0)
    front = compose(compose(driver, MARKER_POSE), Pose2D(CAMERA[0] + 0.8, 0.0, np.pi))
    assert distance(second, front) < 1e-9
    assert abs(wrap_angle(second.theta - front.theta)) < 1e-9
    assert way("failed", 2.5) is None
    assert (bench.machine.state, str(bench.machine.ending)) == (S.PARTING, "Driver not caught up with")


# Decoupling.


@pytest.mark.parametrize("method", ["paper", "measured"])
def test_the_pose_is_taken_over_standing_and_then_acknowledged(method: str) -> None:
    bench = rider_in(S.RIDING, handover=method)
    at = Pose2D(23.4, 5.7, 0.05)
    bench.clear()
    bench.speed = 0.1
    bench.hear(Decouple, x=at.x, y=at.y, theta=at.theta, seq=40)
    bench.wait(1.0)
    assert bench.machine.state is S.SETTLING
    assert bench.effects == []
    bench.speed = 0.0
    bench.wait()
    pose, boxes, ack = bench.take((TakePose, TakeObstacles, Message))
    assert (ack.of, ack.acknowledges, boxes.obstacles) == ("decouple", 40, BOXES)
    assert distance(pose.estimate.pose, _behind(bench, at)) < 0.01
    assert bench.machine.state is S.RELOCALIZING
    _localized(bench, pose.estimate.pose)
    assert (bench.machine.state, str(bench.machine.ending), bench.machine.goal) == (S.IDLE, "", RIDER_GOAL)


def test_the_handover_is_taken_once_and_acknowledged_as_often_as_it_comes() -> None:
    bench = rider_in(S.SETTLING)
    bench.hear(Decouple, seq=1)
    bench.wait(1.0)
    assert len(bench.take(TakePose)) == 1
    bench.hear(Decouple, seq=2)
    _localized(bench, Pose2D(1.7, 5.72))
    assert bench.machine.state is S.IDLE
    bench.hear(Decouple, seq=3)
    bench.wait(10.0)
    assert [type(e) for e in bench.take((TakePose, TakeObstacles))] == []
    bench.hear(Decouple, seq=4)
    assert [a.acknowledges for a in bench.take(Ack)] == [4]


def test_a_robot_that_does_not_stand_takes_over_in_the_end() -> None:
    bench = rider_in(S.SETTLING)
    bench.speed = 0.1
    bench.wait(bench.machine.params.settle_timeout_s + 0.2)
    assert bench.machine.state is S.RELOCALIZING
    assert len(bench.take(Ack)) == 1


def test_a_marker_that_is_lost_while_settling_leaves_the_rough_pose() -> None:
    bench = rider_in(S.SETTLING)
    bench.gap = None
    bench.wait(bench.machine.params.settle_timeout_s + 0.2)
    end, pose = bench.take((Terminate, TakePose, Ack))
    assert (end.reason, str(bench.machine.ending)) == ("Driver lost", "Driver lost")
    assert pose.estimate.covariance[0, 0] > 0.25


def test_it_waits_for_localization_to_answer_with_the_pose_it_was_given() -> None:
    bench = rider_in(S.SETTLING)
    near = PoseEstimate(bench.now, Pose2D(1.7, 5.72), np.array(SIGMA))  # from before the handover
    while bench.machine.state is S.SETTLING:
        bench.wait()
    _localized(bench, Pose2D(20.0, 5.72))  # where it went to sleep
    bench.step(Tick(replace(bench.situation(), estimate=near)))
    assert bench.machine.state is S.RELOCALIZING
    _localized(bench, Pose2D(1.7, 5.72))
    assert bench.machine.state is S.IDLE


def test_a_handover_counts_for_one_ride_only() -> None:
    bench = rider_in(S.RELOCALIZING)
    _localized(bench, Pose2D(1.7, 5.72))
    bench.step(GoalGiven(RIDER_GOAL))
    bench.hear(Accept)
    bench.step(GoalCancelled())
    bench.clear()
    bench.hear(Decouple)
    assert [type(m) for m in bench.take(Message)] == [Terminate]


def test_localization_that_never_answers_does_not_hold_it() -> None:
    bench = rider_in(S.RELOCALIZING)
    bench.wait(bench.machine.params.localize_timeout_s + 0.2)
    assert (bench.machine.state, str(bench.machine.ending)) == (S.IDLE, "localization did not answer")
    bench.hear(Decouple)
    assert len(bench.take(Ack)) == 1


# The goal is changed, and everything else that may happen at any time.


@pytest.mark.parametrize("state", S)
def test_the_goal_may_be_cancelled_in_every_state(state: HitchhikerState) -> None:
    bench = rider_in(state)
    bench.step(GoalCancelled())
    told = Terminate if state in (*COUPLED, *RETURNING) else RequestCancel
    nobody = state in (S.IDLE, S.REQUESTING, S.RELOCALIZING, S.PARTING)
    assert [type(m) for m in bench.take(Message)] == ([] if nobody else [told])
    _localized(bench, Pose2D(1.7, 5.72))
    assert bench.machine.state is S.IDLE
    assert bench.machine.offer is None
    assert bench.machine.goal is None or state in BEFORE_RIDE


@pytest.mark.parametrize("state", S)
def test_a_second_goal_is_the_only_command_that_is_not_allowed(state: HitchhikerState) -> None:
    bench = rider_in(state)
    if state is S.IDLE:
        bench.step(GoalGiven(RIDER_GOAL))
        assert bench.machine.state is S.REQUESTING
        return
    with pytest.raises(TransitionError, match=f"GoalGiven is not allowed in {state.value}"):
        bench.step(GoalGiven(RIDER_GOAL))
    assert bench.machine.state is state


@pytest.mark.parametrize("state", (*LOCKED, *COUPLED))
def test_only_its_own_driver_is_heard(state: HitchhikerState) -> None:
    bench = rider_in(state)
    for cls in MESSAGE_TYPES.values():
        if cls is not Accept:
            bench.hear(cls, robot_id="other")
        bench.hear(cls, ride_id="ride-0")
    assert bench.machine.state is state
    assert bench.take(Message) == []


def test_before_its_first_ride_it_answers_nobody() -> None:
    bench = rider_in(S.IDLE)
    for message in messages(DRIVER, RIDER, "").values():
        bench.step(message)
    assert (bench.machine.state, bench.effects) == (S.IDLE, [])


@pytest.mark.parametrize("state", S)
@pytest.mark.parametrize("cls", MESSAGE_TYPES.values())
def test_no_message_and_no_lack_of_knowledge_raises(state: HitchhikerState, cls: type[Message]) -> None:
    for pose, gap in ((None, None), (Pose2D(1.8, 5.72), 0.8), (Pose2D(1e100, -1e100), 1e100)):
        bench = rider_in(state)
        bench.pose, bench.gap = pose, gap
        bench.wait()
        bench.hear(cls)
        bench.hear(cls, ride_id="")
        bench.wait(1.0)
        assert bench.machine.state in S


# What the modules are told (P17 Table 3).


@pytest.mark.parametrize("state", S)
def test_the_modules_of_each_state(state: HitchhikerState) -> None:
    machine = rider_in(state).machine
    sees = (S.COUPLING, S.CATCHING_UP, S.RECOUPLING)
    alone = ModuleSwitches(PP=True, OBS=True, LZN=True, MAP=True, COM=True, VS=state in sees)
    riding = ModuleSwitches(PP=False, OBS=False, LZN=False, MAP=False, COM=True, VS=True)
    assert machine.modules == (riding if state in COUPLED else alone)
    assert (machine.servo is not None) == (state in (*sees, *COUPLED))
    if machine.servo is not None:
        task = "observe" if state is S.CATCHING_UP else "follow"
        assert (machine.servo.task, machine.servo.marker_id, machine.servo.gap_m) == (task, 0, 0.8)
    assert (machine.ride is not None) == (state not in (S.IDLE, S.REQUESTING))


@pytest.mark.parametrize("yaw_rate", [0.06, -0.4])
def test_a_rider_that_turns_on_the_spot_does_not_stand(yaw_rate: float) -> None:
    bench = rider_in(S.SETTLING)
    bench.yaw_rate = yaw_rate
    bench.wait(bench.machine.params.repeat_period_s + 0.3)
    assert bench.machine.state is S.SETTLING
    bench.yaw_rate = 0.0
    bench.wait(0.2)
    assert bench.machine.state is S.RELOCALIZING


def test_an_acknowledgement_tells_how_old_its_look_is() -> None:
    bench = rider_in(S.RIDING)
    situation = bench.situation()
    bench.step(Tick(situation))
    bench.now += 0.3
    bench.clear()
    bench.hear(Driver)
    (ack,) = bench.take(Ack)
    assert ack.seen == situation.observation.pose
    assert ack.seen_age_s == pytest.approx(0.3)


@pytest.mark.parametrize("moved", [Pose2D(0.15, 0.0, 0.1), Pose2D(-0.02, 0.0, 0.3)])
def test_a_pose_that_is_taken_over_is_carried_to_now_and_the_driver_stays_where_it_was_seen(moved: Pose2D) -> None:
    """The image is 0.3 s old: localization, which was off, cannot know what the robot did since."""
    neighbours = Neighbours()
    bench = rider_in(S.SETTLING, neighbours=neighbours)
    neighbours.hear(replace(messages()[Beacon], robot_id=DRIVER, pose=Pose2D(11.0, 5.0)), bench.now)
    then = Pose2D(7.0, -1.0, 2.0)
    situation = replace(bench.situation(), seen_from=then, odom_pose=compose(then, moved), speed_mps=0.4)
    bench.now += bench.machine.params.settle_timeout_s  # it never stood
    situation = replace(situation, observation=replace(situation.observation, stamp=bench.now - 0.3))
    bench.step(Tick(situation))
    (taken,) = bench.take(TakePose)
    driver = messages()[Decouple].pose
    seen = situation.observation.pose
    at_image = compose(compose(driver, MARKER_POSE), inverse(seen))
    expected = compose(at_image, moved)
    assert astuple(taken.estimate.pose) == pytest.approx(astuple(expected))
    assert taken.estimate.stamp == bench.now
    assert astuple(_place_of(DRIVER, neighbours)) == pytest.approx(astuple(driver))
    # Until localization answers it rolls on; the driver does not.
    on = compose(situation.odom_pose, Pose2D(0.1, 0.0, -0.05))
    bench.now += 0.2
    off = Pose2D(0.03, -0.02, 0.01)  # by which the pose was wrong
    own = compose(off, compose(expected, Pose2D(0.1, 0.0, -0.05)))
    estimate = PoseEstimate(bench.now, own, np.array(SIGMA))
    bench.step(Tick(Situation(estimate, odom_pose=on)))
    assert bench.machine.state is not S.RELOCALIZING
    assert astuple(_place_of(DRIVER, neighbours)) == pytest.approx(astuple(compose(off, driver)))
