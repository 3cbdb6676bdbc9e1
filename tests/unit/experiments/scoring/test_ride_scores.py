"""How runs of scenarios are judged, where every number is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hitchhike_ros.core.datatypes import Contact, Pose2D
from hitchhike_ros.experiments.scenarios.paper import PaperTimes
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, TimedPose, TimedText
from hitchhike_ros.experiments.scenarios.ride_scenario import ExpectedDenial, ExpectedRide, RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.ride_scores import Score, score, score_in, steps
from hitchhike_ros.experiments.scoring.rides import find_rides
from hitchhike_ros.protocol.messages import Deny, encode
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.people import Person
from hitchhike_ros.simulation.world_file import load_world
from repository import ROOT
from synthetic_ride import ALIGNING, DECOUPLING, OFFERED, RELEASED, REQUESTED, RIDE_M, RIDING, synthetic_ride

MARKERS = {0: "p3dx", 1: "turtlebot"}
PAPER = PaperTimes(15.0, 17.0, 3.0, 32.0, 35.0)
RIDE = ExpectedRide("turtlebot", "p3dx", RIDE_M, 8.2, PAPER)
SCENARIO = RideScenario("A ride", "P17", {}, rides=(RIDE,), name="ride")
DENIED = RideScenario("Denied", "P17", {}, "denied", denial=ExpectedDenial("turtlebot", "Profile mismatch", 25.0))


def judged(scenario: RideScenario, record: RideRecord) -> Score:
    goals: dict[str, Pose2D | None] = {name: robot.truth[-1].pose for name, robot in record.robots.items()}
    return score(scenario, record, MARKERS, goals)


def figure(found: Score, name: str) -> Figure:
    return next(f for f in found.figures if f.name == name)


def denied_record(reason: str = "Profile mismatch") -> RideRecord:
    record = synthetic_ride()
    robot = record.robots["turtlebot"]
    robot.statuses = [s for s in robot.statuses if s.state in ("idle", "requesting") or s.role == "none"]
    deny = Outbox().stamp(Deny(robot_id="p3dx", to="turtlebot", ride_id="ride", reason=reason), REQUESTED + 1.0)
    record.messages = [TimedText(REQUESTED + 1.0, encode(deny))]
    return record


def test_a_ride_as_it_should_be() -> None:
    found = judged(SCENARIO, synthetic_ride())
    assert found.trouble == ""
    assert figure(found, "couple").value == pytest.approx(RIDING - ALIGNING)
    assert figure(found, "wait").value == pytest.approx(OFFERED - REQUESTED)
    assert figure(found, "decouple").value == pytest.approx(RELEASED - DECOUPLING)
    assert figure(found, "ride").value == pytest.approx(RIDE_M, abs=0.01)
    assert figure(found, "goal_error_max").value == 0.0


def test_times_must_be_below_the_papers() -> None:
    found = judged(SCENARIO, synthetic_ride())
    assert figure(found, "couple").ok and figure(found, "couple").peer == 15.0
    assert figure(found, "wait").ok is False  # 4 s, the paper's made up 3 s


def test_ride_and_award_are_within_two_percent() -> None:
    found = judged(SCENARIO, synthetic_ride())
    assert figure(found, "ride_deviation").ok
    assert figure(found, "award_deviation").ok is False  # 8.0 points, not 8.2
    assert figure(found, "award_deviation").value == pytest.approx(2.44, abs=0.01)


def test_no_ride_is_trouble_and_says_where_it_stuck() -> None:
    record = denied_record()
    record.robots["turtlebot"].statuses.insert(2, Status(11.0, "turtlebot", "hitchhiker", "requesting", "Why not"))
    assert judged(SCENARIO, record).trouble == "no ride of turtlebot with p3dx; its last state: 'requesting' (Why not)"


def test_a_robot_that_does_not_arrive_is_trouble() -> None:
    record = synthetic_ride()
    record.robots["p3dx"].newest_status = Status(90.0, "p3dx", "none", "navigating", "No path")
    assert judged(SCENARIO, record).trouble == "p3dx is not at its goal: in state 'navigating' (No path)"


def test_a_contact_is_trouble() -> None:
    record = synthetic_ride()
    record.contacts = [Contact(30.0, "p3dx", "obs1", 9.2, 6.1)]
    assert judged(SCENARIO, record).trouble == "p3dx touched obs1 at 30.0 s"


def test_another_ride_than_expected_is_trouble() -> None:
    other = replace(SCENARIO, rides=(ExpectedRide("turtlebot", "p3dx"), ExpectedRide("p3dx", "turtlebot")))
    assert "no ride of p3dx with turtlebot" in judged(other, synthetic_ride()).trouble


def test_a_denial_as_it_should_be() -> None:
    found = judged(DENIED, denied_record())
    assert found.trouble == ""
    assert figure(found, "denials").value == 1.0
    assert figure(found, "wait").value == pytest.approx(RELEASED - REQUESTED)


def test_a_denial_for_another_reason_or_a_ride_is_trouble() -> None:
    assert "never denied" in judged(DENIED, denied_record("High priority")).trouble


def test_who_is_denied_at_the_tick_at_which_it_asks_has_not_waited():
    record = denied_record()
    robot = record.robots["turtlebot"]
    robot.statuses = [replace(s, time_stamp=RELEASED) if s.state == "requesting" else s for s in robot.statuses]
    assert figure(judged(DENIED, record), "wait").value == 0.0
    assert judged(DENIED, synthetic_ride()).trouble != ""


def test_a_driver_that_should_be_lost_and_was_not() -> None:
    lost = replace(SCENARIO, end="lost")
    assert "should have been lost" in judged(lost, synthetic_ride()).trouble


@pytest.mark.parametrize(
    ("driver_there", "hitchhiker_there", "couple", "wait", "waited"),
    [(20.0, 12.0, 5.0, 8.0, 0.0), (12.0, 20.0, 5.0, 0.0, 8.0), (20.0, 0.0, 5.0, 10.0, 0.0)],
)
def test_in_a_network_who_waits_is_seen_from_where_robots_are(
    driver_there: float, hitchhiker_there: float, couple: float, wait: float, waited: float
) -> None:
    """Both come from afar; one that is there before the request waits from the request on."""
    record = synthetic_ride()
    for name, there in (("p3dx", driver_there), ("turtlebot", hitchhiker_there)):
        robot = record.robots[name]
        robot.truth = [TimedPose(p.stamp, p.x - 10.0 * (p.stamp < there - 0.05), p.y, p.theta) for p in robot.truth]
    (ride,) = find_rides(record)
    taken = steps(record, ride, local=False)
    assert (taken.couple_s, taken.wait_s, taken.driver_waited_s) == pytest.approx((couple, wait, waited))
    assert taken.driver_delay_s == pytest.approx(couple + 5.0 + waited)
    assert taken.hitchhiker_delay_s == pytest.approx(couple + 5.0 + wait)


def test_two_rides_of_one_robot_are_told_apart_by_their_drivers() -> None:
    two = replace(SCENARIO, rides=(RIDE, ExpectedRide("turtlebot", "p3dx2")))
    names = [f.name for f in judged(two, synthetic_ride()).figures]
    assert {"p3dx_couple", "p3dx2_couple"} <= set(names)


def test_the_world_says_whose_markers_where_to_and_how_rides_are_arranged() -> None:
    world, record = load_world(ROOT / "maps" / "p17_exp1.world.yaml"), synthetic_ride()
    for name, robot in record.robots.items():
        goal = world.robots[name].goal
        if goal is not None:
            robot.truth.append(TimedPose(100.0, goal.x, goal.y, goal.theta))
    found = score_in(world, SCENARIO, record)
    assert figure(found, "goal_error_max").value == 0.0
    assert figure(found, "wait").value == pytest.approx(OFFERED - REQUESTED)  # by states: at a hitchhiking point
    afar = {name: replace(entry, hitchhiking={"mode": "network"}) for name, entry in world.robots.items()}
    assert figure(score_in(replace(world, robots=afar), SCENARIO, record), "wait").value == 0.0  # by places


def test_the_gap_has_no_bound_where_people_step_between() -> None:
    world, record = load_world(ROOT / "maps" / "p17_exp1.world.yaml"), synthetic_ride()
    person = Person("anna", ((1.0, 1.0), (2.0, 1.0)), 1.0)
    bounds = [
        figure(score_in(w, SCENARIO, record), "gap_error_rms").bound for w in (world, replace(world, people=(person,)))
    ]
    assert bounds == [0.10, None]
