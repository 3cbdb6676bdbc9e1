"""Parameters of nodes: what cannot be used is said in one line, with its name, its value and what was expected."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.control.teleop import TeleopParameters
from hitchhike_ros.core.datatypes import Coordinate, Pose2D, Positive, Variance
from hitchhike_ros.core.errors import HitchhikeError, ParameterError
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.parameters import folder_parameter, frame, node_parameters, parameter, path_parameter


@pytest.mark.parametrize(
    ("cls", "value"),
    [
        (bool, "perhaps"),
        (bool, 5),
        (bool, [True]),
        (str, [1]),
        (str, 5),
        (Positive, 0),
        (Positive, "fast"),
        (Positive, math.nan),
        (Coordinate, math.inf),
        (Coordinate, math.nan),
        (Coordinate, None),
        (Variance, -1),
        (dict[str, Pose2D], 5),
        (dict[str, Pose2D], {"p3dx": 5}),
        (dict[str, Pose2D], {"p3dx": {"x": "left"}}),
    ],
)
def test_a_value_of_the_wrong_kind_is_named(ros: FakeRos, cls: type, value: object) -> None:  # noqa: F811
    ros.params["~given"] = value
    with pytest.raises(ParameterError, match=r"^/p3dx/node: ~given\b.* is .*, expected .") as caught:
        parameter("given", cls, None)
    assert "\n" not in str(caught.value)


def test_private_before_shared_before_default(ros: FakeRos) -> None:  # noqa: F811
    assert parameter("given", Positive, 2.0) == 2.0
    ros.params["given"] = 3
    assert parameter("given", Positive, 2.0) == 3.0
    ros.params["~given"] = "4"
    assert parameter("given", Positive, 2.0) == 4.0
    ros.params["~told"] = "true"
    assert parameter("told", bool, False) is True


@pytest.mark.parametrize("value", [5, 0, True, [1], {"a": 1}, "", "nowhere.yaml", "/", "x" * 5000, "a\0b", 1.5])
def test_a_path_names_an_existing_file(ros: FakeRos, value: object) -> None:  # noqa: F811
    for name in ("config", "urdf", "world", "map"):
        ros.params[f"~{name}"] = value
        with pytest.raises(ParameterError, match=rf"~{name} is .*expected the path of an existing file"):
            path_parameter(name)
    if value != "":
        with pytest.raises(ParameterError, match=r"~config is .*expected the path of an existing file"):
            node_parameters(TeleopParameters, "teleop")


@pytest.mark.parametrize("value", [5, ["x"], "", "/proc/nobody/x", "a\0b", "x" * 5000])
def test_a_folder_can_be_made(ros: FakeRos, value: object) -> None:  # noqa: F811
    ros.params["~output"] = value
    with pytest.raises(ParameterError, match=r"~output is .*expected .*folder"):
        folder_parameter("output")


@pytest.mark.parametrize("rate", [0, -1, "fast", math.nan, math.inf, [10], {"hz": 10}, None, 1e6])
def test_a_rate(ros: FakeRos, rate: object) -> None:  # noqa: F811
    ros.params["~rate"] = rate
    with pytest.raises(ParameterError, match=r"private parameters: teleop\.rate is .*, expected"):
        node_parameters(TeleopParameters, "teleop")


def test_numbers_of_a_component_are_finite(ros: FakeRos, tmp_path: Path) -> None:  # noqa: F811
    (tmp_path / "robot.yaml").write_text("teleop: {speed_mps: .inf}\n")
    ros.params["~config"] = str(tmp_path / "robot.yaml")
    with pytest.raises(ParameterError, match=r"robot\.yaml: teleop\.speed_mps is inf, expected a finite number"):
        node_parameters(TeleopParameters, "teleop")


@pytest.mark.parametrize(("name", "robot_id"), [("/node", None), ("/node", 5), ("/node", ""), ("/p3dx/node", "a b")])
def test_a_robot_has_a_name(ros: FakeRos, name: str, robot_id: object) -> None:  # noqa: F811
    ros.name = name
    if robot_id is not None:
        ros.params["~robot_id"] = robot_id
    with pytest.raises(ParameterError, match=r"~robot_id is .*, expected a robot's name .*namespace"):
        _ = NodeFiles().robot_id
    ros.params["~robot_id"] = "p3dx"
    assert NodeFiles().robot_id == "p3dx"


def test_the_namespace_is_the_name(ros: FakeRos) -> None:  # noqa: F811
    assert NodeFiles().robot_id == "p3dx"


@pytest.mark.parametrize("prefix", [5, ["a"], "a b", "1a", "ü"])
def test_frames_begin_with_a_name(ros: FakeRos, prefix: object) -> None:  # noqa: F811
    ros.params["~tf_prefix"] = prefix
    with pytest.raises(ParameterError, match=r"~tf_prefix is .*, expected the beginning"):
        frame("odom")


def test_frames_of_a_robot_without_namespace(ros: FakeRos) -> None:  # noqa: F811
    ros.name = "/node"
    assert frame("odom") == "odom"
    ros.params["~tf_prefix"] = ""
    assert frame("odom") == "odom"
    ros.params["~tf_prefix"] = "/a/b/"
    assert frame("odom") == "a/b/odom"


@pytest.mark.parametrize("timeout_s", [0, -1, "soon", math.inf, math.nan, [1]])
def test_a_map_is_not_awaited_for_ever(ros: FakeRos, timeout_s: object) -> None:  # noqa: F811
    ros.params["~map_timeout_s"] = timeout_s
    with pytest.raises(HitchhikeError, match=r"~map_timeout_s is .*, expected"):
        _ = NodeFiles().grid
