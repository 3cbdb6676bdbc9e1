"""What is printed: tables that line up, a line that lives, bars for long work, and plain text where no terminal is."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.text import Text

from hitchhike_ros.experiments.report.screen import LivingLine, ProgressBars, console, drawn, show, text_of
from hitchhike_ros.experiments.report.tables import Table, mark

TABLE = Table("Title", ["", "a", "b"], [["long name", "1.0", mark(True)], ["x", "22.25", ""]])
NAMED = Table("Boxes", ["box", "off"], [["obs1", "0.02"], ["[2]", "0.10"]], note="One more.")


def terminal(columns: int = 80) -> tuple[Console, io.StringIO]:
    """A console that takes itself for a terminal with colours, and what it writes."""
    file = io.StringIO()
    return Console(file=file, width=columns, force_terminal=True, color_system="standard", highlight=False), file


def test_columns_line_up_under_a_title() -> None:
    assert text_of(TABLE).split("\n") == ["Title            a  b", "  long name    1.0  ✓", "  x          22.25"]


def test_a_first_column_with_a_name_leaves_the_title_a_line_of_its_own() -> None:
    lines = text_of(NAMED).split("\n")
    assert [line.strip() for line in lines] == ["Boxes", "box    off", "obs1  0.02", "[2]   0.10", "One more."]


def test_several_tables_are_a_blank_line_apart() -> None:
    assert text_of(TABLE, NAMED) == f"{text_of(TABLE)}\n\n{text_of(NAMED)}"


def test_marks_are_coloured_on_a_terminal_alone(capsys: pytest.CaptureFixture[str]) -> None:
    screen, file = terminal()
    show(screen, Table("Title", ["", ""], [["good", mark(True)], ["bad", mark(False)]]))
    assert "\x1b[32m✓" in file.getvalue() and "\x1b[31m✗" in file.getvalue()
    show(console(), TABLE)
    assert "\x1b" not in capsys.readouterr().out


def test_a_file_is_wide_whatever_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    file = io.StringIO()
    console(file).print(drawn(Table("T" * 60, ["", "a"], [["x" * 70, "y" * 50]])))
    assert "x" * 70 in file.getvalue() and "y" * 50 in file.getvalue()


def test_a_line_lives_on_a_terminal_and_leaves_nothing() -> None:
    screen, file = terminal()
    with LivingLine(screen) as line:
        for text in ("one", "two"):
            line.show(Text(text), "same")
    shown = file.getvalue()
    assert "one" in shown and "two" in shown
    assert shown.endswith("\x1b[2K")  # the line is wiped
    assert "\x1b[?25h" in shown  # and the cursor is back


def test_elsewhere_there_is_a_line_at_each_change() -> None:
    file = io.StringIO()
    with LivingLine(console(file)) as line:
        for text, change in (("a 1", "a"), ("a 2", "a"), ("b 3", "b")):
            line.show(Text(f"{text}   "), change)
    assert file.getvalue().split("\n") == ["a 1", "b 3", ""]  # without blanks at the end


def test_the_cursor_is_back_after_a_failure_too() -> None:
    screen, file = terminal()
    with pytest.raises(KeyboardInterrupt), LivingLine(screen):
        raise KeyboardInterrupt
    assert file.getvalue().rfind("\x1b[?25h") > file.getvalue().rfind("\x1b[?25l")


def test_long_work_has_a_bar_on_a_terminal() -> None:
    screen, file = terminal()
    with ProgressBars(screen) as progress:
        for step in ("planning", "driving"):
            for done in (1, 2):
                progress(step, done, 2)
    assert "driving" in file.getvalue() and "2/2" in file.getvalue()


@pytest.mark.parametrize(("of", "lines"), [(1, 1), (4, 4), (10, 10), (100, 10), (105, 11)])
def test_elsewhere_a_step_has_a_few_lines(of: int, lines: int) -> None:
    file = io.StringIO()
    with ProgressBars(console(file)) as progress:
        for done in range(1, of + 1):
            progress("step", done, of)
    told = file.getvalue().splitlines()
    assert len(told) == lines
    assert told[-1] == f"step: {of} of {of}"


def test_bars_can_be_shown_again_and_tell_without_being_shown() -> None:
    screen, file = terminal()
    bars = ProgressBars(screen)
    for _ in range(2):
        with bars:
            bars("step", 1, 1)
    bars("outside", 1, 1)
    assert file.getvalue().rstrip().endswith("outside: 1 of 1")
