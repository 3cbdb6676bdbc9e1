"""The award ledger: every ride is credited once and none is lost, whatever is repeated, restarted or killed."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchhike_ros.commands import awards
from hitchhike_ros.core.errors import CreditError, LedgerError, LedgerFormatError
from hitchhike_ros.protocol.award_ledger import AwardLedger, Credit, Total, totals

RIDE = Credit("p3dx", "turtlebot", "turtlebot-1-12.3", 20.4, 8.16, 1.7e9)
METRES = st.floats(0.0, 1e6)
NAME = st.text(min_size=1, max_size=8)
CREDITS = st.lists(st.builds(Credit, NAME, NAME, NAME, METRES, METRES, METRES), max_size=8, unique_by=lambda c: c.key)


@pytest.fixture
def ledger(tmp_path: Path) -> AwardLedger:
    return AwardLedger(tmp_path / "awards.sqlite")


def in_order(credits: list[Credit]) -> list[Credit]:
    return sorted(credits, key=lambda c: (c.time, c.driver, c.ride_id, c.hitchhiker))


def test_a_ride_is_credited_once(ledger: AwardLedger) -> None:
    assert ledger.credit(RIDE)
    assert not ledger.credit(RIDE)
    assert not ledger.credit(replace(RIDE, ride_m=1.0, points=0.4, time=1.8e9))
    assert ledger.credits() == [RIDE]


@pytest.mark.parametrize("change", [{"driver": "p3dx2"}, {"hitchhiker": "robot1"}, {"ride_id": "turtlebot-2-99.9"}])
def test_another_ride_is_another_credit(ledger: AwardLedger, change: dict[str, str]) -> None:
    other = replace(RIDE, time=1.7e9 + 1, **change)
    assert ledger.credit(RIDE)
    assert ledger.credit(other)
    assert ledger.credits() == [RIDE, other]


@settings(max_examples=40)
@given(CREDITS, st.data())
def test_repeated_reordered_and_restarted(credits: list[Credit], data: st.DataObject) -> None:
    """Every credit arrives at least once, some again and changed, in any order, before and after restarts."""
    again = data.draw(st.lists(st.sampled_from(credits), max_size=12)) if credits else []
    changed = [replace(c, ride_m=c.ride_m / 2) for c in again[::2]]
    arriving = data.draw(st.permutations([*credits, *again, *changed]))
    first: dict[tuple[str, str, str], Credit] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "awards.sqlite"
        ledger = AwardLedger(path)
        for credit in arriving:
            if data.draw(st.booleans()):
                ledger = AwardLedger(path)
            assert ledger.credit(credit) == (credit.key not in first)
            first.setdefault(credit.key, credit)
        assert AwardLedger(path).credits() == in_order(list(first.values())) if first else not path.exists()


@settings(max_examples=40)
@given(CREDITS, st.integers(0, 8))
def test_what_is_not_committed_is_undone(credits: list[Credit], done: int) -> None:
    """As a crash leaves it: some credits whole, the next in the file and its journal, but not committed."""
    with tempfile.TemporaryDirectory() as folder:
        path, left = Path(folder) / "awards.sqlite", Path(folder) / "left.sqlite"
        ledger = AwardLedger(path)
        ledger.check()
        for credit in credits[:done]:
            ledger.credit(credit)
        db = sqlite3.connect(path, isolation_level=None)
        db.execute("PRAGMA cache_spill = 1")
        db.execute("BEGIN IMMEDIATE")
        for credit in credits[done:]:
            db.execute("INSERT INTO awards VALUES (?, ?, ?, ?, ?, ?)", astuple(credit))
        for file in Path(folder).glob("awards.sqlite*"):
            shutil.copy(file, left.with_name(file.name.replace("awards", "left")))
        db.close()
        ledger = AwardLedger(left)
        assert ledger.credits() == in_order(credits[:done])
        assert [ledger.credit(credit) for credit in credits] == [i >= done for i in range(len(credits))]
        assert ledger.credits() == in_order(credits)


CREDITING = """
import sys
from dataclasses import replace
from hitchhike_ros.commands import awards
from hitchhike_ros.protocol.award_ledger import AwardLedger, Credit
ledger = AwardLedger(sys.argv[1])
for i in range(100000):
    print(i, flush=True)
    ledger.credit(Credit("p3dx", "turtlebot", str(i), 1.0, 0.4, float(i)))
"""


def test_killed_at_any_time(tmp_path: Path) -> None:
    path = tmp_path / "awards.sqlite"
    for run in range(6):
        process = subprocess.Popen([sys.executable, "-c", CREDITING, str(path)], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        for _ in range(2 + 7 * run):  # the first is credited by then
            process.stdout.readline()
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        said = process.stdout.read().splitlines()
        started = int(said[-1]) if said else 1 + 7 * run  # the newest that it began
        rides = [credit.ride_id for credit in AwardLedger(path).credits()]
        assert rides == [str(i) for i in range(len(rides))], "none is missing and none is there twice"
        assert len(rides) >= started


def _credit_all(path: Path, first: int) -> list[bool]:
    ledger = AwardLedger(path)
    return [ledger.credit(replace(RIDE, ride_id=str((first + i) % 40))) for i in range(40)]


def test_several_processes_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "awards.sqlite"
    with ProcessPoolExecutor(4) as pool:
        answers = list(pool.map(_credit_all, [path] * 4, (0, 1, 10, 20)))
    assert sum(map(sum, answers)) == 40
    assert len(AwardLedger(path).credits()) == 40


def test_the_folder_is_made(tmp_path: Path) -> None:
    ledger = AwardLedger(tmp_path / "a" / "b c?#%" / "awards.sqlite")
    ledger.check()
    assert ledger.credits() == []
    assert ledger.path.is_file()


def test_an_empty_file_becomes_a_ledger(ledger: AwardLedger) -> None:
    """A crash can leave one of the very first credit."""
    ledger.path.touch()
    assert ledger.credits() == []
    assert ledger.path.stat().st_size == 0
    assert ledger.credit(RIDE)


def _text(path: Path) -> None:
    path.write_text("driver,points\n" * 100, encoding="utf-8")


def _foreign(path: Path) -> None:
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE awards (driver TEXT)")
    db.close()


def _newer(path: Path) -> None:
    AwardLedger(path).check()
    db = sqlite3.connect(path)
    db.execute("PRAGMA user_version = 2")
    db.close()


def _cut(path: Path) -> None:
    AwardLedger(path).credit(RIDE)
    os.truncate(path, path.stat().st_size // 2)


def _overwritten(path: Path) -> None:
    ledger = AwardLedger(path)
    for i in range(200):
        ledger.credit(replace(RIDE, ride_id=str(i)))
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xa5" * 6000)


@pytest.mark.parametrize("make", [_text, _foreign, _newer, _cut, _overwritten])
def test_a_damaged_or_foreign_file_is_refused_and_left_alone(tmp_path: Path, make: object) -> None:
    path = tmp_path / "awards.sqlite"
    make(path)  # type: ignore[operator]
    content = path.read_bytes()
    for use in (AwardLedger.credits, AwardLedger.check, lambda ledger: ledger.credit(RIDE)):
        with pytest.raises(LedgerFormatError) as caught:
            use(AwardLedger(path))
        assert str(path) in str(caught.value)
        assert "expected" in str(caught.value)
    assert path.read_bytes() == content


@pytest.fixture
def unusable(tmp_path: Path) -> Iterator[dict[str, Path]]:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    yield {"below a file": tmp_path / "file" / "awards.sqlite", "a folder": tmp_path / "folder"}


@pytest.mark.parametrize("what", ["below a file", "a folder"])
def test_a_file_that_cannot_be_written(unusable: dict[str, Path], what: str) -> None:
    path = unusable[what]
    for use in (AwardLedger.check, lambda ledger: ledger.credit(RIDE)):
        with pytest.raises(LedgerError, match="expected a file that can be written") as caught:
            use(AwardLedger(path))
        assert str(path) in str(caught.value)
    with pytest.raises(LedgerError, match="expected an existing file"):
        AwardLedger(path).credits()


def test_reading_makes_no_file(ledger: AwardLedger) -> None:
    with pytest.raises(LedgerError, match="expected an existing file that can be read"):
        ledger.credits()
    assert not ledger.path.exists()


def test_a_file_that_another_process_keeps_busy(ledger: AwardLedger, monkeypatch: pytest.MonkeyPatch) -> None:
    ledger.check()
    db = sqlite3.connect(ledger.path, isolation_level=None)
    db.execute("BEGIN EXCLUSIVE")
    waits: list[float] = []
    connect = sqlite3.connect

    def spy(*args: Any, **kwargs: Any) -> sqlite3.Connection:
        waits.append(kwargs["timeout"])
        return connect(*args, **kwargs)

    monkeypatch.setattr(sqlite3, "connect", spy)
    with pytest.raises(LedgerError, match="locked"):
        AwardLedger(ledger.path, busy_timeout_s=0.1).credit(RIDE)
    assert waits == [0.1]
    db.close()
    assert ledger.credit(RIDE)


@pytest.mark.parametrize("field", ["ride_m", "points", "time"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1])
def test_senseless_numbers_are_refused(ledger: AwardLedger, field: str, value: float) -> None:
    with pytest.raises(CreditError, match=f"{field} is .*, expected a finite number"):
        ledger.credit(replace(RIDE, **{field: value}))


def test_totals() -> None:
    credits = [replace(RIDE, ride_id=str(i), ride_m=0.1, points=0.04) for i in range(10)]
    credits.append(replace(RIDE, driver="robot1", ride_m=50.0, points=20.0))
    assert totals(credits) == [Total("robot1", 1, 50.0, 20.0), Total("p3dx", 10, 1.0, 0.4)]
    assert totals([]) == []


def run_awards(monkeypatch: pytest.MonkeyPatch, *arguments: object, status: int | None = None) -> None:
    monkeypatch.setattr(sys, "argv", ["awards", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        awards.main()
    assert end.value.code == status


def test_awards_shows_totals_and_rides(
    ledger: AwardLedger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    other = AwardLedger(tmp_path / "other.sqlite")
    ledger.credit(RIDE)
    for ride in (RIDE, replace(RIDE, ride_id="2", hitchhiker="evil\x1b[31m", time=1.8e9)):
        other.credit(ride)
    run_awards(monkeypatch, ledger.path, other.path)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert [line.split()[0] for line in lines[:3]] == ["Drivers", "p3dx", "Rides"]
    assert lines[1].split() == ["p3dx", "2", "40.8", "m", "16.3"]
    assert [line.split()[-1] for line in lines[3:]] == [RIDE.ride_id, "2"]
    assert "\x1b" not in "".join(lines)
    run_awards(monkeypatch, ledger.path, other.path, "--json")
    shown = json.loads(capsys.readouterr().out)
    assert shown["drivers"] == [{"driver": "p3dx", "rides": 2, "ride_m": 40.8, "points": 16.32}]
    assert [ride["ride_id"] for ride in shown["rides"]] == [RIDE.ride_id, "2"]


def test_awards_reads_the_ledger_in_ros_home(
    ledger: AwardLedger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    run_awards(monkeypatch, status=1)
    said = capsys.readouterr().err
    assert re.match(r"awards: .*hitchhike_awards.sqlite is 'missing', expected an existing file", said)
    AwardLedger(tmp_path / "hitchhike_awards.sqlite").check()
    run_awards(monkeypatch)
    assert capsys.readouterr().out == "No rides.\n"


def test_awards_refuses_what_is_no_ledger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _text(tmp_path / "notes.txt")
    run_awards(monkeypatch, tmp_path / "notes.txt", status=1)
    said = capsys.readouterr().err
    assert re.match(r"awards: .*notes.txt is .*, expected an award ledger of hitchhike_ros", said)
