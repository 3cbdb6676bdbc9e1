"""The processes of one ride: a launch file with its own ROS master, and the monitor that records and scores it."""

from __future__ import annotations

import os
import re
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import msgspec
import psutil
import rospkg

from hitchhike_ros.commands.launch_host import LaunchEvent
from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.report.screen import console, passing
from hitchhike_ros.simulation.world_file import WorldFile

_ALWAYS = ("p3dx", "turtlebot")  # as ride.launch has them
_START_TIMEOUT_S = 60.0
_MONITOR_END_TIMEOUT_S = 30.0
# roslaunch itself waits 15 s for a node after SIGINT and 2 s after SIGTERM, for ten nodes at a time.
_STOP_TIMEOUT_S = 45.0
_LOOK_S = 0.2
_FAMILY_PERIOD_S = 5.0
_TROUBLE = re.compile(r"\[FATAL\]|\[ERROR\]|^\w*(Error|Exception)\b|process has died|cannot|ERROR:")
_SHOWN_TROUBLE = 6


class Launch:
    """A launch file with a ROS master of its own; a context at whose end all of it has ended.

    Args:
        file: the launch file.
        arguments: of the launch file.
        logs: folder for the logs of roslaunch and of every node.
        port: of the ROS master; None: any free one.
    """

    def __init__(self, file: Path, arguments: Mapping[str, object], logs: Path, port: int | None = None) -> None:
        self._file, self._arguments, self._logs = file, dict(arguments), logs
        self._port = port or _free_port()
        self.environment = {
            **os.environ,
            "ROS_MASTER_URI": f"http://localhost:{self._port}",
            "ROS_HOSTNAME": "localhost",
            "ROS_LOG_DIR": str(logs),
            "PYTHONUNBUFFERED": "1",
        }
        """Of programs that are to find this ROS master."""
        self._process: subprocess.Popen[bytes] | None = None
        self._events = -1
        self._unread = b""
        self._started = False
        self._family: dict[int, psutil.Process] = {}
        self._next_look = 0.0

    def __enter__(self) -> Launch:
        """Begin to start it."""
        self._logs.mkdir(parents=True, exist_ok=True)
        self._events, theirs = os.pipe()
        command = [sys.executable, "-m", "hitchhike_ros.commands.launch_host", str(theirs), str(self._port)]
        command += [str(self._file), *remappings(self._arguments)]
        try:
            with (self._logs / "roslaunch.log").open("wb") as log:
                self._process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    env=self.environment,
                    pass_fds=(theirs,),
                    start_new_session=True,  # Ctrl-C must reach the nodes after the monitor, and through roslaunch
                )
        finally:
            os.close(theirs)
        return self

    def __exit__(self, *_exc: object) -> None:
        assert self._process is not None
        self._note_family()
        self.stop()
        _wait(self._process, _STOP_TIMEOUT_S)
        _end_all(list(self._family.values()))
        os.close(self._events)

    def stop(self) -> None:
        """Ask everything to end, without waiting for it."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def wait_for_start(self) -> None:
        """Wait until all nodes have been started.

        Raises:
            HitchhikeError: they have not, or one of them or roslaunch has ended.
        """
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not self._started:
            if time.monotonic() > deadline:
                raise HitchhikeError(f"the nodes did not start within {_START_TIMEOUT_S:.0f} s")
            self.check(_LOOK_S)

    def check(self, wait_s: float) -> None:
        """Look for ``wait_s`` at most for what happens to the nodes.

        Raises:
            HitchhikeError: a node has died, or roslaunch has ended.
        """
        assert self._process is not None
        if time.monotonic() >= self._next_look:
            self._next_look = time.monotonic() + _FAMILY_PERIOD_S
            self._note_family()
        for event in self._read(wait_s):
            if event.died:
                raise HitchhikeError(f"node {event.died} died, exit status {event.exit_code}")
            self._started = True
        ended = self._process.poll()
        if ended is not None:
            raise HitchhikeError(f"roslaunch ended with status {ended}")

    def _read(self, wait_s: float) -> list[LaunchEvent]:
        with selectors.DefaultSelector() as selector:
            selector.register(self._events, selectors.EVENT_READ)
            if not selector.select(wait_s):
                return []
        *lines, self._unread = (self._unread + os.read(self._events, 4096)).split(b"\n")
        return [msgspec.json.decode(line, type=LaunchEvent) for line in lines]

    def _note_family(self) -> None:
        """Remember the nodes: they have sessions of their own, and may outlive roslaunch where that is killed."""
        assert self._process is not None
        try:
            for child in psutil.Process(self._process.pid).children(recursive=True):
                self._family[child.pid] = child
        except psutil.NoSuchProcess:
            return  # it has ended, and what was noted before stands


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
        shown: bool = True,
    ) -> None:
        """``shown`` says whether the monitor has this terminal; else what it says is in its log."""
        self.folder, self.logs, self._shown = folder, folder / "log", shown
        arguments: dict[str, object] = {
            "world": world.path,
            "map": world.map,
            "others": " ".join(_others(world)),
            "seed": seed,
            "output": folder,
            "monitor": False,
            **(launch or {}),
        }
        file = Path(rospkg.RosPack().get_path("hitchhike_ros")) / "launch_scripts" / "demo.launch"
        self._launch = Launch(file, arguments, self.logs, port)
        self._monitor_arguments: dict[str, object] = {"_world": world.path, "_output": folder}
        self._monitor_arguments |= {f"_{name}": value for name, value in (monitor or {}).items()}
        self._monitor: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> RideProcesses:
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "ride.json").unlink(missing_ok=True)
        self._launch.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        # An impatient second Ctrl-C must not leave nodes behind.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            if self._monitor is not None and self._monitor.poll() is None:
                self._monitor.send_signal(signal.SIGINT)
            # Both at once: the monitor reports the sooner for not sharing the machine with the nodes.
            self._launch.stop()
            if self._monitor is not None:
                _wait(self._monitor, _MONITOR_END_TIMEOUT_S)
            with passing(console(), "Stopping the nodes"):
                self._launch.__exit__(*exc)
        finally:
            signal.signal(signal.SIGINT, before)

    def run(self) -> int:
        """Wait for the nodes, start the monitor and wait for its end; its exit status.

        Raises:
            HitchhikeError: the nodes did not start, or one of them or roslaunch ended before the ride.
        """
        self._launch.wait_for_start()
        with (self.logs / "ride_monitor.log").open("wb") as log:
            self._monitor = subprocess.Popen(
                ["rosrun", "hitchhike_ros", "ride_monitor", *remappings(self._monitor_arguments)],
                stdin=subprocess.DEVNULL,
                stdout=None if self._shown else log,
                stderr=log,
                env=self._launch.environment,
            )
        while (status := self._monitor.poll()) is None:
            self._launch.check(_LOOK_S)
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


def remappings(arguments: Mapping[str, object]) -> list[str]:
    """Arguments as ROS takes them on a command line: ``name:=value``."""
    return [f"{name}:={str(v).lower() if isinstance(v, bool) else v}" for name, v in arguments.items()]


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
