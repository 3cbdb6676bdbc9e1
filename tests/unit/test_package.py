"""What the code imports is what package.xml and requirements.txt name, and the set-up installs exactly that."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from catkin_pkg.package import Package, parse_package

ROOT = Path(__file__).resolve().parents[2]
DEPENDENCIES = ("buildtool_depends", "build_depends", "exec_depends", "test_depends")

# What imports and launch files name, where its Debian package or wheel is named otherwise than cv_bridge,
# python3-cv-bridge.
PROVIDERS = {
    "cosmic_ray": "cosmic-ray",
    "cv2": "opencv-python-headless",
    "pybullet_data": "pybullet",
    "robot_state_publisher": "ros-robot-state-publisher",
    "rviz": "rviz",
}


def package(**environment: str) -> Package:
    """The manifest with its conditions evaluated for an environment."""
    manifest = parse_package(str(ROOT / "package.xml"))
    manifest.evaluate_conditions(environment)
    return manifest


def names(manifest: Package, kinds: tuple[str, ...] = DEPENDENCIES) -> set[str]:
    return {d.name for kind in kinds for d in getattr(manifest, kind) if d.evaluated_condition}


def wheels() -> dict[str, str]:
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    return dict(line.split("==") for line in lines if line and not line.startswith("#"))


def imports(folder: str) -> set[str]:
    """First names of what the Python files under a folder import, without the standard library and themselves."""
    found = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - {"hitchhike_ros"} - {p.stem for p in (ROOT / folder).rglob("*.py")}


def provider(name: str) -> str:
    return PROVIDERS.get(name, name if name in wheels() else f"python3-{name.lower().replace('_', '-')}")


@pytest.mark.parametrize("folder", ["src", "tests"])
def test_every_import_has_a_provider(folder: str) -> None:
    kinds = ("exec_depends",) if folder == "src" else ("exec_depends", "test_depends", "buildtool_depends")
    provided = names(package(), kinds) | set(wheels())
    assert {name: provider(name) for name in imports(folder) if provider(name) not in provided} == {}


def test_every_python_library_for_running_is_imported() -> None:
    programs = {f"python3-ros{name}" for name in ("bag", "launch", "node", "param", "service", "topic")}
    libraries = {name for name in names(package(), ("exec_depends",)) if name.startswith("python3-")} - programs
    assert libraries - {provider(name) for name in imports("src")} == set()


def test_every_node_of_a_launch_file_has_a_provider() -> None:
    files = [path for pattern in ("launch_scripts/*.launch", "tests/rostest/*.test") for path in ROOT.glob(pattern)]
    used = {str(node.get("pkg")) for path in files for node in ElementTree.parse(path).iter("node")} - {"hitchhike_ros"}
    assert {provider(name) for name in used} <= names(package(DISPLAY=":0"), ("exec_depends",))
    assert used


def test_wheels_are_pinned() -> None:
    assert all(re.fullmatch(r"\d+(\.\d+)+(\.post\d+)?", version) for version in wheels().values())


@pytest.mark.parametrize("display", ["", ":0"])
@pytest.mark.parametrize("robot", [False, True])
def test_the_setup_installs_what_the_manifest_names(robot: bool, display: str) -> None:
    manifest = package(DISPLAY=display, HITCHHIKE_ROBOT="yes" if robot else "no")
    expected = names(manifest, DEPENDENCIES[:-1] if robot else DEPENDENCIES)
    expected |= {"=".join((name, "", version)) for name, version in wheels().items()}
    if robot:
        left_out = ("cosmic-ray", "mypy", "pupil-apriltags", "pyastar2d", "pybullet", "ruff")
        expected -= {line for line in expected if line.split("==")[0] in left_out}
    command = [str(ROOT / "launch_scripts" / "setup"), "--list", *(["--robot"] if robot else [])]
    listed = subprocess.run(command, env={**os.environ, "DISPLAY": display}, capture_output=True, text=True, check=True)
    assert set(listed.stdout.split()) == expected


def test_every_executable_has_a_name_of_its_own() -> None:
    """Or rosrun asks which one is meant."""
    tracked = subprocess.run(["git", "ls-files", "--stage"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode:
        pytest.skip("not a git checkout")
    executables = [line.split("/")[-1].split("\t")[-1] for line in tracked.stdout.splitlines() if line[:6] == "100755"]
    assert len(executables) == len(set(executables)) > 0


@pytest.mark.parametrize("script", sorted((ROOT / "scripts").iterdir()), ids=lambda script: script.name)
def test_a_script_calls_the_main_of_its_node(script: Path) -> None:
    """It starts with the interpreter that ROS has, not with whichever python3 comes first on PATH."""
    assert os.access(script, os.X_OK)
    lines = script.read_text(encoding="utf-8").split("\n")
    imported = re.fullmatch(r"from hitchhike_ros\.((?:nodes\.(?:robot|sim)|commands)\.\w+) import main", lines[1])
    assert (lines[0], lines[2]) == ("#!/usr/bin/python3", "")
    assert imported, lines[1]
    guarded = ["# Worker processes load this file too.", 'if __name__ == "__main__":', "    main()", ""]
    assert lines[3:] == (guarded if script.name in ("bench", "experiments") else ["main()", ""])
    path = ROOT.joinpath("src", "hitchhike_ros", *imported[1].split(".")).with_suffix(".py")
    module = ast.parse(path.read_text(encoding="utf-8"))
    assert "main" in {node.name for node in module.body if isinstance(node, ast.FunctionDef)}
