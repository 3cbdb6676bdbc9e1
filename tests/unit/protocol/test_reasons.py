"""Reasons and endings: what is told, and what is understood of it."""

from __future__ import annotations

import pytest

from hitchhike_ros.protocol.reasons import LOCALIZATION_SILENT, NONE, Ending, Reason


@pytest.mark.parametrize(
    ("ending", "text"),
    [
        (NONE, ""),
        (Ending(Reason.ARRIVED), "Goal reached"),
        (Ending(Reason.CANNOT_GO_ON, "no way"), "Navigation failed: no way"),
        (Ending(Reason.CANNOT_GO_ON), "Navigation failed"),
        (Ending(Reason.DRIVER_NOT_FOUND, "Path too short"), "Driver not found (Path too short)"),
        (Ending(Reason.DRIVER_LOST).adding(LOCALIZATION_SILENT), "Driver lost; localization did not answer"),
        (NONE.adding(LOCALIZATION_SILENT), "localization did not answer"),
        (Ending.told("in other words").adding("and more"), "in other words; and more"),
    ],
)
def test_an_ending_is_told_as_text(ending: Ending, text: str) -> None:
    assert str(ending) == text
    assert bool(ending) == bool(text)


@pytest.mark.parametrize("reason", Reason)
def test_a_reason_is_understood_from_its_text(reason: Reason) -> None:
    assert Ending.told(str(reason)) == Ending(reason)


def test_other_words_are_kept() -> None:
    assert Ending.told("Batteries are low") == Ending(Reason.NONE, "Batteries are low")
    assert not Ending.told("")
