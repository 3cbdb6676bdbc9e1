"""The layers of the package, read from its imports: downward only; ROS, pybullet and ViSP stay in their places."""

import ast
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "hitchhike_ros"

FOUNDATION = 0  # errors, datatypes, geometry and the like: the modules directly in the package
LAYERS = {
    **dict.fromkeys(("mapping", "planning", "localization", "control", "servoing", "protocol"), 1),
    **dict.fromkeys(("simulation", "experiments"), 2),
    **dict.fromkeys(("ros_io", "nodes"), 3),
}
COMPILED = {
    "_grid_search": "planning",
    "_octree": "mapping",
    "_visp_tracker": "servoing",
}  # module: the only package that imports it
ROS = {
    *("actionlib", "cv_bridge", "diagnostic_updater", "message_filters", "rosbag", "rosgraph", "roslaunch", "roslib"),
    *("rosnode", "rosparam", "rospkg", "rospy", "rosservice", "rostest", "rostopic", "tf", "tf2_py", "tf2_ros"),
}


def imported(source: str, package: str) -> Iterator[str]:
    """Full names of what ``source``, a module of ``package``, imports anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package.rsplit(".", node.level - 1)[0] if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            yield from (f"{module}.{alias.name}" for alias in node.names)


def folder(name: str) -> str | None:
    """Sub-package of a full name in the package; "" for its foundation, None for a foreign name."""
    parts = name.split(".")
    if parts[0] != "hitchhike_ros":
        return None
    return parts[1] if len(parts) > 1 and (PACKAGE / parts[1]).is_dir() else ""


def violations(source: str, package: str) -> list[str]:
    """What ``source``, a module of ``package``, imports against the rules."""
    here = folder(package) or ""
    layer = LAYERS.get(here, FOUNDATION)
    found = []
    for name in imported(source, package):
        top, there = name.split(".")[0], folder(name)
        if there is not None:
            compiled = next((part for part in name.split(".") if part in COMPILED), None)
            if compiled:
                if COMPILED[compiled] != here:
                    found.append(f"{name} is for {COMPILED[compiled]} alone")
            elif LAYERS.get(there, FOUNDATION) > layer:
                found.append(f"{name} is a layer above")
        elif (top in ROS or top.endswith("_msgs") or top == "std_srvs") and layer < 3:
            found.append(f"{name} is ROS")
        elif top in ("pybullet", "pybullet_data") and here != "simulation":
            found.append(f"{name} is for simulation alone")
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downward(path: Path) -> None:
    package = ".".join(path.parent.relative_to(PACKAGE.parent).parts)
    assert violations(path.read_text(encoding="utf-8"), package) == []


def reached(module: str) -> set[str]:
    """Modules of the package that importing ``module`` (a dotted name in it) imports, itself included."""
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        path = PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py")
        if name in found or not path.is_file():
            continue
        found.add(name)
        imports = imported(path.read_text(encoding="utf-8"), name.rpartition(".")[0])
        waiting += [
            prefix for full in imports for prefix in (full, full.rpartition(".")[0]) if folder(full) is not None
        ]
    return found


def test_a_robot_needs_no_simulation() -> None:
    launch = ElementTree.parse(PACKAGE.parents[1] / "launch_scripts" / "robot.launch")
    nodes = [node.get("type", "") for node in launch.iter("node") if node.get("pkg") == "hitchhike_ros"]
    assert len(nodes) >= 7
    for node in nodes:
        modules = reached(f"hitchhike_ros.nodes.{node}")
        assert modules, node
        assert [name for name in modules if folder(name) == "simulation"] == [], node
    assert "hitchhike_ros.simulation.world" in reached("hitchhike_ros.nodes.simulator")


def test_every_folder_has_a_layer() -> None:
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(LAYERS)


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("hitchhike_ros.planning", "import rospy"),
        ("hitchhike_ros.simulation", "def f():\n    from geometry_msgs.msg import Twist"),
        ("hitchhike_ros.control", "from hitchhike_ros.simulation.world import World"),
        ("hitchhike_ros.control", "from ..simulation import world"),
        ("hitchhike_ros", "from hitchhike_ros import mapping"),
        ("hitchhike_ros.nodes", "import pybullet as p"),
        ("hitchhike_ros.simulation", "from hitchhike_ros._visp_tracker import Detector"),
        ("hitchhike_ros.nodes", "import hitchhike_ros._grid_search"),
    ],
)
def test_a_violation_is_seen(package: str, source: str) -> None:
    assert len(violations(source, package)) == 1


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("hitchhike_ros.nodes", "import rospy\nfrom hitchhike_ros.simulation.world import World"),
        ("hitchhike_ros.simulation", "import pybullet\nfrom hitchhike_ros.geometry import compose"),
        ("hitchhike_ros.servoing", "from hitchhike_ros import _visp_tracker"),
        ("hitchhike_ros.localization", "from ..mapping.grid import OccupancyGrid"),
    ],
)
def test_downward_imports_are_allowed(package: str, source: str) -> None:
    assert violations(source, package) == []
