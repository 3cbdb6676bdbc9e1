"""What a person reads of a ride: the line that lives while it runs, and the tables at its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from rich.progress_bar import ProgressBar
from rich.text import Text

from hitchhike_ros.core.datatypes import Obstacle
from hitchhike_ros.experiments.report.screen import FittedLine, Part
from hitchhike_ros.experiments.report.tables import Table, mark
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.boxes import BoxMatch
from hitchhike_ros.experiments.scoring.figures import Figure, Summary
from hitchhike_ros.experiments.scoring.node_costs import NodeCost
from hitchhike_ros.experiments.scoring.ride_figures import MAX_BOX_ERROR_M
from hitchhike_ros.experiments.scoring.rides import Ride
from hitchhike_ros.experiments.scoring.tracks import gap_now
from hitchhike_ros.protocol.status import ModuleSwitches

ARRIVED = "Arrived"
"""The step at which every robot is at its goal."""
_STEPS = {
    "requesting": "Asking for a ride",
    "locking": "Taking the offer",
    "awaiting_aligned": "Driver aligns",
    "coupling": "Coupling",
    "riding": "Riding",
    "settling": "Handing over",
    "relocalizing": "Taking over the pose",
}
_RIDING_STEPS = {"waiting_for_rider": "Driver waits for rider", "decoupling": "Handing over"}
_STEP_WIDTH = max(len(step) for step in (*_STEPS.values(), *_RIDING_STEPS.values()))
_BAR_WIDTH = 20

_DECIMALS = {"s": 1, "%": 1, "m": 3, "s/s": 3, "deg": 2, "sigma": 2, "points": 2}


@dataclass(frozen=True)
class RideProgress:
    """Where a run stands now; None for what is not known, or is not at hand at this step."""

    step: str
    ridden_m: float | None = None
    ride_m: float | None = None
    gap_m: float | None = None
    rider: str = ""
    modules: ModuleSwitches | None = None
    sim_s: float | None = None
    real_time_factor: float | None = None


def progress(record: RideRecord, ride: Ride | None, real_time_factor: float | None) -> RideProgress:
    """Where the run stands, from the newest of everything recorded."""
    sim_s = record.lasted[0] if record.clock else None
    if ride is None:
        if all(robot.arrived for robot in record.robots.values()):
            return RideProgress(ARRIVED, sim_s=sim_s, real_time_factor=real_time_factor)
        started = any(robot.newest_status is not None for robot in record.robots.values())
        return RideProgress("Waiting for a request" if started else "Starting", None, sim_s=sim_s)
    rider = record.robots[ride.hitchhiker].newest_status
    driver = record.robots[ride.driver].newest_status if ride.driver is not None else None
    step = "Driving on alone"
    if rider is not None and rider.role == "hitchhiker":
        step = _STEPS.get(rider.state, rider.state)
        if rider.state == "riding" and driver is not None:
            step = _RIDING_STEPS.get(driver.state, step)
    elif all(robot.arrived for robot in record.robots.values()):
        step = ARRIVED
    reported = driver.ride if driver is not None else None
    aboard = ride.riding_at is not None and ride.released_at is None
    return RideProgress(
        step=step,
        ridden_m=reported.ridden_m if reported is not None and aboard else None,
        ride_m=reported.ride_m if reported is not None and aboard else None,
        gap_m=gap_now(record, ride) if ride.aligning_at is not None and ride.released_at is None else None,
        rider=ride.hitchhiker,
        modules=rider.modules if rider is not None else None,
        sim_s=sim_s,
        real_time_factor=real_time_factor,
    )


def live_line(now: RideProgress) -> FittedLine:
    """Where the run stands, in one line."""
    parts = [Part(Text(now.step.ljust(_STEP_WIDTH), "bold"), 0)]
    if now.ridden_m is not None and now.ride_m:
        parts.append(Part(ProgressBar(now.ride_m, now.ridden_m, width=_BAR_WIDTH), 7))
        parts.append(Part(Text(f"{now.ridden_m:4.1f}/{now.ride_m:.1f} m"), 1))
    if now.gap_m is not None:
        parts.append(Part(Text.assemble(("gap ", "dim"), f"{now.gap_m:.2f} m"), 2))
    if now.modules is not None:
        parts.append(Part(Text(now.rider, "dim"), 6))
        parts.append(Part(_module_text(now.modules), 3))
    if now.sim_s is not None:
        parts.append(Part(Text(f"{now.sim_s:.1f} s", "dim"), 5))
    if now.real_time_factor is not None:
        parts.append(Part(Text(f"{now.real_time_factor:.2f}×", "dim"), 4))
    return FittedLine(parts)


def change(now: RideProgress) -> str:
    """What makes the line worth a line of its own where it is not rewritten: the step and the modules."""
    return f"{now.step} {'' if now.modules is None else module_names(now.modules)}"


def module_names(modules: ModuleSwitches) -> str:
    """Modules that are on in capitals, the others in small letters: ``pp obs lzn map COM VS``."""
    return " ".join(name if on else name.lower() for name, on in asdict(modules).items())


def figure_table(figures: Sequence[Figure], peer: str = "paper", title: str = "Figures") -> Table:
    """Every figure beside its peer's, which are the paper's unless ``peer`` names others, with its bound."""
    rows: list[list[str]] = [
        [
            label(figure),
            number(figure.value, figure.unit, missing="–"),
            number(figure.peer, figure.unit),
            f"{figure.ratio:.2f}" if figure.ratio is not None else "",
            bound(figure),
            mark(figure.ok),
        ]
        for figure in figures
    ]
    return Table(title, ["", "ours", peer, "ratio", "bound", ""], rows)


def box_table(matches: Sequence[BoxMatch]) -> Table:
    """True boxes beside those of the hitchhiker's map: corner, width × breadth, in metres."""
    rows: list[list[str]] = []
    for match in matches:
        ok = (
            None not in (match.place_m, match.size_m)
            and max(match.place_m or 0.0, match.size_m or 0.0) <= MAX_BOX_ERROR_M
        )
        rows.append(
            [
                match.true.id,
                _box(match.true),
                _box(match.found) if match.found is not None else "not found",
                number(match.place_m, "m"),
                number(match.size_m, "m"),
                mark(ok),
            ]
        )
    return Table("Boxes", ["", "true (m)", "hitchhiker's map", "place off", "size off", ""], rows)


def cpu_table(costs: Sequence[NodeCost]) -> Table:
    """CPU of each node: seconds in all, then percent of a core by simulated time in each phase."""
    phases = list(dict.fromkeys(phase for cost in costs for phase in cost.phases))
    rows: list[list[str]] = []
    for cost in costs:
        shares = [cost.phases.get(phase) for phase in phases]
        percents = ["" if use is None else f"{100.0 * use.cpu_s / use.sim_s:.1f} %" for use in shares]
        rows.append([cost.node, f"{cost.cpu_s:.1f} s", *percents, f"{cost.memory_mb:.0f} MB"])
    return Table("CPU", ["", "in all", *phases, "memory"], rows)


def summary_table(summaries: Sequence[Summary], seeds: Sequence[int]) -> Table:
    """Every figure over several runs."""
    rows: list[list[str]] = [
        [
            label(summary),
            number(summary.value, summary.unit, missing="–"),
            number(summary.worst, summary.unit, missing="–"),
            number(summary.peer, summary.unit),
            bound(summary),
            mark(summary.ok),
            f"{summary.runs - summary.failed}/{summary.runs}" if summary.bound is not None else "",
        ]
        for summary in summaries
    ]
    title = f"{len(seeds)} runs, seeds {', '.join(str(seed) for seed in seeds)}"
    return Table(title, ["", "median", "worst", "paper", "bound", "", "held"], rows)


def _module_text(modules: ModuleSwitches) -> Text:
    names = [(name, "cyan") if on else (name.lower(), "dim") for name, on in asdict(modules).items()]
    return Text(" ").join(Text(*name) for name in names)


def label(figure: Figure | Summary) -> str:
    """A figure's name with its unit, to be read."""
    return figure.name.replace("_", " ") + (f" ({figure.unit})" if figure.unit else "")


def number(value: float | None, unit: str, missing: str = "") -> str:
    """A value with as many decimals as its unit deserves."""
    if value is None:
        return missing
    return f"{value:.{_DECIMALS.get(unit, 0 if float(value).is_integer() else 2)}f}"


def bound(figure: Figure | Summary) -> str:
    """``≤ 0.1`` or ``≥ 3``, nothing where there is no bound."""
    if figure.bound is None:
        return ""
    return f"{'≤' if figure.better == 'lower' else '≥'} {figure.bound:g}"


def _box(box: Obstacle) -> str:
    return f"{box.x:5.2f} {box.y:5.2f}  {box.w:.2f} × {box.b:.2f}"
