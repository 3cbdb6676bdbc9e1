"""The machines as pictures."""

from __future__ import annotations

import re

import pytest

from hitchhike_ros.commands.draw_machines import MACHINES
from hitchhike_ros.protocol.diagrams import dot
from repository import ROOT

DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", MACHINES)
def test_every_way_of_the_table_is_drawn_and_no_other(name: str) -> None:
    machine, initial = MACHINES[name]
    drawn = set(re.findall(r"^  (\w+) -> (\w+) ", dot(machine, initial), re.MULTILINE))
    ways = {(s.value, t.value) for row in machine.ROWS for s in row.states for t in row.targets if s is not t}
    ways |= {(timeout.state.value, target.value) for timeout in machine.TIMEOUTS for target in timeout.targets}
    assert drawn == ways
    assert {state.value for state in type(initial)} == {state for way in drawn for state in way}


@pytest.mark.parametrize("name", MACHINES)
def test_what_leads_there_is_told(name: str) -> None:
    machine, initial = MACHINES[name]
    text = dot(machine, initial)
    for timeout in machine.TIMEOUTS:
        arrow = f'{timeout.state.value} -> {timeout.targets[0].value} [label="{timeout.limit}", style=dashed]'
        assert arrow in text


@pytest.mark.parametrize("name", MACHINES)
def test_the_pictures_of_the_documents_are_of_these_tables(name: str) -> None:
    """If not: ``launch_scripts/ros rosrun hitchhike_ros draw_machines``."""
    assert (DOCS / f"{name}.dot").read_text(encoding="utf-8") == dot(*MACHINES[name])
    title = f"<title>{MACHINES[name][0].__name__}</title>"
    assert title in (DOCS / f"{name}.svg").read_text(encoding="utf-8")
