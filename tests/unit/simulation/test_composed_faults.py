"""What goes wrong on a composed ride: the modules see what they would see, and nothing else changes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import PoseEstimate, Twist2D
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.modules.inputs import CameraImage, ServoingCommand
from hitchhike_ros.modules.visual_servoing import VisualServoingOutputs
from hitchhike_ros.protocol.status import ModuleSwitches, ServoCommand
from hitchhike_ros.simulation.composed import ComposedRide, ComposedRobot
from hitchhike_ros.simulation.faults import Fault
from simulated_room import PACKAGE, make_world, robot

LEADER, FOLLOWER = "leader", "follower"


@pytest.fixture
def ride(tmp_path: Path) -> Iterator[ComposedRide]:
    robots = {LEADER: robot("p3dx", 3.5, 2.0, marker=0), FOLLOWER: robot("turtlebot", 2.0, 2.0, marker=1)}
    with make_world(tmp_path, robots) as world:
        ride = ComposedRide(world, PACKAGE)
        ride.start({n: PoseEstimate(0.0, e.start, np.diag([1e-3] * 3)) for n, e in world.file.robots.items()})
        yield ride


def followed(ride: ComposedRide, now: float, sees: bool = True, covered: bool = False) -> VisualServoingOutputs:
    """What servoing of the follower says when it is told to follow, and gets an image or none."""
    follower: ComposedRobot = ride.robots[FOLLOWER]
    servoing = follower.robot.modules["visual_servoing"]
    order = replace(follower.status, servo=ServoCommand("follow", 0), modules=ModuleSwitches(VS=True))
    servoing.order(order, now)
    servoing.sense(follower.body.odometry(), now)
    servoing.sense(replace(follower.body.scan(), stamp=now), now)
    assert CameraImage in servoing.listens()
    if sees:
        follower.see(now, covered)
    assert servoing.next_due(now) <= now
    outputs = servoing.step(now)
    assert isinstance(outputs, VisualServoingOutputs)
    return outputs


def test_a_fault_acts_from_its_start_until_its_end() -> None:
    fault = Fault("camera_silent", FOLLOWER, 2.0, 3.0)
    assert [fault.acts(t) for t in (1.9, 2.0, 2.9, 3.0)] == [False, True, True, False]
    assert Fault("camera_silent", FOLLOWER, 2.0).acts(math.inf) is False
    assert Fault("camera_silent", FOLLOWER, 2.0).acts(1e9)


def test_a_covered_lens_sees_no_marker(ride: ComposedRide) -> None:
    open_, covered = followed(ride, 0.0).observations, followed(ride, 0.3, covered=True).observations
    assert open_ is not None
    assert covered is not None
    assert [len(open_.markers), len(covered.markers)] == [1, 0]


def test_with_a_camera_that_stays_silent_servoing_stands(ride: ComposedRide) -> None:
    assert followed(ride, 0.0).health.reason.startswith("following")
    outputs = followed(ride, 0.5, sees=False)
    assert outputs.command == ServoingCommand(Twist2D())
    assert outputs.health.reason == "stopped: no image for 0.5 s"


def test_one_that_is_cut_off_hears_nobody_and_is_not_heard(ride: ComposedRide) -> None:
    def hear_each_other() -> list[int]:
        for _ in range(12):
            ride.step()
        return [len(ride.robots[name].status.robots) for name in (LEADER, FOLLOWER)]

    ride.messages.clear()  # what was said before
    ride.faults.append(Fault("messages_lost", FOLLOWER, 0.0, 1.25))
    assert hear_each_other() == [0, 0]
    assert hear_each_other() == [1, 1]


def test_who_is_steered_drives_so(ride: ComposedRide) -> None:
    ride.faults.append(Fault("steered", LEADER, 0.0, 1.0, Twist2D(0.3)))
    for _ in range(15):
        ride.step()
    moved = ride.world.robots[LEADER].ground_truth()[0].x - 3.5
    assert 0.1 < moved < 0.4
    assert ride.world.robots[FOLLOWER].ground_truth()[0].x == pytest.approx(2.0, abs=0.01)


def test_changed_parameters_are_checked(ride: ComposedRide) -> None:
    changed = ComposedRide(ride.world, PACKAGE, changes={LEADER: {"hitchhiking": {"marker_id": 7}}})
    assert changed.robots[LEADER].params.marker_id == 7
    assert changed.robots[FOLLOWER].params.marker_id == 1
    with pytest.raises(ParameterError, match="gap_m"):
        ComposedRide(ride.world, PACKAGE, changes={LEADER: {"hitchhiking": {"gap_m": -1.0}}})
