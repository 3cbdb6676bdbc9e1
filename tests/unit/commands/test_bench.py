"""Names of benchmarks, of one word or two."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from hitchhike_ros.commands import bench
from hitchhike_ros.experiments.bench.registry import Findings


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["fuzz", "files"], ["fuzz files"]),
        (["fuzz files"], ["fuzz files"]),
        (["planning", "fuzz", "files", "faults"], ["planning", "fuzz files", "faults"]),
        (["fuzz"], None),
        (["files"], None),
        (["fuzz", "planning"], None),
        ([], None),
    ],
)
def test_names(words: list[str], names: list[str] | None, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[str] = []

    class Measured:
        @staticmethod
        def run(*_: object) -> Findings:
            return Findings([])

    monkeypatch.setattr(bench, "load", lambda name: loaded.append(name) or Measured)
    result = CliRunner().invoke(bench.command, words, standalone_mode=True)
    assert result.exit_code == (0 if names else 2), result.output
    assert loaded == (names or [])
    if words and not names:
        assert "'fuzz files'" in result.output
