"""What the report shows over time: bars of states and modules, in percent of a picture that stretches, and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from markupsafe import Markup

from hitchhike_ros.experiments.report.curves import SIZES, Series, curves_svg, round_values
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide
from hitchhike_ros.experiments.scoring.tracks import distances_from_trail, gap_errors, poses_at, trail_of
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.status import Status

# What a phase is about, by which bars are coloured; "trouble" is a ride that hangs.
TROUBLE = "trouble"
_KIND_OF = {
    Phase.ALONE: "alone",
    Phase.ASKING: "arranging",
    Phase.MEETING: "coupling",
    Phase.COUPLING: "coupling",
    Phase.COUPLED: "riding",
    Phase.HANDING_OVER: "handing over",
    Phase.PARTING: "handing over",
    Phase.RETURNING: TROUBLE,
}
# A ride that hangs although both are coupled.
_HANGING = (HitchhikerState.SEEKING.value, DriverState.WAITING_FOR_RIDER.value)
KINDS = ("idle", *dict.fromkeys(_KIND_OF.values()))

_TICKS = 10  # at most about so many on the axis of time
_LATERAL_POINTS = 200  # of a curve, as each costs a search


@dataclass(frozen=True)
class AxisTick:
    """A place on an axis, in percent from its beginning."""

    percent: float
    text: str


@dataclass(frozen=True)
class Bar:
    """From ``left`` on ``width`` percent of the axis; ``text`` in it, and ``title`` when it is pointed at."""

    left: float
    width: float
    text: str
    kind: str
    title: str


@dataclass(frozen=True)
class TimeAxis:
    """Simulated seconds from ``start`` to ``end``."""

    start: float
    end: float

    @property
    def span(self) -> float:
        return max(self.end - self.start, 1e-9)

    def percent(self, stamp: float) -> float:
        return round(100.0 * min(max((stamp - self.start) / self.span, 0.0), 1.0), 3)

    @property
    def ticks(self) -> list[AxisTick]:
        return [AxisTick(self.percent(t), f"{t:g}") for t in round_values(self.start, self.end, _TICKS)]

    def bar(self, begin: float, end: float, text: str, kind: str) -> Bar:
        left = self.percent(begin)
        width = round(self.percent(end) - left, 3)
        return Bar(left, width, text, kind, f"{text}, {begin:.1f} s to {end:.1f} s")


@dataclass(frozen=True)
class RobotBars:
    """What one robot did over time, and which of its modules were on (P17 Table 3)."""

    robot: str
    states: tuple[Bar, ...]
    modules: tuple[tuple[str, tuple[Bar, ...]], ...]


@dataclass(frozen=True)
class Plot:
    """Curves over the time axis of their run, a picture for each size of the page, and whose each curve is."""

    title: str
    pictures: dict[str, Markup]
    legend: tuple[tuple[str, int], ...]  # label and number of the robot


def time_axis(record: RideRecord) -> TimeAxis:
    """From the first to the last thing that is known of any robot."""
    stamps = [p.stamp for robot in record.robots.values() for p in (*robot.truth[:1], *robot.truth[-1:])]
    stamps += [s.time_stamp for robot in record.robots.values() for s in robot.statuses]
    return TimeAxis(min(stamps), max(stamps)) if stamps else TimeAxis(0.0, 1.0)


def robot_bars(name: str, robot: RobotRecord, axis: TimeAxis) -> RobotBars:
    """Bars of one robot: each state until the next, each module while it is on."""
    ends = [*(s.time_stamp for s in robot.statuses[1:]), axis.end]
    spans = list(zip(robot.statuses, ends, strict=False))
    states: list[tuple[float, float, Status]] = []
    for status, end in spans:
        if states and (states[-1][2].role, states[-1][2].state) == (status.role, status.state):
            states[-1] = (states[-1][0], end, states[-1][2])
        else:
            states.append((status.time_stamp, end, status))
    bars = tuple(axis.bar(a, b, state_text(s), _kind(s)) for a, b, s in states)
    modules = list(asdict(robot.statuses[0].modules)) if robot.statuses else []
    return RobotBars(name, bars, tuple((module, _module_bars(module, spans, axis)) for module in modules))


def state_text(status: Status) -> str:
    """A state to be read: ``awaiting aligned``."""
    return status.state.replace("_", " ")


def _kind(status: Status) -> str:
    if status.state in _HANGING:
        return TROUBLE
    return "idle" if status.state == "idle" else _KIND_OF[status.phase]


def _module_bars(module: str, spans: Sequence[tuple[Status, float]], axis: TimeAxis) -> tuple[Bar, ...]:
    on: list[tuple[float, float]] = []
    for status, end in spans:
        if not getattr(status.modules, module):
            continue
        if on and on[-1][1] == status.time_stamp:
            on[-1] = (on[-1][0], end)
        else:
            on.append((status.time_stamp, end))
    return tuple(axis.bar(a, b, f"{module} on", "module") for a, b in on)


def following_plots(
    record: RideRecord, rides: Sequence[NetworkRide], markers: Mapping[int, str], axis: TimeAxis
) -> list[Plot]:
    """The gap's error and the lateral error of every rider over time, against ground truth."""
    gaps, laterals = [], []
    for ride in rides:
        for ahead, window in _followed(record, ride, markers, axis.end):
            robot = record.robots[ride.hitchhiker]
            index = list(record.robots).index(ride.hitchhiker)
            label = f"{ride.hitchhiker} behind {ahead}"
            stamps = np.array(sorted(p.stamp for p in robot.truth if window[0] <= p.stamp <= window[1]))
            errors = gap_errors(record.robots[ahead], robot, window)
            if len(errors) and len(errors) == len(stamps):
                gaps.append(Series(label, index, stamps, errors))
            laterals.append(_lateral(label, index, record.robots[ahead], robot, window))
    plots = (
        _plot("Error of the gap (true distance − ordered), in m", gaps, axis),
        _plot("Lateral error (distance from the trail of the robot ahead), in m", laterals, axis),
    )
    return [plot for plot in plots if plot is not None]


def _followed(
    record: RideRecord, ride: NetworkRide, markers: Mapping[int, str], last: float
) -> list[tuple[str, tuple[float, float]]]:
    """Which robots were ahead during a ride, and from when to when."""
    end = next((t for t in (ride.settled_at, ride.released_at) if t is not None), last)
    statuses = [s for s in record.robots[ride.hitchhiker].statuses if ride.riding_at <= s.time_stamp < end]
    ends = [*(s.time_stamp for s in statuses[1:]), end]
    found: list[tuple[str, tuple[float, float]]] = []
    for status, until in zip(statuses, ends, strict=True):
        ahead = markers.get(status.servo.marker_id) if status.servo is not None else None
        if ahead is None or ahead not in record.robots:
            continue
        if found and found[-1][0] == ahead and found[-1][1][1] == status.time_stamp:
            found[-1] = (ahead, (found[-1][1][0], until))
        else:
            found.append((ahead, (status.time_stamp, until)))
    return found


def _lateral(label: str, index: int, ahead: RobotRecord, robot: RobotRecord, window: tuple[float, float]) -> Series:
    """Distance from the trail that the robot ahead has left since ``window`` began."""
    stamps = np.linspace(*window, _LATERAL_POINTS)
    if not robot.truth or not ahead.truth:
        return Series(label, index, np.empty(0), np.empty(0))
    trail = trail_of(ahead.truth, window)
    points = poses_at(robot.truth, stamps)[:, :2]
    # A point before the trail's start has no distance, and so no value.
    distances = [distances_from_trail(point[None], trail) for point in points]
    return Series(label, index, stamps, np.array([d[0] if len(d) else np.nan for d in distances]))


def _plot(title: str, series: Sequence[Series], axis: TimeAxis) -> Plot | None:
    drawn = [one for one in series if np.isfinite(one.values).any()]
    if not drawn:
        return None
    pictures = {name: curves_svg(drawn, (axis.start, axis.end), size, title) for name, size in SIZES.items()}
    return Plot(title, pictures, tuple((one.label, one.index) for one in drawn))
