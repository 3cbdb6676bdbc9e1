"""Bounds that keep drivers and agents from waiting, promising and asking for ever, each held by a test of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.protocol.agent import Agent
from hitchhike_ros.protocol.driver.convoy import Convoy, Offer, Rider
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import Effect, GoalGiven, Report, Situation, Tick
from hitchhike_ros.protocol.hitchhiker.ride import Ride
from hitchhike_ros.protocol.matching import Stretch
from hitchhike_ros.protocol.messages import Accept, Ack, Deny, Driver, Lock, RearMarker, Request, Terminate
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Reason
from protocol_helpers import (
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
    corridor_path,
    driver_in,
    messages,
)

S = DriverState
MEETING: dict[str, Any] = {
    "aligning": WEST.aligning_pose,
    "waiting": WEST.waiting_pose,
    "leave": (24.0, 5.72),
    "rear_marker": REAR_MARKER,
}


def _asked_from_afar(**params: Any) -> Bench:
    """A driver in a network that has answered a hitchhiker."""
    bench = driver_in(S.NAVIGATING, mode="network", min_ride_m=5.0, **params)
    bench.hear(Request)
    assert [type(message) for message in bench.take(Accept)] == [Accept]
    return bench


def _another(cls: type, ride_id: str = "other-1", **changes: Any) -> Any:
    return replace(messages("other", DRIVER, ride_id)[cls], **changes)


@pytest.mark.parametrize("state", [S.ALIGNING, S.ALIGNED])
def test_a_hitchhiker_that_says_nothing_more_is_dropped(state: DriverState) -> None:
    bench = _asked_from_afar(contact_timeout_s=5.0)
    bench.hear(Lock, **MEETING, in_s=2.0)
    if state is S.ALIGNED:
        bench.navigation = "arrived"
    bench.wait(0.1)
    bench.navigation = None
    bench.wait(6.7)  # until it would be there, and the time that it may say nothing
    assert bench.machine.state is state
    bench.clear()
    bench.wait(0.4)
    assert bench.machine.state is S.NAVIGATING
    assert {end.reason for end in bench.take(Terminate)} == {str(Reason.RIDER_GONE)}


@pytest.mark.parametrize(("after_s", "holds"), [(8.9, True), (9.2, False)])
def test_a_promise_holds_until_all_other_offers_are_heard_and_no_longer(after_s: float, holds: bool) -> None:
    bench = _asked_from_afar(offer_window_s=3.0, confirm_timeout_s=3.0)
    bench.wait(after_s)
    bench.clear()
    bench.hear(Lock, **MEETING)
    assert (bench.machine.state is S.ALIGNING) == holds
    assert [denial.reason for denial in bench.take(Deny)] == ([] if holds else [str(Reason.NOT_OFFERED)])


@pytest.mark.parametrize(("aside_m", "joins"), [(0.45, True), (0.55, False)])
def test_one_that_joins_boards_where_the_first_does_or_not_at_all(aside_m: float, joins: bool) -> None:
    bench = _asked_from_afar(places=2)
    bench.hear(Lock, **MEETING, in_s=5.0)
    boarding = bench.machine.facts.boarding
    bench.step(_another(Request))
    bench.clear()
    aligning, waiting = (Pose2D(pose.x + aside_m, pose.y) for pose in (WEST.aligning_pose, WEST.waiting_pose))
    bench.step(_another(Lock, **{**MEETING, "aligning": aligning, "waiting": waiting}, in_s=9.0))
    (answer,) = bench.take((Ack, Deny))
    assert bench.machine.riders == ((RIDER, "other") if joins else (RIDER,))
    assert isinstance(answer, Ack) == joins
    assert joins or answer.reason == str(Reason.INVALID_PLACE)
    # The driver aligns where it was to align.
    assert bench.machine.facts.boarding == boarding
    assert bench.machine.goal.pose == WEST.aligning_pose


@pytest.mark.parametrize("state", [S.NAVIGATING, S.ALIGNING, S.DRIVING])
@pytest.mark.parametrize("report", ["failed", "blocked"])
def test_one_bad_report_of_navigation_gives_nothing_up(state: DriverState, report: str) -> None:
    bench = driver_in(state)
    bench.navigation = "driving"
    bench.wait(1.0)
    bench.navigation = report
    bench.wait(0.2)
    assert bench.machine.state is state


def test_a_rider_that_has_not_said_what_it_sees_is_about_a_metre_behind_the_robot_ahead() -> None:
    convoy = Convoy(replace(REAR_MARKER, marker_id=0))
    riders = [
        Rider(
            Offer(name, name, WEST, Stretch(Polyline([(3.0, 5.72), (23.0, 5.72)]), 0.0, 20.0)),
            replace(REAR_MARKER, marker_id=k),
        )
        for k, name in ((1, "a"), (2, "b"))
    ]
    for rider in riders:
        convoy.add(rider)
    driver = PoseEstimate(1.0, Pose2D(5.0, 2.0, 0.0), np.array(SIGMA))
    ahead = convoy.pose_ahead_of(riders[1], driver, np.zeros((3, 3)))
    assert ahead.pose == Pose2D(4.0, 2.0, 0.0)
    assert ahead.covariance == pytest.approx(np.array(SIGMA) + np.diag([0.25, 0.09, 0.09]))
    assert convoy.pose_ahead_of(riders[0], driver, np.zeros((3, 3))).covariance == pytest.approx(np.array(SIGMA))


def test_a_rider_that_moves_up_forgets_the_way_of_the_robot_that_was_ahead() -> None:
    ride = Ride(HitchhikingParameters(), CAMERA, REAR_MARKER, 0.0)
    driver = messages()[Driver]
    ride.hear(replace(driver, ahead=REAR_MARKER), 1.0)
    track = ride._track
    ride.hear(replace(driver, ahead=REAR_MARKER, x=4.0), 2.0)
    assert ride._track is track
    assert len(ride.told) == 2
    ahead = RearMarker(marker_id=7, marker_size_m=0.16, marker_pose=MARKER_POSE)
    ride.hear(replace(driver, ahead=ahead, x=5.0), 3.0)
    assert ride.rear_marker == ahead
    assert ride._track is not track
    assert [pose.x for pose in ride.told] == [5.0]


# The agent.


def _here(now: float) -> Tick:
    return Tick(Situation(estimate=PoseEstimate(now, WEST.waiting_pose, np.array(SIGMA))))


def _agent(**params: Any) -> Agent:
    settings = {"mode": "network", "profile": 30.0, "min_ride_m": 5.0, "offer_window_s": 3.0, "board_anywhere": True}
    params = {**settings, **params}
    return Agent(RIDER, HitchhikingParameters(**params), SITES, corridor_path, MARKER_POSE, CAMERA, 0.3)


def _alone(**params: Any) -> Agent:
    """An agent in a network that has asked once, has been answered by nobody, and drives alone at 10 s."""
    agent = _agent(**params)
    agent.step(GoalGiven(RIDER_GOAL), 0.0)
    for now in range(11):
        agent.step(_here(float(now)), float(now))
    assert agent.driver.state is S.NAVIGATING
    return agent


def _reverses(agent: Agent, now: float, goal: Pose2D = RIDER_GOAL) -> bool:
    """Whether it rather rides than drives the better profile that asks it."""
    request = replace(messages("other", RIDER, f"other-{now}")[Request], goal=goal, profile=90.0)
    effects: list[Effect] = agent.step(request, now)
    return any(isinstance(effect, Report) and effect.reason is Reason.ROLES_REVERSED for effect in effects)


@pytest.mark.parametrize(("max_asks", "asks"), [(1, False), (2, True)])
def test_an_agent_asks_for_no_more_rides_than_it_may(max_asks: int, asks: bool) -> None:
    assert _reverses(_alone(max_asks=max_asks), 10.5) == asks


@pytest.mark.parametrize(("after_s", "again"), [(59.0, False), (61.0, True)])
def test_roles_are_looked_at_once_in_a_while(after_s: float, again: bool) -> None:
    agent = _alone(max_wait_s=60.0)
    assert not _reverses(agent, 10.5, goal=Pose2D(1.0, 5.72))  # its way is no use
    agent.step(_here(10.5 + after_s), 10.5 + after_s)
    assert _reverses(agent, 10.5 + after_s) == again


@pytest.mark.parametrize(("max_asks", "asks"), [(1, False), (2, True)])
def test_after_a_ride_it_asks_for_another_one_if_it_may(max_asks: int, asks: bool) -> None:
    agent = _agent(max_asks=max_asks)
    agent.step(GoalGiven(RIDER_GOAL), 0.0)
    agent.step(_here(0.0), 0.0)
    agent.hitchhiker.facts.rode = True
    for now in (1.0, 2.0, 3.0):
        assert agent.rides
        agent.step(_here(now), now)
    assert agent.rides == asks
    assert (agent.driver.state is S.NAVIGATING) != asks
