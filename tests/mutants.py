"""Draws mutants of the code and tells which of them the unit tests of their rooms do not notice.

Runs in no ROS environment (launch_scripts/mutants calls it): the clones in which the tests run have environments of
their own, since a devel space imports the sources of the tree that it was built from.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TextIO

from mutant_draw import Mutant, draw

ROOT = Path(__file__).resolve().parents[1]
SOURCES, TESTS = "src/hitchhike_ros", "tests/unit"
ROOMS = ("protocol", "modules", "control", "servoing", "localization", "planning", "mapping")
BOUND_PERCENT = 88.0

# Variables that a catkin environment sets; one that is entered from within another would import from both.
_ENVIRONMENT = ("CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH", "PKG_CONFIG_PATH", "PYTHONPATH", "ROS_PACKAGE_PATH")
_SETUP_LIMIT_S = 1800.0
_BASELINE_LIMIT_S = 900.0
_LEAST_LIMIT_S = 120.0
_TIMES_BASELINE = 8.0  # a mutant that makes the tests of its room so much slower hangs
_MEMORY_BYTES = 8 << 30  # a mutant that collects without end is ended by this
_NO_TESTS = 5  # exit status of pytest


class MutantsError(Exception):
    """The mutants cannot be judged; says why."""


class StoppedError(Exception):
    """A command was ended because the whole run ends."""


@dataclass(frozen=True)
class Result:
    """What became of a mutant: ``by`` is the first test that failed, or what else ended the tests."""

    mutant: Mutant
    killed: bool
    by: str
    seconds: float

    @property
    def room(self) -> str:
        return room_of(self.mutant.path)


def room_of(path: str) -> str:
    """The room of a source file: `src/hitchhike_ros/planning/astar.py` is in planning."""
    return Path(path).relative_to(SOURCES).parts[0]


def sources(root: Path, rooms: Iterable[str]) -> list[str]:
    """Source files of rooms, relative to the repository.

    Raises:
        MutantsError: A room has no sources or no unit tests.
    """
    found = []
    for room in rooms:
        files = sorted((root / SOURCES / room).rglob("*.py"))
        if not files or not (root / TESTS / room).is_dir():
            raise MutantsError(f"{room} is no room with sources in {SOURCES} and tests in {TESTS}")
        found += [str(path.relative_to(root)) for path in files]
    return found


def tests_of(root: Path, path: str) -> list[str]:
    """Arguments of pytest for the unit tests of a file's room, those that mirror the file first."""
    room = root / TESTS / room_of(path)
    own = sorted(room.rglob(f"test_{Path(path).stem}.py"))
    return [str(test.relative_to(root)) for test in (*own, room)]


class Bounded:
    """Runs one command at a time, with all that it starts, for so long and with so much memory at most."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._group: int | None = None
        self._stopped = False

    def run(self, command: Sequence[str], cwd: Path, env: Mapping[str, str], limit_s: float) -> tuple[int | None, str]:
        """Runs a command.

        Returns:
            Exit status, None when its time was up, and what it printed.

        Raises:
            StoppedError: ``stop`` was called.
        """
        with self._lock:
            if self._stopped:
                raise StoppedError
            process = subprocess.Popen(
                ["prlimit", f"--as={_MEMORY_BYTES}", *command],
                cwd=cwd,
                env=dict(env),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            self._group = process.pid
        status: int | None = None
        try:
            output, _ = process.communicate(timeout=limit_s)
            status = process.returncode
        except subprocess.TimeoutExpired:
            output = ""
        finally:
            with self._lock:
                kill_group(process.pid)  # also what a test left behind
                self._group = None
            process.communicate()
        if self._stopped:
            raise StoppedError
        return status, output

    def stop(self) -> None:
        """Ends the command, from another thread, and starts no other."""
        with self._lock:
            self._stopped = True
            if self._group is not None:
                kill_group(self._group)


def kill_group(group: int) -> None:
    """Kills what is left of a group of processes."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


class Clone:
    """A clone of the repository with an environment of its own, in which one mutant at a time is tested."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.tests = Bounded()
        self._env: dict[str, str] = {}

    def prepare(self, commit: str) -> None:
        """Checks a commit out and builds it; what was built before is used again.

        Raises:
            MutantsError: The set-up failed, or the clone's environment imports other sources than the clone's.
        """
        if not (self.path / ".git").is_dir():
            self._run("git", "clone", "-q", "--no-checkout", str(ROOT), str(self.path), cwd=ROOT)
        self._run("git", "fetch", "-q", str(ROOT), commit)
        self._run("git", "checkout", "-q", "--force", "--detach", commit)
        self._run("git", "clean", "-q", "-fd", "--", "src", "tests")
        self._run(str(self.path / "launch_scripts" / "setup"), show=True)
        listed = self._run(str(self.path / "launch_scripts" / "ros"), "env", "-0")
        self._env = dict(entry.split("=", 1) for entry in listed.split("\0") if "=" in entry)
        self._env["PYTHONDONTWRITEBYTECODE"] = "1"
        imported = self._run("python3", "-c", "import hitchhike_ros.core as core; print(core.__file__)").strip()
        if not Path(imported).is_relative_to(self.path):
            raise MutantsError(f"the environment of {self.path} imports {imported}")

    def baseline_s(self, room: str) -> float:
        """Runs the tests of a room without a mutant and returns how long they took.

        Raises:
            MutantsError: They do not pass.
        """
        start = time.monotonic()
        status, output = self._pytest([f"{TESTS}/{room}"], _BASELINE_LIMIT_S)
        if status != 0:
            raise MutantsError(f"the unit tests of {room} do not pass without a mutant:\n{output[-4000:]}")
        return time.monotonic() - start

    def judge(self, mutant: Mutant, limit_s: float) -> Result:
        """Tests one mutant and puts the file back as it was.

        Raises:
            MutantsError: No test ran.
        """
        file = self.path / mutant.path
        text, before = file.read_text(encoding="utf-8"), file.stat()
        start = time.monotonic()
        try:
            file.write_text(mutant.source(text), encoding="utf-8")
            # Python takes compiled code for current when size and second of its source are the same.
            os.utime(file, (before.st_mtime + 10.0, before.st_mtime + 10.0))
            status, output = self._pytest(tests_of(self.path, mutant.path), limit_s)
        finally:
            file.write_text(text, encoding="utf-8")
            os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
        if status == _NO_TESTS:
            raise MutantsError(f"no test ran for {mutant.path}")
        return Result(mutant, status != 0, killer(status, output), time.monotonic() - start)

    def _pytest(self, paths: Sequence[str], limit_s: float) -> tuple[int | None, str]:
        # An example that Hypothesis found against one mutant is no test of the next.
        if (self.path / ".hypothesis").exists():
            shutil.rmtree(self.path / ".hypothesis")
        options = ("-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider", "--hypothesis-seed=0")
        return self.tests.run(["python3", "-m", "pytest", *options, *paths], self.path, self._env, limit_s)

    def _run(self, *command: str, cwd: Path | None = None, show: bool = False) -> str:
        env = self._env or {name: value for name, value in os.environ.items() if name not in _ENVIRONMENT}
        result = subprocess.run(
            command,
            cwd=cwd or self.path,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=None if show else subprocess.PIPE,
            text=True,
            timeout=_SETUP_LIMIT_S,
            check=False,
        )
        if result.returncode:
            raise MutantsError(f"{' '.join(command)} failed:\n{(result.stdout + (result.stderr or ''))[-4000:]}")
        return result.stdout


def killer(status: int | None, output: str) -> str:
    """What noticed a mutant, from pytest's exit status and output; empty where nothing did."""
    if status == 0:
        return ""
    if status is None:
        return "time limit"
    if status < 0:
        return signal.Signals(-status).name
    told = [line.split(" ")[1] for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return told[0].removeprefix(f"{TESTS}/") if told else f"exit status {status}"


class Store:
    """Results on disk, one a line, so that a run that was stopped goes on where it was."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()

    def load(self) -> list[Result]:
        if not self._path.is_file():
            return []
        lines = self._path.read_text(encoding="utf-8").splitlines(keepends=True)
        # A run that was stopped while it wrote leaves half a line.
        values = [json.loads(line) for line in lines if line.endswith("\n")]
        return [Result(**{**value, "mutant": Mutant(**value["mutant"])}) for value in values]

    def add(self, result: Result) -> None:
        with self._lock, self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(result)) + "\n")


def judge_all(
    clones: Sequence[Clone],
    mutants: Sequence[Mutant],
    limits_s: Mapping[str, float],
    done: Callable[[Result], None],
) -> None:
    """Judges mutants, one in each clone at a time.

    Args:
        clones: Prepared clones.
        mutants: What is to be judged.
        limits_s: For each room, how long its tests may take.
        done: Is called with each result, one at a time.

    Raises:
        MutantsError: A clone could not go on; the others were stopped.
    """
    waiting: queue.SimpleQueue[Mutant] = queue.SimpleQueue()
    for mutant in mutants:
        waiting.put(mutant)
    lock = threading.Lock()
    failures: list[MutantsError] = []

    def work(clone: Clone) -> None:
        try:
            while True:
                mutant = waiting.get_nowait()
                result = clone.judge(mutant, limits_s[room_of(mutant.path)])
                with lock:
                    done(result)
        except queue.Empty:
            return  # nothing is left
        except StoppedError:
            return
        except MutantsError as error:
            failures.append(error)
            for other in clones:
                other.tests.stop()

    threads = [threading.Thread(target=work, args=(clone,)) for clone in clones]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    finally:
        for clone in clones:
            clone.tests.stop()
    if failures:
        raise failures[0]


def share_percent(results: Sequence[Result]) -> float:
    """Killed mutants of all, in percent; 0 of none."""
    return 100.0 * sum(result.killed for result in results) / len(results) if results else 0.0


def diff(mutant: Mutant, text: str) -> str:
    """The change as a unified diff with a line of context."""
    lines = difflib.unified_diff(
        text.splitlines(), mutant.source(text).splitlines(), mutant.path, mutant.path, n=1, lineterm=""
    )
    return "\n".join(lines)


def report(results: Sequence[Result], read: Callable[[str], str]) -> str:
    """Survivors with their diffs, then a table by room and the share in all.

    Args:
        results: What became of the mutants.
        read: Gives the text of a source file by its path.
    """
    lines = []
    survivors = sorted((r for r in results if not r.killed), key=lambda r: (r.mutant.path, r.mutant.line))
    for number, result in enumerate(survivors, 1):
        lines += [f"survivor {number}: {result.mutant.operator}", diff(result.mutant, read(result.mutant.path)), ""]
    total, killed = Counter(r.room for r in results), Counter(r.room for r in results if r.killed)
    lines.append(f"{'room':<14}{'mutants':>8}{'killed':>8}{'survived':>10}{'share':>8}")
    for room in sorted(total):
        of_room = share_percent([result for result in results if result.room == room])
        lines.append(f"{room:<14}{total[room]:>8}{killed[room]:>8}{total[room] - killed[room]:>10}{of_room:>7.1f}%")
    lines.append(
        f"killed {killed.total()} of {len(results)}: {share_percent(results):.1f} % (bound {BOUND_PERCENT:g} %)"
    )
    return "\n".join(lines)


def as_json(results: Sequence[Result], commit: str, seed: int, read: Callable[[str], str]) -> dict[str, object]:
    """The same for programs: one figure with its bound, versions and seed, and every mutant."""
    share = share_percent(results)
    figure = {
        "name": "mutants killed",
        "value": share,
        "unit": "%",
        "bound": BOUND_PERCENT,
        "better": "higher",
        "peer": None,
        "ok": share >= BOUND_PERCENT,
    }
    mutants = [{**asdict(r), "diff": diff(r.mutant, read(r.mutant.path))} for r in results]
    return {
        "figures": [figure],
        "versions": {"commit": commit, "cosmic-ray": version("cosmic-ray")},
        "seed": seed,
        "mutants": mutants,
    }


def say(text: str, out: TextIO = sys.stderr) -> None:
    print(text, file=out, flush=True)


def run(args: argparse.Namespace) -> int:
    """Draws, judges and reports; returns the exit status."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    if subprocess.run([*git, "diff", "--quiet", "HEAD"], check=False).returncode:
        say("mutants: the last commit is judged; what is not committed is left out")
    folder = ROOT / "build" / "mutants"
    folder.mkdir(parents=True, exist_ok=True)

    clones = [Clone(folder / str(number)) for number in range(1, args.jobs + 1)]
    for number, clone in enumerate(clones, 1):
        say(f"mutants: setting clone {number} of {len(clones)} up")
        clone.prepare(commit)
    here = clones[0].path
    mutants = draw(here, sources(here, args.rooms), args.sample, args.seed)
    rooms = sorted({room_of(mutant.path) for mutant in mutants})
    store = Store(folder / f"{commit[:12]}-{args.seed}-{args.sample}-{'-'.join(args.rooms)}.jsonl")
    results = [result for result in store.load() if result.mutant in mutants]
    finished = {result.mutant for result in results}
    left = [mutant for mutant in mutants if mutant not in finished]
    if left:
        say(f"mutants: {len(mutants)} drawn, {len(finished)} of them judged before; first the tests without any")
        limits_s = {}
        for room in rooms:
            seconds = clones[0].baseline_s(room)
            limits_s[room] = max(_LEAST_LIMIT_S, _TIMES_BASELINE * seconds)
            say(f"  {room} passes in {seconds:.0f} s; a mutant has {limits_s[room]:.0f} s")

        def done(result: Result) -> None:
            store.add(result)
            results.append(result)
            mutant, verdict = result.mutant, "killed  " if result.killed else "SURVIVED"
            say(
                f"{len(results):4d}/{len(mutants)}  {verdict} {result.seconds:5.0f} s  "
                f"{mutant.path.removeprefix(SOURCES + '/')}:{mutant.line}  {mutant.operator}  {result.by}"
            )

        judge_all(clones, left, limits_s, done)

    def read(path: str) -> str:
        return (here / path).read_text(encoding="utf-8")

    print(report(results, read))
    if args.json:
        args.json.write_text(json.dumps(as_json(results, commit, args.seed, read), indent=1) + "\n", encoding="utf-8")
    return 1 if args.check and share_percent(results) < BOUND_PERCENT else 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="launch_scripts/mutants",
        description="Draws a seeded sample of mutants of the last commit, runs the unit tests of each mutant's room in "
        "clones in build/mutants, and lists those that no test noticed. Goes on where it was stopped.",
    )
    parser.add_argument("--sample", type=int, default=150, metavar="N", help="mutants to draw (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the sample (default %(default)s)")
    parser.add_argument("--rooms", nargs="+", default=ROOMS, metavar="ROOM", help=f"default: {' '.join(ROOMS)}")
    parser.add_argument(
        "--jobs", type=int, default=min(2, os.cpu_count() or 1), metavar="N", help="clones (default %(default)s)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write figures and every mutant as JSON")
    parser.add_argument("--check", action="store_true", help=f"fail when less than {BOUND_PERCENT:g} %% are killed")
    args = parser.parse_args(argv)
    if args.sample < 1 or args.jobs < 1:
        parser.error("--sample and --jobs are at least 1")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # ends the tests that run, too
    try:
        return run(args)
    except MutantsError as error:
        say(f"mutants: {error}")
        return 2


if __name__ == "__main__":
    sys.exit(main())
