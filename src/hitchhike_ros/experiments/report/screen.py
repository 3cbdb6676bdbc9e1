"""What goes to a terminal: tables, one line that lives, and bars for long work. In a file the same is plain text."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from types import TracebackType
from typing import TextIO

import rich.table
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.live import Live
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from hitchhike_ros.experiments.report.tables import BAD, GOOD, Table

_FILE_COLUMNS = 160  # of what is no terminal
_INDENT = "  "
_STYLES = {GOOD: "green", BAD: "red"}
_GAP = 2  # between columns, and between the parts of a line
_LINES = 10  # for a step, where there is no bar


def console(stream: TextIO | None = None) -> Console:
    """A console on ``stream``, by default standard output: with colours and its width where that is a terminal."""
    stream = stream or sys.stdout
    width = None if stream.isatty() else _FILE_COLUMNS
    return Console(file=stream, width=width, highlight=False, markup=False, emoji=False)


def drawn(table: Table) -> rich.table.Table:
    """A table as a terminal shows it. Where its first column has no name, its title stands there."""
    heads = list(table.header)
    shown = rich.table.Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0), header_style="dim", caption_style="dim")
    shown.caption = table.note or None
    shown.caption_justify = "left"
    indent = ""
    if heads[0]:
        shown.title, shown.title_style, shown.title_justify = table.title, "bold", "left"
    else:
        heads[0], indent = table.title, _INDENT
    shown.add_column(Text(heads[0], "dim" if table.header[0] else "bold"))
    for head in heads[1:]:
        shown.add_column(Text(head), justify="right", no_wrap=True)
    for row in table.rows:
        shown.add_row(indent + row[0], *(Text(cell, _STYLES.get(cell, "")) for cell in row[1:]))
    return shown


def show(screen: Console, *tables: Table) -> None:
    """Print tables, a blank line after each."""
    for table in tables:
        _print(screen, drawn(table))
        screen.print()


def text_of(*tables: Table) -> str:
    """Tables as plain text for a file, a blank line between two."""
    file = io.StringIO()
    show(console(file), *tables)
    return file.getvalue().rstrip()


def _print(screen: Console, what: RenderableType) -> None:
    """Print, in a file without the blanks that fill lines on a terminal."""
    if screen.is_terminal:
        screen.print(what)
        return
    with screen.capture() as printed:
        screen.print(what)
    for line in printed.get().splitlines():
        screen.out(line.rstrip(), highlight=False)


@dataclass(frozen=True)
class Part:
    """A part of a line. Where the line is too long, the parts of the highest ``rank`` are left out first."""

    shown: RenderableType
    rank: int


@dataclass(frozen=True)
class FittedLine:
    """Parts side by side in one line that never wraps."""

    parts: Sequence[Part]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = {id(part): Measurement.get(console, options, part.shown).maximum for part in self.parts}
        kept = list(self.parts)
        while len(kept) > 1 and sum(widths[id(p)] + _GAP for p in kept) - _GAP > options.max_width:
            kept.remove(max(kept, key=lambda part: part.rank))
        grid = rich.table.Table.grid(padding=(0, _GAP, 0, 0))
        for part in kept:
            grid.add_column(no_wrap=True, overflow="crop", min_width=min(widths[id(part)], options.max_width))
        grid.add_row(*(part.shown for part in kept))
        yield grid


def _lives(console: Console) -> bool:
    """Whether what was written can be written over."""
    return console.is_terminal and not console.is_dumb_terminal


def passing(console: Console, text: str) -> AbstractContextManager[object]:
    """A text that stands on a terminal as long as the context lasts; elsewhere nothing."""
    return console.status(text) if _lives(console) else nullcontext()


class LivingLine:
    """One line that is rewritten on a terminal; elsewhere a line at each change. A context that shows it."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, auto_refresh=False, transient=True) if _lives(console) else None
        self._shown = ""

    def __enter__(self) -> LivingLine:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_exc: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, line: RenderableType, change: str) -> None:
        """Show the line as it is now. ``change`` is what makes it worth a line of its own where nothing lives."""
        if self._live is not None:
            self._live.update(line, refresh=True)
        elif change != self._shown:
            _print(self._console, line)
        self._shown = change


class ProgressBars:
    """Says how far long work is: a bar on a terminal, while this is entered; elsewhere a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bars: Progress | None = None
        self._steps: dict[str, int] = {}

    def __enter__(self) -> ProgressBars:
        if _lives(self._console):
            columns = (
                *(TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn()),
                TimeRemainingColumn(),
            )
            self._bars = Progress(*columns, console=self._console, transient=True)
            self._bars.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _exc: BaseException | None, _where: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()
        self._bars, self._steps = None, {}

    def __call__(self, step: str, done: int, of: int) -> None:
        """``done`` of ``of`` parts of a step are done; the step that was shown before is over."""
        if self._bars is None:
            if of <= _LINES or done == of or done % (of // _LINES) == 0:
                self._console.print(f"{step}: {done} of {of}", soft_wrap=True)
            return
        if step not in self._steps:
            for task in self._steps.values():
                self._bars.remove_task(task)  # type: ignore[arg-type]
            self._steps = {step: self._bars.add_task(step, total=of)}
        self._bars.update(self._steps[step], completed=done, total=of)  # type: ignore[arg-type]
