"""Recording a run: what is heard goes where it is scored, and samples are due by their periods."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Contact, MarkerObservation, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.experiments.scenarios.ride_record import (
    CpuSample,
    MemorySample,
    StepSample,
    TimedPose,
    TrafficSample,
)
from hitchhike_ros.experiments.scenarios.ride_recorder import RideRecorder, Sampling, SamplingParameters, missed
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.status import RideStatus, Status
from hitchhike_ros.simulation.world_file import load_world
from repository import ROOT

WORLD = load_world(ROOT / "maps" / "p17_exp1.world.yaml")


@pytest.fixture
def recorder() -> RideRecorder:
    return RideRecorder.of_world(WORLD, 5, ROOT)


def test_a_record_begins_with_the_world_and_the_robots_mounts(recorder: RideRecorder) -> None:
    record = recorder.record
    assert (record.scenario, record.seed, record.true_boxes) == ("p17_exp1", 5, WORLD.boxes)
    assert list(record.robots) == list(WORLD.robots)
    driver = record.robots["p3dx"]
    assert driver.marker.x < 0.0 < driver.camera.x
    assert abs(driver.marker.theta) == pytest.approx(math.pi)
    assert all(record.robots[name].has_goal == (entry.goal is not None) for name, entry in WORLD.robots.items())


def test_each_robot_keeps_what_it_did_and_believed(recorder: RideRecorder) -> None:
    estimate = PoseEstimate(1.5, Pose2D(1.1, 2.0, 0.1), np.diag([0.01, 0.01, 0.02]))
    boxes = [Obstacle("a", 1.0, 1.0, 0.2, 0.2)]
    recorder.truth("p3dx", 1.0, Pose2D(1.0, 2.0, 0.1))
    recorder.estimate("p3dx", estimate)
    recorder.initial_pose("p3dx", replace(estimate, stamp=0.5))
    recorder.award("p3dx", Award("ride", "turtlebot", 20.0, 8.0))
    recorder.obstacles("p3dx", [Obstacle("old", 0.0, 0.0, 1.0, 1.0)])
    recorder.obstacles("p3dx", boxes)
    recorder.markers("p3dx", [MarkerObservation(1.2, 7, Pose2D(0.8, 0.0, math.pi), np.eye(3))])
    robot = recorder.record.robots["p3dx"]
    assert robot.truth == [TimedPose(1.0, 1.0, 2.0, 0.1)]
    assert [(e.stamp, e.x, e.sigma[2][2]) for e in robot.estimates] == [(1.5, 1.1, 0.02)]
    assert [e.stamp for e in robot.initial_poses] == [0.5]
    assert [award.points for award in robot.awards] == [8.0]
    assert robot.obstacles == tuple(boxes)
    assert [(s.stamp, s.marker_id, s.x) for s in robot.sightings] == [(1.2, 7, 0.8)]
    assert recorder.record.robots["turtlebot"].truth == []


def test_the_run_keeps_messages_contacts_and_samples(recorder: RideRecorder) -> None:
    contact, cpu = Contact(2.0, "p3dx", "walls", 1.0, 1.0), CpuSample(1.0, 100.0, "/p3dx/slam", 0.5, 40.0)
    recorder.message(1.0, "{}")
    recorder.contact(contact)
    recorder.cpu(cpu)
    recorder.traffic(TrafficSample(1.0, "/p3dx/slam", 3))
    recorder.memory(MemorySample(2.0, "/p3dx/slam", 30.0))
    recorder.clock(1.0, 100.0)
    recorder.clock(4.0, 106.0)
    recorder.simulator(1.0, {"contacts": "0"})
    recorder.simulator(2.0, {"steps": "2", "late_steps": "1"})
    record = recorder.record
    assert [m.text for m in record.messages] == ["{}"]
    assert (record.contacts, record.cpu, record.traffic[0].messages_in) == ([contact], [cpu], 3)
    assert record.lasted == (3.0, 6.0)
    assert record.simulator == {"steps": "2", "late_steps": "1"}
    assert record.steps == [StepSample(2.0, 2, 1)]
    assert record.memory == [MemorySample(2.0, "/p3dx/slam", 30.0)]


def test_a_switch_is_told_once(recorder: RideRecorder) -> None:
    assert not recorder.switched()
    first = Status(1.0, "p3dx", "none", "navigating")
    recorder.status("p3dx", first)
    assert recorder.switched() and not recorder.switched()
    recorder.status("p3dx", replace(first, time_stamp=2.0))
    assert not recorder.switched()


def test_a_run_is_over_when_all_with_a_goal_have_come_to_an_end(recorder: RideRecorder) -> None:
    record = recorder.record
    record.robots["turtlebot"].has_goal = False
    assert not record.over
    recorder.status("p3dx", Status(1.0, "p3dx", "none", "navigating"))
    assert not record.over
    recorder.status("p3dx", Status(2.0, "p3dx"))
    assert record.over
    record.robots["p3dx"].has_goal = False
    assert not record.over  # nobody has anything to do: nothing has happened yet


def test_the_ride_is_as_long_as_its_driver_says(recorder: RideRecorder) -> None:
    ride = RideStatus("r", "p3dx", "turtlebot", 20.0, 7.5)
    assert recorder.record.ridden_m("turtlebot") == 0.0
    recorder.status("turtlebot", Status(1.0, "turtlebot", "hitchhiker", "riding", ride=replace(ride, ridden_m=1.0)))
    assert recorder.record.ridden_m("turtlebot") == 0.0
    recorder.status("p3dx", Status(1.0, "p3dx", "driver", "driving", ride=ride))
    assert recorder.record.ridden_m("turtlebot") == recorder.record.ridden_m("p3dx") == 7.5
    stranger = replace(ride, driver="nobody")
    recorder.status("turtlebot", Status(2.0, "turtlebot", "hitchhiker", "riding", ride=stranger))
    assert recorder.record.ridden_m("turtlebot") == 0.0


def test_samples_are_due_by_their_periods_and_at_once_in_a_hurry() -> None:
    sampling = Sampling(SamplingParameters(cpu_s=0.4, traffic_s=4.0))
    times = [0.1 * k for k in range(100)]
    assert [t for t in times if sampling.due("cpu", t)][:4] == pytest.approx([0.0, 0.4, 0.8, 1.2])
    assert [t for t in times if sampling.due("traffic", t)] == pytest.approx([0.0, 4.0, 8.0])
    sampling.hurry("traffic")
    assert sampling.due("traffic", 8.5) and not sampling.due("traffic", 8.6)


def test_only_nodes_that_a_ride_needs_are_missed() -> None:
    gone = ["/p3dx/slam", "/rviz", "/turtlebot/robot", "/operator", "/simulator"]
    assert missed(gone) == ["/p3dx/slam", "/turtlebot/robot", "/simulator"]
