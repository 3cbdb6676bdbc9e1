"""The radio between simulated robots: which copies of a message arrive, and when.

The grid simulator and the node ``network_model`` ask the same model. What happens to the n-th message from one robot
to another depends on the seed, on the two and on n alone: more messages elsewhere, or more loss, leave it as it is, so
that runs can be compared message by message.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass
from typing import Annotated

import msgspec

from hitchhike_ros.core.datatypes import NonNegative, UnitInterval
from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import convert

Seed = Annotated[int, msgspec.Meta(ge=0)]

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

    Seconds are of the simulated clock. ``loss``, ``duplication`` and ``reordering`` are probabilities: that no copy
    arrives, that two do, and, for each copy, that it takes ``reorder_delay_s`` longer, so that later ones overtake it.
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


def _mixed(place: int) -> int:
    """64 random bits at a place of a stream."""
    z = place & _64_BITS
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _64_BITS
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _64_BITS
    return z ^ (z >> 31)
