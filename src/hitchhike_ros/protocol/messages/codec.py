"""Messages as JSON: numbers given as strings are read, unknown keys are ignored, unknown types and versions refused."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.messages.fields import Covariance, Message, RearMarker
from hitchhike_ros.protocol.messages.map import MapAck, MapMessage, MapOffer, MapPiece, MapRequest
from hitchhike_ros.protocol.messages.ride import (
    Accept,
    Ack,
    Aligned,
    Beacon,
    Coupled,
    Decouple,
    Deny,
    Driver,
    Lock,
    Request,
    RequestCancel,
    Terminate,
)

VERSION = 1

MESSAGE_TYPES: dict[str, type[Message]] = {
    cls.type: cls
    for cls in (
        Beacon,
        Request,
        Accept,
        Deny,
        Lock,
        RequestCancel,
        Aligned,
        Coupled,
        Driver,
        Ack,
        Decouple,
        Terminate,
    )
}
MAP_MESSAGES: dict[str, type[MapMessage]] = {cls.type: cls for cls in (MapRequest, MapOffer, MapPiece, MapAck)}
_ALL_TYPES: dict[str, type[Message]] = {**MESSAGE_TYPES, **MAP_MESSAGES}


# msgspec crashes when two threads are the first to use a type, and some types are in several messages: all are made
# ready now.
for _cls in _ALL_TYPES.values():
    msgspec.json.Decoder(_cls)


def encode(message: Message) -> str:
    """``message`` as JSON."""
    content = msgspec.to_builtins(message, enc_hook=float)  # NumPy's scalars are no floats to msgspec
    return msgspec.json.encode({"version": VERSION, "type": message.type, **content}).decode()


def decode(text: str) -> Message:
    """The message in a JSON text.

    Raises:
        MessageError: no JSON object, another version, an unknown type, or a field that is missing or out of bounds;
            it names the field and what was expected.
    """
    try:
        content = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as exc:
        raise MessageError(f"not JSON: {exc}") from exc
    if not isinstance(content, dict):
        raise MessageError(f"not a JSON object but {type(content).__name__}")
    if str(content.get("version")) != str(VERSION):
        raise MessageError(f"version {content.get('version')!r}, expected {VERSION}")
    kind = content.get("type")
    cls = _ALL_TYPES.get(kind) if isinstance(kind, str) else None
    if cls is None:
        raise MessageError(f"type {kind!r}, expected one of {', '.join(_ALL_TYPES)}")
    try:
        message = msgspec.convert(content, cls, strict=False)
    except msgspec.ValidationError as exc:
        raise MessageError(f"{kind}: {exc}") from exc
    for name, pose in _poses(message, content):  # elsewhere "nowhere in particular", here all or nothing
        if len(pose) < 3 or not {"x", "y", "theta"} <= set(pose):
            raise MessageError(f"{kind}: {name} is {pose}, expected x, y and theta")
    if not _finite(message):
        name, value = next((name, value) for name, value in _floats(message) if not math.isfinite(value))
        raise MessageError(f"{kind}: {name} is {value}, expected a finite number")
    for name in ("sigma", "seen_sigma"):
        sigma = getattr(message, name, None)
        if sigma is not None and not _is_covariance(sigma):
            raise MessageError(f"{kind}: {name} is {sigma}, expected symmetric and positive semidefinite")
    path = message.path if isinstance(message, Beacon | Accept) else ()
    if len(path) == 1 or any(after[2] <= before[2] for before, after in pairwise(path)):
        raise MessageError(f"{kind}: path is {path}, expected two points or more, each later than the one before")
    return message


def _is_covariance(sigma: Covariance) -> bool:
    """Zero is one (P17 §6.1 starts with it); rounding in the last digits is let through."""
    matrix = np.array(sigma)
    scaled = matrix / (np.abs(matrix).max() or 1.0)
    return bool(np.abs(scaled - scaled.T).max() <= 1e-9 and np.linalg.eigvalsh(scaled)[0] >= -1e-9)


@cache
def _names(cls: type[Any]) -> tuple[str, ...]:
    return tuple(f.name for f in fields(cls))


# Of each class, the fields that may hold a pose, or a rear marker with one.
_FIELDS_OF_POSES = {
    cls: tuple(f.name for f in fields(cls) if "Pose2D" in str(f.type) or "RearMarker" in str(f.type))
    for cls in (*_ALL_TYPES.values(), RearMarker)
}


def _poses(value: object, content: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every pose in a message as it came, with the name of its field."""
    if isinstance(value, Pose2D):
        yield name, content
    elif isinstance(value, Message | RearMarker):
        for field in _FIELDS_OF_POSES[type(value)]:
            if (inner := getattr(value, field)) is not None:
                yield from _poses(inner, content[field], f"{name}.{field}" if name else field)


def _finite(value: object) -> bool:
    """Whether every number in a message is."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, tuple):
        return all(map(_finite, value))
    if is_dataclass(value) and not isinstance(value, type):
        return all(_finite(getattr(value, name)) for name in _names(type(value)))
    return True


def _floats(value: object, name: str = "") -> Iterator[tuple[str, float]]:
    """Every float in a message with the name of its field."""
    if isinstance(value, float):
        yield name, value
    elif isinstance(value, tuple):
        for item in value:
            yield from _floats(item, name)
    elif is_dataclass(value):
        for f in fields(value):
            yield from _floats(getattr(value, f.name), f"{name}.{f.name}" if name else f.name)
