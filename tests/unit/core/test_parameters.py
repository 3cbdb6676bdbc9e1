import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from hitchhike_ros.core.datatypes import NonNegative, Pose2D, Positive, UnitInterval
from hitchhike_ros.core.errors import HitchhikeError, MapFileError, ParameterError
from hitchhike_ros.core.parameters import convert, load_parameters, read_yaml


@dataclass(frozen=True)
class Settings:
    goal: Pose2D
    range_m: Positive = 8.0
    gain: UnitInterval = 0.5
    beams: int = 3
    offsets: tuple[NonNegative, ...] = ()


def write(folder: Path, text: str) -> Path:
    path = folder / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_defaults_then_file_then_overrides(tmp_path: Path) -> None:
    file = write(tmp_path, "scan: {goal: {x: 1, y: 2.5}, range_m: 4, offsets: [0, 0.1]}\nother: {}\n")
    assert load_parameters(Settings, "scan", file) == Settings(Pose2D(1.0, 2.5), 4.0, offsets=(0.0, 0.1))
    overridden = load_parameters(Settings, "scan", file, {"range_m": 6.0, "gain": 1})
    assert (overridden.range_m, overridden.gain, overridden.goal) == (6.0, 1.0, Pose2D(1.0, 2.5))


def test_without_a_file_the_defaults_hold() -> None:
    assert load_parameters(Settings, "scan", None, {"goal": {}}).range_m == 8.0


@pytest.mark.parametrize("text", ["scan:\n", "other: {}\n"])
def test_a_missing_section_has_the_defaults(tmp_path: Path, text: str) -> None:
    assert load_parameters(Pose2D, "scan", write(tmp_path, text)) == Pose2D()


@pytest.mark.parametrize(
    ("section", "field", "value", "expected"),
    [
        ("{goal: {}, range_m: -1}", "scan.range_m", -1, "> 0"),
        ("{goal: {}, range_m: .nan}", "scan.range_m", "nan", "> 0"),
        ("{goal: {}, gain: 1.01}", "scan.gain", 1.01, "<= 1"),
        ("{goal: {}, beams: 2.5}", "scan.beams", 2.5, "int"),
        ("{goal: {}, range_m: far}", "scan.range_m", "'far'", "float"),
        ("{goal: {x: left}}", "scan.goal.x", "'left'", "float"),
        ("{goal: {}, offsets: [0, -0.5]}", "scan.offsets", "-0.5", ">= 0"),
        ("{goal: {}, ragne_m: 3}", "scan.ragne_m", 3, "range_m"),
        ("{range_m: 3}", "scan", "range_m", "goal"),
        ("[1, 2]", "scan", "[1, 2]", "a mapping"),
    ],
)
def test_a_bad_field_is_named(tmp_path: Path, section: str, field: str, value: object, expected: str) -> None:
    file = write(tmp_path, f"scan: {section}\n")
    with pytest.raises(ParameterError) as caught:
        load_parameters(Settings, "scan", file)
    assert caught.value.file == str(file)
    assert caught.value.field.startswith(field)
    assert str(value) in str(caught.value)
    assert expected in caught.value.expected


@dataclass(frozen=True)
class Robot:
    mode: Literal["local", "network"] = "local"
    policy: Literal["nearest", "first"] | None = None
    modes: tuple[Literal["a", "b"], ...] = ()
    pair: tuple[Literal["left"], Literal[0, 1]] = ("left", 0)


@dataclass(frozen=True)
class Fleet:
    robots: dict[str, Robot]


@pytest.mark.parametrize(
    ("robot", "field", "expected"),
    [
        ({"mode": "Network"}, "mode", "one of 'local', 'network'"),
        ({"policy": "last"}, "policy", "one of 'first', 'nearest'"),
        ({"modes": ["a", "c"]}, "modes[1]", "one of 'a', 'b'"),
        ({"pair": ["left", 2]}, "pair[1]", "one of 0, 1"),
        ({"pair": ["right", 0]}, "pair[0]", "one of 'left'"),
    ],
)
def test_of_a_choice_the_allowed_values_are_said(robot: dict[str, object], field: str, expected: str) -> None:
    with pytest.raises(ParameterError) as caught:
        convert(robot, Robot, "robot.yaml", "hitchhiking")
    assert (caught.value.field, caught.value.expected) == (f"hitchhiking.{field}", expected)
    with pytest.raises(ParameterError) as caught:
        convert({"robots": {"p3dx": robot}}, Fleet, "robot.yaml")
    assert caught.value.expected == expected


def test_expectations_are_in_words() -> None:
    with pytest.raises(ParameterError, match="expected a mapping that has the field `goal`"):
        convert({"range_m": 3}, Settings, "robot.yaml")
    with pytest.raises(ParameterError, match="expected a number of at most 64 bits"):
        convert({"goal": {}, "range_m": 10**400}, Settings, "robot.yaml")


def test_a_bad_override_is_not_blamed_on_the_file(tmp_path: Path) -> None:
    file = write(tmp_path, "scan: {goal: {}}\n")
    with pytest.raises(ParameterError, match=r"^private parameters: scan\.gain is 2, expected .*<= 1"):
        load_parameters(Settings, "scan", file, {"gain": 2})


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"a: [1, 2", "valid YAML"),
        (b"- 1\n- 2\n", "a YAML mapping"),
        (b"", "a YAML mapping"),
        (b"\xff\xfe", "readable"),
    ],
)
def test_a_file_that_is_no_mapping(tmp_path: Path, content: bytes, expected: str) -> None:
    file = tmp_path / "robot.yaml"
    file.write_bytes(content)
    with pytest.raises(ParameterError, match=expected) as caught:
        read_yaml(file)
    assert caught.value.file == str(file)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.yaml", tmp_path):
        with pytest.raises(MapFileError, match="expected a readable YAML file"):
            read_yaml(path, MapFileError)


def test_the_error_is_one_of_the_package_and_of_the_kind_asked_for() -> None:
    with pytest.raises(HitchhikeError) as caught:
        convert({"x": "left"}, Pose2D, "world.yaml", "robots.p3dx.start", MapFileError)
    assert type(caught.value) is MapFileError
    assert caught.value.field == "robots.p3dx.start.x"
    assert caught.value.value == "left"


@dataclass(frozen=True)
class Reach:
    range_m: NonNegative = math.inf
    speed_mps: Positive = 1.0


def test_only_what_is_unlimited_by_default_may_be_infinite() -> None:
    assert load_parameters(Reach, "network", None, {"range_m": "inf"}).range_m == math.inf
    assert load_parameters(Reach, "network", None, {"range_m": 5}).range_m == 5.0
    for name, value in (("range_m", math.nan), ("speed_mps", math.inf)):
        with pytest.raises(ParameterError, match=rf"network\.{name}"):
            load_parameters(Reach, "network", None, {name: value})
