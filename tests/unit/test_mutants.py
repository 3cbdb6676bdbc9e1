"""Drawing mutants, running tests against them within bounds, and telling which survived."""

import json
import os
import select
import sys
import textwrap
import threading
from collections import Counter
from pathlib import Path

import pytest

import mutants
from mutant_draw import Mutant, draw, matters, places
from mutants import Bounded, MutantsError, Result, StoppedError, Store

ROOM = f"{mutants.SOURCES}/planning"

SOURCE = '''
"""A module with 1 docstring."""

from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Step:
    """One of 2 classes."""

    count: int | None = 3

    def __repr__(self) -> str:
        return "step" * (4 + 1)


def first(values: list[int] | None, *, least: int = 5) -> int | None:
    """The first of 6 values."""
    for a, b in zip(values or [], range(7), strict=True):
        if a + b >= least and not b == 8:
            return a
    raise ValueError(f"none of {least + 9}")
'''


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A folder with one source file and its test in the layout of this repository."""
    for folder, name, text in (
        (ROOM, "first.py", SOURCE),
        (f"{mutants.TESTS}/planning", "test_first.py", ""),
        (f"{mutants.TESTS}/planning/deep", "test_else.py", ""),
    ):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / name).write_text(text, encoding="utf-8")
    return tmp_path


def that_matter() -> list[Mutant]:
    return [mutant for place in places("first.py", SOURCE) for mutant in place if matters(SOURCE, mutant)]


def test_only_what_a_run_depends_on_is_changed() -> None:
    lines = SOURCE.splitlines()
    assert {lines[mutant.line - 1].strip() for mutant in that_matter()} == {
        "@dataclass(frozen=True, eq=False)",
        "count: int | None = 3",
        "def first(values: list[int] | None, *, least: int = 5) -> int | None:",
        "for a, b in zip(values or [], range(7), strict=True):",
        "if a + b >= least and not b == 8:",
    }


def test_every_kind_of_change_of_a_line_is_found() -> None:
    number = 1 + SOURCE.splitlines().index("        if a + b >= least and not b == 8:")
    here = [mutant.source(SOURCE) for mutant in that_matter() if mutant.line == number]
    changed = sorted(text.splitlines()[number - 1].replace(" ", "") for text in here)
    binary = [f"ifa{sign}b>=leastandnotb==8:" for sign in ("-", "*", "/", "//", "%", "**")]
    order = [f"ifa+b{sign}leastandnotb==8:" for sign in ("<", "<=", ">", "==", "!=")]
    equal = [f"ifa+b>=leastandnotb{sign}8:" for sign in ("<", "<=", ">", ">=", "!=")]
    rest = [
        "ifa+b>=leastornotb==8:",
        "ifa+b>=leastandb==8:",
        "ifa+b>=leastandnotb==9:",
        "ifa+b>=leastandnotb==7:",
        "ifnota+b>=leastandnotb==8:",
    ]
    assert changed == sorted(binary + order + equal + rest)


def test_each_place_counts_once(repository: Path) -> None:
    drawn = draw(repository, [f"{ROOM}/first.py"], 100, 0)
    # The decorator; 3; 5; the loop, `or` and 7; +, >=, `and`, `not`, ==, 8 and the condition.
    assert Counter(mutant.line for mutant in drawn) == {7: 1, 11: 1, 17: 1, 19: 3, 20: 7}


def test_the_seed_decides(repository: Path) -> None:
    paths = [f"{ROOM}/first.py"]
    assert draw(repository, paths, 5, 1) == draw(repository, paths, 5, 1)
    assert len({tuple(draw(repository, paths, 5, seed)) for seed in range(10)}) > 5
    assert draw(repository, paths, 5, 1) == draw(repository, paths, 13, 1)[:5]


def test_what_is_no_program_is_no_mutant() -> None:
    # Cosmic Ray takes the star of the signature for a product.
    text = "def f(*, a): return a\n"
    mutant = Mutant("f.py", "ReplaceBinaryOperator_Mul_Add", 0, 1)
    assert "+" in mutant.source(text)
    assert not matters(text, mutant)


def test_a_place_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="no place 1"):
        Mutant("f.py", "AddNot", 1, 1).source("if a: pass\n")


def test_rooms_need_sources_and_tests(repository: Path) -> None:
    assert mutants.sources(repository, ["planning"]) == [f"{ROOM}/first.py"]
    with pytest.raises(MutantsError, match="control is no room"):
        mutants.sources(repository, ["planning", "control"])


def test_the_test_that_mirrors_the_file_comes_first(repository: Path) -> None:
    tests = f"{mutants.TESTS}/planning"
    assert mutants.tests_of(repository, f"{ROOM}/first.py") == [f"{tests}/test_first.py", tests]
    assert mutants.tests_of(repository, f"{ROOM}/deep/else.py") == [f"{tests}/deep/test_else.py", tests]
    assert mutants.tests_of(repository, f"{ROOM}/other.py") == [tests]


def python(code: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(code)]


@pytest.mark.parametrize("status", [0, 1, 5])
def test_a_command_tells_its_status_and_what_it_printed(tmp_path: Path, status: int) -> None:
    code = f"import os, sys; print(os.environ['A'], os.getcwd()); sys.exit({status})"
    assert Bounded().run(python(code), tmp_path, {"A": "b"}, 60.0) == (status, f"b {tmp_path}\n")


def test_what_does_not_end_is_ended(tmp_path: Path) -> None:
    assert Bounded().run(python("while True: pass"), tmp_path, {}, 0.2) == (None, "")


def test_to_stop_ends_all_that_a_command_started(tmp_path: Path) -> None:
    """Whoever is left would keep the pipe open, and its end would not be read."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    code = f"""
        import subprocess, sys
        with open({str(pipe)!r}, "w") as file:
            subprocess.Popen([sys.executable, "-c", "print('here', flush=True)\\nwhile True: pass"], stdout=file)
        while True: pass
    """
    bounded = Bounded()
    stopped: list[StoppedError] = []

    def run() -> None:
        try:
            bounded.run(python(code), tmp_path, {}, 300.0)
        except StoppedError as error:
            stopped.append(error)

    thread = threading.Thread(target=run)

    def read() -> bytes:
        assert select.select([reader], [], [], 60.0)[0]
        return os.read(reader, 100)

    thread.start()
    assert read() == b"here\n"
    bounded.stop()
    assert read() == b""
    os.close(reader)
    thread.join(60.0)
    assert len(stopped) == 1


def test_memory_is_bounded(tmp_path: Path) -> None:
    status, output = Bounded().run(python(f"bytearray({mutants._MEMORY_BYTES})"), tmp_path, {}, 60.0)
    assert status == 1
    assert "MemoryError" in output


def test_what_was_stopped_starts_no_more(tmp_path: Path) -> None:
    bounded = Bounded()
    bounded.stop()
    with pytest.raises(StoppedError):
        bounded.run(python("pass"), tmp_path, {}, 60.0)


@pytest.mark.parametrize(
    ("status", "output", "by"),
    [
        (0, "3 passed", ""),
        (None, "", "time limit"),
        (-11, "", "SIGSEGV"),
        (
            1,
            "..F\nFAILED tests/unit/planning/test_first.py::test_a - assert 1\n1 failed",
            "planning/test_first.py::test_a",
        ),
        (2, "ERROR tests/unit/core/test_a.py - NameError\n", "core/test_a.py"),
        (3, "INTERNALERROR>", "exit status 3"),
    ],
)
def test_who_noticed(status: int | None, output: str, by: str) -> None:
    assert mutants.killer(status, output) == by


def results(repository: Path) -> list[Result]:
    drawn = draw(repository, [f"{ROOM}/first.py"], 8, 0)
    return [Result(mutant, n != 3, "" if n == 3 else "test", float(n)) for n, mutant in enumerate(drawn)]


def test_results_are_kept_and_half_a_line_is_left_out(repository: Path, tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    store = Store(path)
    assert store.load() == []
    kept = results(repository)
    for result in kept:
        store.add(result)
    path.write_text(path.read_text(encoding="utf-8")[:-5], encoding="utf-8")
    assert store.load() == kept[:-1]


class FakeClone:
    """Judges without running anything."""

    def __init__(self, fails_at: int | None = None) -> None:
        self.tests = Bounded()
        self.judged: list[tuple[Mutant, float]] = []
        self._fails_at = fails_at

    def judge(self, mutant: Mutant, limit_s: float) -> Result:
        if len(self.judged) == self._fails_at:
            raise MutantsError("no test ran")
        self.judged.append((mutant, limit_s))
        return Result(mutant, True, "test", 1.0)


def test_every_mutant_is_judged_once(repository: Path) -> None:
    drawn = draw(repository, [f"{ROOM}/first.py"], 9, 0)
    clones = [FakeClone(), FakeClone()]
    done: list[Result] = []
    mutants.judge_all(clones, drawn, {"planning": 7.0}, done.append)  # type: ignore[arg-type]
    assert {result.mutant for result in done} == set(drawn)
    judged = [entry for clone in clones for entry in clone.judged]
    assert sorted(judged, key=str) == sorted([(mutant, 7.0) for mutant in drawn], key=str)


def test_a_clone_that_cannot_go_on_ends_the_run(repository: Path) -> None:
    drawn = draw(repository, [f"{ROOM}/first.py"], 9, 0)
    done: list[Result] = []
    with pytest.raises(MutantsError, match="no test ran"):
        mutants.judge_all([FakeClone(fails_at=2)], drawn, {"planning": 7.0}, done.append)  # type: ignore[list-item]
    assert len(done) == 2


def test_the_report_shows_survivors_and_the_share(repository: Path) -> None:
    judged = results(repository)
    survivor = judged[3].mutant
    text = mutants.report(judged, lambda path: (repository / path).read_text(encoding="utf-8"))
    assert text.count("survivor ") == 1
    lines = text.splitlines()
    assert lines[0] == f"survivor 1: {survivor.operator}"
    removed = SOURCE.splitlines()[survivor.line - 1]
    assert f"-{removed}" in lines
    assert lines[-2].split() == ["planning", "8", "7", "1", "87.5%"]
    assert lines[-1] == "killed 7 of 8: 87.5 % (bound 88 %)"


def test_json_has_the_figure_with_its_bound_and_every_mutant(repository: Path) -> None:
    judged = results(repository)
    value = mutants.as_json(judged, "abc", 4, lambda path: (repository / path).read_text(encoding="utf-8"))
    assert json.loads(json.dumps(value)) == value
    assert value["figures"] == [
        {
            "name": "mutants killed",
            "value": 87.5,
            "unit": "%",
            "bound": 88.0,
            "better": "higher",
            "peer": None,
            "ok": False,
        }
    ]
    assert value["seed"] == 4
    listed = value["mutants"]
    assert isinstance(listed, list)
    assert [entry["killed"] for entry in listed] == [True, True, True, False, True, True, True, True]
    assert all(entry["diff"].startswith("--- ") for entry in listed)


def test_none_killed_of_none() -> None:
    assert mutants.share_percent([]) == 0.0
