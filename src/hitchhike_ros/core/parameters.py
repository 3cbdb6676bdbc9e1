"""Parameter files: YAML with one section a component, each checked into that component's frozen dataclass."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from hitchhike_ros.core.errors import InputFileError, ParameterError

T = TypeVar("T")


def read_yaml(path: Path | str, error: type[InputFileError] = ParameterError) -> dict[str, Any]:
    """The mapping in a YAML file; raises ``error`` when it is missing, malformed or not a mapping."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        reason = getattr(exc, "strerror", None) or "not UTF-8 text"
        raise error(path, "", reason, "a readable YAML file") from exc
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as exc:
        raise error(path, "", str(exc).replace("\n", " "), "valid YAML") from exc
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
        match = re.search(r"^(.*?)(?: - at `\$\.?(.*?)`)?$", str(exc), re.DOTALL)
        expected, inner = (match.group(1), match.group(2) or "") if match else (str(exc), "")
        expected = expected.removeprefix("Expected ")
        name = ".".join(part for part in (field, inner) if part)
        raise error(file, name, _lookup(value, inner), expected) from exc


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
    return convert(merged, cls, "private parameters" if overrides else (file or "defaults"), section)


def _lookup(value: object, path: str) -> object:
    """The value at a msgspec error path such as ``robots[...].start.x``, as far as it can be followed."""
    for part in re.findall(r"[^.\[\]]+", path):
        if isinstance(value, Mapping) and part in value:
            value = value[part]
        else:
            break
    return value
