"""The machines as pictures."""

from __future__ import annotations

import re

import pytest

from hitchhike_ros.commands.draw_machines import MACHINES
from hitchhike_ros.protocol.diagrams import dot
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.machine import arrows
from repository import ROOT

DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", MACHINES)
def test_every_way_of_the_table_is_drawn_and_no_other(name: str) -> None:
    machine = MACHINES[name]
    drawn = set(re.findall(r"^  (\w+) -> (\w+) ", dot(machine), re.MULTILINE))
    assert drawn == {(state.value, row.to.value) for state, row in arrows(machine.ROWS)}
    assert {state.value for state in type(machine.INITIAL)} == {state for way in drawn for state in way}


@pytest.mark.parametrize(
    "arrow",
    [
        'navigating -> offering [label="Request [is offered]"]',
        "navigating -> idle [label=<<i>arrived<br/>given up<br/>is at goal<br/>need not move, need not be exact</i>>]",
        'aligning -> navigating [label="max align", style=dashed]',
        'aligned -> driving [label="max couple [all but late coupled]", style=dashed]',
    ],
)
def test_what_leads_there_is_told(arrow: str) -> None:
    assert f"\n  {arrow};\n" in dot(DriverMachine)


@pytest.mark.parametrize("name", MACHINES)
def test_the_pictures_of_the_documents_are_of_these_tables(name: str) -> None:
    """If not: ``launch_scripts/ros rosrun hitchhike_ros draw_machines``."""
    assert (DOCS / f"{name}.dot").read_text(encoding="utf-8") == dot(MACHINES[name])
    title = f"<title>{MACHINES[name].__name__}</title>"
    assert title in (DOCS / f"{name}.svg").read_text(encoding="utf-8")
