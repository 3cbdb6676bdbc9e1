"""What an operator typed, from its file and beside another run's."""

from __future__ import annotations

from pathlib import Path

import pytest

from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.experiments.scoring.operator_counts import (
    NAME,
    OperatorCounts,
    count_figures,
    load_counts,
    share_figures,
)


def test_the_file_of_the_operator_is_read_and_more_than_is_wanted_is_ignored(tmp_path: Path) -> None:
    (tmp_path / NAME).write_text('{"keys": 3, "commands": 2, "bytes": 99, "completed": true, "robots": {}}\n')
    counts = load_counts(tmp_path)
    assert counts == OperatorCounts(3, 2, 99, True)
    assert [(f.name, f.value) for f in count_figures(counts)] == [
        ("operator_keys", 3.0),
        ("operator_commands", 2.0),
        ("operator_bytes", 99.0),
    ]


def test_nobody_teleoperated(tmp_path: Path) -> None:
    assert load_counts(tmp_path) is None


@pytest.mark.parametrize("text", ["", "{", '{"keys": "many", "commands": 2, "bytes": 9, "completed": true}'])
def test_a_file_that_is_none_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / NAME).write_text(text)
    with pytest.raises(InputFileError, match=NAME):
        load_counts(tmp_path)


@pytest.mark.parametrize(("commands", "holds"), [(50, True), (51, False)])
def test_half_the_commands_is_the_bound(commands: int, holds: bool) -> None:
    figure, _ = share_figures(OperatorCounts(1, commands, 40, True), OperatorCounts(1, 100, 100, True))
    assert (figure.value, figure.ok) == (commands / 100, holds)


def test_without_commands_there_is_no_share() -> None:
    assert [f.ok for f in share_figures(OperatorCounts(0, 1, 1, True), OperatorCounts(0, 0, 0, True))] == [False, False]
