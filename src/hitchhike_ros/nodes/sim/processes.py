"""The processes behind nodes of this machine: what CPU time, memory and traffic they use, and whether they still run.

CPU and memory come from the operating system. Messages and bytes come from each node's slave API: ``getBusStats``
counts them for each connection, and forgets one that has closed; so the newest counts of every connection are kept
here, and what one carried after it was last asked for is lost. rospy counts the handshake and the length in front of
each message (some 350 and 4 bytes), roscpp the bare messages. Services are not counted.
"""

from __future__ import annotations

import contextlib
import http.client
import itertools
import xmlrpc.client
from collections.abc import Callable, Collection, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import psutil
import rosgraph
import rospy

_TIMEOUT_S = 2.0
_UNREACHABLE = (OSError, rosgraph.MasterException, xmlrpc.client.Error, http.client.HTTPException)


@dataclass(frozen=True)
class Traffic:
    """What went through a node's connections since it started."""

    messages_in: int = 0
    bytes_in: int = 0
    messages_out: int = 0
    bytes_out: int = 0

    def __add__(self, other: Traffic) -> Traffic:
        return Traffic(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@dataclass(frozen=True)
class ProcessUse:
    """CPU seconds since a node's process started, and its resident memory now and at most."""

    node: str
    cpu_s: float
    memory_mb: float
    peak_mb: float


class TrafficCounter:
    """Running sums over one node's connections, those that have closed included.

    Args:
        watchers: nodes that only look on; what is sent to them is not counted.
    """

    def __init__(self, watchers: Collection[str] = ()) -> None:
        self._watchers = frozenset(watchers)
        self._connections: dict[int, Traffic] = {}
        self._ignored: set[int] = set()

    @property
    def total(self) -> Traffic:
        return sum(self._connections.values(), Traffic())

    def update(self, stats: Sequence[Any], bus_info: Callable[[], Sequence[Sequence[Any]]]) -> None:
        """Take what ``getBusStats`` says: ``[publications, subscriptions, services]``.

        A publication is ``[topic, bytes, connections]`` with ``[id, bytes, messages, connected]`` from rospy and
        ``[topic, connections]`` with ``[id, bytes, bytes of data, messages, 0]`` from roscpp, a subscription ``[topic,
        connections]`` with ``[id, bytes, messages, dropped, connected]`` from both; ids are those of the process.

        Args:
            stats: that answer.
            bus_info: asks for what ``getBusInfo`` says, only when there are connections not known yet.
        """
        publications, subscriptions = stats[0], stats[1]
        counts: dict[int, Traffic] = {}
        for publication in publications:
            for connection in publication[-1]:
                messages = connection[3] if len(connection) > 4 else connection[2]
                counts[int(connection[0])] = Traffic(messages_out=int(messages), bytes_out=int(connection[1]))
        for subscription in subscriptions:
            for connection in subscription[-1]:
                counts[int(connection[0])] = Traffic(messages_in=int(connection[2]), bytes_in=int(connection[1]))
        if self._watchers and counts.keys() - self._connections.keys() - self._ignored:
            self._ignored |= {int(info[0]) for info in bus_info() if info[1] in self._watchers}
        self._connections.update({k: count for k, count in counts.items() if k not in self._ignored})


class NodeProcesses:
    """Finds the processes by asking each node's slave API; nodes on other machines are left out.

    Args:
        watchers: as in :class:`TrafficCounter`.
    """

    def __init__(self, watchers: Collection[str] = ()) -> None:
        self._watchers = watchers
        self._master = rosgraph.Master(rospy.get_name())
        self._processes: dict[str, psutil.Process] = {}
        self._uris: dict[str, str] = {}
        self._traffic: dict[str, TrafficCounter] = {}

    def discover(self) -> bool:
        """Look for nodes that are not known yet; whether there were any.

        Raises:
            OSError, rosgraph.MasterException: the ROS master does not answer.
        """
        state = self._master.getSystemState()
        names = {node for _topic, nodes in itertools.chain.from_iterable(state) for node in nodes}
        new = names - self._processes.keys()
        before = len(self._processes)
        for name in new:
            process = self._process_of(name)
            if process is not None:
                self._processes[name] = process
        return len(self._processes) > before

    def use(self) -> list[ProcessUse]:
        """What every known process that still runs has used. The nodes themselves notice nothing of it."""
        uses = []
        for name, process in sorted(self._processes.items()):
            try:
                times, memory, peak_mb = process.cpu_times(), process.memory_info(), _peak_mb(process.pid)
            except (psutil.NoSuchProcess, psutil.AccessDenied, OSError):
                continue
            uses.append(ProcessUse(name, times.user + times.system, memory.rss / 2**20, peak_mb))
        return uses

    def memory(self) -> dict[str, float]:
        """The proportional set size of every known process that still runs, in MB.

        The system looks at all its pages for that: some milliseconds a process.
        """
        sizes = {}
        for name, process in self._processes.items():
            with contextlib.suppress(OSError):
                sizes[name] = pss_mb(process.pid)
        return sizes

    def traffic(self) -> dict[str, Traffic]:
        """What went through the connections of every known node; as it was when it last answered, where it does not.

        Each is asked, which may take its time and costs the node some of its own.
        """
        return {name: self._traffic_of(name) for name in sorted(self._uris)}

    def gone(self) -> list[str]:
        """Known nodes whose process has ended."""
        return [name for name, process in self._processes.items() if not _runs(process)]

    def _process_of(self, node: str) -> psutil.Process | None:
        try:
            uri = self._master.lookupNode(node)
            host = urlparse(uri).hostname or ""
            if not rosgraph.network.is_local_address(host):
                return None
            process = psutil.Process(_ask(uri, "getPid"))
        except (*_UNREACHABLE, psutil.Error):
            return None  # it is just starting or ending, and is asked again next time
        self._uris[node] = uri
        self._traffic[node] = TrafficCounter(self._watchers)
        return process

    def _traffic_of(self, node: str) -> Traffic:
        uri, counter = self._uris[node], self._traffic[node]
        with contextlib.suppress(*_UNREACHABLE):
            counter.update(_ask(uri, "getBusStats"), lambda: _ask(uri, "getBusInfo"))
        return counter.total


def _ask(uri: str, method: str) -> Any:
    """What a node's slave API answers.

    Raises:
        OSError, xmlrpc.client.Error, http.client.HTTPException: it does not answer, or with an error.
    """
    with xmlrpc.client.ServerProxy(uri, transport=_Transport()) as slave:
        answer: Any = getattr(slave, method)(rospy.get_name())
    if isinstance(answer[0], list):  # roscpp's getBusStats has neither code nor text
        return answer
    code, text, value = answer
    if code != 1:
        raise xmlrpc.client.Fault(code, text)
    return value


def pss_mb(pid: int) -> float:
    """The proportional set size of a process, as Linux counts it.

    Raises:
        OSError: there is no such process, or it is another user's.
    """
    rollup = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii", errors="replace")
    kilobytes = next((line.split()[1] for line in rollup.splitlines() if line.startswith("Pss:")), "0")
    return int(kilobytes) / 1024.0


def _peak_mb(pid: int) -> float:
    """The most memory that was resident, as Linux keeps it."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    kilobytes = next((line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:")), "0")
    return int(kilobytes) / 1024.0


class _Transport(xmlrpc.client.Transport):
    """HTTP that does not wait forever for a node that hangs."""

    def make_connection(self, host: object) -> http.client.HTTPConnection:
        connection = super().make_connection(host)  # type: ignore[arg-type]
        connection.timeout = _TIMEOUT_S
        return connection


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
