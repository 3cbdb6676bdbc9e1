"""The machines' tables as diagrams, in the language of Graphviz."""

from __future__ import annotations

from typing import Any

from hitchhike_ros.protocol.events import Tick
from hitchhike_ros.protocol.loose_machine import Machine

_HEAD = (
    'graph [rankdir=TB, nodesep=0.45, ranksep=0.5, fontname="sans-serif"]',
    'node [shape=box, style="rounded,filled", fillcolor="#e8f0fa", color="gray40", fontname="sans-serif", fontsize=12]',
    'edge [color="#7a8a9a", fontname="sans-serif", fontsize=9, fontcolor="#333333"]',
)


def dot(machine: type[Machine[Any]], initial: Any) -> str:
    """Every row that leads to another state as an arrow, with what causes it.

    A message or command is named as in the protocol; what the machine sees for itself from tick to tick is named by its
    action, in italics; a timeout, dashed, by its parameter.
    """
    arrows: dict[tuple[str, str, str], list[str]] = {}
    for row in machine.ROWS:
        by_itself = row.event is Tick
        label = row.action.strip("_").replace("_", " ") if by_itself else row.event.__name__
        for state in row.states:
            for target in row.targets:
                if target is not state:
                    key = (state.value, target.value, "italic" if by_itself else "")
                    arrows.setdefault(key, []).append(label)
    for timeout in machine.TIMEOUTS:
        for target in timeout.targets:
            arrows.setdefault((timeout.state.value, target.value, "dashed"), []).append(timeout.limit)
    states = dict.fromkeys(name for key in arrows for name in key[:2])
    lines = [*_HEAD, *(f'{name} [label="{name.replace("_", " ")}"]' for name in states)]
    lines.append(f"{initial.value} [penwidth=2.5]")
    for (state, target, style), labels in arrows.items():
        text = "\\n".join(dict.fromkeys(labels))
        if style == "italic":
            shown = f"label=<<i>{'<br/>'.join(dict.fromkeys(labels))}</i>>"
        else:
            shown = f'label="{text}"' + (", style=dashed" if style else "")
        lines.append(f"{state} -> {target} [{shown}]")
    body = "\n".join(f"  {line};" for line in lines)
    return f"digraph {machine.__name__} {{\n{body}\n}}\n"
