"""When localization works on a scan, what it starts from, what it tells, and what it does while it is off."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import (
    LaserScan,
    MarkerObservation,
    Obstacle,
    Odometry,
    Pose2D,
    PoseEstimate,
    Twist2D,
)
from hitchhike_ros.core.errors import HitchhikeError, SensorDataError
from hitchhike_ros.core.geometry import between, compose
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import ScanParameters
from hitchhike_ros.mapping.new_obstacles import MappingParameters, NewObstacleMapper
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.modules.inputs import FoundObstacles, HandedOverObstacles, InitialPose
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Level, Refused
from hitchhike_ros.modules.slam import Slam, SlamOutputs, SlamParameters
from hitchhike_ros.protocol.observations import Observations
from hitchhike_ros.protocol.status import GoalCommand, KnownRobot, ModuleSwitches, Status
from laser_world import LASER, boxes_of, take_scan, walls_of

PARAMS = SlamParameters()
GRID = OccupancyGrid(np.pad(np.zeros((60, 80), np.int8), 2, constant_values=100), 0.05, Pose2D())
SIGMA = np.diag([0.01, 0.01, 0.001])
START = PoseEstimate(0.0, Pose2D(1.0, 1.5, 0.25), SIGMA)
BOX = Obstacle("obs1", 2.0, 1.0, 0.25, 0.25)
OFF = ModuleSwitches(LZN=False, MAP=False)
GOAL = GoalCommand("g", 3.0, 1.0, 0.0)
EVERYTHING = frozenset({Odometry, LaserScan, Observations, InitialPose, HandedOverObstacles})
ALWAYS = frozenset({InitialPose, HandedOverObstacles})


class Filter:
    """A localizer without mathematics: its pose is the one that it was started with, moved on by odometry."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.start: PoseEstimate | None = None
        self.odometry: list[Odometry] = []
        self.explained: float | None = None
        self.problem = ""  # of the next scan, marker or odometry
        self.used, self.explains = True, 0.876

    @property
    def initialised(self) -> bool:
        return self.start is not None

    @property
    def estimate(self) -> PoseEstimate:
        return self.estimate_at(self.odometry[-1].stamp if self.odometry else 0.0)

    @property
    def twist(self) -> Twist2D:
        return self.odometry[-1].twist

    def restart(self) -> None:
        self.calls.append("restart")
        self.start, self.odometry, self.explained = None, [], None

    def initialise(self, estimate: PoseEstimate) -> None:
        self.calls.append("initialise")
        self.start = estimate

    def predict(self, odometry: Odometry) -> None:
        self.calls.append(f"predict {odometry.stamp}")
        self._raise()
        self.odometry.append(odometry)

    def update_scan(self, scan: LaserScan) -> bool:
        self.calls.append(f"scan {scan.stamp}")
        self._raise()
        self.explained = self.explains if self.used else None
        return self.used

    def update_markers(self, markers: tuple[MarkerObservation, ...]) -> int:
        self.calls.append(f"{len(markers)} markers")
        self._raise()
        return len(markers)

    def odometry_at(self, stamp: float) -> Pose2D:
        return self.odometry[-1].pose if self.odometry else Pose2D()

    def estimate_at(self, stamp: float) -> PoseEstimate:
        assert self.start is not None
        return PoseEstimate(stamp, compose(self.start.pose, self.odometry_at(stamp)), self.start.covariance)

    def _raise(self) -> None:
        if self.problem:
            raise SensorDataError(self.problem)


class Boxes:
    """A mapper that finds what the test lets it find."""

    def __init__(self) -> None:
        self.obstacles: tuple[Obstacle, ...] = ()
        self.finds: list[tuple[Obstacle, ...]] = []  # at the next scans
        self.updates: list[tuple[float, float, list[tuple[Pose2D, float]]]] = []

    def update(self, scan: LaserScan, estimate: PoseEstimate, T_base_laser: Pose2D, others: list) -> bool:
        assert T_base_laser == LASER
        self.updates.append((scan.stamp, estimate.stamp, list(others)))
        self.obstacles = self.finds.pop(0) if self.finds else self.obstacles
        return True

    def add(self, obstacles: tuple[Obstacle, ...]) -> None:
        self.obstacles += tuple(box for box in obstacles if box not in self.obstacles)


def scan(stamp: float, returns: int = 21) -> LaserScan:
    """Of 21 beams, of which the last ones have no return."""
    return LaserScan(stamp, -1.0, 0.1, 0.02, 8.0, np.where(np.arange(21) < returns, 2.0, np.inf))


def status(modules: ModuleSwitches | None = None, **fields: Any) -> Status:
    return Status(0.0, "p3dx", modules=modules or ModuleSwitches(), **fields)


class Rig:
    """A module, on unless told otherwise, and what it says."""

    def __init__(self, *, on: bool = True, start: PoseEstimate | None = START, **options: Any) -> None:
        self.filter, self.boxes = Filter(), Boxes()
        self.slam = Slam(PARAMS, self.filter, self.boxes, GRID, LASER, **options)  # type: ignore[arg-type]
        self.said = SlamOutputs(health=None)  # type: ignore[arg-type]
        if on:
            self.order(status(goal=GOAL), 0.0)
        if start is not None:
            self.sense(InitialPose(start), 0.0)

    def drain(self, now: float) -> SlamOutputs:
        """Step as a host does; what the last step said."""
        steps = 0
        while self.slam.next_due(now) <= now:
            self.said, steps = self.slam.step(now), steps + 1
            assert steps <= 2
        return self.said

    def order(self, order: Status, now: float) -> SlamOutputs:
        self.slam.order(order, now)
        return self.drain(now)

    def sense(self, x: object, now: float) -> SlamOutputs:
        self.slam.sense(x, now)
        return self.drain(now)

    def scan(self, stamp: float, now: float | None = None) -> SlamOutputs:
        return self.sense(scan(stamp), stamp if now is None else now)

    def odometry(self, stamp: float, v: float = 0.0, omega: float = 0.0, pose: Pose2D | None = None) -> None:
        self.sense(Odometry(stamp, pose or Pose2D(), Twist2D(v, omega)), stamp)

    def worked_on(self) -> list[float]:
        """Stamps of the scans that the filter has seen."""
        return [float(call.split()[1]) for call in self.filter.calls if call.startswith("scan")]


# On and off.


def test_at_first_it_says_its_map_and_that_it_is_off() -> None:
    rig = Rig(on=False, start=None)
    outputs = rig.drain(3.0)
    assert outputs.boxes == FoundObstacles(())
    np.testing.assert_array_equal(outputs.grid.data, GRID.data)  # type: ignore[union-attr]
    assert (outputs.health.level, outputs.health.reason) == (Level.OK, "off")
    assert rig.slam.listens() == ALWAYS
    assert rig.slam.next_due(3.0) == math.inf


def test_it_listens_to_sensors_only_while_localization_is_on() -> None:
    rig = Rig(on=False)
    rig.order(status(OFF), 0.0)
    assert rig.slam.listens() == ALWAYS
    rig.order(status(), 1.0)
    assert rig.slam.listens() == EVERYTHING
    rig.order(status(replace(ModuleSwitches(), LZN=False)), 2.0)
    assert rig.slam.listens() == ALWAYS


def test_while_it_is_off_sensors_say_nothing() -> None:
    rig = Rig(on=False)
    calls = list(rig.filter.calls)
    for x in (scan(1.0), Odometry(1.0, Pose2D(), Twist2D()), Observations(1.0), Refused(LaserScan, "x")):
        rig.slam.sense(x, 1.0)
    assert rig.slam.next_due(1.0) == math.inf
    assert rig.filter.calls == calls


def test_what_came_before_it_was_switched_off_counts_and_what_came_after_does_not() -> None:
    rig = Rig()
    rig.slam.sense(scan(1.0), 1.0)
    rig.slam.order(status(OFF), 1.0)
    rig.slam.sense(scan(1.1), 1.0)
    outputs = rig.drain(1.0)
    assert rig.worked_on() == [1.0]
    assert outputs.pose is not None
    assert outputs.health.reason == "off"


def test_switched_on_it_starts_anew_from_what_it_knew_when_it_was_switched_off() -> None:
    rig = Rig()
    rig.odometry(1.0, pose=Pose2D(0.5))
    rig.order(status(OFF), 1.1)
    rig.filter.calls.clear()
    outputs = rig.order(status(), 60.0)
    assert rig.filter.calls == ["restart", "initialise"]
    assert rig.filter.start is not None
    assert rig.filter.start.stamp == 1.0
    assert rig.filter.start.pose == compose(START.pose, Pose2D(0.5))
    assert outputs.health.reason == "waiting for scans"


def test_it_does_not_know_what_it_never_knew() -> None:
    rig = Rig(start=None)
    rig.order(status(OFF), 1.0)
    rig.filter.calls.clear()
    rig.order(status(), 2.0)
    assert rig.filter.calls == ["restart"]


def test_a_pose_that_is_told_while_it_is_off_counts_when_it_is_switched_on() -> None:
    rig = Rig()
    rig.order(status(OFF), 1.0)
    told = PoseEstimate(2.0, Pose2D(2.0, 1.0, 1.5), SIGMA)
    rig.sense(InitialPose(told), 2.0)
    assert rig.filter.start is START
    rig.order(status(), 3.0)
    assert rig.filter.start is told


def test_that_pose_counts_once() -> None:
    rig = Rig()
    rig.order(status(OFF), 1.0)
    rig.order(status(), 2.0)
    rig.filter.start = None
    rig.order(status(OFF), 3.0)
    rig.order(status(), 4.0)
    assert rig.filter.start is None


def test_an_order_that_is_repeated_changes_nothing() -> None:
    rig = Rig()
    rig.filter.calls.clear()
    rig.order(status(), 1.0)
    assert rig.filter.calls == []


def test_it_stays_on_without_a_status_but_says_so() -> None:
    rig = Rig()
    assert rig.scan(ORDER_MAX_AGE_S - 0.1).health.reason == "localizing"
    outputs = rig.scan(ORDER_MAX_AGE_S)
    assert (outputs.health.level, outputs.health.reason) == (Level.WARN, "localizing, but no status for 3.5 s")
    assert outputs.pose is not None


def test_alone_it_is_on_and_obeys_nobody() -> None:
    rig = Rig(on=False, start=None, alone=True)
    assert rig.slam.listens() == EVERYTHING
    outputs = rig.drain(5.0)
    assert outputs.grid is not None
    assert rig.filter.calls == ["restart"]
    rig.order(status(OFF), 5.5)
    rig.sense(InitialPose(START), 5.6)
    rig.odometry(5.6)
    assert [rig.scan(stamp).health.reason for stamp in (5.7, 1000.0)] == ["localizing"] * 2
    assert rig.boxes.updates


# Where it starts.


def test_without_a_pose_it_says_so_and_tells_none() -> None:
    rig = Rig(start=None)
    outputs = rig.scan(0.1)
    assert (outputs.health.level, outputs.health.reason) == (Level.WARN, "no initial pose yet")
    assert (outputs.pose, outputs.T_map_odom, outputs.answered) == (None, None, 0.1)
    assert rig.worked_on() == []


@pytest.mark.parametrize("on", [True, False])
@pytest.mark.parametrize(
    ("estimate", "named"),
    [
        (replace(START, pose=Pose2D(math.nan, 0.0, 0.0)), "not finite"),
        (replace(START, covariance=np.diag([1.0, -1.0, 1.0])), "not symmetric and positive"),
        (replace(START, covariance=np.full((3, 3), math.inf)), "not a finite"),
    ],
)
def test_an_initial_pose_that_is_none_is_refused_before_it_gets_into_the_filter(
    on: bool, estimate: PoseEstimate, named: str
) -> None:
    rig = Rig(on=on, start=None)
    rig.drain(0.0)
    outputs = rig.sense(InitialPose(estimate), 0.1)
    assert outputs.health.level is Level.WARN
    assert outputs.health.reason.startswith("initialpose refused: ")
    assert named in outputs.health.reason
    assert outputs.health.counters["bad_initialpose"] == 1
    assert "initialise" not in rig.filter.calls
    rig.order(status(), 2.0)
    outputs = rig.scan(2.1)
    assert outputs.health.reason.startswith("no initial pose yet: the one that was told is refused: ")
    assert named in outputs.health.reason
    rig.sense(InitialPose(START), 2.2)
    assert rig.scan(2.3).health.reason == "localizing"


def test_an_initial_pose_in_another_frame_is_refused_and_the_known_one_stays() -> None:
    rig = Rig()
    outputs = rig.sense(Refused(InitialPose, "frame 'odom', expected 'map'", "/rviz"), 0.1)
    assert outputs.health.reason == "initialpose refused: frame 'odom', expected 'map'"
    assert outputs.health.counters["bad_initialpose"] == 1
    assert rig.scan(0.2).health.reason == "localizing"


def test_off_it_says_so_again_when_a_pose_is_taken_after_one_that_was_none() -> None:
    rig = Rig(on=False, start=None)
    rig.sense(Refused(InitialPose, "frame"), 1.0)
    assert rig.sense(InitialPose(START), 2.0).health.reason == "off"


# Localizing.


def test_a_scan_gives_a_pose_and_where_odometry_began() -> None:
    rig = Rig()
    rig.odometry(1.0, v=0.5, pose=Pose2D(0.25, 0.0, 0.5))
    outputs = rig.scan(1.05, now=1.2)
    assert outputs.answered == 1.05
    assert outputs.pose is not None
    assert outputs.pose.stamp == 1.05
    stamp, T_map_odom = outputs.T_map_odom  # type: ignore[misc]
    assert stamp == 1.05 + PARAMS.transform_tolerance_s
    error = between(START.pose, T_map_odom)
    assert max(abs(error.x), abs(error.y), abs(error.theta)) < 1e-12
    assert (outputs.health.level, outputs.health.reason) == (Level.OK, "localizing")
    assert outputs.health.counters["explained"] == 0.88
    assert outputs.particles is None


def test_inputs_are_taken_in_the_order_in_which_they_came_and_odometry_is_never_left_out() -> None:
    rig = Rig()
    rig.filter.calls.clear()
    for i in range(60):
        rig.slam.sense(Odometry(0.01 * i, Pose2D(), Twist2D()), 0.01 * i)
    rig.slam.sense(Observations(0.55, (MarkerObservation(0.55, 3, Pose2D(), SIGMA),)), 0.6)
    assert rig.filter.calls == []  # odometry and markers wait for a scan
    rig.slam.sense(scan(0.6), 0.6)
    rig.slam.sense(Odometry(0.6, Pose2D(), Twist2D()), 0.6)
    rig.drain(0.6)
    assert rig.filter.calls == [f"predict {0.01 * i}" for i in range(60)] + ["1 markers", "scan 0.6", "predict 0.6"]


def test_without_a_scan_odometry_and_markers_make_no_step_due() -> None:
    rig = Rig()
    rig.scan(1.0)
    due = rig.slam.next_due(1.0)
    for x in (
        Odometry(1.1, Pose2D(), Twist2D()),
        Observations(1.1),
        Refused(Odometry, "x"),
        Refused(Observations, "x"),
    ):
        rig.slam.sense(x, 1.1)
    assert rig.slam.next_due(1.1) == due == 1.0 + PARAMS.scan_timeout_s


def test_markers_say_nothing_before_there_is_a_pose() -> None:
    rig = Rig(start=None)
    rig.slam.sense(Observations(0.1, (MarkerObservation(0.1, 3, Pose2D(), SIGMA),)), 0.1)
    rig.scan(0.2)
    assert "1 markers" not in rig.filter.calls


def test_a_scan_that_shows_too_little_says_so_and_the_pose_goes_on() -> None:
    rig = Rig()
    rig.filter.used = False
    outputs = rig.sense(scan(1.0, returns=6), 1.0)
    assert (outputs.health.level, outputs.health.reason) == (Level.WARN, "the scan shows too little of the map")
    assert "explained" not in outputs.health.counters
    assert outputs.pose is not None


@pytest.mark.parametrize(("used", "share"), [(True, "49%"), (True, "0%"), (False, "none")])
def test_scans_that_contradict_the_pose_are_said_become_an_error_and_map_nothing(used: bool, share: str) -> None:
    rig = Rig()
    rig.boxes.finds = [(BOX,)] * 40
    rig.filter.used, rig.filter.explains = used, 0.0 if share == "0%" else 0.49
    levels = []
    for k in range(31):
        now = 1.0 + 0.1 * k
        rig.order(status(), now)
        outputs = rig.scan(now)
        assert outputs.health.reason == (
            f"scans contradict the pose: {share} of them lies on walls of the map, expected 50%"
        )
        assert outputs.pose is not None
        levels.append(outputs.health.level)
    assert levels == [Level.WARN] * 20 + [Level.ERROR] * 11
    assert rig.boxes.updates == []
    rig.filter.used, rig.filter.explains = True, 0.51
    assert rig.scan(4.1).health.level is Level.OK
    assert len(rig.boxes.updates) == 1
    rig.filter.explains = 0.1
    assert rig.scan(4.2).health.level is Level.WARN, "it counts anew"


def test_a_robot_that_rests_goes_on_looking_while_scans_contradict_its_pose() -> None:
    rig = standing()
    rig.filter.explains = 0.3
    scans(rig, TENTHS[:5])
    assert rig.worked_on() == TENTHS[:5]


def test_bad_beams_are_left_out_and_too_many_of_them_are_no_scan() -> None:
    rig = Rig(scan_params=ScanParameters(0.5))
    outputs = rig.sense(replace(scan(1.0), ranges=[*np.full(10, 0.0), *np.full(11, 2.0)]), 1.0)
    assert (outputs.health.level, outputs.health.reason) == (Level.OK, "localizing")
    assert outputs.health.counters["bad_beam_share"] == 0.476
    outputs = rig.sense(replace(scan(1.1), ranges=[*np.full(11, math.nan), *np.full(10, 2.0)]), 1.1)
    assert (outputs.health.level, outputs.pose) == (Level.ERROR, None)
    assert outputs.health.reason == (
        "scan: 11 of 21 beams are NaN or below range_min 0.02 m, expected at most 50% (scan/max_bad_share)"
    )
    assert (outputs.health.counters["bad_beam_share"], outputs.health.counters["bad_scans"]) == (0.524, 1)
    assert "bad_beam_share" not in rig.scan(1.2).health.counters


@pytest.mark.parametrize("refused", [True, False])
def test_a_bad_scan_is_named_counted_and_answered(refused: bool) -> None:
    rig = Rig()
    rig.filter.problem = "" if refused else "3 NaN beams"
    x = Refused(LaserScan, "3 NaN beams", "/laser", 1.0) if refused else scan(1.0)
    outputs = rig.sense(x, 1.0)
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, "3 NaN beams")
    assert outputs.health.counters["bad_scans"] == 1
    assert (outputs.answered, outputs.pose) == (1.0, None)
    assert rig.slam.next_due(1.0) == 1.0 + PARAMS.scan_timeout_s


@pytest.mark.parametrize("refused", [True, False])
def test_after_bad_odometry_no_scan_is_worked_on_before_good_one_comes(refused: bool) -> None:
    rig = Rig()
    rig.filter.problem = "" if refused else "odometry jumped"
    rig.sense(Refused(Odometry, "odometry jumped") if refused else Odometry(1.0, Pose2D(), Twist2D()), 1.0)
    outputs = rig.scan(1.0)
    rig.filter.problem = ""
    assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, "odometry jumped")
    assert outputs.health.counters == {"bad_odometry": 1, "bad_scans": 1}
    assert rig.worked_on() == []
    rig.odometry(1.1)
    assert rig.scan(1.1).health.reason == "localizing"


def test_bad_markers_are_counted() -> None:
    rig = Rig()
    rig.filter.problem = "marker 3 is not finite"
    rig.slam.sense(Observations(0.1), 0.1)
    rig.slam.sense(Refused(Observations, "no JSON"), 0.1)
    rig.slam.sense(InitialPose(START), 0.1)
    assert rig.drain(0.1).health.counters["bad_observations"] == 2


def test_scans_that_stay_away_are_spoken_of_again_and_again() -> None:
    rig = Rig()
    rig.scan(1.0)
    now = 1.0
    for silent in (0.3, 0.4, 0.5):
        now = rig.slam.next_due(now)
        assert now == pytest.approx(1.0 + silent)
        outputs = rig.drain(now)
        assert (outputs.health.level, outputs.health.reason) == (Level.ERROR, f"no scan for {silent:.1f} s")
        assert (outputs.pose, outputs.answered) == (None, None)
    assert rig.scan(1.6).health.reason == "localizing"
    assert rig.slam.next_due(1.6) == 1.6 + PARAMS.scan_timeout_s


def test_a_scan_is_awaited_from_when_it_is_switched_on() -> None:
    rig = Rig()
    rig.order(status(OFF), 1.0)
    rig.order(status(), 50.0)
    assert rig.slam.next_due(50.0) == 50.0 + PARAMS.scan_timeout_s


# Rest.


def standing(start: float = 0.1) -> Rig:
    """Without a goal, and it has just come to a stand."""
    rig = Rig()
    rig.order(status(), 0.0)
    rig.odometry(start - 0.1, v=0.4)
    rig.scan(start - 0.1)
    rig.odometry(start)
    rig.filter.calls.clear()
    return rig


def scans(rig: Rig, stamps: list[float]) -> list[SlamOutputs]:
    said = []
    for stamp in stamps:
        rig.slam.order(status(), stamp)
        said.append(rig.scan(stamp))
    return said


TENTHS = [round(0.1 * i, 1) for i in range(1, 31)]


def test_of_a_robot_that_rests_a_scan_is_worked_on_once_in_a_while_and_all_are_answered() -> None:
    rig = standing()
    said = scans(rig, TENTHS)
    assert rig.worked_on() == [0.1, 2.5]
    assert [outputs.answered for outputs in said] == TENTHS
    assert [outputs.pose.stamp for outputs in said if outputs.pose is not None] == [0.1, 0.9, 1.7, 2.5]
    assert {outputs.health.reason for outputs in said} == {"localizing"}
    assert [outputs.T_map_odom[0] for outputs in said] == [  # type: ignore[index]
        stamp + PARAMS.transform_tolerance_s for stamp in TENTHS
    ]


def test_while_it_rests_no_box_is_looked_for() -> None:
    rig = standing()
    rig.boxes.updates.clear()
    scans(rig, TENTHS)
    assert [stamp for stamp, *_ in rig.boxes.updates] == [0.1, 2.5]


@pytest.mark.parametrize("twist", [Twist2D(0.002, 0.0), Twist2D(-0.4, 0.0), Twist2D(0.0, 0.002), Twist2D(0.0, -0.1)])
def test_a_robot_that_moves_works_on_every_scan_and_on_the_first_one_after(twist: Twist2D) -> None:
    rig = standing()
    scans(rig, TENTHS[:2])
    rig.odometry(0.25, twist.v, twist.omega)
    scans(rig, TENTHS[2:4])
    rig.odometry(0.45)
    scans(rig, TENTHS[4:6])
    assert rig.worked_on() == [0.1, 0.3, 0.4, 0.5]


def test_a_goal_ends_the_rest_with_the_next_scan() -> None:
    rig = standing()
    scans(rig, TENTHS[:3])
    rig.order(status(goal=GOAL), 0.35)
    assert rig.worked_on() == [0.1]
    rig.scan(0.4)
    rig.scan(0.5)
    assert rig.worked_on() == [0.1, 0.4, 0.5]


def test_a_new_pose_ends_the_rest() -> None:
    rig = standing()
    scans(rig, TENTHS[:2])
    rig.sense(InitialPose(START), 0.25)
    scans(rig, TENTHS[2:4])
    assert rig.worked_on() == [0.1, 0.3]


def test_what_went_wrong_ends_the_rest() -> None:
    for wrong in (Refused(Odometry, "x"), Refused(LaserScan, "x", "", 0.25)):
        rig = standing()
        scans(rig, TENTHS[:2])
        rig.sense(wrong, 0.25)
        rig.odometry(0.28)
        scans(rig, TENTHS[2:4])
        assert rig.worked_on() == [0.1, 0.3]


def test_a_scan_after_silence_is_worked_on() -> None:
    rig = standing()
    scans(rig, TENTHS[:2])
    rig.drain(0.6)
    assert scans(rig, [0.7])[0].health.reason == "localizing"
    assert rig.worked_on() == [0.1, 0.7]


def test_after_a_pause_the_first_scan_is_worked_on() -> None:
    rig = standing()
    scans(rig, TENTHS[:2])
    rig.order(status(OFF), 0.25)
    rig.order(status(), 0.25)
    scans(rig, TENTHS[2:4])
    assert rig.worked_on() == [0.1, 0.3, 0.4]  # no odometry has come that says that it stands


def test_a_robot_without_orders_does_not_rest() -> None:
    rig = standing()
    scans(rig, [0.1])
    for stamp in (3.4, 3.6, 3.7):
        rig.scan(stamp)
    assert rig.worked_on() == [0.1, 3.4, 3.6, 3.7]


def test_alone_it_does_not_rest() -> None:
    rig = Rig(on=False, start=None, alone=True)
    rig.drain(0.0)
    rig.sense(InitialPose(START), 0.0)
    rig.odometry(0.0)
    for stamp in TENTHS[:4]:
        rig.scan(stamp)
    assert rig.worked_on() == TENTHS[:4]


def test_a_scan_of_before_is_worked_on() -> None:
    rig = standing()
    scans(rig, TENTHS[:5])
    rig.scan(0.05, now=0.55)
    assert rig.worked_on() == [0.1, 0.05]


# While it is off.


def test_off_the_last_transform_is_repeated_and_holds_until_it_is_repeated_again() -> None:
    rig = Rig()
    rig.odometry(1.0, pose=Pose2D(0.25))
    T_map_odom = rig.scan(1.0).T_map_odom[1]  # type: ignore[index]
    rig.order(status(OFF), 2.0)
    assert rig.drain(2.0).T_map_odom == (2.0 + PARAMS.repeat_holds_s, T_map_odom), "without a gap"
    now = 2.0
    for _ in range(3):
        due = rig.slam.next_due(now)
        assert due == now + PARAMS.repeat_period_s
        outputs = rig.drain(due)
        assert outputs.T_map_odom == (due + PARAMS.repeat_holds_s, T_map_odom)
        assert rig.slam.next_due(due) < due + PARAMS.repeat_holds_s
        assert (outputs.pose, outputs.health.reason) == (None, "off")
        now = due


@pytest.mark.parametrize("frame", ["", "odom", "robbie/odom"])
def test_it_says_what_odometry_calls_its_frame(frame: str) -> None:
    rig = Rig()
    rig.sense(Odometry(1.0, Pose2D(), Twist2D(), frame), 1.0)
    assert rig.scan(1.0).odom_frame == frame
    rig.order(status(OFF), 2.0)
    assert rig.drain(2.0).odom_frame == frame


def test_on_it_is_not_repeated() -> None:
    rig = Rig()
    rig.scan(1.0)
    assert rig.drain(5.0).T_map_odom is None


# Mapping.


def test_boxes_are_told_when_they_have_changed_and_not_too_often() -> None:
    rig = Rig()
    rig.boxes.finds = [(), (BOX,), (BOX,)]
    said = [rig.scan(stamp) for stamp in (0.5, 0.9, 1.0, 1.5)]
    assert [outputs.boxes for outputs in said] == [None, None, FoundObstacles((BOX,)), None]
    assert said[2].grid is not None
    assert said[2].grid.data.sum() > GRID.data.sum()
    assert said[1].grid is None


def test_a_box_that_is_gone_is_told_too() -> None:
    rig = Rig()
    rig.boxes.finds = [(BOX,), ()]
    assert [rig.scan(stamp).boxes for stamp in (1.0, 2.0)] == [FoundObstacles((BOX,)), FoundObstacles(())]


def test_boxes_that_a_driver_hands_over_are_told_at_once_and_once() -> None:
    for on in (True, False):
        rig = Rig(on=on)
        rig.drain(0.0)
        assert rig.sense(HandedOverObstacles((BOX,)), 0.1).boxes == FoundObstacles((BOX,))
        outputs = rig.sense(HandedOverObstacles((BOX,)), 0.2)
        assert (outputs.boxes, outputs.grid) == (None, None)
        outputs = rig.sense(Refused(HandedOverObstacles, "no JSON"), 0.3)
        assert outputs.health.counters["bad_new_obstacles"] == 1


def test_mapping_is_switched_by_itself() -> None:
    rig = Rig()
    rig.order(status(replace(ModuleSwitches(), MAP=False)), 0.5)
    rig.scan(0.6)
    assert rig.boxes.updates == []
    rig.order(status(), 0.7)
    rig.scan(0.8)
    assert [update[:2] for update in rig.boxes.updates] == [(0.8, 0.8)]


def test_other_robots_are_no_boxes_while_it_is_known_where_they_are() -> None:
    rig = Rig()
    rig.order(status(robots=(KnownRobot(2.0, 1.0, 0.3),)), 1.0)
    rig.scan(1.1)
    rig.scan(1.0 + ORDER_MAX_AGE_S)
    assert [others for *_, others in rig.boxes.updates] == [[(Pose2D(2.0, 1.0), 0.3)], []]


# Particles, and what it is made of.


class Files:
    robot_id, first_seq, grid, sites = "p3dx", 0, GRID, Sites((), ())

    def load(self, cls: type, section: str) -> Any:
        return load_parameters(cls, section)

    def has(self, _link: str) -> bool:
        return True

    def mount(self, _link: str) -> np.ndarray:
        T = np.eye(4)
        T[0, 3] = LASER.x
        return T


def test_it_localizes_in_its_map() -> None:
    truth = Pose2D(2.0, 1.5, 0.5)
    for method in ("ekf", "particle"):
        slam = Slam.build(Files(), method=method)
        slam.order(status(), 0.0)
        slam.sense(InitialPose(PoseEstimate(0.0, Pose2D(2.05, 1.47, 0.52), SIGMA)), 0.0)
        for i in range(20):
            slam.sense(Odometry(0.1 * i, Pose2D(), Twist2D()), 0.1 * i)
            slam.sense(take_scan(truth, np.vstack([walls_of(GRID), boxes_of([BOX])]), stamp=0.1 * i), 0.1 * i)
            outputs = slam.step(0.1 * i)
        slam.order(status(goal=GOAL), 2.0)
        slam.sense(take_scan(truth, walls_of(GRID), stamp=2.0), 2.0)
        outputs = slam.step(2.0)
        assert outputs.pose is not None
        error = between(truth, outputs.pose.pose)
        assert max(abs(error.x), abs(error.y), abs(error.theta)) < 0.03
        assert slam.can_globalize == (method == "particle")
        assert (outputs.particles is not None) == slam.can_globalize
        if outputs.particles is not None:
            assert outputs.particles.shape[1] == 3


def test_particles_can_be_spread_over_the_map_while_localization_is_on() -> None:
    localizer = ParticleLocalizer(GRID, [], LocalizerParameters(), LASER)
    slam = Slam(PARAMS, localizer, NewObstacleMapper(GRID, MappingParameters()), GRID, LASER)
    slam.step(0.0)
    with pytest.raises(HitchhikeError, match="localization is off"):
        slam.globalize()
    slam.order(status(), 1.0)
    slam.step(1.0)
    slam.globalize()
    assert np.ptp(localizer.particles[:, 0]) > 3.0


def test_after_that_the_next_scan_is_worked_on() -> None:
    localizer = ParticleLocalizer(GRID, [], LocalizerParameters(), LASER)
    slam = Slam(PARAMS, localizer, NewObstacleMapper(GRID, MappingParameters()), GRID, LASER)
    slam.order(status(), 0.0)
    slam.sense(InitialPose(START), 0.0)
    truth = take_scan(START.pose, walls_of(GRID))
    poses = []
    for stamp in (0.0, 0.1, 0.2):
        slam.sense(Odometry(stamp, Pose2D(), Twist2D()), stamp)
        slam.sense(replace(truth, stamp=stamp), stamp)
        poses.append(slam.step(stamp).pose)
        if stamp == 0.1:
            slam.globalize()
    assert [pose is None for pose in poses] == [False, True, False]


def test_without_particles_that_is_refused() -> None:
    with pytest.raises(HitchhikeError, match="no particles"):
        Rig().slam.globalize()


# Whatever comes.


def test_a_clock_that_goes_back_leaves_it_working() -> None:
    rig = Rig()
    rig.order(status(), 100.0)
    rig.scan(100.0)
    rig.drain(100.4)  # silent
    assert rig.slam.next_due(5.0) <= 5.0
    rig.drain(5.0)
    assert rig.slam.next_due(5.0) == pytest.approx(5.0 + PARAMS.scan_timeout_s)
    rig.boxes.finds = [(BOX,)]
    rig.order(status(), 6.0)
    assert rig.scan(6.0).boxes == FoundObstacles((BOX,))
    rig.order(status(OFF), 7.0)
    rig.drain(7.5)
    rig.drain(1.0)
    assert rig.slam.next_due(1.0) == 1.0 + PARAMS.repeat_period_s


INPUTS = [
    *("scan", "late scan", "bad scan", "odometry", "moving", "bad odometry", "markers", "pose", "bad pose", "boxes"),
    *("on", "goal", "off", "none", "problem"),
]
dt = st.one_of(st.floats(0.0, 0.5), st.sampled_from([0.0, 0.1, 4.0, -3.0, -100.0]))


@given(st.lists(st.tuples(dt, st.sampled_from(INPUTS)), max_size=40))
def test_it_is_never_due_again_at_once_and_hears_sensors_only_while_it_is_on(events: list) -> None:
    rig, now, on = Rig(on=False, start=None), 1000.0, False
    answered: float | None = None
    for ahead, event in events:
        now += ahead
        x: object = {
            "scan": scan(now),
            "late scan": scan(now - 0.4),
            "bad scan": Refused(LaserScan, "bad", "", now),
            "odometry": Odometry(now, Pose2D(), Twist2D()),
            "moving": Odometry(now, Pose2D(), Twist2D(0.5)),
            "bad odometry": Refused(Odometry, "bad"),
            "markers": Observations(now),
            "pose": InitialPose(replace(START, stamp=now)),
            "bad pose": InitialPose(replace(START, covariance=-SIGMA)),
            "boxes": HandedOverObstacles((BOX,)),
            "on": status(),
            "goal": status(goal=GOAL),
            "off": status(OFF),
        }.get(event)
        rig.filter.problem = "a problem" if event == "problem" else ""
        if isinstance(x, Status):
            rig.order(x, now)
            on = x.modules.LZN
        elif x is not None:
            answered = rig.sense(x, now).answered
        rig.drain(now)
        assert rig.slam.next_due(now) > now
        assert rig.slam.listens() == (EVERYTHING if on else ALWAYS)
        if isinstance(x, (LaserScan, Refused)) and on and event != "bad odometry":
            assert answered == x.stamp
