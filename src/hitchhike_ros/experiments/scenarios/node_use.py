"""What nodes use, out of what the system and the nodes themselves say: CPU time, memory and traffic.

Messages and bytes come from each node's slave API: ``getBusStats`` counts them for each connection, and forgets one
that has closed; so the newest counts of every connection are kept here, and what one carried after it was last asked
for is lost. rospy counts the handshake and the length in front of each message (some 350 and 4 bytes), roscpp the bare
messages. Services are not counted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import astuple, dataclass
from typing import Any


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


def megabytes(text: str, field: str) -> float:
    """A field of a file of Linux's proc that is in kB, as ``VmHWM`` of ``status``, in MB; 0 where it has none.

    >>> megabytes("Name: slam\\nVmHWM:     51200 kB", "VmHWM")
    50.0
    """
    return next((int(line.split()[1]) / 1024.0 for line in text.splitlines() if line.startswith(f"{field}:")), 0.0)


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
