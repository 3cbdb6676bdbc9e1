"""YAML is read in bounded time and memory, never as something else than what stands there."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import load_parameters, read_yaml
from hitchhike_ros.core.yaml_text import MAX_BYTES, MAX_DEPTH, MAX_VALUES, YamlError, parse_yaml, parse_yaml_text


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: 3\nb: -0.5\nc: .5\nd: 1.\ne: 0x1F\n", {"a": 3, "b": -0.5, "c": 0.5, "d": 1.0, "e": 31}),
        ("a: true\nb: No\nc: on\n", {"a": True, "b": False, "c": True}),
        ("a: ~\nb:\nc: null\n", {"a": None, "b": None, "c": None}),
        ("a: 'true'\nb: \"3\"\nc: |\n  text\n", {"a": "true", "b": "3", "c": "text\n"}),
        ("a: .inf\nb: -.INF\n", {"a": math.inf, "b": -math.inf}),
        ("a: [1, [2, {b: x}]]\n", {"a": [1, [2, {"b": "x"}]]}),
        ("a: !!int 3\nb: !!float 3\nc: !!str 3\n", {"a": 3, "b": 3, "c": "3"}),
        ("a: !!bool yes\nb: !!null ~\n", {"a": True, "b": None}),
        ("a: &p {x: 1, y: 2}\nb: *p\n", {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 2}}),
        ("a: &p {x: 1, y: 2}\nb: {<<: *p, y: 3}\n", {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}}),
        ("a: {<<: [{x: 1}, {x: 2, y: 2}], z: 3}\n", {"a": {"x": 1, "y": 2, "z": 3}}),
        ("1: a\nno: b\n1.0: c\n", {"1": "a", "no": "b", "1.0": "c"}),
        ("", None),
    ],
)
def test_what_both_versions_of_yaml_agree_on(text: str, value: object) -> None:
    assert parse_yaml(text) == value


@pytest.mark.parametrize("scalar", ["010", "-017", "1:30", "12:30:45.5", "1_000", "0b11", "0o17", "2026-12-01", "1e3"])
def test_what_they_read_differently_stays_text(scalar: str) -> None:
    assert parse_yaml(f"a: {scalar}") == {"a": scalar}


@pytest.mark.parametrize("scalar", ["010", "1:30", "1_000", "0b11", "2026-12-01", "!!int x", "!!float {}", "!!set {}"])
def test_a_number_that_could_be_another_is_refused_where_a_number_has_to_be(tmp_path: Path, scalar: str) -> None:
    (tmp_path / "robot.yaml").write_text(f"start: {{x: {scalar}, y: 1}}\n")
    with pytest.raises(ParameterError, match=r"robot\.yaml: start\.x"):
        load_parameters(Pose2D, "start", tmp_path / "robot.yaml")


@pytest.mark.parametrize(
    ("text", "field", "expected"),
    [
        ("a: 1\nb: 2\na: 3\n", "a", "one value; line 3 has the same key again"),
        ("a: {b: 1, 'b': 1}\n", "a.b", "same key"),
        ("- {x: 1}\n- {x: 1, x: 2}\n", "[1].x", "same key"),
        ("a: !!int x\n", "a", "fits its tag"),
        ("a: !!int 1.5\n", "a", "fits its tag"),
        ("a: !!bool 1\n", "a", "fits its tag"),
        ("a: !!timestamp x\n", "a", "fits its tag"),
        ("a: !!python/object:os.system {}\n", "a", "without a tag"),
        ("a: !!binary eA==\n", "a", "fits its tag"),
        ("a: *b\n", "a", "stands completely before"),
        ("a: &a [*a]\n", "a[0]", "stands completely before"),
        ("a: &a {b: *a}\n", "a.b", "stands completely before"),
        ("{[1, 2]: 3}\n", "", "names as keys"),
        ("a: {<<: 3}\n", "a.<<", "a mapping to merge"),
        ("a: 1\n---\nb: 2\n", "", "a single one"),
        ("a: [1, 2", "", "valid YAML"),
        ("a: \x00", "", "valid YAML"),
        ("a: b: c", "", "valid YAML"),
        ("\ta: 1", "", "valid YAML"),
    ],
)
def test_what_says_two_things_or_nothing_is_refused(text: str, field: str, expected: str) -> None:
    with pytest.raises(YamlError) as caught:
        parse_yaml(text)
    assert caught.value.field == field
    assert expected in caught.value.expected


def bomb(levels: int, each: int) -> str:
    lines = [f"a0: &a0 [{', '.join(['x'] * each)}]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * each)}]" for i in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: " + "[" * 2000 + "]" * 2000, "levels"),
        ("a: " + "{b: " * 2000 + "1" + "}" * 2000, "levels"),
        ("".join(" " * i + "a:\n" for i in range(1200)), "levels"),
        ("- " * 2000 + "x", "levels"),
        ("? " * 2000 + "x", "levels"),
        ("[" * 400_000, "levels"),
        (bomb(9, 9), "aliases counted"),
        ("a: &a {x: 1}\nb: {" + ", ".join(f"k{i}: *a" for i in range(30_000)) + "}", "aliases counted"),
        ("[" + "1," * 480_000 + "1]", "values"),
        ("{" + ",".join(f"k{i}: 1" for i in range(80_000)) + "}", "values"),
    ],
)
@pytest.mark.parametrize("parse", [parse_yaml, parse_yaml_text])
def test_what_would_take_long_is_refused_at_once(parse, text: str, expected: str) -> None:
    started = time.process_time()
    with pytest.raises(YamlError) as caught:
        parse(text)
    assert expected in caught.value.expected
    assert time.process_time() - started < 1.0


def test_the_limits_leave_room() -> None:
    depth = MAX_DEPTH - 1
    assert parse_yaml("a: " + "[" * depth + "]" * depth) is not None
    assert len(parse_yaml("[" + "1," * (MAX_VALUES - 2) + "]")) == MAX_VALUES - 2


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("# " + "x" * MAX_BYTES + "\n")
    with pytest.raises(ParameterError, match="at most 1000000 bytes"):
        read_yaml(path)


@pytest.mark.parametrize(
    "text",
    [
        "a:\t1\nb:\t[0,\t1]\n",
        "a: 1\t\nb: [0, 1] \t\n",
        "a: 1\t# one\n\t# a comment\nb: [0, 1]\n",
        "a: 1\n\t\n \t \nb: [\n\t0,\n\t1\n]\n",
        "a: 1\r\n\t\r\nb:\r\n-\t0\r\n-\t1\r\n",
    ],
)
def test_tabs_where_yaml_cpp_takes_them(text: str) -> None:
    assert parse_yaml(text) == {"a": 1, "b": [0, 1]}


def test_text_as_yaml_cpp_hands_it_out() -> None:
    text = "a: 010\nb: !!int x\nc: 'y'\nd: ~\ne: ''\nf: &f 2026-12-01\ng: *f\nh: [no, !foo 1:30]\n<<: {i: 1}\n"
    assert parse_yaml_text(text) == {
        "a": "010",
        "b": "x",
        "c": "y",
        "d": None,
        "e": "",
        "f": "2026-12-01",
        "g": "2026-12-01",
        "h": ["no", "1:30"],
        "<<": {"i": "1"},
    }


def test_an_error_is_one_line_however_much_stands_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("start: {x: [" + "1, " * 40_000 + "1]}\n")
    with pytest.raises(ParameterError) as caught:
        load_parameters(Pose2D, "start", path)
    assert str(caught.value).count("\n") == 0
    assert len(str(caught.value)) < 1000
