"""YAML, read in bounded time and memory, and refused where it says two things or readers of YAML disagree.

PyYAML's own loaders take the last of two equal keys, read 010 as 8 and 1:30 as 90, follow nesting until Python's stack
ends, and multiply what aliases name. Here the parser's events (libyaml) are counted while the values are built.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import yaml

MAX_BYTES = 1_000_000
MAX_DEPTH = 32
MAX_VALUES = 50_000

_NULL = re.compile(r"|~|null|Null|NULL")
_BOOL = {
    spelling: value
    for value, words in ((True, ("true", "yes", "on")), (False, ("false", "no", "off")))
    for word in words
    for spelling in (word, word.capitalize(), word.upper())
}
_INT = re.compile(r"[-+]?(?:0|[1-9][0-9]{0,18}|0x[0-9a-fA-F]{1,16})")
_FLOAT = re.compile(r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_NOT_FINITE = {
    f"{sign}.{spelling}": value
    for sign, value in (("", math.inf), ("+", math.inf), ("-", -math.inf))
    for spelling in ("inf", "Inf", "INF")
} | {f".{spelling}": math.nan for spelling in ("nan", "NaN", "NAN")}
_TAG = "tag:yaml.org,2002:"
_TYPES: dict[str, tuple[type, ...]] = {"int": (int,), "float": (int, float), "bool": (bool,), "null": (type(None),)}
# libyaml takes tabs between tokens, but for these places, where yaml-cpp takes them too.
_TABS = re.compile(r"^[ \t]*\t[ \t]*(?=#|\r?$)|(?<=-)\t+(?=[^\s#])", re.MULTILINE)


class YamlError(Exception):
    """The text cannot be used: ``field`` (dotted, may be empty) has ``value``, and ``expected`` says what was."""

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(f"{field} is {value!r}, expected {expected}")
        self.field, self.value, self.expected = field, value, expected


def parse_yaml(text: str) -> Any:
    """The value of a YAML document. Mappings have their keys as text, and ``<<`` merges.

    Scalars that YAML 1.1 and 1.2 read differently, as 010, 1:30, 1_000, 1e3 or a date, stay text, and whoever expects
    a number of them decides.

    Raises:
        YamlError: it is no valid YAML, has a key twice or a tag whose value does not fit, or is too large.
    """
    return _Builder(text, _resolved, merges=True).build()


def parse_yaml_text(text: str) -> Any:
    """As :func:`parse_yaml`, all scalars as the text that they are, None for an empty one, as yaml-cpp hands them out.

    Tags mean nothing, and ``<<`` is a key as any other.
    """
    return _Builder(text, _as_text, merges=False).build()


def _resolved(event: yaml.ScalarEvent) -> object:
    value = _implicit(event.value) if event.implicit[0] else event.value
    tag = event.tag.removeprefix(_TAG) if event.tag and event.tag != "!" else ""
    if not tag:
        return value
    if tag == "str":
        return event.value
    value = _implicit(event.value)
    if tag not in _TYPES or type(value) not in _TYPES[tag]:
        raise ValueError(f"a value that fits its tag {event.tag!r}, of int, float, bool, null or str")
    return value


def _implicit(text: str) -> object:
    if _NULL.fullmatch(text):
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _INT.fullmatch(text):
        return int(text, 16 if "x" in text else 10)
    return float(text) if _FLOAT.fullmatch(text) else _NOT_FINITE.get(text, text)


def _as_text(event: yaml.ScalarEvent) -> object:
    return None if not event.style and _NULL.fullmatch(event.value) else event.value


class _Builder:
    """Builds the value of one document from the events of the parser, and counts what it builds."""

    def __init__(self, text: str, scalar: Callable[[yaml.ScalarEvent], object], merges: bool) -> None:
        self._events: Iterator[Any] = yaml.parse(_TABS.sub(_spaces, text), Loader=yaml.CSafeLoader)
        self._scalar, self._merges = scalar, merges
        self._anchors: dict[str, tuple[object, int]] = {}
        self._values = 0

    def build(self) -> object:
        try:
            next(self._events)  # the stream starts
            if isinstance(next(self._events), yaml.StreamEndEvent):
                return None
            value = self._value(next(self._events), "", 0)
            next(self._events)  # the document ends
            if not isinstance(next(self._events), yaml.StreamEndEvent):
                raise YamlError("", "more than one document", "a single one")
        except yaml.YAMLError as exc:
            raise YamlError("", str(exc).replace("\n", " "), "valid YAML") from exc
        return value

    def _value(self, event: Any, field: str, depth: int) -> object:
        before = self._values
        self._count(1, event)
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                raise YamlError(field, f"*{event.anchor}", "the alias of a value that stands completely before it")
            value, size = self._anchors[event.anchor]
            self._count(size, event)
            return value
        if isinstance(event, yaml.ScalarEvent):
            try:
                value = self._scalar(event)
            except ValueError as exc:
                raise YamlError(field, event.value, str(exc)) from exc
        else:
            if depth >= MAX_DEPTH:
                raise YamlError("", f"nested deeper at line {_line(event)}", f"at most {MAX_DEPTH} levels")
            known = f"{_TAG}{'seq' if isinstance(event, yaml.SequenceStartEvent) else 'map'}"
            if self._merges and event.tag not in (None, "!", known):
                raise YamlError(field, f"tagged {event.tag}", "a list or a mapping without a tag")
            build = self._sequence if isinstance(event, yaml.SequenceStartEvent) else self._mapping
            value = build(field, depth)
        if event.anchor:
            self._anchors[event.anchor] = value, self._values - before
        return value

    def _sequence(self, field: str, depth: int) -> list[object]:
        items: list[object] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._value(event, f"{field}[{len(items)}]", depth + 1))
        return items

    def _mapping(self, field: str, depth: int) -> dict[str, object]:
        mapping: dict[str, object] = {}
        merged: list[object] = []
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key = event.value if isinstance(event, yaml.ScalarEvent) else None
            if key is None:
                key = self._value(event, field, depth + 1)
                if not isinstance(key, str):
                    raise YamlError(field, f"a key at line {_line(event)} that is no text", "names as keys")
            elif event.anchor:
                self._anchors[event.anchor] = key, 1
            name = f"{field}.{key}" if field else key
            value = self._value(next(self._events), name, depth + 1)
            if self._merges and key == "<<":
                merged.append(value)
            elif key in mapping:
                raise YamlError(name, mapping[key], f"one value; line {_line(event)} has the same key again")
            else:
                mapping[key] = value
        for value in merged:
            for below in value if isinstance(value, list) else [value]:
                if not isinstance(below, dict):
                    raise YamlError(f"{field}.<<" if field else "<<", below, "a mapping to merge, or a list of them")
                for key, item in below.items():
                    mapping.setdefault(key, item)
        return mapping

    def _count(self, values: int, event: Any) -> None:
        self._values += values
        if self._values > MAX_VALUES:
            raise YamlError("", f"too large at line {_line(event)}", f"at most {MAX_VALUES} values, aliases counted")


def _spaces(match: re.Match[str]) -> str:
    return " " * len(match.group())


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1
