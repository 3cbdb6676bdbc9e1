"""usage: launch_scripts/demo [OPTIONS]

Drives the ride of P17 Experiment 1 in simulation, through real ROS nodes: shows it in one line while it runs, then
prints its figures beside the paper's. Needs no ROS master: it starts one of its own on a free port, and Ctrl-C ends
everything that it started.

  --world FILE            world file instead of maps/p17_exp1.world.yaml
  --seed N                of all noise (0)
  --runs N                so many rides with seeds N, N + 1, …, and a table over all of them (1)
  --output DIR            folder for what a ride leaves (runs/DATE-TIME); with several, one folder each inside it
  --rviz auto|true|false  show it in rviz; auto: when there is a display and rviz (auto)
  --json FILE             write the figures, with versions and seeds, as JSON
  --check                 the exit status also says whether every bound holds
  --help                  print this

A ride leaves ride.json (figures, boxes, CPU, modules over time), record.json (all that was recorded, for scoring it
again), map.png, ride.bag (every topic but images), awards.sqlite (what the driver earned; rosrun hitchhike_ros awards
reads it) and log/ (of roslaunch and of every node).
Exit status: 0 when every ride was completed, 1 when not, 2 for wrong usage, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import msgspec
import psutil
import rospkg

from hitchhike_ros.errors import HitchhikeError
from hitchhike_ros.experiments.figures import Figure, summarize
from hitchhike_ros.experiments.ride_report import summary_table
from hitchhike_ros.experiments.terminal import has_colours
from hitchhike_ros.simulation.world_file import WorldFile, load_world

_ALWAYS = ("p3dx", "turtlebot")  # as ride.launch has them
_MASTER_TIMEOUT_S = 30.0
_MONITOR_END_TIMEOUT_S = 30.0
# roslaunch itself waits 15 s for a node after SIGINT and 2 s after SIGTERM.
_STOP_TIMEOUT_S = 25.0
_POLL_S = 0.2
_FAMILY_PERIOD_S = 5.0
_TROUBLE = re.compile(r"\[FATAL\]|\[ERROR\]|^\w*(Error|Exception)\b|process has died|cannot|ERROR:")
_DEATH = re.compile(r"\[(\S+)-\d+\] process has died")
_SHOWN_TROUBLE = 6


@dataclass(frozen=True)
class Options:
    """The command line."""

    world: WorldFile
    seed: int
    runs: int
    output: Path
    rviz: bool
    json: Path | None
    check: bool


class Ride:
    """The processes of one ride, started on entry and all ended on exit."""

    def __init__(self, options: Options, seed: int, folder: Path) -> None:
        self.folder, self.logs = folder, folder / "log"
        self._options, self._seed = options, seed
        self._port = _free_port()
        self._environment = {
            **os.environ,
            "ROS_MASTER_URI": f"http://localhost:{self._port}",
            "ROS_HOSTNAME": "localhost",
            "ROS_LOG_DIR": str(self.logs),
            "PYTHONUNBUFFERED": "1",
        }
        self._launch: subprocess.Popen[bytes] | None = None
        self._monitor: subprocess.Popen[bytes] | None = None
        self._family: dict[int, psutil.Process] = {}
        self._log_read = 0

    def __enter__(self) -> Ride:
        self.logs.mkdir(parents=True, exist_ok=True)
        (self.folder / "ride.json").unlink(missing_ok=True)
        return self

    def __exit__(self, *_exc: object) -> None:
        if self._launch is None:
            return
        # An impatient second Ctrl-C must not leave nodes behind.
        interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN)
        self._note_family()
        # Both at once: the monitor reports the sooner for not sharing the machine with the nodes.
        for process in (self._monitor, self._launch):
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGINT)
        if self._monitor is not None:
            _wait(self._monitor, _MONITOR_END_TIMEOUT_S)
        _say("Stopping the nodes", passing=True)
        _wait(self._launch, _STOP_TIMEOUT_S)
        _end_all(list(self._family.values()))
        _say("", passing=True)
        signal.signal(signal.SIGINT, interrupt)

    def run(self) -> int:
        """Start nodes and monitor, wait for the monitor's end; its exit status.

        Raises:
            HitchhikeError: the nodes did not start, or one of them or roslaunch ended before the ride.
        """
        options = self._options
        self._launch = self._start(
            "roslaunch",
            ["roslaunch", "-p", str(self._port), "hitchhike_ros", "demo.launch"],
            world=options.world.path,
            map=options.world.map,
            others=" ".join(_others(options.world)),
            seed=self._seed,
            output=self.folder,
            rviz=str(options.rviz).lower(),
            monitor="false",
        )
        self._wait_for_master()
        self._monitor = self._start(
            "ride_monitor",
            ["rosrun", "hitchhike_ros", "ride_monitor"],
            _world=options.world.path,
            _output=self.folder,
            _check=str(options.check).lower(),
            _tables=str(options.runs == 1).lower(),
        )
        next_look = 0.0
        while (status := self._monitor.poll()) is None:
            if time.monotonic() >= next_look:
                next_look = time.monotonic() + _FAMILY_PERIOD_S
                self._note_family()
            cause = self._broken()
            if cause:
                raise HitchhikeError(cause)
            time.sleep(_POLL_S)
        if not (self.folder / "ride.json").is_file():
            raise HitchhikeError(f"the ride's monitor ended with status {status} and left no report")
        return status

    def trouble(self) -> list[str]:
        """The last lines of the logs that look like the cause of a failure."""
        lines: list[str] = []
        for log in (self.logs / "roslaunch.log", self.logs / "ride_monitor.log"):
            if log.is_file():
                found = [line for line in log.read_text(errors="replace").splitlines() if _TROUBLE.search(line)]
                lines += found[-_SHOWN_TROUBLE:]
        return lines

    def _start(self, name: str, command: list[str], **arguments: object) -> subprocess.Popen[bytes]:
        """A process with its errors, and but for the monitor its output, in a file."""
        command = [*command, *(f"{key}:={value}" for key, value in arguments.items())]
        with (self.logs / f"{name}.log").open("wb") as log:
            monitor = name == "ride_monitor"
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=None if monitor else log,
                stderr=log,
                env=self._environment,
                # Ctrl-C must reach the nodes after the monitor, and through roslaunch.
                start_new_session=not monitor,
            )

    def _wait_for_master(self) -> None:
        assert self._launch is not None
        deadline = time.monotonic() + _MASTER_TIMEOUT_S
        while time.monotonic() < deadline:
            if self._launch.poll() is not None:
                raise HitchhikeError(f"roslaunch ended with status {self._launch.returncode} at once")
            with socket.socket() as probe:
                probe.settimeout(_POLL_S)
                if probe.connect_ex(("localhost", self._port)) == 0:
                    return
            time.sleep(_POLL_S)
        raise HitchhikeError(f"no ROS master within {_MASTER_TIMEOUT_S:.0f} s")

    def _broken(self) -> str:
        """Why the ride cannot go on, or nothing: a node that dies early is known to roslaunch alone."""
        assert self._launch is not None
        with (self.logs / "roslaunch.log").open("rb") as log:
            log.seek(self._log_read)
            news = log.read()
        self._log_read += len(news)
        dead = _DEATH.search(news.decode(errors="replace"))
        if dead is not None:
            return f"node {dead.group(1)} died"
        ended = self._launch.poll()
        return "" if ended is None else f"roslaunch ended with status {ended} before the ride did"

    def _note_family(self) -> None:
        """Remember what roslaunch started: its nodes have sessions of their own, and may outlive it."""
        assert self._launch is not None
        try:
            for child in psutil.Process(self._launch.pid).children(recursive=True):
                self._family[child.pid] = child
        except psutil.NoSuchProcess:
            pass


def main() -> NoReturn:
    """Entry point of ``rosrun hitchhike_ros ride_demo``."""
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    try:
        sys.exit(_run(_options(sys.argv[1:])))
    except HitchhikeError as exc:
        print(f"demo: {exc}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("\nInterrupted; everything that was started has ended.", file=sys.stderr)
        sys.exit(130)


def _run(options: Options) -> int:
    seeds = list(range(options.seed, options.seed + options.runs))
    reports: list[dict[str, Any]] = []
    failed = False
    for i, seed in enumerate(seeds):
        folder = options.output if options.runs == 1 else options.output / f"seed-{seed}"
        count = f"Ride {i + 1} of {options.runs}: " if options.runs > 1 else ""
        _say(f"{count}{options.world.path.name}, seed {seed}, logs in {_shown(folder / 'log')}")
        failure = ""
        with Ride(options, seed, folder) as ride:
            try:
                failed |= ride.run() != 0
            except HitchhikeError as exc:
                failure = f"Failed: {exc}"
        report = folder / "ride.json"
        if report.is_file():
            reports.append(json.loads(report.read_bytes()))
        if failure or not reports or not reports[-1]["completed"]:
            failed = True
            print("\n".join(line for line in (failure, *ride.trouble(), f"Logs: {ride.logs}") if line), file=sys.stderr)
    _summarize(options, seeds, reports)
    return 1 if failed or len(reports) < len(seeds) else 0


def _summarize(options: Options, seeds: Sequence[int], reports: Sequence[dict[str, Any]]) -> None:
    """The table over several runs, and the JSON."""
    runs = [msgspec.convert(report["figures"], list[Figure]) for report in reports]
    figures: Sequence[object] = runs[0] if len(runs) == options.runs == 1 else summarize(runs)
    if options.runs > 1 and runs:
        completed = sum(report["completed"] for report in reports)
        print(f"\n{completed} of {options.runs} rides completed\n")
        print(summary_table(summarize(runs), [report["seed"] for report in reports], has_colours(sys.stdout)))
    if options.json is not None:
        content = {
            "world": options.world.path.name,
            "seeds": list(seeds),
            "versions": reports[0]["versions"] if reports else {},
            "completed": sum(report["completed"] for report in reports),
            "figures": figures,
            "runs": list(reports),
        }
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2))


def _options(arguments: list[str]) -> Options:
    if {"-h", "--help"} & set(arguments):
        print(__doc__)
        sys.exit(0)
    parser = argparse.ArgumentParser("launch_scripts/demo", add_help=False, allow_abbrev=False)
    parser.add_argument("--world", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=_count, default=1)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--rviz", choices=("auto", "true", "false"), default="auto")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args(arguments)
    default = Path(rospkg.RosPack().get_path("hitchhike_ros")) / "maps" / "p17_exp1.world.yaml"
    world = load_world((given.world or default).resolve())
    output = (given.output or Path("runs") / time.strftime("%Y-%m-%d-%H%M%S")).resolve()
    try:
        output.mkdir(parents=True, exist_ok=True)
        if given.json is not None:
            given.json.parent.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise HitchhikeError(f"{exc.filename}: {exc.strerror}, expected a folder that can be written to") from exc
    shows = given.rviz == "true" or (
        given.rviz == "auto" and bool(os.environ.get("DISPLAY")) and shutil.which("rviz") is not None
    )
    return Options(world, given.seed, given.runs, output, shows, given.json, given.check)


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value}, expected at least 1")
    return value


def _others(world: WorldFile) -> list[str]:
    """The world's robots that have something to do, beside the two that are always there."""
    return [name for name, robot in world.robots.items() if name not in _ALWAYS and robot.goal is not None]


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


def _wait(process: subprocess.Popen[bytes], timeout_s: float) -> None:
    """Wait for the process's end, and end it for good if it takes too long."""
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _end_all(processes: list[psutil.Process]) -> None:
    """End what is still there of these processes."""
    for how in (psutil.Process.terminate, psutil.Process.kill):
        _gone, alive = psutil.wait_procs(processes, timeout=2.0)
        for process in alive:
            try:
                how(process)
            except psutil.NoSuchProcess:
                continue


def _interrupt(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _say(text: str, passing: bool = False) -> None:
    """A line; ``passing``: one that the next line replaces, on a terminal only."""
    if not passing:
        print(text, flush=True)
    elif sys.stdout.isatty():
        print(f"\r{text}\x1b[K", end="", flush=True)


def _shown(path: Path) -> str:
    """The path as a person would type it."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)
