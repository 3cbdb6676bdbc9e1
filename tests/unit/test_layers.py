"""The layers of the package, read from its imports: each room imports only what stands below it.

``ALLOWED`` says it by path prefix; the longest prefix of a module's path counts, for who imports and for what is
imported.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "hitchhike_ros"

CORE = ("core",)
NAVIGATION = (*CORE, "mapping", "planning", "localization", "control", "servoing", "servoing/tag_cells")
ROLES = ("protocol/driver", "protocol/hitchhiker")  # which never import each other
PROTOCOL = ("protocol", *ROLES)
ROBOT = (*NAVIGATION, *PROTOCOL, "modules")
SIMULATION = (
    *(*ROBOT, "simulation", "simulation/physics", "simulation/grid", "simulation/composed"),
    *("simulation/people", "simulation/world_file", "simulation/radio", "simulation/lockstep", "simulation/frames"),
)
ROOMS = tuple(f"experiments/{room}" for room in ("scenarios", "scoring", "report", "faults", "bench"))
EXPERIMENTS = (*SIMULATION, *ROOMS)
ROS_IO = (*ROBOT, "ros_io")

# What each room may import beside itself.
ALLOWED: dict[str, tuple[str, ...]] = {
    "core": (),
    "mapping": CORE,
    "planning": (*CORE, "mapping"),
    "localization": (*CORE, "mapping"),
    "control": (*CORE, "mapping"),
    "servoing": (*CORE, "servoing/tag_cells"),
    "servoing/tag_cells": CORE,
    "protocol": (*CORE, "mapping", "planning", "localization", *ROLES),
    **dict.fromkeys(ROLES, (*CORE, "mapping", "planning", "localization", "protocol")),
    "modules": (*NAVIGATION, *PROTOCOL),
    "simulation": CORE,
    "simulation/people": CORE,
    "simulation/world_file": (*CORE, "mapping", *PROTOCOL, "simulation/people"),
    "simulation/lockstep": PROTOCOL,
    "simulation/frames": (*CORE, *PROTOCOL, "simulation/lockstep"),
    "simulation/radio": CORE,
    "simulation/physics": (*CORE, "mapping", "servoing/tag_cells", "simulation/people", "simulation/world_file"),
    "simulation/grid": (*CORE, "mapping", "planning", *PROTOCOL, "simulation/radio"),
    "simulation/composed": (*ROBOT, "simulation", "simulation/physics", "simulation/people", "simulation/world_file"),
    # Each room imports those before it; faults are about the protocol, and import no other room.
    **{room: (*SIMULATION, *ROOMS[:place]) for place, room in enumerate(ROOMS)},
    "experiments/faults": (*CORE, "mapping", *PROTOCOL, "simulation/grid", "simulation/radio"),
    "experiments": (),
    "ros_io": ROBOT,
    "nodes/robot": ROS_IO,
    "nodes/sim": (*EXPERIMENTS, "ros_io"),
    "nodes": (),
    "commands": (*EXPERIMENTS, "ros_io"),
}
COMPILED = {"_grid_search": "planning", "_octree": "mapping", "_visp_tracker": "servoing"}
"""Module: the only room that imports it."""
ROS = {
    *("actionlib", "cv_bridge", "diagnostic_updater", "message_filters", "rosbag", "rosgraph", "roslaunch", "roslib"),
    *("rosnode", "rosparam", "rospkg", "rospy", "rosservice", "rostest", "rostopic", "tf", "tf2_py", "tf2_ros"),
}
KNOW_ROS = ("ros_io", "nodes/robot", "nodes/sim", "nodes", "commands")


def imported(source: str, package: str) -> Iterator[str]:
    """Full names of what ``source``, a module of ``package``, imports anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package.rsplit(".", node.level - 1)[0] if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            yield from (f"{module}.{alias.name}" for alias in node.names)


def room(name: str) -> str | None:
    """The room of a full name: the longest prefix that ``ALLOWED`` knows; "" for none of them, None for a foreign name.

    A name of another package, as ``numpy.linalg``, is foreign.
    """
    parts = name.split(".")
    if parts[0] != "hitchhike_ros":
        return None
    paths = ["/".join(parts[1:end]) for end in range(len(parts), 1, -1)]
    return next((path for path in paths if path in ALLOWED), "")


def violations(source: str, module: str) -> list[str]:
    """What ``source``, a full module name, imports against the rules."""
    here, found = room(module) or "", []
    for name in imported(source, module.rpartition(".")[0]):
        top, there = name.split(".")[0], room(name)
        if there is not None:
            compiled = next((part for part in name.split(".") if part in COMPILED), None)
            if compiled:
                if COMPILED[compiled] != here:
                    found.append(f"{name} is for {COMPILED[compiled]} alone")
            elif there not in (here, *ALLOWED.get(here, ())):
                found.append(f"{here} must not import {name}")
        elif (top in ROS or top.endswith("_msgs") or top == "std_srvs") and here not in KNOW_ROS:
            found.append(f"{name} is ROS")
        elif top in ("pybullet", "pybullet_data") and here != "simulation/physics":
            found.append(f"{name} is for simulation/physics alone")
    return found


def module_of(path: Path) -> str:
    """The full name of a file of the package."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downward(path: Path) -> None:
    assert violations(path.read_text(encoding="utf-8"), module_of(path)) == []


def reached(module: str) -> set[str]:
    """Modules of the package that importing ``module`` (a full name in it) imports, itself included."""
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        path = PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py")
        if name in found or not path.is_file():
            continue
        found.add(name)
        imports = imported(path.read_text(encoding="utf-8"), name.rpartition(".")[0])
        waiting += [prefix for full in imports for prefix in (full, full.rpartition(".")[0]) if room(full) is not None]
    return found


def test_a_robot_needs_no_simulation() -> None:
    launch = ElementTree.parse(PACKAGE.parents[1] / "launch_scripts" / "robot.launch")
    nodes = [node.get("type", "") for node in launch.iter("node") if node.get("pkg") == "hitchhike_ros"]
    assert len(nodes) >= 7
    for node in nodes:
        rooms = ("nodes.robot", "commands", "nodes.sim")
        modules = next(filter(None, (reached(f"hitchhike_ros.{here}.{node}") for here in rooms)), None)
        assert modules, node
        assert [name for name in modules if (room(name) or "").startswith("simulation")] == [], node
    assert "hitchhike_ros.simulation.physics.world" in reached("hitchhike_ros.nodes.sim.simulator")


def test_every_file_has_a_room() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path != PACKAGE / "__init__.py":
            assert room(module_of(path)), path


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("hitchhike_ros.planning.x", "import rospy"),
        ("hitchhike_ros.simulation.x", "def f():\n    from geometry_msgs.msg import Twist"),
        ("hitchhike_ros.control.x", "from hitchhike_ros.simulation.physics.world import World"),
        ("hitchhike_ros.control.x", "from ..simulation import world_file"),
        ("hitchhike_ros.protocol.driver.x", "from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState"),
        ("hitchhike_ros.core.x", "from hitchhike_ros import mapping"),
        ("hitchhike_ros.nodes.robot.x", "from hitchhike_ros.simulation.world_file import WorldFile"),
        ("hitchhike_ros.nodes.sim.x", "import pybullet as p"),
        ("hitchhike_ros.simulation.grid.x", "import pybullet as p"),
        ("hitchhike_ros.simulation.grid.x", "from hitchhike_ros.simulation.physics.world import World"),
        ("hitchhike_ros.simulation.physics.x", "from hitchhike_ros._visp_tracker import Detector"),
        ("hitchhike_ros.ros_io.x", "from hitchhike_ros.experiments.scoring.figures import Figure"),
        ("hitchhike_ros.nodes.sim.x", "import hitchhike_ros._grid_search"),
        ("hitchhike_ros.experiments.scenarios.x", "from hitchhike_ros.experiments.scoring.figures import Figure"),
        ("hitchhike_ros.experiments.report.x", "from hitchhike_ros.experiments.bench.registry import Options"),
        ("hitchhike_ros.experiments.faults.x", "from hitchhike_ros.experiments.scenarios.runs import run_all"),
    ],
)
def test_a_violation_is_seen(module: str, source: str) -> None:
    assert len(violations(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("hitchhike_ros.nodes.sim.x", "import rospy\nfrom hitchhike_ros.simulation.physics.world import World"),
        ("hitchhike_ros.simulation.physics.x", "import pybullet\nfrom hitchhike_ros.core.geometry import compose"),
        ("hitchhike_ros.servoing.x", "from hitchhike_ros import _visp_tracker"),
        ("hitchhike_ros.localization.x", "from ..mapping.grid import OccupancyGrid"),
    ],
)
def test_downward_imports_are_allowed(module: str, source: str) -> None:
    assert violations(source, module) == []
