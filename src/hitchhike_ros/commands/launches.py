"""The processes of one ride: roslaunch with its own ROS master, and the monitor that records and scores it."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import FrameType
from typing import NoReturn

import psutil

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.simulation.world_file import WorldFile

_ALWAYS = ("p3dx", "turtlebot")  # as ride.launch has them
_MASTER_TIMEOUT_S = 30.0
_MONITOR_END_TIMEOUT_S = 30.0
# roslaunch itself waits 15 s for a node after SIGINT and 2 s after SIGTERM.
_STOP_TIMEOUT_S = 25.0
_POLL_S = 0.2
_FAMILY_PERIOD_S = 5.0
_TROUBLE = re.compile(r"\[FATAL\]|\[ERROR\]|^\w*(Error|Exception)\b|process has died|cannot|ERROR:")
_DEATH = re.compile(r"\[([^\s\[\]]+)-\d+\] process has died")
_SHOWN_TROUBLE = 6


class RideProcesses:
    """Everything of one ride, ended on exit. ``launch`` are arguments of demo.launch beside those of the world."""

    def __init__(
        self,
        world: WorldFile,
        seed: int,
        folder: Path,
        launch: Mapping[str, object] | None = None,
        monitor: Mapping[str, object] | None = None,
        port: int | None = None,
    ) -> None:
        self.folder, self.logs = folder, folder / "log"
        self._world, self._seed = world, seed
        self._launch_arguments, self._monitor_arguments = dict(launch or {}), dict(monitor or {})
        self._port = port or free_port()
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

    def __enter__(self) -> RideProcesses:
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
        say("Stopping the nodes", passing=True)
        _wait(self._launch, _STOP_TIMEOUT_S)
        _end_all(list(self._family.values()))
        say("", passing=True)
        signal.signal(signal.SIGINT, interrupt)

    def run(self) -> int:
        """Start nodes and monitor, wait for the monitor's end; its exit status.

        Raises:
            HitchhikeError: the nodes did not start, or one of them or roslaunch ended before the ride.
        """
        world = self._world
        self._launch = self._start(
            "roslaunch",
            ["roslaunch", "-p", str(self._port), "hitchhike_ros", "demo.launch"],
            world=world.path,
            map=world.map,
            others=" ".join(_others(world)),
            seed=self._seed,
            output=self.folder,
            monitor=False,
            **self._launch_arguments,
        )
        self._wait_for_master()
        self._monitor = self._start(
            "ride_monitor",
            ["rosrun", "hitchhike_ros", "ride_monitor"],
            _world=world.path,
            _output=self.folder,
            **{f"_{name}": value for name, value in self._monitor_arguments.items()},
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
        command = [*command, *(f"{key}:={_argument(value)}" for key, value in arguments.items())]
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


def _others(world: WorldFile) -> list[str]:
    """The world's robots that have something to do, beside the two that are always there."""
    return [name for name, robot in world.robots.items() if name not in _ALWAYS and robot.goal is not None]


def free_port() -> int:
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


def interrupt(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def say(text: str, passing: bool = False) -> None:
    """A line; ``passing``: one that the next line replaces, on a terminal only."""
    if not passing:
        print(text, flush=True)
    elif sys.stdout.isatty():
        print(f"\r{text}\x1b[K", end="", flush=True)


def _argument(value: object) -> str:
    """A value as ROS takes it on a command line."""
    return str(value).lower() if isinstance(value, bool) else str(value)
