"""The processes behind nodes of this machine: what they use, and whether they still run.

CPU and memory come from the operating system, traffic from each node's slave API.
"""

from __future__ import annotations

import contextlib
import http.client
import itertools
import xmlrpc.client
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import psutil
import rosgraph
import rospy

from hitchhike_ros.experiments.scenarios.node_use import ProcessUse, Traffic, TrafficCounter, megabytes

_UNREACHABLE = (OSError, rosgraph.MasterException, xmlrpc.client.Error, http.client.HTTPException)


@dataclass(frozen=True)
class _Node:
    process: psutil.Process
    uri: str
    traffic: TrafficCounter


class NodeProcesses:
    """Finds the processes by asking each node's slave API; nodes on other machines are left out.

    Args:
        watchers: as in :class:`TrafficCounter`.
        timeout_s: wall time after which a node that is asked counts as hanging.
    """

    def __init__(self, watchers: Collection[str], timeout_s: float) -> None:
        self._watchers, self._timeout_s = watchers, timeout_s
        self._master = rosgraph.Master(rospy.get_name())
        self._nodes: dict[str, _Node] = {}

    def discover(self) -> None:
        """Look for nodes that are not known yet.

        Raises:
            OSError, rosgraph.MasterException: the ROS master does not answer.
        """
        state = self._master.getSystemState()
        names = {node for _topic, nodes in itertools.chain.from_iterable(state) for node in nodes}
        for name in names - self._nodes.keys():
            # One that is just starting or ending is asked again next time.
            with contextlib.suppress(*_UNREACHABLE, psutil.Error):
                uri = self._master.lookupNode(name)
                if rosgraph.network.is_local_address(urlparse(uri).hostname or ""):
                    process = psutil.Process(self._ask(uri, "getPid"))
                    self._nodes[name] = _Node(process, uri, TrafficCounter(self._watchers))

    def use(self) -> list[ProcessUse]:
        """What every known process that still runs has used. The nodes themselves notice nothing of it."""
        uses = []
        for name, node in sorted(self._nodes.items()):
            with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied, OSError):
                times, memory = node.process.cpu_times(), node.process.memory_info()
                peak_mb = _peak_mb(node.process.pid)
                uses.append(ProcessUse(name, times.user + times.system, memory.rss / 2**20, peak_mb))
        return uses

    def memory(self) -> dict[str, float]:
        """The proportional set size of every known process that still runs, in MB.

        The system looks at all its pages for that: some milliseconds a process.
        """
        sizes = {}
        for name, node in self._nodes.items():
            with contextlib.suppress(OSError):
                sizes[name] = pss_mb(node.process.pid)
        return sizes

    def traffic(self) -> dict[str, Traffic]:
        """What went through the connections of every known node; as it was when it last answered, where it does not.

        Each is asked, which may take its time and costs the node some of its own.
        """
        return {name: self._traffic_of(node) for name, node in sorted(self._nodes.items())}

    def gone(self) -> list[str]:
        """Known nodes whose process has ended."""
        return [name for name, node in self._nodes.items() if not _runs(node.process)]

    def _traffic_of(self, node: _Node) -> Traffic:
        with contextlib.suppress(*_UNREACHABLE):
            node.traffic.update(self._ask(node.uri, "getBusStats"), lambda: self._ask(node.uri, "getBusInfo"))
        return node.traffic.total

    def _ask(self, uri: str, method: str) -> Any:
        """What a node's slave API answers.

        Raises:
            OSError, xmlrpc.client.Error, http.client.HTTPException: it does not answer, or with an error.
        """
        with xmlrpc.client.ServerProxy(uri, transport=_Transport(self._timeout_s)) as slave:
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
    return _proc_mb(pid, "smaps_rollup", "Pss")


def _peak_mb(pid: int) -> float:
    """The most memory that was resident, as Linux keeps it."""
    return _proc_mb(pid, "status", "VmHWM")


def _proc_mb(pid: int, file: str, field: str) -> float:
    return megabytes(Path(f"/proc/{pid}/{file}").read_text(encoding="ascii", errors="replace"), field)


class _Transport(xmlrpc.client.Transport):
    """HTTP that does not wait forever for a node that hangs."""

    def __init__(self, timeout_s: float) -> None:
        super().__init__()
        self._timeout_s = timeout_s

    def make_connection(self, host: object) -> http.client.HTTPConnection:
        connection = super().make_connection(host)  # type: ignore[arg-type]
        connection.timeout = self._timeout_s
        return connection


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
