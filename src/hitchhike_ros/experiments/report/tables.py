"""Tables as plain values; :mod:`screen` and the HTML report draw them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

GOOD, BAD = "✓", "✗"
"""Cells that are drawn in green and red."""


@dataclass(frozen=True)
class Table:
    """A table of texts: the first column to the left, the others to the right. ``note`` stands under it.

    ``header`` names every column; a table whose first column needs no name has "" there.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def mark(ok: bool | None) -> str:
    """The cell for a bound that holds or not; empty where there is none."""
    return "" if ok is None else GOOD if ok else BAD
