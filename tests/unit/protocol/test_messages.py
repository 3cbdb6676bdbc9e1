"""Messages on the network: every type survives, everything else is refused with what was expected."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.protocol.messages import (
    MESSAGE_TYPES,
    Accept,
    Ack,
    Beacon,
    Covariance,
    Decouple,
    Driver,
    Lock,
    Message,
    Request,
    Waypoints,
    decode,
    encode,
)
from protocol_helpers import messages

EXAMPLES = [pytest.param(message, id=message.type) for message in messages().values()]


def _covariances() -> st.SearchStrategy[Any]:
    factors = st.lists(st.floats(-1e3, 1e3), min_size=9, max_size=9)
    rows = factors.map(lambda v: np.tril(np.reshape(v, (3, 3)))).map(lambda A: A @ A.T)
    return rows.map(lambda C: tuple(tuple(float(v) for v in row) for row in (C + C.T) / 2))


def _paths() -> st.SearchStrategy[Any]:
    point, step = st.floats(-1e6, 1e6), st.floats(1e-3, 1e3)
    points = st.lists(st.tuples(point, point, step), min_size=2, max_size=4)
    later = points.map(lambda ps: tuple((x, y, sum(p[2] for p in ps[:i])) for i, (x, y, _) in enumerate(ps)))
    return st.just(()) | later


def _strategy(hint: Any) -> st.SearchStrategy[Any]:
    """Values of a field's type within its bounds."""
    if hint in (Covariance, Waypoints):
        return _covariances() if hint == Covariance else _paths()
    bounds: dict[str, Any] = {}
    if get_origin(hint) is Annotated:
        meta, hint = get_args(hint)[1], get_args(hint)[0]
        bounds = {k: v for k in ("ge", "gt", "le", "min_length", "max_length") if (v := getattr(meta, k)) is not None}
    if hint is float:
        low, open_end = bounds.get("ge", bounds.get("gt")), "gt" in bounds
        return st.floats(low, bounds.get("le"), allow_nan=False, allow_infinity=False, exclude_min=open_end)
    if hint is int:
        return st.integers(bounds.get("ge", -(2**60)), bounds.get("le", 2**60))
    if hint is str:
        return st.text(
            'aä☃\U0001f916 "\\{}0\n', min_size=bounds.get("min_length", 0), max_size=bounds.get("max_length", 20)
        )
    if get_origin(hint) is tuple and get_args(hint)[-1] is Ellipsis:
        return st.lists(_strategy(get_args(hint)[0]), max_size=3).map(tuple)
    if get_origin(hint) in (tuple, Union, UnionType):
        return (st.tuples if get_origin(hint) is tuple else st.one_of)(*map(_strategy, get_args(hint)))
    if not is_dataclass(hint):
        return st.from_type(hint)
    hints = get_type_hints(hint, include_extras=True)
    return st.builds(hint, **{f.name: _strategy(hints[f.name]) for f in fields(hint)})


def _numbers(value: Any, where: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], float | int]]:
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield where, value
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _numbers(item, (*where, key))


def _with(content: Any, where: tuple[Any, ...], value: Any) -> Any:
    if not where:
        return value
    copy = dict(content) if isinstance(content, dict) else list(content)
    copy[where[0]] = _with(copy[where[0]], where[1:], value)
    return copy


@settings(max_examples=50)
@given(st.one_of(*(_strategy(cls) for cls in MESSAGE_TYPES.values())))
def test_every_message_survives_the_network(message: Message) -> None:
    assert decode(encode(message)) == message


@pytest.mark.parametrize("message", EXAMPLES)
def test_numbers_as_strings_and_unknown_keys(message: Message) -> None:
    content = json.loads(encode(message))
    for where, number in _numbers(content):
        content = _with(content, where, str(number))
    assert decode(json.dumps({**content, "colour": {"of": ["the", "robot"]}})) == message


@pytest.mark.parametrize("message", EXAMPLES)
def test_senseless_numbers_name_their_field(message: Message) -> None:
    content = json.loads(encode(message))
    for where, _ in _numbers(content):
        for value in ("nan", "inf", "-inf", "1e999", math.nan, math.inf):
            with pytest.raises(MessageError):
                decode(json.dumps(_with(content, where, value)))
    # Whole numbers are refused for their type; of floats the field is named.
    with pytest.raises(MessageError, match=r"time_stamp.*finite"):
        decode(json.dumps({**content, "time_stamp": "inf"}))


@pytest.mark.parametrize("message", EXAMPLES)
def test_wrong_types_and_missing_fields_name_the_field(message: Message) -> None:
    content = json.loads(encode(message))
    for name in content.keys() - {"version", "type"}:
        with pytest.raises(MessageError, match=rf"{message.type}: Expected .*{name}"):
            decode(json.dumps({**content, name: [1]}))
    optional = {f.name for f in fields(message) if f.default is not MISSING}
    for name in content.keys() - {"version", "type"} - optional:
        with pytest.raises(MessageError, match=rf"missing required field `{name}`"):
            decode(json.dumps({k: v for k, v in content.items() if k != name}))


@pytest.mark.parametrize("message", EXAMPLES)
def test_a_truncated_message_is_refused(message: Message) -> None:
    text = encode(message)
    for end in range(len(text)):
        with pytest.raises(MessageError, match="JSON"):
            decode(text[:end])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "not JSON"),
        ("\ud800", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "not a JSON object but list"),
        ("null", "not a JSON object but NoneType"),
        ('{"type": "lock", "robot_id": "a"}', "version None, expected 1"),
        ('{"version": 2, "type": "lock", "robot_id": "a"}', "version 2, expected 1"),
        ('{"version": 1, "robot_id": "a"}', "type None, expected one of status, request"),
        ('{"version": 1, "type": "hello", "robot_id": "a"}', "type 'hello', expected one of status, request"),
        ('{"version": 1, "type": ["lock"], "robot_id": "a"}', "expected one of"),
        ('{"version": 1, "type": "lock", "robot_id": ""}', "length >= 1.*robot_id"),
        ('{"version": 1, "type": "lock", "robot_id": "a", "seq": -1}', ">= 0.*seq"),
    ],
)
def test_garbage_is_refused_with_what_was_expected(text: str, expected: str) -> None:
    with pytest.raises(MessageError, match=expected):
        decode(text)


@pytest.mark.parametrize(
    ("cls", "field", "value", "expected"),
    [
        (Request, "priority", 21, "<= 20"),
        (Request, "profile", -0.5, ">= 0"),
        (Request, "goal", {"x": 1.0}, "goal is .*expected x, y and theta"),
        (Driver, "sigma", [[1, 0, 0], [0, 1, 0]], "length 3"),
        (Driver, "sigma", [[1, 0, 0], [0, -1, 0], [0, 0, 1]], "sigma is .*positive semidefinite"),
        (Driver, "sigma", [[1, 2, 0], [0, 1, 0], [0, 0, 1]], "sigma is .*symmetric"),
        (Driver, "sigma", [[1e308, -1e308, 0], [1e308, 1, 0], [0, 0, 1]], "sigma is .*symmetric"),
        (Driver, "new_obstacles", {"obstacles": [{"id": "a", "x": 0, "y": 0, "w": -1, "b": 1}]}, ">= 0"),
        (Driver, "place", 0, ">= 1"),
        (Driver, "ahead", {"marker_id": 1, "marker_size_m": 0.1, "marker_pose": {"x": 1.0}}, "ahead.marker_pose is .*"),
        (Ack, "seen_sigma", [[1, 0, 0], [0, -1, 0], [0, 0, 1]], "seen_sigma is .*positive semidefinite"),
        (Lock, "in_s", -1.0, ">= 0"),
        (Lock, "ride_m", -0.1, ">= 0"),
        (Ack, "ride_m", -0.1, ">= 0"),
        (Request, "path", [[1.0, 2.0, 0.0], [2.0, 2.0, 1.0]], "length 2"),
        (Request, "path", [[float(i), 2.0] for i in range(65)], "length <= 64"),
        (Request, "path", [[1.0, 2.0], [1.0, "inf"]], "path is inf, expected a finite number"),
        (Beacon, "free_places", -1, ">= 0"),
        (Beacon, "path", [[1.0, 2.0, 0.0]], "path is .*two points or more"),
        (Beacon, "path", [[1.0, 2.0, -3.0], [1.0, 2.0, 3.0]], ">= 0"),
        (Accept, "path", [[1.0, 2.0, 3.0], [2.0, 2.0, 3.0]], "path is .*later than the one before"),
        (Accept, "path", [[1.0, 2.0, float(i)] for i in range(501)], "length <= 500"),
    ],
)
def test_values_out_of_bounds_are_refused(cls: type[Message], field: str, value: Any, expected: str) -> None:
    content = {**json.loads(encode(messages()[cls])), field: value}
    with pytest.raises(MessageError, match=expected):
        decode(json.dumps(content))


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text('a1"'),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("xyz"), inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=50)
@given(st.sampled_from(list(messages().values())), st.data())
def test_fuzzed_fields_are_read_or_refused(message: Message, data: st.DataObject) -> None:
    content = json.loads(encode(message))
    content[data.draw(st.sampled_from(sorted(content)))] = data.draw(_JSON)
    try:
        text = msgspec.json.encode(content).decode()
    except (OverflowError, ValueError):
        return  # no JSON, so nothing that comes over the network
    try:
        assert isinstance(decode(text), Message)
    except MessageError as exc:
        assert str(exc)


def test_every_type_is_ready_before_threads_decode_it() -> None:
    """msgspec 0.22 crashes when two threads are the first to use a dataclass; what it has made is kept on the class."""
    code = (
        "from hitchhike_ros.protocol import messages, observations, status as s\n"
        "types = [*messages.MESSAGE_TYPES.values(), messages.NewObstacles, s.Status, s.GoalCommand, s.KnownRobot]\n"
        "print([t.__name__ for t in types if '__msgspec_cache__' not in vars(t)])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(("cls", "name"), [(Driver, "age_s"), (Decouple, "age_s"), (Ack, "seen_age_s")])
def test_the_age_of_what_is_told_may_be_left_out_and_is_never_negative(cls: type[Message], name: str) -> None:
    """Robots of before do not tell it."""
    message = messages()[cls]
    content = json.loads(encode(message))
    del content[name]
    assert getattr(decode(json.dumps(content)), name) == 0.0
    for bad in (-0.1, "soon", None):
        with pytest.raises(MessageError, match=name):
            decode(json.dumps({**content, name: bad}))


def test_a_message_that_has_waited_tells_of_a_time_longer_ago() -> None:
    told, ack, other = messages()[Driver].aged(0.2).aged(0.1), messages()[Ack].aged(0.2), messages()[Lock]
    assert isinstance(told, Driver) and isinstance(ack, Ack)
    assert (told.age_s, ack.seen_age_s) == (pytest.approx(0.3), pytest.approx(0.2))
    assert messages()[Driver].aged(-1.0) == messages()[Driver]  # the clock was set back
    assert other.aged(5.0) is other


@pytest.mark.parametrize("given", [{"x": 1, "y": 2.5}, {"theta": 0.3}, {}])
def test_a_pose_of_which_a_file_says_a_part_is_told_whole(given: dict[str, float]) -> None:
    """A hitchhiking point's pose goes from the world file into the lock."""
    pose = convert(given, Pose2D, "office.world.yaml", "hitchhiking_points[0].waiting_pose")
    lock = Lock(robot_id="a", to="b", ride_id="r", aligning=pose, waiting=pose)
    assert decode(encode(lock)) == lock
    assert json.loads(encode(lock))["waiting"] == {"x": pose.x, "y": pose.y, "theta": pose.theta}
