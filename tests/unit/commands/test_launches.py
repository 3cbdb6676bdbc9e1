"""Launch files are started with a ROS master of their own: deaths of nodes are told, and everything ends in the end."""

from __future__ import annotations

import socket
from pathlib import Path

import psutil
import pytest

from hitchhike_ros.commands.launches import Launch, remappings
from hitchhike_ros.core.errors import HitchhikeError

WAIT_S = 60.0

WELL = """<launch>
  <arg name="who"/>
  <node name="$(arg who)" pkg="hitchhike_ros" type="idle"/>
</launch>
"""
DYING = """<launch>
  <node name="lost" pkg="hitchhike_ros" type="map_server" args="/no/such/map.yaml"/>
  <node name="idle" pkg="hitchhike_ros" type="idle"/>
</launch>
"""


def launch(folder: Path, text: str, **arguments: object) -> Launch:
    file = folder / "some.launch"
    file.write_text(text)
    return Launch(file, arguments, folder / "log")


def answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("localhost", port)) == 0


def test_nodes_run_until_the_context_ends(tmp_path: Path) -> None:
    with launch(tmp_path, WELL, who="anybody") as nodes:
        nodes.wait_for_start()
        nodes.check(0.0)
        port = int(nodes.environment["ROS_MASTER_URI"].rpartition(":")[2])
        assert answers(port)
        family = [process for process in psutil.process_iter(["cmdline"]) if _of(process, tmp_path)]
        assert any("__name:=anybody" in process.info["cmdline"] for process in family)
    gone, alive = psutil.wait_procs(family, timeout=WAIT_S)
    assert gone and not alive
    assert not answers(port)
    assert (tmp_path / "log" / "roslaunch.log").stat().st_size > 0


def test_a_node_that_dies_is_named_with_its_status(tmp_path: Path) -> None:
    with launch(tmp_path, DYING) as nodes, pytest.raises(HitchhikeError, match=r"node lost died, exit status 1"):
        nodes.wait_for_start()
        for _ in range(int(WAIT_S)):
            nodes.check(1.0)


def test_a_file_that_cannot_be_launched_is_an_end_at_once(tmp_path: Path) -> None:
    with launch(tmp_path, "<launch>") as nodes, pytest.raises(HitchhikeError, match="roslaunch ended with status"):
        nodes.wait_for_start()


def test_arguments_are_those_of_ros() -> None:
    assert remappings({"a": True, "b": 1.5, "_c": Path("/x")}) == ["a:=true", "b:=1.5", "_c:=/x"]


def _of(process: psutil.Process, folder: Path) -> bool:
    """Whether it belongs to the launch with its logs in ``folder``."""
    return any(str(folder) in word for word in process.info["cmdline"] or ())
