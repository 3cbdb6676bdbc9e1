"""CPU and memory of every node over a run, and how fast the simulation ran."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.experiments.scenarios.ride_record import ClockSample, CpuSample, RideRecord
from hitchhike_ros.experiments.scoring.rides import Ride, phases

_RECENT_S = 5.0  # wall time (chosen)


@dataclass(frozen=True)
class CpuUse:
    """CPU seconds that one node used in some time, and how long that was on both clocks."""

    cpu_s: float
    sim_s: float
    wall_s: float


@dataclass(frozen=True)
class NodeCost:
    """CPU of one node: in all, and in those phases of the run (see :func:`phases`) that have samples."""

    node: str
    cpu_s: float
    memory_mb: float
    phases: dict[str, CpuUse]


def node_costs(record: RideRecord, ride: Ride | None) -> list[NodeCost]:
    """CPU of every node, those of one robot together."""
    costs = []
    for node in sorted({sample.node for sample in record.cpu}):
        samples = [sample for sample in record.cpu if sample.node == node]
        uses = {name: cpu_use(samples, record.clock, window) for name, window in phases(record, ride).items()}
        known = {name: use for name, use in uses.items() if use is not None}
        costs.append(NodeCost(node, samples[-1].cpu_s, max(s.memory_mb for s in samples), known))
    return costs


def cpu_use(samples: Sequence[CpuSample], clock: Sequence[ClockSample], window: tuple[float, float]) -> CpuUse | None:
    """CPU seconds between two simulated times, interpolated between samples; None where samples do not reach."""
    start, end = max(window[0], samples[0].stamp), min(window[1], samples[-1].stamp)
    if end <= start or not clock:
        return None
    used = np.interp([start, end], [s.stamp for s in samples], [s.cpu_s for s in samples])
    wall = np.interp([start, end], [c.stamp for c in clock], [c.wall_s for c in clock])
    return CpuUse(float(used[1] - used[0]), end - start, float(wall[1] - wall[0]))


def real_time_factor(record: RideRecord, ride: Ride | None) -> float | None:
    """Simulated by wall seconds, from the request (or else from the start) to the end."""
    since = ride.requested_at if ride is not None else None
    return _factor([c for c in record.clock if since is None or c.stamp >= since])


def recent_real_time_factor(record: RideRecord) -> float | None:
    """The same of the last few seconds, for a person who watches."""
    return _factor([c for c in record.clock if c.wall_s >= record.clock[-1].wall_s - _RECENT_S])


def _factor(clock: Sequence[ClockSample]) -> float | None:
    if len(clock) < 2 or clock[-1].wall_s <= clock[0].wall_s:
        return None
    return (clock[-1].stamp - clock[0].stamp) / (clock[-1].wall_s - clock[0].wall_s)
