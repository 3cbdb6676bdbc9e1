"""The processes behind nodes of this machine: what CPU time and memory they use, and whether they still run."""

from __future__ import annotations

import http.client
import itertools
import xmlrpc.client
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlparse

import psutil
import rosgraph
import rospy

_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class ProcessUse:
    """CPU seconds since a node's process started, and its resident memory."""

    node: str
    cpu_s: float
    memory_mb: float


class NodeProcesses:
    """Finds the processes by asking each node's slave API; nodes on other machines are left out."""

    def __init__(self) -> None:
        self._master = rosgraph.Master(rospy.get_name())
        self._processes: dict[str, psutil.Process] = {}

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
        """What every known process that still runs has used."""
        uses = []
        for name, process in sorted(self._processes.items()):
            try:
                times, memory = process.cpu_times(), process.memory_info()
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
            uses.append(ProcessUse(name, times.user + times.system, memory.rss / 2**20))
        return uses

    def gone(self) -> list[str]:
        """Known nodes whose process has ended."""
        return [name for name, process in self._processes.items() if not _runs(process)]

    def _process_of(self, node: str) -> psutil.Process | None:
        try:
            uri = self._master.lookupNode(node)
            host = urlparse(uri).hostname or ""
            if not rosgraph.network.is_local_address(host):
                return None
            with xmlrpc.client.ServerProxy(uri, transport=_Transport()) as slave:
                answer: Any = slave.getPid(rospy.get_name())
            code, _text, pid = answer
            return psutil.Process(pid) if code == 1 else None
        except (OSError, rosgraph.MasterException, xmlrpc.client.Error, http.client.HTTPException, psutil.Error):
            return None  # it is just starting or ending, and is asked again next time


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
