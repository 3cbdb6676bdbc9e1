"""The machines' tables as diagrams, in the language of Graphviz."""

from __future__ import annotations

from typing import Any

from hitchhike_ros.protocol.events import Tick
from hitchhike_ros.protocol.machine import Deadline, Machine, Row, arrows

_HEAD = (
    'graph [rankdir=TB, nodesep=0.45, ranksep=0.5, fontname="sans-serif"]',
    'node [shape=box, style="rounded,filled", fillcolor="#e8f0fa", color="gray40", fontname="sans-serif", fontsize=12]',
    'edge [color="#7a8a9a", fontname="sans-serif", fontsize=9, fontcolor="#333333"]',
)

Arrow = tuple[str, str, str]
"""From which state to which, and in which style."""


def dot(machine: type[Machine[Any, Any]]) -> str:
    """Every row that leads to a state as an arrow, with what causes it and its guards in brackets.

    A message or command is named as in the protocol. What the machine sees for itself from tick to tick, in italics, is
    told by the guards alone; a deadline, dashed, is named by its limit.
    """
    labels: dict[Arrow, list[str]] = {}
    for state, row in arrows(machine.ROWS):
        style = "dashed" if isinstance(row.on, Deadline) else "italic" if row.on is Tick else ""
        labels.setdefault((state.value, row.to.value, style), []).append(label(row))
    return _drawn(machine.__name__, machine.INITIAL.value, labels)


def label(row: Row) -> str:
    """What leads along the row's arrow."""
    guards = ", ".join(guard.__name__.replace("_", " ") for guard in row.when)
    if row.on is Tick:
        return guards
    cause = row.on.name.replace("_", " ") if isinstance(row.on, Deadline) else row.on.__name__
    return f"{cause} [{guards}]" if guards else cause


def _drawn(name: str, initial: str, labels: dict[Arrow, list[str]]) -> str:
    states = dict.fromkeys(state for arrow in labels for state in arrow[:2])
    lines = [*_HEAD, *(f'{state} [label="{state.replace("_", " ")}"]' for state in states)]
    lines.append(f"{initial} [penwidth=2.5]")
    for (state, target, style), texts in labels.items():
        if style == "italic":
            shown = f"label=<<i>{'<br/>'.join(dict.fromkeys(texts))}</i>>"
        else:
            text = "\\n".join(dict.fromkeys(texts))
            shown = f'label="{text}"' + (", style=dashed" if style else "")
        lines.append(f"{state} -> {target} [{shown}]")
    body = "\n".join(f"  {line};" for line in lines)
    return f"digraph {name} {{\n{body}\n}}\n"
