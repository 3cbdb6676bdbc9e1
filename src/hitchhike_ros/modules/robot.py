"""All modules of one robot, wired once: what each of them says goes to those that take it, at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args, get_type_hints

from hitchhike_ros.localization.methods import Method
from hitchhike_ros.modules.hitchhike_comm import HitchhikeComm
from hitchhike_ros.modules.inputs import InitialPose
from hitchhike_ros.modules.mapping_3d import Mapping3D
from hitchhike_ros.modules.module import Module, Order, Outputs, Refused
from hitchhike_ros.modules.obstacle_avoidance import ObstacleAvoidance
from hitchhike_ros.modules.path_planning import PathPlanning
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.modules.slam import Slam
from hitchhike_ros.modules.velocity_mux import VelocityMux
from hitchhike_ros.modules.visual_servoing import VisualServoing
from hitchhike_ros.protocol.status import Status

ORDER_OF_STEPS = (
    "slam",
    "mapping_3d",
    "path_planning",
    "obstacle_avoidance",
    "visual_servoing",
    "hitchhike_comm",
    "velocity_mux",
)
"""Modules that are due together are stepped in this order, so that each has what the ones before it say."""


@dataclass(frozen=True)
class Wire:
    """What module ``source`` says in ``field`` of its outputs goes to the modules ``sinks``.

    What is ``kept`` goes also to a sink that begins to take it later, as from a latched topic.
    """

    source: str
    field: str
    sinks: tuple[str, ...]
    kept: bool = False


WIRES = (
    Wire("slam", "pose", ("mapping_3d", "path_planning", "obstacle_avoidance", "hitchhike_comm")),
    Wire("slam", "grid", ("path_planning", "hitchhike_comm"), kept=True),
    Wire("slam", "boxes", ("hitchhike_comm",), kept=True),
    Wire("path_planning", "plan", ("obstacle_avoidance",), kept=True),
    Wire("path_planning", "report", ("hitchhike_comm",), kept=True),
    Wire("obstacle_avoidance", "command", ("velocity_mux",)),
    Wire("obstacle_avoidance", "report", ("path_planning", "hitchhike_comm"), kept=True),
    Wire("visual_servoing", "command", ("velocity_mux",)),
    Wire("visual_servoing", "observations", ("slam", "hitchhike_comm")),
    Wire("hitchhike_comm", "initial_pose", ("slam",)),
    Wire("hitchhike_comm", "handed_over", ("slam",)),
    Wire("hitchhike_comm", "status", tuple(name for name in ORDER_OF_STEPS if name != "hitchhike_comm")),
)

# What an operator says too, beside a module of the robot.
_ALSO_FROM_OUTSIDE = frozenset({InitialPose})


class Robot:
    """The modules of one robot as one: it is sensed, ordered and stepped as each of them is (:class:`.module.Module`).

    A wire whose source or sink is missing is left out: a robot without a depth camera has no mapping_3d.
    """

    def __init__(self, modules: Mapping[str, Module[Any]]) -> None:
        """``modules`` by their names."""
        self.modules = {name: modules[name] for name in ORDER_OF_STEPS if name in modules}
        self._wires = {
            name: [
                (wire, [self.modules[sink] for sink in wire.sinks if sink in self.modules])
                for wire in WIRES
                if wire.source == name
            ]
            for name in self.modules
        }
        self._kept: dict[type, object] = {}
        said = {
            kind for wire in WIRES if wire.source in self.modules for kind in kinds(self.modules[wire.source], wire)
        }
        taken = {kind for module in self.modules.values() for kind in module.inputs}
        self._from_outside = frozenset(taken - (said - _ALSO_FROM_OUTSIDE))

    def listens(self) -> frozenset[type]:
        """What some module takes now and none of them says."""
        taken: frozenset[type] = frozenset().union(*(module.listens() for module in self.modules.values()))
        return taken & self._from_outside

    def patient(self) -> frozenset[type]:
        """What makes none of the modules due that take it now."""
        wants: frozenset[type] = frozenset().union(*(m.listens() - m.patient for m in self.modules.values()))
        return self._from_outside - wants

    def sense(self, x: object, now: float) -> None:
        """Hand an input from outside to all modules that take it now."""
        kind = x.what if isinstance(x, Refused) else type(x)
        for module in self.modules.values():
            if kind in module.listens():
                module.sense(x, now)

    def order(self, order: Order, now: float) -> None:
        """Hand a goal, or its end, to hitchhike_comm, which gives all other orders."""
        self.modules["hitchhike_comm"].order(order, now)

    def next_due(self, now: float) -> float:
        """When the first module is due."""
        return min(module.next_due(now) for module in self.modules.values())

    def step(self, now: float) -> Sequence[tuple[str, Outputs]]:
        """Step the modules that are due, and hand on at once what each of them says; their outputs by name."""
        said = []
        for name, module in self.modules.items():
            if module.next_due(now) <= now:
                outputs = module.step(now)
                said.append((name, outputs))
                self._hand_on(name, outputs, now)
        return said

    def _hand_on(self, source: str, outputs: Outputs, now: float) -> None:
        for wire, sinks in self._wires[source]:
            value = getattr(outputs, wire.field)
            if value is None:
                continue
            if wire.kept:
                self._kept[type(value)] = value
            for sink in sinks:
                if isinstance(value, Status):
                    self._give_order(sink, value, now)
                elif type(value) in sink.listens():
                    sink.sense(value, now)

    def _give_order(self, sink: Module[Any], status: Status, now: float) -> None:
        """Hand on an order, and to a module that begins to listen what it has missed."""
        before = sink.listens()
        sink.order(status, now)
        for kind, value in self._kept.items():
            if kind in sink.listens() - before:
                sink.sense(value, now)


def kinds(module: Module[Any], wire: Wire) -> tuple[type, ...]:
    """The types that go along ``wire``, which begins at ``module``."""
    outputs = get_type_hints(type(module).step)["return"]
    hint = get_type_hints(outputs)[wire.field]
    return tuple(kind for kind in (get_args(hint) or (hint,)) if kind is not type(None))


def build(files: RobotFiles, localization_method: Method = "ekf", *, map_3d: bool = False) -> Robot:
    """The robot that ``files`` describe.

    Args:
        files: what each module is built from.
        localization_method: of slam.
        map_3d: whether it maps its surroundings in 3D during rides that it gives, and takes such maps over.
    """
    modules: list[Module[Any]] = [
        Slam.build(files, method=localization_method),
        PathPlanning.build(files),
        ObstacleAvoidance.build(files),
        VisualServoing.build(files),
        HitchhikeComm.build(files),
        VelocityMux.build(files),
    ]
    if map_3d:
        modules.append(Mapping3D.build(files))
    return Robot({module.name: module for module in modules})
