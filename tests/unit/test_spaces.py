"""rosrun and roslaunch from the devel space and from an install space, each in a shell that has read its setup.bash."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"


@pytest.fixture(scope="session", params=["devel", "install"])
def space(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a space's setup.bash."""
    if not (BUILD / "devel" / "setup.bash").is_file():
        pytest.skip("launch_scripts/setup has not built it")
    if request.param == "devel":
        return BUILD / "devel"
    destination = tmp_path_factory.mktemp("install")
    environment = {**os.environ, "DESTDIR": str(destination)}
    subprocess.run(["cmake", "--install", str(BUILD)], env=environment, check=True, capture_output=True)
    return next(destination.rglob("setup.bash")).parent


def run(space: Path, command: str) -> str:
    environment = {"PATH": "/usr/bin:/bin", "HOME": os.environ.get("HOME", "/")}
    script = f". '{space}/setup.bash' && cd / && {command}"
    done = subprocess.run(
        ["bash", "-c", script], env=environment, check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_rosrun_finds_programs(space: Path) -> None:
    assert run(space, "rosrun hitchhike_ros map_server --help").startswith("map_server")


def test_roslaunch_finds_launch_files_and_their_nodes(space: Path) -> None:
    arguments = "robot:=turtlebot map:=any.yaml world:=any.world.yaml"
    nodes = run(space, f"roslaunch --nodes hitchhike_ros robot.launch {arguments}").split()
    assert "/turtlebot/slam" in nodes


def test_compiled_modules_and_wheels_are_found(space: Path) -> None:
    imports = "import cv2, hitchhike_ros._grid_search, hitchhike_ros._visp_tracker"
    assert run(space, f"/usr/bin/python3 -c '{imports}; print(cv2.__version__)'").strip() == "4.11.0"


def test_maps_and_models_are_found_by_the_package(space: Path) -> None:
    package = Path(run(space, "rospack find hitchhike_ros").strip())
    assert all((package / name).is_file() for name in ("maps/p17_exp1.yaml", "urdf/p3dx.urdf", "config/p3dx.yaml"))
