"""Files that went wrong: seeds say which, and a reader that breaks a rule is noticed."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.core.errors import MapFileError
from hitchhike_ros.experiments.bench import fuzz_files
from hitchhike_ros.experiments.bench.fuzz_files import BlockResult, fuzz_block
from hitchhike_ros.experiments.bench.mutations import MAX_BYTES, mutate, mutate_png
from hitchhike_ros.experiments.bench.registry import Options
from repository import ROOT


def test_the_first_seeds_break_no_rule() -> None:
    result = fuzz_block(ROOT, range(220))
    assert result.broken == ()
    assert (result.cases, 0 < result.read < 220) == (220, True)
    assert 0.0 < result.slowest_s < 1.0


def raises(error: Exception):
    def read(_path: Path) -> None:
        raise error

    return read


def spends(_path: Path) -> None:
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass


def fills(_path: Path) -> None:
    np.ones(100_000_000, np.uint8)  # more than malloc ever keeps


@pytest.mark.parametrize(
    ("read", "rule"),
    [
        (raises(KeyError("x")), "KeyError"),
        (raises(MapFileError("a", "b", 1, "c")), None),
        (raises(RecursionError()), "RecursionError"),
        (spends, "s of CPU"),
        (fills, "MB"),
    ],
)
def test_what_breaks_a_rule_is_noticed(read, rule, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz_files, "load_map", read)
    monkeypatch.setattr(fuzz_files, "_MAX_CPU_S", 0.1)
    monkeypatch.setattr(fuzz_files, "_MAX_MB", 20.0)
    monkeypatch.setattr(fuzz_files, "_Cases", OneCase)
    (*broken,) = fuzz_block(ROOT, range(7, 8)).broken
    assert [(case.seed, case.kind) for case in broken] == ([(7, "map")] if rule else [])
    assert all(rule in case.rule for case in broken)


class OneCase:
    def __init__(self, _package: Path, _folder: Path) -> None: ...

    def case(self, _seed: int):
        return "map", lambda: fuzz_files.load_map(Path("map.yaml"))


def test_what_does_not_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(_path: Path) -> None:
        while True:
            pass

    monkeypatch.setattr(fuzz_files, "load_map", hang)
    monkeypatch.setattr(fuzz_files, "_GIVE_UP_S", 0.1)
    monkeypatch.setattr(fuzz_files, "_Cases", OneCase)
    (broken,) = fuzz_block(ROOT, range(1)).broken
    assert "TimeoutError" in broken.rule


def test_a_seed_makes_the_same_file_again() -> None:
    original = (ROOT / "maps" / "p17_exp1.yaml").read_bytes()
    made = [mutate(original, [original, b"<robot/>"], np.random.default_rng(seed)) for seed in range(200)]
    assert made == [mutate(original, [original, b"<robot/>"], np.random.default_rng(seed)) for seed in range(200)]
    assert len(set(made)) > 190
    assert max(map(len, made)) <= MAX_BYTES
    assert mutate_png(np.random.default_rng(3)) == mutate_png(np.random.default_rng(3))


def test_every_broken_case_is_said_with_the_command_that_repeats_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = (
        BlockResult(3, 1, 0.5, 10.0, ()),
        BlockResult(2, 0, 1.5, 20.0, (fuzz_files.Broken(4, "urdf", "1.50 s of CPU, 20 MB"),)),
    )
    monkeypatch.setattr(fuzz_files, "run_all", lambda *_: results)
    findings = fuzz_files.run(Options(ROOT, ROOT, tmp_path / "out", seeds=5), lambda *_: None)
    figures = {figure.name: (figure.value, figure.ok) for figure in findings.figures}
    assert figures["files: cases that broke a rule"] == (1, False)
    assert figures["files: slowest case"] == (1.5, False)
    assert figures["files: largest case"] == (20.0, True)
    assert "bench fuzz files --seed 4 --seeds 1" in capsys.readouterr().err
    assert '"rule": "1.50 s of CPU, 20 MB"' in (tmp_path / "out" / "fuzz_files.json").read_text()
