"""A robot hands on what its modules say, at once and to those that take it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import pytest

from hitchhike_ros.core.datatypes import LaserScan, Odometry, Pose2D, Twist2D
from hitchhike_ros.modules.hitchhike_comm import HitchhikeComm
from hitchhike_ros.modules.inputs import InitialPose, NavigationCommand, PlannedPath, PlanReport
from hitchhike_ros.modules.mapping_3d import Mapping3D
from hitchhike_ros.modules.module import Health, Order, Outputs, Refused
from hitchhike_ros.modules.obstacle_avoidance import ObstacleAvoidance
from hitchhike_ros.modules.path_planning import PathPlanning
from hitchhike_ros.modules.robot import ORDER_OF_STEPS, WIRES, Robot, kinds
from hitchhike_ros.modules.slam import Slam
from hitchhike_ros.modules.velocity_mux import VelocityMux
from hitchhike_ros.modules.visual_servoing import VisualServoing
from hitchhike_ros.protocol.events import GoalCancelled, NavigationReport
from hitchhike_ros.protocol.status import Status

ALL = (Slam, Mapping3D, PathPlanning, ObstacleAvoidance, VisualServoing, HitchhikeComm, VelocityMux)
ODOMETRY = Odometry(1.0, Pose2D(), Twist2D())


@dataclass(frozen=True, kw_only=True)
class PoseLikeOutputs(Outputs):
    command: NavigationCommand | None = None
    report: NavigationReport | None = None


@dataclass(frozen=True, kw_only=True)
class CommLikeOutputs(Outputs):
    initial_pose: InitialPose | None = None
    handed_over: None = None
    status: Status | None = None


@dataclass(frozen=True, kw_only=True)
class MuxLikeOutputs(Outputs):
    twist: Twist2D | None = None


@dataclass(frozen=True, kw_only=True)
class PlanningLikeOutputs(Outputs):
    report: PlanReport | None = None
    plan: PlannedPath | None = None


@dataclass
class Fake:
    """Keeps what it was told, and says at its next step what it was made to say."""

    name: ClassVar[str] = ""
    inputs: ClassVar[frozenset[type]] = frozenset()
    patient: ClassVar[frozenset[type]] = frozenset()
    says: list[Outputs] = field(default_factory=list)
    told: list[object] = field(default_factory=list)
    deaf: bool = False

    def listens(self) -> frozenset[type]:
        return frozenset() if self.deaf else self.inputs

    def sense(self, x: object, now: float) -> None:
        self.told.append(x)

    def order(self, order: Order, now: float) -> None:
        self.told.append(order)

    def next_due(self, now: float) -> float:
        return now if self.says else math.inf

    def step(self, now: float) -> Outputs:
        return self.says.pop(0)


class Avoidance(Fake):
    inputs = frozenset({Odometry, LaserScan})
    patient = frozenset({Odometry})

    def step(self, now: float) -> PoseLikeOutputs:
        return super().step(now)  # type: ignore[return-value]


class Comm(Fake):
    inputs = frozenset({Odometry, NavigationReport})
    patient = inputs

    def step(self, now: float) -> CommLikeOutputs:
        return super().step(now)  # type: ignore[return-value]


@dataclass
class Planning(Fake):
    """Begins to listen at an order."""

    inputs = frozenset({NavigationReport, NavigationCommand})
    wakes: bool = False

    def order(self, order: Order, now: float) -> None:
        super().order(order, now)
        self.deaf &= not self.wakes

    def step(self, now: float) -> PlanningLikeOutputs:
        return super().step(now)  # type: ignore[return-value]


class Mux(Fake):
    inputs = frozenset({NavigationCommand})

    def step(self, now: float) -> MuxLikeOutputs:
        return super().step(now)  # type: ignore[return-value]


@pytest.fixture
def fakes() -> dict[str, Fake]:
    return {"velocity_mux": Mux(), "hitchhike_comm": Comm(), "obstacle_avoidance": Avoidance()}


OK = Health()
COMMAND = NavigationCommand(Twist2D(0.3, 0.0))


def test_what_a_module_says_reaches_those_that_take_it_in_the_same_step(fakes: dict[str, Fake]) -> None:
    report, status = NavigationReport("g", "driving"), Status(0.0, "p3dx")
    fakes["obstacle_avoidance"].says = [PoseLikeOutputs(health=OK, command=COMMAND, report=report)]
    fakes["hitchhike_comm"].says = [CommLikeOutputs(health=OK, status=status)]
    fakes["velocity_mux"].says = [MuxLikeOutputs(health=OK)]
    said = Robot(fakes).step(2.0)
    assert [name for name, _ in said] == ["obstacle_avoidance", "hitchhike_comm", "velocity_mux"]
    assert fakes["hitchhike_comm"].told == [report]
    assert fakes["velocity_mux"].told == [COMMAND, status]
    assert fakes["obstacle_avoidance"].told == [status]


def test_modules_that_are_not_due_are_not_stepped(fakes: dict[str, Fake]) -> None:
    robot = Robot(fakes)
    assert robot.next_due(2.0) == math.inf
    assert robot.step(2.0) == []
    fakes["velocity_mux"].says = [MuxLikeOutputs(health=OK)]
    assert robot.next_due(2.0) == 2.0


def test_it_listens_to_what_its_modules_take_and_none_of_them_says(fakes: dict[str, Fake]) -> None:
    robot = Robot(fakes)
    assert robot.listens() == {Odometry, LaserScan}
    fakes["obstacle_avoidance"].deaf = True
    assert robot.listens() == {Odometry}


def test_what_no_module_is_in_a_hurry_for_is_patient(fakes: dict[str, Fake]) -> None:
    robot = Robot(fakes)
    assert Odometry in robot.patient()
    assert LaserScan not in robot.patient()
    fakes["obstacle_avoidance"].deaf = True
    assert LaserScan in robot.patient(), "nobody takes it now"


def test_an_input_goes_to_those_that_take_it_now(fakes: dict[str, Fake]) -> None:
    robot, refused = Robot(fakes), Refused(Odometry, "not finite")
    robot.sense(ODOMETRY, 1.0)
    fakes["obstacle_avoidance"].deaf = True
    robot.sense(refused, 1.1)
    assert fakes["obstacle_avoidance"].told == [ODOMETRY]
    assert fakes["hitchhike_comm"].told == [ODOMETRY, refused]
    assert fakes["velocity_mux"].told == []


def test_a_module_that_does_not_listen_is_told_nothing_by_the_others(fakes: dict[str, Fake]) -> None:
    fakes["velocity_mux"].deaf = True
    fakes["obstacle_avoidance"].says = [PoseLikeOutputs(health=OK, command=COMMAND)]
    Robot(fakes).step(2.0)
    assert fakes["velocity_mux"].told == []


@pytest.mark.parametrize("begins", [False, True])
def test_a_module_that_begins_to_listen_gets_what_it_has_missed(fakes: dict[str, Fake], begins: bool) -> None:
    old, new, status = NavigationReport("g", "driving"), NavigationReport("g", "blocked"), Status(0.0, "p3dx")
    comm, planning = Comm(), Planning(deaf=begins, wakes=True)
    robot = Robot({**fakes, "hitchhike_comm": comm, "path_planning": planning})
    fakes["obstacle_avoidance"].says = [PoseLikeOutputs(health=OK, command=COMMAND, report=old)]
    robot.step(2.0)
    fakes["obstacle_avoidance"].says = [PoseLikeOutputs(health=OK, report=new)]
    robot.step(3.0)
    comm.says = [CommLikeOutputs(health=OK, status=status)] * 2
    robot.step(4.0)
    robot.step(5.0)
    assert planning.told == ([status, new, status] if begins else [old, new, status, status])


def test_goals_are_for_hitchhike_comm(fakes: dict[str, Fake]) -> None:
    Robot(fakes).order(GoalCancelled(), 1.0)
    assert fakes["hitchhike_comm"].told == [GoalCancelled()]
    assert fakes["velocity_mux"].told == fakes["obstacle_avoidance"].told == []


def test_every_wire_joins_modules() -> None:
    for wire in WIRES:
        assert {wire.source, *wire.sinks} <= set(ORDER_OF_STEPS), wire
    assert len({(wire.source, wire.field) for wire in WIRES}) == len(WIRES)


def test_every_wire_carries_what_its_ends_say_and_take() -> None:
    modules = {cls.name: cls.__new__(cls) for cls in ALL}
    assert modules.keys() == set(ORDER_OF_STEPS)
    for wire in WIRES:
        for kind in kinds(modules[wire.source], wire):
            if kind is Status:
                continue  # an order, which every module takes
            takers = {name for name, module in modules.items() if kind in module.inputs}
            assert takers == set(wire.sinks), (wire, kind)
