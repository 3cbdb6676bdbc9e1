"""The radio between simulated robots: which copies of a message arrive, and when; and those that are under way.

The grid simulator and the node ``network_model`` ask the same model. What happens to the n-th message from one robot
to another depends on the seed, on the two and on n alone: more messages elsewhere, or more loss, leave it as it is, so
that runs can be compared message by message.
"""

from __future__ import annotations

import hashlib
import heapq
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Generic, TypeVar

from hitchhike_ros.core.datatypes import NonNegative, Seed, UnitInterval
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import convert

T = TypeVar("T")

# SplitMix64: a stream is one integer, so that a pair costs a hundred bytes, and random.Random's 2.5 kB times the pairs
# of a thousand robots are saved. https://doi.org/10.1145/2714064.2660195
_32_BITS, _64_BITS, _2_32 = (1 << 32) - 1, (1 << 64) - 1, float(1 << 32)
_STEP = 0x9E3779B97F4A7C15


@dataclass(frozen=True)
class Partition:
    """From ``begin_s`` until before ``end_s``, robots of different ``groups`` do not hear each other.

    A robot in none of the groups hears all and is heard by all: it stands between them.
    """

    begin_s: float
    end_s: float
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class NetworkParameters:
    """What the network does to each message from one robot to another; the defaults leave it as it is.

    Seconds are of the simulated clock, or count from the start on the system's. ``loss``, ``duplication`` and
    ``reordering`` are probabilities: that no copy arrives, that two do, and, for each copy, that it takes
    ``reorder_delay_s`` longer, so that later ones overtake it.
    """

    range_m: NonNegative = math.inf
    delay_s: NonNegative = 0.0
    jitter_s: NonNegative = 0.0  # each copy takes longer by 0 to this, uniformly
    loss: UnitInterval = 0.0
    duplication: UnitInterval = 0.0
    reordering: UnitInterval = 0.0
    reorder_delay_s: NonNegative = 1.0
    partitions: tuple[Partition, ...] = ()
    seed: Seed = 0


def check_network(params: NetworkParameters, file: object = "network") -> NetworkParameters:
    """The parameters themselves.

    Raises:
        ParameterError: one is out of bounds or not finite, or a partition ends before it begins, has fewer than two
            groups, or has a robot twice; it names ``file``, the field, its value and what was expected.
    """
    checked = convert(asdict(params), NetworkParameters, file)
    for name in ("delay_s", "jitter_s", "reorder_delay_s"):
        if not math.isfinite(getattr(checked, name)):
            raise ParameterError(file, name, getattr(checked, name), "a finite number")
    for name in ("range_m", "loss", "duplication", "reordering"):
        if math.isnan(getattr(checked, name)):
            raise ParameterError(file, name, getattr(checked, name), "a number")
    for i, partition in enumerate(checked.partitions):
        field = f"partitions[{i}]"
        if not partition.begin_s < partition.end_s:
            raise ParameterError(file, f"{field}.end_s", partition.end_s, f"more than begin_s, {partition.begin_s:g}")
        if len(partition.groups) < 2:
            raise ParameterError(file, f"{field}.groups", partition.groups, "at least two lists of robots")
        robots = [robot for group in partition.groups for robot in group]
        if len(robots) > len(set(robots)):
            raise ParameterError(file, f"{field}.groups", partition.groups, "each robot once")
    return checked


class NetworkModel:
    """Decides over every message from one robot to another."""

    def __init__(self, params: NetworkParameters, file: object = "network") -> None:
        """Raises ParameterError as :func:`check_network`; ``file`` is where the parameters come from."""
        self.params = params = check_network(params, file)
        self._partitions = [
            (p.begin_s, p.end_s, {robot: i for i, group in enumerate(p.groups) for robot in group})
            for p in params.partitions
        ]
        self._certain = params.loss == params.duplication == params.reordering == params.jitter_s == 0.0
        self._late = params.jitter_s > 0.0 or params.reordering > 0.0
        self._streams: dict[str, dict[str, int]] = {}

    def reaches(self, now: float, sender: str, receiver: str, distance_m: float) -> bool:
        """Whether ``receiver``, ``distance_m`` away, can hear what ``sender`` says at ``now``; none hears itself."""
        if sender == receiver or not distance_m <= self.params.range_m:
            return False
        for begin, end, group in self._partitions:
            if begin <= now < end and sender in group and group.get(receiver, group[sender]) != group[sender]:
                return False
        return True

    def deliveries(self, now: float, sender: str, receiver: str, distance_m: float) -> tuple[float, ...]:
        """When the copies arrive of what ``sender`` says at ``now``, earliest first; empty where none does.

        Without jitter and reordering, the messages of a pair keep their order. What is out of reach is no message of
        the pair's: it takes nobody's luck.
        """
        if not self.reaches(now, sender, receiver, distance_m):
            return ()
        params = self.params
        soon = now + params.delay_s
        if self._certain:
            return (soon,)
        place = self._next_place(sender, receiver)
        number = _mixed(place)
        if (number >> 32) / _2_32 < params.loss:
            return ()
        copies = 2 if (number & _32_BITS) / _2_32 < params.duplication else 1
        if not self._late:
            return (soon,) * copies
        times = [soon + self._lateness(_mixed(place + i * _STEP)) for i in range(1, copies + 1)]
        times.sort()
        return tuple(times)

    def _lateness(self, number: int) -> float:
        """What jitter and reordering add to a copy's delay, from 64 random bits."""
        extra = self.params.reorder_delay_s if (number & _32_BITS) / _2_32 < self.params.reordering else 0.0
        return (number >> 32) / _2_32 * self.params.jitter_s + extra

    def _next_place(self, sender: str, receiver: str) -> int:
        """Where in its random stream the pair's next message stands; each takes three places, used or not."""
        streams = self._streams.get(sender)
        if streams is None:
            streams = self._streams[sender] = {}
        place = streams.get(receiver)
        if place is None:
            name = repr((self.params.seed, sender, receiver)).encode()
            place = int.from_bytes(hashlib.blake2b(name, digest_size=8).digest(), "little")
        streams[receiver] = (place + 3 * _STEP) & _64_BITS
        return place


COUNTED = ("sent", "delivered", "lost", "doubled", "out_of_reach", "overflowed")
"""What a radio counts, of each pair of robots."""


class Radio(Generic[T]):
    """Carries messages between robots: each copy is under way until its time has come.

    Args:
        model: decides over each message.
        robots: who hears and is heard.
        max_waiting: copies that may be under way at once; those beyond are lost.
        start_s: where the time begins of which the model's partitions are.
    """

    def __init__(self, model: NetworkModel, robots: Sequence[str], max_waiting: int, start_s: float = 0.0) -> None:
        self.counts: Counter[tuple[str, str, str]] = Counter()
        """Of what, sender and receiver."""
        self.latest_s = 0.0
        """How late the latest delivery was."""
        self._model, self._robots, self._max_waiting, self._start_s = model, tuple(robots), max_waiting, start_s
        self._places: dict[str, tuple[float, float]] = {}
        self._under_way: list[tuple[float, int, str, str, T]] = []  # a heap
        self._pushed = 0
        self._now = -math.inf

    @property
    def waiting(self) -> int:
        """Copies under way."""
        return len(self._under_way)

    def place(self, robot: str, x: float, y: float) -> None:
        """Where a robot is, in m."""
        self._places[robot] = x, y

    def send(self, now: float, sender: str, message: T) -> None:
        """Put the copies of a message under way that reach the other robots; ``now`` as in :meth:`arrived`."""
        self._take_time(now)
        for receiver in self._robots:
            if receiver != sender:
                self._send(now - self._start_s, sender, receiver, message)

    def arrived(self, now: float) -> Iterator[tuple[str, T]]:
        """Receiver and message of each copy that has arrived by ``now``, in that order.

        When time jumps back the simulation has begun anew, and what was under way is lost.
        """
        self._take_time(now)
        while self._under_way and self._under_way[0][0] <= now - self._start_s:
            at, _, sender, receiver, message = heapq.heappop(self._under_way)
            self.counts["delivered", sender, receiver] += 1
            self.latest_s = max(self.latest_s, now - self._start_s - at)
            yield receiver, message

    def totals(self) -> dict[str, int]:
        """What is counted, of all pairs together."""
        totals = dict.fromkeys(COUNTED, 0)
        for (what, _, _), number in self.counts.items():
            totals[what] += number
        return totals

    def diagnosis(self) -> tuple[bool, str, dict[str, object]]:
        """Whether all is well, what to say of it, and the values of the diagnostics."""
        totals = self.totals()
        overflowed = totals["overflowed"]
        values: dict[str, object] = {
            **totals,
            "waiting": self.waiting,
            "latest_s": f"{self.latest_s:.3f}",
            **{f"{what}_{sender}_to_{receiver}": count for (what, sender, receiver), count in self.counts.items()},
        }
        return not overflowed, f"{overflowed} copies more than ~max_waiting" if overflowed else "running", values

    def _take_time(self, now: float) -> None:
        if now < self._now:
            self._under_way.clear()
        self._now = now

    def _send(self, now: float, sender: str, receiver: str, message: T) -> None:
        """``now`` is of the model's time."""
        counts, distance_m = self.counts, self._distance(sender, receiver)
        counts["sent", sender, receiver] += 1
        if not self._model.reaches(now, sender, receiver, distance_m):
            counts["out_of_reach", sender, receiver] += 1
            return
        arrivals = self._model.deliveries(now, sender, receiver, distance_m)
        if not arrivals:
            counts["lost", sender, receiver] += 1
        elif len(arrivals) > 1:
            counts["doubled", sender, receiver] += 1
        for at in arrivals:
            if len(self._under_way) < self._max_waiting:
                self._pushed += 1
                heapq.heappush(self._under_way, (at, self._pushed, sender, receiver, message))
            else:
                counts["overflowed", sender, receiver] += 1

    def _distance(self, sender: str, receiver: str) -> float:
        """Between the two in m; without end where one has not been seen yet."""
        if sender not in self._places or receiver not in self._places:
            return math.inf
        return math.dist(self._places[sender], self._places[receiver])


def _mixed(place: int) -> int:
    """64 random bits at a place of a stream."""
    z = place & _64_BITS
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _64_BITS
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _64_BITS
    return z ^ (z >> 31)
