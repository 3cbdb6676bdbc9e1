"""Text for a terminal: colours where it has them, tables whose columns line up, and a line that fits its width."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TextIO

Colour = Literal["plain", "bold", "dim", "green", "red", "cyan"]

_CODES: dict[Colour, str] = {"plain": "", "bold": "1", "dim": "2", "green": "32", "red": "31", "cyan": "36"}


@dataclass(frozen=True)
class Text:
    """A piece of text in one colour."""

    text: str
    colour: Colour = "plain"

    def render(self, colours: bool) -> str:
        code = _CODES[self.colour]
        return f"\x1b[{code}m{self.text}\x1b[0m" if colours and code and self.text else self.text


Cell = Text | str


@dataclass(frozen=True)
class Segment:
    """A part of a line; where the line is too long, those of the highest ``rank`` are left out first."""

    texts: tuple[Text, ...]
    rank: int

    @property
    def width(self) -> int:
        return sum(len(text.text) for text in self.texts)


def has_colours(stream: TextIO) -> bool:
    """Whether to write escape sequences to the stream."""
    return stream.isatty() and "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb"


def fit(segments: Sequence[Segment], columns: int, colours: bool, gap: str = "  ") -> str:
    """The segments in one line of at most ``columns`` characters, in their order, the least important left out."""
    kept = list(segments)
    while len(kept) > 1 and sum(s.width for s in kept) + len(gap) * (len(kept) - 1) > columns:
        kept.remove(max(kept, key=lambda segment: segment.rank))
    line = gap.join("".join(text.render(colours) for text in segment.texts) for segment in kept)
    return line if sum(s.width for s in kept) <= columns else "".join(t.text for t in kept[0].texts)[:columns]


def bar(fraction: float, width: int) -> tuple[Text, Text]:
    """Done and left of a progress bar."""
    done = round(max(0.0, min(1.0, fraction)) * width)
    return Text("━" * done, "green"), Text("─" * (width - done), "dim")


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[Cell]], colours: bool, indent: str = "  ") -> str:
    """A table: the first column to the left, the others to the right, the title above the first."""
    cells = [[cell if isinstance(cell, Text) else Text(cell) for cell in row] for row in rows]
    head = [Text(title, "bold"), *(Text(name, "dim") for name in header)]
    widths = [max(len(row[k].text) for row in [head, *cells] if k < len(row)) for k in range(len(head))]
    widths[0] += len(indent)
    lines = []
    for row, start in [(head, ""), *((row, indent) for row in cells)]:
        padded = [start + _padded(row[0], widths[0] - len(start), colours, left=True)]
        padded += [_padded(cell, widths[k + 1], colours, left=False) for k, cell in enumerate(row[1:])]
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def _padded(cell: Text, width: int, colours: bool, left: bool) -> str:
    fill = " " * (width - len(cell.text))
    return cell.render(colours) + fill if left else fill + cell.render(colours)
