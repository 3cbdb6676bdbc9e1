"""What a ride costs its hitchhiker, beside driving the same way alone: CPU, memory, messages and bytes of every module.

Two runs are compared, of the same world, nodes, sensors and seed: one with the ride, and one in which the hitchhiker
asks for none and drives to its goal by itself. Everything counts that the hitchhiker's nodes use, in three ways:

    ride          from asking for the ride until it drives by itself again, so waiting, coupling, camera, following and
                  handing over, by the metres that it went meanwhile; alone: from where it asked to where it was set
                  down, by the metres between
    riding        without what comes before and after: ``riding`` to ``decoupling``, and alone between the same places
    whole run     from being given its goal until it is there, in both runs, by the metres of each

Samples are interpolated in simulated time, and what was seen of a node stands for the part of the time in which it was
not yet. Nodes that look on, such as the recorder, are nobody's cost.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.experiments.scenarios.ride_record import CpuSample, RideRecord, RobotRecord, TrafficSample
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.rides import Ride, Window, find_ride
from hitchhike_ros.experiments.scoring.tracks import metres_driven, poses_at
from hitchhike_ros.protocol.status import ModuleSwitches

# The most that the hitchhiker's computation per metre may be, by driving alone.
MAX_RIDE_COST = 0.40
# The most that a module which is off may cost more than a node that does nothing, percent of a core (design §6).
MAX_OFF_PERCENT = 0.5
IDLE_NODE = "/idle"
# So near to the place in question the lone robot has reached it (chosen; it does not drive quite the same line).
_AT_PLACE_M = 0.05
# A module's time off counts when it is longer than this (chosen: a few samples), but for its ends, in which the module
# is still switching (chosen).
_MIN_OFF_S, _SWITCHING_S = 8.0, 1.0
# The node that is off when all of these switches are.
_SWITCHES = {
    "path_planning": ("PP",),
    "obstacle_avoidance": ("OBS",),
    "slam": ("LZN", "MAP"),
    "visual_servoing": ("VS",),
}


@dataclass(frozen=True)
class ModuleCost:
    """What one node used in some time. ``peak_mb`` is the most memory that was resident, ever until its end."""

    robot: str
    module: str
    cpu_s: float
    peak_mb: float
    messages_in: float
    bytes_in: float
    messages_out: float
    bytes_out: float


@dataclass(frozen=True)
class Stretch:
    """What a robot's nodes used between two simulated times in which it went so many metres."""

    name: str
    begin: float
    end: float
    metres: float
    modules: tuple[ModuleCost, ...]

    @property
    def seconds(self) -> float:
        return self.end - self.begin

    @property
    def total(self) -> ModuleCost:
        return total(self.modules)

    @property
    def cpu_s_per_metre(self) -> float | None:
        return self.total.cpu_s / self.metres if self.metres > 0.0 and self.modules else None

    def module(self, name: str) -> ModuleCost | None:
        """What one module used."""
        return next((cost for cost in self.modules if cost.module == name), None)


@dataclass(frozen=True)
class Comparison:
    """The same way as a rider and alone."""

    name: str
    rider: Stretch
    alone: Stretch

    @property
    def ratio(self) -> float | None:
        """CPU per metre as a rider by that alone."""
        return _by(self.rider.cpu_s_per_metre, self.alone.cpu_s_per_metre)

    def module_ratio(self, name: str) -> float | None:
        """The same of one module."""
        rider, alone = self.rider.module(name), self.alone.module(name)
        if rider is None or alone is None or not self.rider.metres or not self.alone.metres:
            return None
        return _by(rider.cpu_s / self.rider.metres, alone.cpu_s / self.alone.metres)


def module_costs(record: RideRecord, window: Window) -> list[ModuleCost]:
    """Every node that belongs to a robot, and ``robot`` "" for the others, between two simulated times."""
    samples: dict[str, list[CpuSample]] = {}
    for sample in record.cpu:
        samples.setdefault(sample.node, []).append(sample)
    traffic: dict[str, list[TrafficSample]] = {}
    for counted in record.traffic:
        traffic.setdefault(counted.node, []).append(counted)
    costs = [_cost(node, of_node, traffic.get(node, []), window, record) for node, of_node in sorted(samples.items())]
    return [cost for cost in costs if cost is not None]


def total(costs: Iterable[ModuleCost]) -> ModuleCost:
    """All of them together; of several robots it is nobody's."""
    costs = list(costs)
    robots = {cost.robot for cost in costs}
    sums = np.sum([_numbers(cost) for cost in costs], axis=0) if costs else np.zeros(6)
    return ModuleCost(robots.pop() if len(robots) == 1 else "", "total", *(float(v) for v in sums))


def stretch(record: RideRecord, robot: str, name: str, window: Window) -> Stretch:
    """What ``robot`` used and how far it went."""
    modules = tuple(cost for cost in module_costs(record, window) if cost.robot == robot)
    metres = metres_driven(record.robots[robot], window)
    return Stretch(name, *window, metres, modules)


def pss_mb(record: RideRecord, robot: str, window: Window) -> float | None:
    """The memory that the processes of a robot's nodes take together, in MB, on average over a window.

    None where a node was not looked at in the window, or the robot has none.
    """
    nodes: dict[str, list[float]] = {}
    for sample in record.memory:
        if sample.node.startswith(f"/{robot}/"):
            inside = nodes.setdefault(sample.node, [])
            if window[0] <= sample.stamp <= window[1]:
                inside.append(sample.pss_mb)
    if not nodes or not all(nodes.values()):
        return None
    return float(sum(np.mean(sizes) for sizes in nodes.values()))


def ride_steps(record: RideRecord, ride: Ride) -> list[Stretch]:
    """The hitchhiker's run in parts: before the ride, waiting, coupling, riding, handing over, and after it."""
    run = run_window(record.robots[ride.hitchhiker])
    if run is None:
        return []
    times = [run[0], ride.requested_at, ride.aligning_at, ride.riding_at, ride.decoupling_at, ride.released_at, run[1]]
    names = ["before", "waiting", "coupling", "riding", "decoupling", "after"]
    return [
        stretch(record, ride.hitchhiker, name, (begin, end))
        for name, (begin, end) in zip(names, pairwise(times), strict=True)
        if begin is not None and end is not None and end > begin
    ]


def compare(ridden: RideRecord, alone: RideRecord) -> list[Comparison]:
    """The run with a ride beside the one without, in the three ways that stand above; empty where it has no ride."""
    ride = find_ride(ridden)
    if ride is None or ride.hitchhiker not in alone.robots:
        return []
    robot = ride.hitchhiker
    windows = {
        "ride": (ride.requested_at, ride.released_at),
        "riding": (ride.riding_at, ride.decoupling_at),
    }
    comparisons = []
    for name, (begin, end) in windows.items():
        if begin is None or end is None:
            continue
        places = poses_at(ridden.robots[robot].truth, np.array([begin, end]))
        window = window_between(alone.robots[robot], *(Pose2D(*(float(v) for v in place)) for place in places))
        if window is not None:
            comparisons.append(
                Comparison(name, stretch(ridden, robot, name, (begin, end)), stretch(alone, robot, name, window))
            )
    runs = [run_window(record.robots[robot]) for record in (ridden, alone)]
    if runs[0] is not None and runs[1] is not None:
        name = "whole run"
        comparisons.append(
            Comparison(name, stretch(ridden, robot, name, runs[0]), stretch(alone, robot, name, runs[1]))
        )
    return comparisons


def run_window(robot: RobotRecord) -> Window | None:
    """From when a robot had something to do until it had no longer; None where it never had, or was not seen to end."""
    begin = next((s.time_stamp for s in robot.statuses if s.state != "idle"), None)
    if begin is None or not robot.ended or robot.newest_status is None:
        return None
    # Several statuses in a row may report that it is idle; the first of the last such row is the end.
    end = robot.newest_status.time_stamp
    for status in reversed(robot.statuses):
        if status.state != "idle":
            break
        end = status.time_stamp
    return begin, end


def window_between(robot: RobotRecord, start: Pose2D, end: Pose2D) -> Window | None:
    """When a robot that had something to do came first to one place, and after that to the other."""
    run = run_window(robot)
    if run is None:
        return None
    track = [pose for pose in robot.truth if run[0] <= pose.stamp <= run[1]]
    times: list[float] = []
    for place in (start, end):
        track = [pose for pose in track if not times or pose.stamp > times[-1]]
        if not track:
            return None
        apart = [distance(pose.pose, place) for pose in track]
        times.append(next(p.stamp for p, d in zip(track, apart, strict=True) if d <= min(apart) + _AT_PLACE_M))
    return times[0], times[1]


def cost_figures(ridden: RideRecord, alone: RideRecord) -> list[Figure]:
    """The ledger's figures; those that could not be had have no value."""
    found = {comparison.name: comparison for comparison in compare(ridden, alone)}
    figures = []
    for name, bound in (("ride", MAX_RIDE_COST), ("riding", None), ("whole run", None)):
        comparison, key = found.get(name), name.replace(" ", "_")
        sides = (comparison.rider, comparison.alone) if comparison is not None else (None, None)
        for side, part in zip(("rider", "alone"), sides, strict=True):
            figures.append(Figure(f"{key}_cpu_{side}", part.cpu_s_per_metre if part is not None else None, "s/m"))
        figures.append(Figure(f"{key}_cpu_ratio", comparison.ratio if comparison is not None else None, "", bound))
    own = found.get("ride")
    for name, key, scale in (("memory_peak", "peak_mb", 1.0), ("bytes_in", "bytes_in", 1e-6)):
        for side in ("rider", "alone"):
            part = getattr(own, side) if own is not None else None
            value = None if part is None or not part.modules else scale * getattr(part.total, key)
            figures.append(Figure(f"ride_{name}_{side}", value, "MB"))
    return [*figures, *off_figures(ridden)]


def off_figures(record: RideRecord) -> list[Figure]:
    """The most that any module costs while it is off, more than the node that does nothing does at the same time."""
    extras = [extra for _robot, _module, extra in modules_off(record)]
    return [Figure("module_off_cost", max(extras, default=None), "% of a core", MAX_OFF_PERCENT)]


def modules_off(record: RideRecord) -> list[tuple[str, str, float]]:
    """Robot, module, and by how many percent of a core it cost more than :data:`IDLE_NODE` while it was off."""
    found = []
    for name, robot in record.robots.items():
        for module, switches in _SWITCHES.items():
            node = f"/{name}/{module}"
            spent = [(_cpu(record, node, window), _cpu(record, IDLE_NODE, window)) for window in _off(robot, switches)]
            both = [(own, idle) for own, idle in spent if own is not None and idle is not None]
            seconds = sum(own[1] for own, _idle in both)
            if seconds > 0.0:
                extra = sum(own[0] - idle[0] for own, idle in both)
                found.append((name, module, 100.0 * extra / seconds))
    return found


def _off(robot: RobotRecord, switches: Sequence[str]) -> list[Window]:
    """When all of these were off while the robot had something to do."""
    run = run_window(robot)
    if run is None:
        return []
    windows = []
    since: float | None = None
    steps = [(s.time_stamp, s.modules) for s in robot.statuses if s.time_stamp < run[1]]
    for stamp, modules in [*steps, (run[1], ModuleSwitches(*(True,) * 6))]:
        off = not any(getattr(modules, switch) for switch in switches)
        if off and since is None:
            since = max(stamp, run[0])
        elif not off and since is not None:
            windows.append((since + _SWITCHING_S, stamp - _SWITCHING_S))
            since = None
    return [(begin, end) for begin, end in windows if end - begin >= _MIN_OFF_S]


def _cpu(record: RideRecord, node: str, window: Window) -> tuple[float, float] | None:
    """CPU seconds, and of how many simulated seconds."""
    samples = [sample for sample in record.cpu if sample.node == node]
    if not samples or samples[0].stamp > window[0] or samples[-1].stamp < window[1]:
        return None
    used = np.interp(window, [s.stamp for s in samples], [s.cpu_s for s in samples])
    return float(used[1] - used[0]), window[1] - window[0]


def _cost(
    node: str,
    samples: Sequence[CpuSample],
    traffic: Sequence[TrafficSample],
    window: Window,
    record: RideRecord,
) -> ModuleCost | None:
    """None where the node was seen for less than half of the time."""
    cpu = _between([(s.stamp, s.cpu_s) for s in samples], window)
    if cpu is None:
        return None
    counts = [(t.stamp, t.messages_in, t.bytes_in, t.messages_out, t.bytes_out) for t in traffic]
    passed = _between(counts, window) or (0.0,) * 4
    # The memory of the first sample after the end holds for it.
    until = [s.peak_mb for s in samples if s.stamp <= window[1]] or [samples[0].peak_mb]
    robot, _, module = node.strip("/").rpartition("/")
    robot = robot if robot in record.robots else ""
    return ModuleCost(robot, module if robot else node.strip("/"), cpu[0], max(until), *passed)


def _between(sums: Sequence[tuple[float, ...]], window: Window) -> tuple[float, ...] | None:
    """What running sums, rows of a stamp and numbers, grow by between two times; None where the rows reach over less
    than half of it. Before the first and after the last they are taken to grow as between."""
    if not sums:
        return None
    stamps, *columns = np.array(sums, float).T
    begin, end = max(window[0], stamps[0]), min(window[1], stamps[-1])
    if not end - begin >= 0.5 * (window[1] - window[0]) > 0.0:
        return None
    share = (window[1] - window[0]) / (end - begin)
    return tuple(float(share * np.diff(np.interp((begin, end), stamps, column))[0]) for column in columns)


def _numbers(cost: ModuleCost) -> tuple[float, ...]:
    return cost.cpu_s, cost.peak_mb, cost.messages_in, cost.bytes_in, cost.messages_out, cost.bytes_out


def _by(a: float | None, b: float | None) -> float | None:
    return a / b if a is not None and b else None
