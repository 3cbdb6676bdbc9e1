"""When servoing looks at an image, what it makes of it, and when the robot stands."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import marker_images as images
from flat_world import TURTLEBOT
from hitchhike_ros.control.safety_limiter import SafetyLimiter
from hitchhike_ros.core.datatypes import CameraInfo, LaserScan, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import ParameterError, RobotModelError, SensorDataError
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.modules.inputs import CameraImage, ServoingCommand
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Level, Refused
from hitchhike_ros.modules.visual_servoing import (
    View,
    VisualServoing,
    VisualServoingOutputs,
    VisualServoingParameters,
)
from hitchhike_ros.protocol.status import ANY_MARKER, ModuleSwitches, ServoCommand, Status
from hitchhike_ros.servoing.follow import FollowDecision, FollowLaw
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.marker_tracker import MarkerTracker
from hitchhike_ros.servoing.qr_codes import code_id

PARAMS = VisualServoingParameters()
STAND = ServoingCommand(Twist2D())
FOLLOW, OBSERVE = ServoCommand("follow", 0), ServoCommand("observe", 0)
CAMERA_X = float(images.T_BASE_CAMERA[0, 3])


@lru_cache
def picture(marker_id: int | None = 0, gap_m: float = 0.8, size_m: float = 0.16) -> np.ndarray:
    """A marker square-on ahead, or a bare wall."""
    if marker_id is None:
        return np.full((480, 640), 120, np.uint8)
    return images.render_marker(marker_id, images.marker_pose(gap_m), size_m)


def status(servo: ServoCommand | None) -> Status:
    return Status(0.0, "turtlebot", modules=ModuleSwitches(VS=servo is not None), servo=servo)


def raising(text: str) -> Callable[[], Any]:
    def gray() -> Any:
        raise SensorDataError(text)

    return gray


def scan(now: float, ahead_m: float = math.inf) -> LaserScan:
    """Of a wall straight ahead, from the laser."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, 181)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(ahead_m / np.maximum(np.cos(angles), 1e-9), 20.0)
    return LaserScan(
        now, float(angles[0]), float(angles[1] - angles[0]), 0.02, 8.0, np.where(ranges > 8, np.inf, ranges)
    )


class Rig:
    """A module, its inputs, and what it says of them."""

    def __init__(self, *, law: Any = None, alone: ServoCommand | None = None, **options: Any) -> None:
        self.tracker = options.pop("tracker", None) or MarkerTracker()
        self.module = VisualServoing(
            options.pop("params", PARAMS),
            self.tracker,
            images.T_BASE_CAMERA,
            FollowLaw(FollowParameters(), TURTLEBOT, CAMERA_X) if law is None else law or None,
            options.pop("limiter", SafetyLimiter(TURTLEBOT, Pose2D())),
            alone=alone,
            **options,
        )
        self.looked_at: list[float] = []
        self.speed_mps = 0.0
        self.laser = True  # whether a scan, in which there is nothing, comes with each image

    def drain(self, now: float) -> list[VisualServoingOutputs]:
        """Step as a host does."""
        outputs = []
        while self.module.next_due(now) <= now:
            outputs.append(self.module.step(now))
            assert len(outputs) < 5
        return outputs

    def order(self, servo: ServoCommand | None, now: float) -> list[VisualServoingOutputs]:
        self.module.order(status(servo), now)
        return self.drain(now)

    def image(self, stamp: float, pixels: np.ndarray | str, now: float | None = None) -> VisualServoingOutputs:
        """One image, or one that is none for this reason."""

        def gray() -> Any:
            self.looked_at.append(stamp)
            return raising(pixels)() if isinstance(pixels, str) else pixels

        now = stamp if now is None else now
        if self.laser:
            self.module.sense(scan(now), now)
        self.module.sense(CameraImage(stamp, gray, gray, "camera"), now)
        [outputs] = self.drain(now)
        assert outputs.answered == stamp
        return outputs

    def odometry(self, now: float) -> None:
        self.module.sense(Odometry(now, Pose2D(self.speed_mps * now), Twist2D(self.speed_mps)), now)

    def ride(
        self, start: float, end: float, pixels: np.ndarray | str | None = None, period_s: float = 0.1
    ) -> list[VisualServoingOutputs]:
        """Images with ``period_s`` between them; the marker is at its gap where none are given."""
        said = []
        for i in range(round((end - start) / period_s) + 1):
            now = round(start + period_s * i, 6)
            self.odometry(now)
            said.append(self.image(now, picture() if pixels is None else pixels))
        return said


def following(start: float = 0.0, end: float = 0.9, speed_mps: float = 0.4, **options: Any) -> Rig:
    """Behind a driver, at its gap, with images from ``start`` to ``end``, the last of which was looked at."""
    rig = Rig(**options)
    rig.speed_mps = speed_mps
    rig.order(FOLLOW, start)
    rig.module.sense(images.CAMERA, start)
    rig.ride(start, end)
    assert rig.looked_at[-1] == pytest.approx(end)
    return rig


# On and off.


def test_off_it_hears_nothing_and_says_so_once() -> None:
    rig = Rig()
    assert rig.module.listens() == frozenset()
    [outputs] = rig.drain(0.0)
    assert (outputs.health.level, outputs.health.reason) == (Level.OK, "off")
    assert (outputs.command, outputs.answered) == (None, None)
    rig.module.sense(CameraImage(1.0, raising("x"), raising("x")), 1.0)
    rig.module.sense(Refused(Odometry, "x"), 1.0)
    assert rig.module.next_due(1.0) == math.inf


@pytest.mark.parametrize(
    ("servo", "modules", "on"),
    [
        (FOLLOW, ModuleSwitches(VS=True), True),
        (FOLLOW, ModuleSwitches(), False),
        (None, ModuleSwitches(VS=True), False),
    ],
)
def test_the_status_switches_it(servo: ServoCommand | None, modules: ModuleSwitches, on: bool) -> None:
    rig = Rig()
    rig.module.order(Status(0.0, "t", modules=modules, servo=servo), 0.0)
    assert (CameraImage in rig.module.listens()) == on


def test_it_hears_scans_only_while_it_follows() -> None:
    rig = Rig()
    rig.order(OBSERVE, 0.0)
    assert rig.module.listens() == {CameraImage, CameraInfo, Odometry}
    rig.order(FOLLOW, 1.0)
    assert rig.module.listens() == {CameraImage, CameraInfo, Odometry, LaserScan}


def test_switched_on_it_waits_for_images() -> None:
    [outputs] = Rig().order(FOLLOW, 3.0)
    assert (outputs.health.level, outputs.health.reason) == (Level.OK, "waiting for images")
    assert outputs.command is None


@pytest.mark.parametrize("next_order", [None, OBSERVE, ServoCommand("follow", 7)])
def test_it_stops_the_robot_when_it_follows_no_more(next_order: ServoCommand | None) -> None:
    [outputs] = following().order(next_order, 0.95)
    assert outputs.command == STAND


def test_switched_off_it_says_so() -> None:
    for order in (FOLLOW, OBSERVE):
        rig = Rig()
        rig.order(order, 0.0)
        [outputs] = rig.order(None, 1.0)
        assert (outputs.health.level, outputs.health.reason) == (Level.OK, "off")
        assert outputs.command == (STAND if order is FOLLOW else None)


def test_another_task_is_done_with_the_same_camera() -> None:
    rig = following()
    rig.order(OBSERVE, 0.95)
    assert rig.ride(1.0, 1.0)[0].health.reason == "observing"
    rig.order(FOLLOW, 1.05)
    assert rig.ride(1.1, 1.1)[0].health.reason == "following"


def test_an_order_that_is_repeated_changes_nothing() -> None:
    rig = following()
    assert rig.order(ServoCommand("follow", 0, gap_m=0.81, feed_forward_mps=0.4), 1.05) == []
    assert rig.module.next_due(1.05) > 1.05


def test_after_a_pause_nothing_of_before_counts() -> None:
    rig = following()
    rig.order(None, 1.0)
    rig.order(FOLLOW, 1.1)
    rig.odometry(1.2)
    outputs = rig.image(1.2, picture())
    assert outputs.health.reason == "stopped: no camera_info: none received"
    assert outputs.health.level is Level.WARN  # it has only just been switched on
    assert outputs.command == STAND


@pytest.mark.parametrize("order", [ServoCommand("follow", 7), None])
def test_for_a_new_order_the_driver_is_forgotten(order: ServoCommand | None) -> None:
    rig = following()
    rig.order(order, 1.0)
    rig.order(FOLLOW, 1.0)
    rig.module.sense(images.CAMERA, 1.0)
    rig.odometry(1.1)
    assert rig.image(1.1, picture(None)).health.reason == "searching: marker not seen yet"


def test_while_an_order_holds_the_driver_is_remembered() -> None:
    rig = following()
    rig.order(FOLLOW, 1.0)
    rig.odometry(1.2)
    assert rig.image(1.2, picture(None)).health.reason == "following"


# What it sees.


def test_it_follows_and_says_what_it_sees() -> None:
    rig = Rig()
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    outputs = rig.ride(0.0, 0.0, picture(0, 1.2))[0]
    assert outputs.command is not None
    assert outputs.command.twist.v > 0.05
    assert (outputs.health.level, outputs.health.reason) == (Level.OK, "following")
    assert outputs.health.counters["gap_m"] == pytest.approx(1.2, abs=0.02)
    assert outputs.health.counters["braked_for_an_obstacle"] is False
    assert outputs.observations is not None
    assert (outputs.observations.stamp, outputs.observations.following) == (0.0, "following")
    [seen] = outputs.observations.markers
    assert (seen.stamp, seen.marker_id) == (0.0, 0)
    assert seen.pose.x == pytest.approx(1.2 + CAMERA_X, abs=0.02)
    assert outputs.view is View.SEEN
    assert outputs.look is not None
    assert (outputs.look.markers, outputs.look.carried) == (1, False)
    assert outputs.look.target is not None
    assert outputs.look.target.code.message == "36h11 id: 0"


def test_the_pose_belongs_to_the_image_that_came_late() -> None:
    rig = Rig()
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    rig.odometry(0.0)
    rig.odometry(0.2)
    outputs = rig.image(0.05, picture(), now=0.2)
    assert outputs.observations is not None
    assert [o.stamp for o in outputs.observations.markers] == [0.05]


def test_what_it_follows_is_carried_and_what_it_observes_is_looked_for_in_all_of_the_image() -> None:
    for order, carried in ((FOLLOW, True), (OBSERVE, False)):
        rig = Rig()
        rig.order(order, 0.0)
        rig.module.sense(images.CAMERA, 0.0)
        look = rig.ride(0.0, 0.1)[-1].look
        assert look is not None
        assert look.carried == carried


def test_alone_it_carries_also_what_it_observes() -> None:
    rig = Rig(alone=OBSERVE)
    rig.drain(0.0)
    rig.module.sense(images.CAMERA, 0.0)
    look = rig.ride(0.0, 0.1)[-1].look
    assert look is not None
    assert look.carried


def test_alone_it_obeys_nobody() -> None:
    rig = Rig(alone=OBSERVE, law=False)
    [outputs] = rig.drain(5.0)
    assert outputs.health.reason == "waiting for images"
    assert CameraImage in rig.module.listens()
    rig.order(None, 6.0)
    rig.order(FOLLOW, 6.0)
    rig.module.sense(images.CAMERA, 6.0)
    outputs = rig.image(6.0, picture(), now=6.0)
    assert (outputs.health.reason, outputs.command) == ("observing", None)
    assert rig.image(1e6, picture(), now=1e6).health.reason == "observing"


def test_observing_does_not_drive() -> None:
    rig = Rig()
    rig.order(OBSERVE, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    [outputs] = rig.ride(0.0, 0.0)
    assert (outputs.command, outputs.health.reason) == (None, "observing")
    assert outputs.observations is not None
    assert outputs.observations.following == ""
    assert len(outputs.observations.markers) == 1


def test_any_marker_is_the_nearest_one() -> None:
    near, far = np.roll(picture(3, 1.2), 120, axis=1), np.roll(picture(5, 2.0), -120, axis=1)
    rig = Rig(alone=ServoCommand("observe", ANY_MARKER))
    rig.drain(0.0)
    rig.module.sense(images.CAMERA, 0.0)
    look = rig.image(0.0, np.where(np.arange(640) < 320, far, near).astype(np.uint8)).look
    assert look is not None
    assert look.target is not None
    assert (look.target.id, look.markers) == (3, 2)


def test_a_marker_that_is_not_the_one_is_seen_and_not_followed() -> None:
    rig = Rig()
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    [outputs] = rig.ride(0.0, 0.0, picture(5))
    assert outputs.view is View.SEEKING
    assert outputs.look is not None
    assert (outputs.look.target, outputs.look.markers) == (None, 1)
    assert outputs.observations is not None
    assert [o.marker_id for o in outputs.observations.markers] == [5]
    assert outputs.health.reason == "searching: marker not seen yet"
    assert outputs.health.level is Level.WARN


def test_the_size_of_the_marker_is_the_orders() -> None:
    rig = Rig()
    rig.order(ServoCommand("follow", 0, marker_size_m=0.32), 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    assert rig.ride(0.0, 0.0)[0].health.counters["gap_m"] == pytest.approx(1.6, abs=0.03)


def test_how_an_image_fared_is_said_as_visp_auto_tracker_says_it() -> None:
    assert {view.name: int(view) for view in View} == {"NO_IMAGE": 0, "SEEKING": 1, "SEEN": 3}


# Which images it leaves out.


def test_while_it_follows_steadily_every_other_image_is_left_out_and_never_converted() -> None:
    rig = following()
    rig.looked_at.clear()
    said = rig.ride(1.0, 2.0)
    assert rig.looked_at == pytest.approx([1.1, 1.3, 1.5, 1.7, 1.9])
    for outputs, before in zip(said[2::2], said[1::2], strict=False):
        assert outputs == VisualServoingOutputs(health=before.health, answered=outputs.answered)
    assert all(outputs.command is not None and outputs.command.twist.v > 0.25 for outputs in said[1::2])


def test_at_a_slower_rate_no_image_is_left_out() -> None:
    rig = following()
    rig.looked_at.clear()
    rig.ride(1.1, 2.1, period_s=0.2)
    assert len(rig.looked_at) == 6


def test_no_image_is_left_out_where_that_is_not_wanted() -> None:
    rig = following(params=VisualServoingParameters(steady_period_s=0.0))
    assert len(rig.looked_at) == 10


class Decided:
    """A law that decides as the test wants."""

    def __init__(self, decision: FollowDecision) -> None:
        self.decision = decision

    def reset(self) -> None: ...

    def add_odometry(self, _odometry: Odometry) -> None: ...

    def pose_at(self, _stamp: float) -> None: ...

    def step(self, *_: object) -> FollowDecision:
        return self.decision


STEADY = FollowDecision(Twist2D(0.4, 0.0), "following", "", 0.8)


@pytest.mark.parametrize(
    ("decision", "steady"),
    [
        (STEADY, True),
        (replace(STEADY, gap_m=0.839), True),
        (replace(STEADY, gap_m=0.841), False),
        (replace(STEADY, gap_m=0.759), False),
        (replace(STEADY, gap_m=None), False),
        (replace(STEADY, twist=Twist2D(0.251, 0.149)), True),
        (replace(STEADY, twist=Twist2D(0.249, 0.0)), False),
        (replace(STEADY, twist=Twist2D(0.4, 0.151)), False),
        (replace(STEADY, twist=Twist2D(0.4, -0.151)), False),
        (replace(STEADY, state="coasting"), False),
    ],
)
def test_it_leaves_an_image_out_only_while_it_follows_steadily(decision: FollowDecision, steady: bool) -> None:
    rig = Rig(law=Decided(decision))
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    rig.ride(0.0, 0.1)
    assert rig.looked_at == ([0.0] if steady else [0.0, 0.1])


def test_without_a_laser_images_are_left_out_as_well() -> None:
    rig = Rig(law=Decided(STEADY), limiter=None)
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    assert rig.ride(0.0, 0.1)[0].health.counters["braked_for_an_obstacle"] is False
    assert rig.looked_at == [0.0]


def test_an_image_after_one_without_the_marker_is_looked_at() -> None:
    rig = Rig(law=Decided(STEADY))
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    rig.ride(0.0, 0.2, picture(None))
    assert rig.looked_at == [0.0, 0.1, 0.2]


def test_an_image_of_before_is_looked_at() -> None:
    rig = following()
    rig.image(0.85, picture(), now=0.95)
    assert rig.looked_at[-1] == 0.85


def test_what_comes_between_ends_the_leaving_out_and_is_braked_for() -> None:
    rig = following()
    rig.laser = False
    rig.module.sense(scan(0.95, ahead_m=3.0), 0.95)
    assert rig.ride(1.0, 1.0)[0].observations is None  # left out
    rig.ride(1.1, 1.1)
    rig.module.sense(scan(1.15, ahead_m=0.35), 1.15)
    for now in (1.2, 1.3):
        [outputs] = rig.ride(now, now)
        assert outputs.observations is not None
        assert outputs.health.counters["braked_for_an_obstacle"] is True
        assert outputs.command is not None
        assert outputs.command.twist.v < 0.25


def test_one_bad_beam_does_not_blind_it() -> None:
    """A NaN among the beams once switched the limiter off, and it drove on at the box."""
    rig = following()
    rig.laser = False
    box = scan(0.95, ahead_m=0.35)
    rig.module.sense(replace(box, ranges=np.where(np.arange(181) == 100, np.nan, box.ranges)), 0.95)
    rig.ride(1.0, 1.1)
    [outputs] = rig.ride(1.2, 1.2)
    assert outputs.command is not None
    assert outputs.command.twist.v < 0.25
    assert outputs.health.counters["braked_for_an_obstacle"] is True
    assert outputs.health.counters["bad_beam_share"] == 0.006


def test_when_the_laser_dies_it_stands_within_half_a_second_and_says_so() -> None:
    rig = following()
    rig.laser = False
    rig.ride(1.0, 1.2)
    due = rig.module.next_due(1.2)
    assert due == pytest.approx(1.25)  # the last scan is of 0.9 s
    [outputs] = rig.drain(due)
    assert outputs.command == STAND
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, "stopped: no scan for 0.3 s")
    assert rig.module.next_due(due) > due + 0.2
    said = rig.ride(1.3, 1.6)[-1]
    assert (said.command, said.health.reason) == (STAND, "stopped: no scan for 0.7 s")
    rig.laser = True
    assert rig.ride(1.7, 1.9)[-1].health.reason == "following"


def test_a_scan_that_waits_at_its_host_is_no_reason_to_stand() -> None:
    rig = following()
    rig.laser = False
    rig.ride(1.0, 1.2)
    rig.module.sense(scan(1.2), 1.21)
    assert rig.drain(1.26) == []
    assert rig.ride(1.3, 1.3)[0].health.reason == "following"


@pytest.mark.parametrize("refused", [False, True])
def test_a_scan_that_cannot_be_used_is_none(refused: bool) -> None:
    rig = following()
    rig.laser = False
    why = "scan: 181 of 181 beams are NaN or below range_min 0.02 m, expected at most 90% (scan/max_bad_share)"
    bad = replace(scan(1.0), ranges=np.zeros(181))
    rig.module.sense(Refused(LaserScan, why) if refused else bad, 1.0)
    [outputs] = rig.drain(1.0)
    assert (outputs.command, outputs.health.reason) == (STAND, f"stopped: {why}")
    assert outputs.health.counters["bad_scans"] == 1


def test_without_a_laser_it_follows_and_says_that_nothing_brakes_it() -> None:
    rig = following(limiter=None)
    outputs = rig.ride(1.0, 1.1)[-1]
    assert outputs.health.reason == "following"
    assert outputs.health.counters["laser"] == "none: it brakes for no obstacle"


def test_a_new_order_does_not_drive_by_the_scans_of_before() -> None:
    rig = following()
    rig.laser = False
    rig.order(None, 1.0)
    rig.order(FOLLOW, 1.05)
    rig.module.sense(images.CAMERA, 1.05)
    assert rig.ride(1.1, 1.1)[0].health.reason == "stopped: no scan yet"


# When the robot stands.


def test_without_images_it_stands_and_says_so_again_and_again() -> None:
    rig = following()
    now, silent = 0.9, 0.9 + PARAMS.image_timeout_s
    for dt in (0.0, 0.1, 0.2):
        now = rig.module.next_due(now)
        assert now == pytest.approx(silent + dt)
        rig.odometry(now)
        [outputs] = rig.drain(now)
        assert (outputs.command, outputs.view) == (STAND, View.NO_IMAGE)
        assert (outputs.observations, outputs.answered, outputs.look) == (None, None, None)
        assert outputs.health.reason == f"stopped: no image for {0.3 + dt:.1f} s"
    assert outputs.health.level is Level.ERROR
    assert rig.ride(1.5, 1.5)[0].health.reason == "following"
    assert rig.module.next_due(1.5) == 1.5 + PARAMS.image_timeout_s


def test_what_is_missing_is_no_error_yet_when_it_has_just_been_switched_on() -> None:
    rig = Rig()
    rig.order(FOLLOW, 10.0)
    levels = [rig.drain(10.0 + dt)[0].health.level for dt in (0.3, 0.7, 1.0, 1.2)]
    assert levels == [Level.WARN, Level.WARN, Level.WARN, Level.ERROR]


def test_observing_without_images_moves_nothing() -> None:
    rig = Rig()
    rig.order(OBSERVE, 0.0)
    [outputs] = rig.drain(2.0)
    assert (outputs.command, outputs.view) == (None, View.NO_IMAGE)
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, "no image for 2.0 s")


@pytest.mark.parametrize("pixels", ["image of 0 bytes", np.zeros((3, 3), np.uint8)])
def test_an_image_that_cannot_be_used_is_named_and_counted(pixels: Any) -> None:
    rig = following(speed_mps=0.2)
    rig.odometry(1.1)
    outputs = rig.image(1.1, pixels)
    assert (outputs.command, outputs.view, outputs.look) == (STAND, View.NO_IMAGE, None)
    assert ("image of 0 bytes" if isinstance(pixels, str) else "(3, 3)") in outputs.health.reason
    assert outputs.health.counters["bad_images"] == 1
    assert outputs.observations is not None
    assert (outputs.observations.markers, outputs.observations.following) == ((), "stopped")


def test_a_calibration_that_cannot_be_used_is_named_until_one_comes_that_can() -> None:
    rig = following(speed_mps=0.2)
    rig.module.sense(Refused(CameraInfo, "distortion model 'equidistant' in it"), 1.05)
    [outputs] = rig.ride(1.1, 1.1)
    assert outputs.health.reason == "stopped: no camera_info: distortion model 'equidistant' in it"
    rig.module.sense(images.CAMERA, 1.15)
    assert rig.ride(1.2, 1.2)[0].health.reason == "following"


@pytest.mark.parametrize("refused", [True, False])
def test_bad_odometry_stops_it_and_ends_the_trail(refused: bool) -> None:
    rig = following()
    bad = Odometry(1.05, Pose2D(math.nan), Twist2D())
    rig.module.sense(Refused(Odometry, "odometry at 1.05 s is not finite") if refused else bad, 1.05)
    outputs = rig.image(1.1, picture(None))
    assert outputs.health.reason == "stopped: odometry at 1.05 s is not finite"
    assert outputs.health.counters["bad_odometry"] == 1
    assert outputs.command == STAND
    rig.odometry(1.2)
    assert rig.image(1.2, picture(None)).health.reason == "searching: marker not seen yet"


def test_odometry_that_stays_away_stops_it() -> None:
    rig = following(speed_mps=0.2)
    outputs = rig.image(1.4, picture())
    assert outputs.health.reason == "stopped: odometry is 0.50 s old"
    assert outputs.command == STAND


def test_bad_scans_are_counted() -> None:
    rig = following()
    rig.module.sense(Refused(LaserScan, "3 NaN beams"), 1.0)
    assert rig.ride(1.1, 1.2)[-1].health.counters["bad_scans"] == 1


def test_an_order_to_follow_that_is_not_repeated_ends_at_once() -> None:
    rig, end = following(end=3.3), ORDER_MAX_AGE_S
    assert rig.module.next_due(3.3) == end
    [outputs] = rig.drain(end)
    assert (outputs.command, outputs.view) == (STAND, None)
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, "stopped: no status for 3.5 s")
    assert rig.module.next_due(end) > end
    [outputs] = rig.ride(end + 0.1, end + 0.1)
    assert (outputs.command, outputs.health.reason) == (STAND, "stopped: no status for 3.6 s")
    rig.order(FOLLOW, end + 0.15)
    assert rig.ride(end + 0.2, end + 0.2)[0].health.reason == "following"


def test_an_image_at_the_end_of_the_order_is_not_left_out() -> None:
    rig = following(end=3.3)
    rig.ride(3.49, 3.49)
    [outputs] = rig.ride(ORDER_MAX_AGE_S, ORDER_MAX_AGE_S)
    assert (outputs.command, outputs.health.reason) == (STAND, "stopped: no status for 3.5 s")


def test_it_observes_on_without_a_status() -> None:
    rig = Rig()
    rig.order(OBSERVE, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    assert rig.image(100.0, picture(), now=100.0).health.reason == "observing"
    assert rig.module.next_due(100.0) == 100.0 + PARAMS.image_timeout_s


def test_without_a_law_it_cannot_follow() -> None:
    rig = Rig(law=False)
    rig.order(FOLLOW, 0.0)
    rig.module.sense(images.CAMERA, 0.0)
    outputs = rig.image(0.0, picture())
    assert outputs.command is None
    assert outputs.health.level is Level.ERROR
    assert "cannot follow" in outputs.health.reason


def test_a_clock_that_goes_back_leaves_it_working() -> None:
    rig = following(start=100.0, end=100.9)
    assert rig.module.next_due(5.0) <= 5.0
    rig.drain(5.0)
    assert rig.module.next_due(5.0) == pytest.approx(5.0 + PARAMS.image_timeout_s)
    [outputs] = rig.drain(5.31)
    assert outputs.command == STAND
    rig.order(FOLLOW, 5.4)
    rig.ride(5.4, 5.6)  # odometry of before the jump is thrown away
    assert rig.ride(5.7, 5.7)[0].health.reason == "following"


# What it is made of.


class Files:
    """A robot without files; ``sections`` are its parameters."""

    def __init__(self, described: bool = True, **sections: dict[str, object]) -> None:
        self._links = {"base_footprint": np.eye(4), "camera_optical": images.T_BASE_CAMERA} if described else {}
        self._sections = sections

    def load(self, cls: type, section: str) -> Any:
        return TURTLEBOT if cls is RobotLimits else load_parameters(cls, section, None, self._sections.get(section))

    def has(self, link: str) -> bool:
        return link in self._links

    def mount(self, link: str) -> np.ndarray:
        if link not in self._links:
            raise RobotModelError("robot.urdf", "link", link, "another one")
        return self._links[link]


def test_alone_it_observes_the_nearest_marker_unless_it_is_told_otherwise() -> None:
    module = VisualServoing.build(Files(described=False), follows=False, alone={})
    assert module.standing_order == ServoCommand("observe", ANY_MARKER)
    told = {"task": "follow", "code_message": "dock", "gap_m": 1.0}
    assert VisualServoing.build(Files(), alone=told).standing_order == ServoCommand(
        "follow", code_id("dock"), gap_m=1.0
    )
    assert VisualServoing.build(Files()).standing_order is None


def test_a_camera_that_is_nowhere_is_where_the_base_is_and_looks_ahead() -> None:
    module = VisualServoing.build(Files(described=False), alone={})
    module.step(0.0)
    module.sense(images.CAMERA, 0.0)
    module.sense(CameraImage(0.0, picture, picture), 0.0)
    seen = module.step(0.0).observations
    assert seen is not None
    assert seen.markers[0].pose.x == pytest.approx(0.8, abs=0.02)
    assert seen.markers[0].pose.y == pytest.approx(0.0, abs=0.02)
    right, down, ahead = module._T_base_camera[:3, :3].T.tolist()
    assert (right, down, ahead) == ([0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0])
    assert module._T_base_camera[:, 3].tolist() == module._T_base_camera[3].tolist() == [0.0, 0.0, 0.0, 1.0]


def test_a_robot_that_is_described_without_a_camera_is_refused() -> None:
    files = Files()
    del files._links["camera_optical"]
    with pytest.raises(RobotModelError, match="camera_optical"):
        VisualServoing.build(files)


def test_only_a_robot_with_a_laser_brakes_for_what_comes_between() -> None:
    for laser in (True, False):
        files = Files()
        if laser:
            files._links["laser"] = np.eye(4)
        module = VisualServoing.build(files)
        module.order(status(FOLLOW), 0.0)
        assert (LaserScan in module.listens()) == laser


@pytest.mark.parametrize(
    ("alone", "follows", "named"),
    [
        ({"task": "dance"}, True, "task"),
        ({"task": "follow"}, False, "config"),
        ({"gap_m": -1.0}, True, "gap_m"),
    ],
)
def test_a_standing_order_that_cannot_be_obeyed_is_refused(alone: dict, follows: bool, named: str) -> None:
    with pytest.raises(ParameterError, match=named):
        VisualServoing.build(Files(), follows=follows, alone=alone, where="/node")


@pytest.mark.parametrize(
    ("section", "named"), [({"family": "99h9"}, "99h9"), ({"marker_size_m": 0.0}, "marker_size_m")]
)
def test_a_marker_that_cannot_be_is_spoken_of_for_as_long_as_it_is_asked_for(section: dict, named: str) -> None:
    module = VisualServoing.build(Files(marker_detector=section), follows=False, alone=section)
    module.step(0.0)
    module.sense(images.CAMERA, 2.0)
    module.sense(CameraImage(2.0, picture, picture), 2.0)
    for outputs in (module.step(2.0), module.step(3.0)):
        assert (outputs.health.level, outputs.view, outputs.look) == (Level.ERROR, View.NO_IMAGE, None)
        assert named in outputs.health.reason


# Whatever comes.


class Blind:
    """A tracker that finds nothing, at once."""

    tracking = False

    def reset(self) -> None: ...

    def see(self, *_: object, **__: object) -> list:
        return []


dt = st.one_of(st.floats(0.0, 0.5), st.sampled_from([0.0, 0.1, 4.0, -3.0, -100.0]))
events = st.lists(
    st.tuples(
        dt,
        st.sampled_from(["image", "late image", "odometry", "bad odometry", "info", "scan", "follow", "off", "none"]),
    ),
    max_size=40,
)


@given(events)
def test_it_is_never_due_again_at_once_and_never_drives_on_without_images_or_orders(events: list) -> None:
    rig = Rig(tracker=Blind())
    now, image_at, ordered_at = 1000.0, -math.inf, -math.inf
    command, on = STAND, False
    for step, (ahead, event) in enumerate(events):
        for moment in itertools.chain(
            (now + ahead * i / 4 for i in range(1, 4)), [now + ahead]
        ):  # a host's thread wakes when it is due
            if ahead > 0.0 and rig.module.next_due(moment) <= moment:
                command = newest(command, rig.drain(moment))
        now += ahead
        match event:
            case "image" | "late image":
                stamp = now - (0.0 if event == "image" else 0.5)
                rig.module.sense(CameraImage(stamp, picture, picture), now)
                image_at = now if on else image_at
            case "odometry":
                rig.odometry(now)
            case "bad odometry":
                rig.module.sense(Refused(Odometry, "bad"), now)
            case "info":
                rig.module.sense(images.CAMERA, now)
            case "scan":
                rig.module.sense(scan(now), now)
            case "follow" | "off":
                rig.module.order(status(FOLLOW if event == "follow" else None), now)
                ordered_at, on = now, event == "follow"
        command = newest(command, rig.drain(now))
        assert rig.module.next_due(now) > now, (step, event)
        if not on:
            assert rig.module.next_due(now) == math.inf
            assert command == STAND
        elif now - image_at >= PARAMS.image_timeout_s or now - ordered_at >= ORDER_MAX_AGE_S:
            assert command == STAND


def newest(command: ServoingCommand, outputs: list[VisualServoingOutputs]) -> ServoingCommand:
    return next((o.command for o in reversed(outputs) if o.command is not None), command)
