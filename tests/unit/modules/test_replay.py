"""One ride, recorded as one sequence of inputs, gives the same in every host: composed, one process, a node each.

The ride is driven by the composed simulation. What its modules were told and when they stepped is replayed into hosts
of nodes, through their callbacks and as serialized messages, without a master.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.core.datatypes import CameraInfo, LaserScan, Odometry, PoseEstimate
from hitchhike_ros.experiments.scenarios.couplings import CHANGES, LIMIT_S, MARKER, RIDER, SIGMA, build
from hitchhike_ros.modules.inputs import CameraImage, InitialPose, NetworkText
from hitchhike_ros.modules.module import Module, Outputs
from hitchhike_ros.modules.robot import ORDER_OF_STEPS, WIRES, Robot, kinds
from hitchhike_ros.modules.robot import build as build_robot
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.ros_io.conversions import estimate_to_msg, odometry_to_msg, scan_to_msg
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.images import camera_info_to_msg, image_to_msg
from hitchhike_ros.ros_io.inlets import INLETS
from hitchhike_ros.ros_io.outlets import outlets
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.physics.world import World
from repository import ROOT

TOLERANCE = 1e-6


@dataclass(frozen=True)
class Event:
    """What a module was told, or what came of its step, at ``now``."""

    what: str  # sense, order, step
    now: float
    value: Any


class Tape:
    """Records what a module is told and what it says, without changing it."""

    def __init__(self, module: Any) -> None:
        self.events: list[Event] = []
        for what in ("sense", "order", "step"):
            setattr(module, what, self._tapped(what, getattr(module, what)))

    def _tapped(self, what: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def tapped(*args: Any) -> Any:
            *value, now = args
            if what != "step":
                self.events.append(Event(what, now, kept(value[0])))
            result = method(*args)
            if what == "step":
                self.events.append(Event(what, now, result))
            return result

        return tapped


def kept(x: object) -> object:
    """An input as it was then: an image would be taken when it is looked at."""
    if not isinstance(x, CameraImage):
        return x
    gray = x.gray()
    return replace(x, gray=lambda: gray, rgb=lambda: np.repeat(gray[..., None], 3, axis=2))


@dataclass
class Recording:
    """The ride of one robot: of all its modules as one, and of each."""

    files: Any
    whole: Tape
    single: dict[str, Tape]


@pytest.fixture(scope="module")
def recording() -> Iterator[Recording]:
    """The rider's part of a short ride, from its goal until it drives on by itself."""
    file = build(MARKER, ROOT, 0)
    with World(file, 0, package=ROOT) as world:
        ride = ComposedRide(world, ROOT, changes=CHANGES)
        robot = ride.robots[RIDER].robot
        recording = Recording(
            ride.robots[RIDER].files, Tape(robot), {name: Tape(module) for name, module in robot.modules.items()}
        )
        ride.start({name: PoseEstimate(0.0, entry.start, SIGMA) for name, entry in file.robots.items()})
        phases, status = set(), ride.robots[RIDER].status
        while world.now < LIMIT_S and not (Phase.COUPLED in phases and status.phase is Phase.ALONE):
            ride.step()
            status = ride.robots[RIDER].status
            phases.add(status.phase)
        assert {Phase.ASKING, Phase.MEETING, Phase.COUPLING, Phase.COUPLED, Phase.HANDING_OVER} <= phases
        yield recording


def message(x: Any) -> Any:
    """A sensor's reading, or what comes from other robots and people, as the message that would carry it."""
    match x:
        case Odometry():
            return odometry_to_msg(x, x.frame_id, "base_footprint")
        case LaserScan():
            return scan_to_msg(x, "laser")
        case CameraInfo():
            return camera_info_to_msg(x, 0.0, "camera_optical")
        case CameraImage():
            return image_to_msg(x.gray(), x.stamp, x.frame_id, "mono8")
        case NetworkText():
            return String(x.text)
        case InitialPose():
            return estimate_to_msg(x.estimate)
    raise AssertionError(f"no message carries {x}")


def carriers(robot: Robot) -> dict[type, Callable[[Any], Any]]:
    """How what one module says to another becomes a message: by the outlet whose topic is the other's inlet."""
    found: dict[type, Callable[[Any], Any]] = {}
    for wire in WIRES:
        for kind in kinds(robot.modules[wire.source], wire) if wire.source in robot.modules else ():
            (outlet,) = (o for o in outlets(wire.source) if (o.field, o.topic) == (wire.field, INLETS[kind].topic))
            found[kind] = lambda x, outlet=outlet: next(iter(outlet.convert(x)))
    return found


def sent(msg: Any, cls: Any) -> Any:
    """The message as it comes out of the wire."""
    buffer = io.BytesIO()
    msg.serialize(buffer)
    arrived = cls()
    arrived.deserialize(buffer.getvalue())
    return arrived


def replay(host: ModuleHost, events: list[Event], ros: FakeRos, carry: Callable[[Any], Any]) -> None:  # noqa: F811
    """Tell the host by its callbacks what the recording says, and step it only when that did."""
    for event, following in pairwise([*events, Event("end", math.inf, None)]):
        ros.now = event.now
        if event.what == "step":
            host.turn(event.now)
        elif type(event.value) in INLETS:
            inlet = INLETS[type(event.value)]
            host.receive(inlet, sent(carry(event.value), inlet.cls))
        else:
            host.order(event.value)
        if following.now > event.now:
            host.turn(event.now)  # nothing may be due that the recording did not step


def differences(a: Any, b: Any, path: str = "") -> list[str]:
    """Where two outputs differ by more than the tolerance."""
    if isinstance(a, CameraImage) or callable(a):
        return []
    if isinstance(a, str) and isinstance(b, str) and a[:1] == b[:1] == "{":
        return differences(json.loads(a), json.loads(b), path)
    if dataclasses.is_dataclass(a) and type(a) is type(b):
        names = [field.name for field in dataclasses.fields(a)]
        return [d for name in names for d in differences(getattr(a, name), getattr(b, name), f"{path}.{name}")]
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return [d for key in a for d in differences(a[key], b[key], f"{path}[{key}]")]
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape:
        same = np.allclose(np.asarray(a, float), np.asarray(b, float), rtol=0.0, atol=TOLERANCE, equal_nan=True)
        return [] if same else [f"{path}: {a} and {b}"]
    if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)) and len(a) == len(b):
        return [d for i, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{path}[{i}]")]
    if isinstance(a, float) and isinstance(b, float):
        return [] if a == b or math.isclose(a, b, rel_tol=0.0, abs_tol=TOLERANCE) else [f"{path}: {a} and {b}"]
    return [] if type(a) is type(b) and a == b else [f"{path}: {a!r} and {b!r}"]


def by_module(said: list[tuple[str, float, Outputs]]) -> dict[str, list[tuple[float, Outputs]]]:
    """What each module said and when."""
    found = defaultdict(list)
    for name, now, outputs in said:
        found[name].append((now, outputs))
    return found


def compare(recorded: list[tuple[float, Outputs]], replayed: list[tuple[float, Outputs]]) -> None:
    assert len(recorded) > 10
    for (now, expected), (then, got) in zip(recorded, replayed, strict=False):
        assert then == now
        assert differences(expected, got) == [], f"at {now:.2f} s"
    assert len(replayed) == len(recorded)


def test_one_process_does_what_the_composed_robot_did(recording: Recording, ros: FakeRos) -> None:  # noqa: F811
    said: list[tuple[str, float, Outputs]] = []
    robot = build_robot(recording.files)
    host = ModuleHost(
        robot,
        {name: outlets(name) for name in robot.modules},
        orders=False,
        start=False,
        also=lambda name, outputs: said.append((name, ros.now, outputs)),
    )
    replay(host, recording.whole.events, ros, message)
    recorded = [
        (name, event.now, outputs)
        for event in recording.whole.events
        if event.what == "step"
        for name, outputs in event.value
    ]
    assert by_module(recorded).keys() == by_module(said).keys() == robot.modules.keys()
    for name, of_module in by_module(recorded).items():
        compare(of_module, by_module(said)[name])


@pytest.mark.parametrize("name", [name for name in ORDER_OF_STEPS if name != "mapping_3d"])
def test_a_node_each_does_what_the_composed_robot_did(
    name: str,
    recording: Recording,
    ros: FakeRos,  # noqa: F811
) -> None:
    said: list[tuple[float, Outputs]] = []
    robot = build_robot(recording.files)
    module: Module[Any] = robot.modules[name]
    between = carriers(robot)
    host = ModuleHost(
        Single(module),
        {name: outlets(name)},
        orders=name != "hitchhike_comm",
        start=False,
        also=lambda _name, outputs: said.append((ros.now, outputs)),
    )
    events = recording.single[name].events
    replay(host, events, ros, lambda x: between[type(x)](x) if type(x) in between else message(x))
    compare([(event.now, event.value) for event in events if event.what == "step"], said)


def test_what_a_module_is_patient_for_does_not_make_it_due(recording: Recording) -> None:
    patient = 0
    for name, module in build_robot(recording.files).modules.items():
        for event in recording.single[name].events:
            match event.what:
                case "step":
                    module.step(event.now)
                case "order":
                    module.order(event.value, event.now)
                case _:
                    due = module.next_due(event.now)
                    module.sense(event.value, event.now)
                    if type(event.value) in module.patient:
                        patient += 1
                        assert module.next_due(event.now) >= due, f"{name}: {event.value}"
    assert patient > 1000
