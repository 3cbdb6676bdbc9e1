"""The experiments as one HTML file that needs nothing else: figures beside the papers', and what happened on the way.

The first run of a scenario that left a record is shown in full, the others by their figures. Everything comes from the
folders of the runs (ride.json, record.json, frames/); the report names what is missing there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

from hitchhike_ros.core.errors import HitchhikeError, MessageError
from hitchhike_ros.experiments.report.report_map import MapPicture, data_uri, map_picture, replay
from hitchhike_ros.experiments.report.report_plots import (
    KINDS,
    Plot,
    RobotBars,
    TimeAxis,
    following_plots,
    robot_bars,
    state_text,
    time_axis,
)
from hitchhike_ros.experiments.report.ride_frames import CameraFrame, find_frames
from hitchhike_ros.experiments.report.ride_report import bound, label, number
from hitchhike_ros.experiments.report.tables import BAD, GOOD, Table, mark
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, load_record
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scoring.boxes import match_boxes
from hitchhike_ros.experiments.scoring.figures import Summary
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide, markers_of, network_rides
from hitchhike_ros.experiments.scoring.results import RunResult, ScenarioResult
from hitchhike_ros.experiments.scoring.ride_figures import MAX_BOX_ERROR_M
from hitchhike_ros.experiments.scoring.rides import module_changes
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.messages import Ack, Beacon, Driver, decode
from hitchhike_ros.simulation.world_file import WorldFile, load_world

NAME = "report.html"

# Messages that are sent all the time.
_REPEATED = (Beacon, Driver, Ack)
_MODULE_ON, _MODULE_OFF = "●", "○"


@dataclass(frozen=True)
class _FrameView:
    stamp: float
    caption: str
    uri: str


@dataclass(frozen=True)
class _Shown:
    """The run that is shown in full."""

    seed: int
    axis: TimeAxis
    robots: tuple[str, ...]
    map: MapPicture | None
    bars: tuple[RobotBars, ...]
    plots: tuple[Plot, ...]
    frames: tuple[_FrameView, ...]
    replay: dict[str, object]
    tables: tuple[Table, ...]
    log: Table
    endings: tuple[str, ...]


@dataclass(frozen=True)
class _RunView:
    seed: int
    ok: bool
    text: str
    files: tuple[tuple[str, str], ...]  # name and address within the report's folder


@dataclass(frozen=True)
class _Row:
    """One figure of a scenario: texts, whether its bound holds, and whether it stands in the summary: what a paper has
    too, and the shares that say what a ride saves."""

    name: str
    peer: str
    median: str
    worst: str
    ratio: str
    bound: str
    ok: bool | None
    seeds: tuple[str, ...]
    in_summary: bool


@dataclass(frozen=True)
class _Experiment:
    scenario: RideScenario
    ok: bool
    outcome: str
    ended: int
    rows: tuple[_Row, ...]
    runs: tuple[_RunView, ...]
    shown: _Shown | None
    missing: str  # why nothing is shown
    extras: tuple[Table, ...]
    command: str

    @property
    def summary(self) -> list[_Row]:
        """What is to be seen first."""
        return [row for row in self.rows if row.in_summary]


def write_report(
    folder: Path, results: Sequence[ScenarioResult], extras: Mapping[str, Sequence[Table]] | None = None
) -> Path:
    """Write ``report.html`` to ``folder``, in which the runs are.

    ``extras`` are by the name of a scenario; those of other names become sections of their own after the rides.
    """
    extras = extras or {}
    names = {result.scenario.name for result in results}
    experiments = [_experiment(folder, result, tuple(extras.get(result.scenario.name, ()))) for result in results]
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hitchhike_ros.experiments.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = environment.get_template("report.html").render(
        experiments=experiments,
        others={name: list(parts) for name, parts in extras.items() if name not in names},
        versions=_versions(results),
        command=_command([result.scenario.name for result in results], _seeds(results)),
        seeds=_seeds(results),
        kinds=KINDS,
        marks={GOOD: "good", BAD: "bad"},
    )
    path = folder / NAME
    path.write_text(text, encoding="utf-8")
    return path


def _experiment(folder: Path, result: ScenarioResult, extras: tuple[Table, ...]) -> _Experiment:
    shown, missing = None, "no run left a record"
    for run in result.runs:
        try:
            shown = _shown(run)
        except HitchhikeError as exc:
            missing = str(exc)
            continue
        break
    return _Experiment(
        scenario=result.scenario,
        ok=result.ok,
        outcome=_outcome(result, shown),
        ended=sum(run.ok for run in result.runs),
        rows=tuple(_row(summary, result.runs) for summary in result.figures),
        runs=tuple(_run_view(folder, run) for run in result.runs),
        shown=shown,
        missing=missing,
        extras=extras,
        command=_command([result.scenario.name], [run.seed for run in result.runs]),
    )


def _outcome(result: ScenarioResult, shown: _Shown | None) -> str:
    """How the scenario ended, in a few words."""
    failed = [run for run in result.runs if not run.ok]
    if failed:
        return f"{len(failed)} of {len(result.runs)} runs failed"
    if result.scenario.denial is not None:
        return f"denied, as it should be: {result.scenario.denial.reason}"
    if result.scenario.end == "lost":
        return "the driver was lost, as it should be"
    if result.scenario.end == "alone":
        return "driven alone"
    count = len(result.scenario.rides)
    return "ride completed" if count == 1 else f"{count} rides completed"


def _row(summary: Summary, runs: Sequence[RunResult]) -> _Row:
    seeds = []
    for run in runs:
        figure = next((f for f in run.figures if f.name == summary.name), None)
        seeds.append("–" if figure is None else number(figure.value, summary.unit, "–"))
    ratio = summary.value / summary.peer if summary.value is not None and summary.peer else None
    return _Row(
        label(summary),
        number(summary.peer, summary.unit),
        number(summary.value, summary.unit, "–"),
        number(summary.worst, summary.unit, "–"),
        "" if ratio is None else f"{ratio:.2f}",
        bound(summary),
        summary.ok,
        tuple(seeds),
        summary.peer is not None or (summary.bound is not None and summary.name.endswith("_ratio")),
    )


def _run_view(folder: Path, run: RunResult) -> _RunView:
    of_run = Path(run.folder)
    files = []
    maps = sorted(path.name for path in of_run.glob("*.bt"))
    for name in ("ride.bag", "ride.json", "record.json", "map.png", *maps, "log"):
        path = of_run / name
        if path.exists() and path.is_relative_to(folder):
            files.append((name, path.relative_to(folder).as_posix()))
    lasted = f"{run.sim_s:.0f} s simulated in {run.wall_s:.0f} s"
    return _RunView(run.seed, run.ok, run.trouble or f"ended as it should, {lasted}", tuple(files))


def _shown(run: RunResult) -> _Shown:
    """Everything of a run.

    Raises:
        HitchhikeError: it left no record, or one that cannot be read.
    """
    folder = Path(run.folder)
    record = load_record(folder / "record.json")
    world, grid = _world(folder)
    markers = markers_of(world) if world else {}
    rides = network_rides(record, markers) if markers else []
    axis = time_axis(record)
    tables = [*_box_tables(record, rides, grid), _module_table(record)]
    return _Shown(
        seed=run.seed,
        axis=axis,
        robots=tuple(record.robots),
        map=map_picture(record, rides, grid, world.sites if world else Sites()),
        bars=tuple(robot_bars(name, robot, axis) for name, robot in record.robots.items()),
        plots=tuple(following_plots(record, rides, markers, axis)),
        frames=tuple(_frame_view(frame) for frame in find_frames(folder)),
        replay=replay(record, axis),
        tables=tuple(table for table in tables if table.rows),
        log=_log(record),
        endings=tuple(_endings(record)),
    )


def _world(folder: Path) -> tuple[WorldFile | None, OccupancyGrid | None]:
    """The world that the run was in, and its map; None for what is no longer there."""
    for path in sorted(folder.glob("*.world.yaml")):
        try:
            world = load_world(path)
        except HitchhikeError:
            continue
        try:
            return world, load_map(world.map)
        except HitchhikeError:
            return world, None
    return None, None


def _frame_view(frame: CameraFrame) -> _FrameView:
    caption = f"{frame.stamp:.1f} s, {frame.robot}: {frame.state.replace('_', ' ')}"
    return _FrameView(frame.stamp, caption, data_uri(frame.path.read_bytes(), "image/jpeg"))


def _box_tables(record: RideRecord, rides: Iterable[NetworkRide], grid: OccupancyGrid | None) -> list[Table]:
    """The boxes in every rider's map beside the true ones (P17 Table 1)."""
    tables = []
    for name in dict.fromkeys(ride.hitchhiker for ride in rides):
        rows = []
        for match in match_boxes(record.true_boxes, record.robots[name].obstacles):
            true, found = match.true, match.found
            row = [true.id, f"{true.x:.2f}, {true.y:.2f}", f"{true.w:.2f} × {true.b:.2f}"]
            if found is None or match.place_m is None or match.size_m is None:
                rows.append([*row, "not found", "", "", "", "", mark(False)])
                continue
            pixels = f"{match.place_m / grid.resolution:.1f}" if grid is not None else ""
            well = max(match.place_m, match.size_m) <= MAX_BOX_ERROR_M
            row += [f"{found.x:.2f}, {found.y:.2f}", f"{found.w:.2f} × {found.b:.2f}", f"{match.place_m:.3f}"]
            rows.append([*row, pixels, f"{match.size_m:.3f}", mark(well)])
        extra = len(record.robots[name].obstacles) - sum(row[3] != "not found" for row in rows)
        note = f"{extra} more in its map that are in no place of a true one." if extra else ""
        header = ("true corner (m)", "size (m)", "handed over corner (m)", "size (m)")
        offs = ("place off (m)", "(map pixels)", "size off (m)", "")
        tables.append(Table(f"Boxes in {name}'s map beside the true ones", ("box", *header, *offs), rows, note))
    return tables


def _module_table(record: RideRecord) -> Table:
    changes = module_changes(record)
    names = [f for f in ("PP", "OBS", "LZN", "MAP", "COM", "VS") if changes and hasattr(changes[0].modules, f)]
    rows = [
        [f"{c.stamp:.1f}", c.robot, c.state.replace("_", " ")]
        + [_MODULE_ON if getattr(c.modules, name) else _MODULE_OFF for name in names]
        for c in changes
    ]
    note = f"{_MODULE_ON} on, {_MODULE_OFF} off, as P17 Table 3 and P18 Tables 3 and 4."
    return Table("Modules on and off", ("from (s)", "robot", "state", *names), rows, note)


def _log(record: RideRecord) -> Table:
    """The messages that the robots sent, without those that they send all the time; repetitions are counted."""
    rows: list[list[str]] = []
    counts: list[int] = []
    for sent in record.messages:
        try:
            message = decode(sent.text)
        except MessageError as exc:
            row = ["?", "", "unreadable", str(exc)]
        else:
            if isinstance(message, _REPEATED):
                continue
            row = [message.robot_id, message.to, message.type.replace("_", " "), str(getattr(message, "reason", ""))]
        if rows and rows[-1][1:] == row:
            counts[-1] += 1
        else:
            rows.append([f"{sent.stamp:.1f}", *row])
            counts.append(1)
    full = [[*row, str(count)] for row, count in zip(rows, counts, strict=True)]
    return Table("Messages", ("first (s)", "from", "to", "type", "reason", "times"), full)


def _endings(record: RideRecord) -> Iterable[str]:
    """Where each robot stood at the end."""
    for name, robot in record.robots.items():
        now = robot.newest_status
        if now is None:
            yield f"{name}: never heard of"
        elif robot.has_goal or now.state != "idle":
            yield f"{name}: {state_text(now)}" + (f" ({now.reason})" if now.reason else "")


def _versions(results: Iterable[ScenarioResult]) -> dict[str, str]:
    """Versions that the runs were driven with; several where they differ."""
    found: dict[str, dict[str, None]] = {}
    for run in (run for result in results for run in result.runs):
        for name, version in _ride_json(Path(run.folder)).get("versions", {}).items():
            found.setdefault(str(name), {})[str(version)] = None
    return {name: ", ".join(versions) for name, versions in found.items()}


def _ride_json(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / "ride.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _seeds(results: Iterable[ScenarioResult]) -> list[int]:
    return sorted({run.seed for result in results for run in result.runs})


def _command(names: Sequence[str], seeds: Sequence[int]) -> str:
    runs = f" --runs {len(seeds)}" if len(seeds) > 1 else ""
    seed = f" --seed {min(seeds)}" if seeds and min(seeds) else ""
    return f"rosrun hitchhike_ros experiments {' '.join(names)}{runs}{seed} --report DIR"
