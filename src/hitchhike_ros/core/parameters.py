"""Parameter files: YAML with one section a component, each checked into that component's frozen dataclass."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import msgspec.inspect

from hitchhike_ros.core.errors import InputFileError, ParameterError
from hitchhike_ros.core.yaml_text import MAX_BYTES, YamlError, parse_yaml

T = TypeVar("T")

# A part of a msgspec error path: a name, the index of an item, or three dots for some value of a mapping.
_PART = re.compile(r"\.{3}|[^.\[\]]+")


def read_yaml(
    path: Path | str,
    error: type[InputFileError] = ParameterError,
    parse: Callable[[str], Any] = parse_yaml,
) -> dict[str, Any]:
    """The mapping in a YAML file; raises ``error`` when it is missing, too large, malformed or not a mapping."""
    try:
        with Path(path).open("rb") as file:
            read = file.read(MAX_BYTES + 1)
        if len(read) > MAX_BYTES:
            raise error(path, "", "larger", f"a YAML file of at most {MAX_BYTES} bytes")
        text = read.decode()
    except (OSError, ValueError) as exc:
        reason = getattr(exc, "strerror", None) or (
            "not UTF-8 text" if isinstance(exc, UnicodeDecodeError) else str(exc)
        )
        raise error(path, "", reason, "a readable YAML file") from exc
    try:
        content = parse(text)
    except YamlError as exc:
        raise error(path, exc.field, exc.value, exc.expected) from exc
    if not isinstance(content, dict):
        raise error(path, "", type(content).__name__, "a YAML mapping")
    return content


def convert(
    value: object, cls: type[T], file: object, field: str = "", error: type[InputFileError] = ParameterError
) -> T:
    """``value`` as a checked ``cls``; unknown and missing fields, wrong types and bounds raise ``error``."""
    if isinstance(value, Mapping) and hasattr(cls, "__dataclass_fields__"):
        known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
        for key in value:
            if key not in known:
                name = f"{field}.{key}" if field else str(key)
                raise error(file, name, value[key], f"one of the fields {', '.join(sorted(known))}")
    try:
        return msgspec.convert(value, cls, strict=False)
    except msgspec.ValidationError as exc:
        match = re.fullmatch(r"(.*?)(?: - at `\$\.?(.*?)`)?", str(exc), re.DOTALL)
        message, inner = (match.group(1), match.group(2) or "") if match else (str(exc), "")
        name = ".".join(part for part in (field, inner) if part).replace(".[", "[")
        raise error(file, name, _lookup(value, inner), _expected(message, cls, inner)) from exc


def load_parameters(
    cls: type[T], section: str, file: Path | str | None = None, overrides: Mapping[str, object] | None = None
) -> T:
    """Parameters of one component: the defaults of ``cls``, then ``section`` of ``file``, then ``overrides``.

    Raises:
        ParameterError: names the file (``private parameters`` for an override), the field, its value and what was
            expected.
    """
    content: dict[str, Any] = {}
    if file:
        content = read_yaml(file).get(section) or {}
        if not isinstance(content, dict):
            raise ParameterError(file, section, content, "a mapping of parameters")
        convert(content, cls, file, section)
    merged = {**content, **(overrides or {})}
    source = "private parameters" if overrides else (file or "defaults")
    parameters = convert(merged, cls, source, section)
    unlimited = {f.name for f in fields(cls) if f.default == math.inf}  # type: ignore[arg-type]
    for name in merged:
        value = getattr(parameters, name)
        if not (name in unlimited and value == math.inf):
            require_finite(value, source, f"{section}.{name}")
    return parameters


def require_finite(value: object, file: object, field: str, error: type[InputFileError] = ParameterError) -> None:
    """Raises ``error`` where a number in ``value``, a number, a tuple, a mapping or a dataclass, is not finite."""
    for name, number in _numbers(value, field):
        if not math.isfinite(number):
            raise error(file, name, number, "a finite number")


def _numbers(value: object, name: str) -> Iterable[tuple[str, float]]:
    if isinstance(value, float):
        yield name, value
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from _numbers(item, f"{name}[{i}]")
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _numbers(item, f"{name}.{key}")
    elif is_dataclass(value):
        for f in fields(value):
            yield from _numbers(getattr(value, f.name), f"{name}.{f.name}")


def _expected(message: str, cls: type, path: str) -> str:
    """What msgspec expected, in words, from its message about the value at ``path`` of a ``cls``."""
    if message.startswith("Invalid enum value"):
        return "one of " + ", ".join(repr(value) for value in _choices(msgspec.inspect.type_info(cls), path))
    missing = re.fullmatch(r"Object missing required field (`.*`)", message)
    if missing:
        return f"a mapping that has the field {missing.group(1)}"
    if message == "Number out of range":
        return "a number of at most 64 bits"
    return message.removeprefix("Expected ")


def _choices(info: msgspec.inspect.Type, path: str) -> list[object]:
    """The values that a type allows, at msgspec error path ``path`` below it."""
    infos = _alternatives(info)
    for part in _PART.findall(path):
        infos = [leaf for info in infos for below in _below(info, part) for leaf in _alternatives(below)]
    return [value for info in infos for value in _values(info)]


def _alternatives(info: msgspec.inspect.Type) -> list[msgspec.inspect.Type]:
    if isinstance(info, msgspec.inspect.Metadata):
        return _alternatives(info.type)
    if isinstance(info, msgspec.inspect.UnionType):
        return [leaf for kind in info.types for leaf in _alternatives(kind)]
    return [info]


def _below(info: msgspec.inspect.Type, part: str) -> list[msgspec.inspect.Type]:
    if isinstance(info, msgspec.inspect.DataclassType):
        return [field.type for field in info.fields if field.name == part]
    if isinstance(info, msgspec.inspect.TupleType):
        return [info.item_types[int(part)]] if part.isdigit() else list(info.item_types)
    if isinstance(info, msgspec.inspect.DictType):
        return [info.value_type]
    item = getattr(info, "item_type", None)
    return [] if item is None else [item]


def _values(info: msgspec.inspect.Type) -> list[object]:
    if isinstance(info, msgspec.inspect.LiteralType):
        return list(info.values)
    return [member.value for member in info.cls] if isinstance(info, msgspec.inspect.EnumType) else []


def _lookup(value: object, path: str) -> object:
    """The value at a msgspec error path such as ``robots[...].start.x``, as far as it can be followed."""
    for part in _PART.findall(path):
        if isinstance(value, Mapping) and part in value:
            value = value[part]
        elif isinstance(value, list | tuple) and part.isdigit():
            value = value[int(part)]
        else:
            break
    return value
