"""Benchmark of fleets in one grid world: what they cost to simulate, how that grows, and when hitchhiking pays.

All sizes drive the trips of ``maps/fleet.scenario.yaml`` in the same building, so that more robots are also nearer to
each other; a trip is compared with the same one of the same robot where riding is forbidden. Times are the processor's,
of the one thread that simulates. Riding *pays* where modules (P17 Table 3: PP, OBS, LZN, MAP) are off for longer than
everybody, the drivers included, is late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Picture

from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.report.screen import text_of
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.scenarios.fleet_runs import FleetRun, FleetTrip, run_fleet
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import write_results
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.simulation.grid.drawing import Recorder, animate, draw_state
from hitchhike_ros.simulation.grid.scenario import Scenario, build, load_scenario

_SIZES, _QUICK_SIZES = (10, 30, 100, 300, 1000), (10, 100)
_QUICK_S = 700.0
_LARGEST, _LEAST_FACTOR = 1000, 20.0
# Growth is fitted from this size on: below, most robots are alone, and nothing grows with what is not there (chosen).
_CROWD = 100
# Trips by the metres that they take alone (chosen).
_LENGTHS_M = ((0.0, 70.0), (70.0, 100.0), (100.0, np.inf))
_PICTURE_ROBOTS, _PICTURE_S, _GIF_S, _GIF_PERIOD_S = 100, 400.0, 120.0, 2.0


def run(options: Options, progress: Progress) -> Findings:
    """All figures; tables, plots and pictures are ``fleet*`` in the output folder.

    Raises:
        WorldFileError: the scenario cannot be used.
    """
    scenario = load_scenario(options.package / "maps" / "fleet.scenario.yaml").seeded(options.seed)
    if options.quick:
        scenario = replace(scenario, duration_s=_QUICK_S)
    runs = []
    for size in _QUICK_SIZES if options.quick else _SIZES:
        runs.append(run_fleet(scenario.sized(size), progress))
    write_results(options.output / "fleet_trips.json", {str(r.robots): r.trips for r in runs})
    tables = _tables(runs)
    (options.output / "fleet.txt").write_text(text_of(*tables) + "\n", encoding="utf-8")
    _draw(options.output / "fleet.png", runs)
    if not options.quick:
        _show(options.output, scenario.sized(_PICTURE_ROBOTS), progress)
    return Findings(_figures(runs), tables)


def _figures(runs: Sequence[FleetRun]) -> list[Figure]:
    figures = []
    for r in runs:
        name, bound = f"fleet_{r.robots}", _LEAST_FACTOR if r.robots == _LARGEST else None
        figures += [
            Figure(f"{name}_real_time_factor", r.real_time_factor, "", bound, "higher"),
            Figure(f"{name}_processor_per_robot_second", r.processor_us, "µs"),
            Figure(f"{name}_robots_in_range", r.in_range, "robots"),
            Figure(f"{name}_messages_sent", r.sent, "1/s"),
            Figure(f"{name}_messages_received", r.received, "1/s"),
            Figure(f"{name}_rides", r.rides, "rides"),
            Figure(f"{name}_ridden_share", 100.0 * r.ridden_share, "%"),
            Figure(f"{name}_delay_mean", r.delay_s, "s"),
            Figure(f"{name}_modules_on", 100.0 * modules_on(r.trips), "%"),
            Figure(f"{name}_failed_trips", r.failed, "trips", 0.0),
        ]
    crowds = [r for r in runs if r.robots >= _CROWD]
    if len(crowds) > 1:
        in_range = [r.in_range for r in crowds]
        for name, values in (
            ("processor_growth_exponent", [r.processor_us for r in crowds]),
            ("received_growth_exponent", [r.received for r in crowds]),
            ("sent_growth_exponent", [r.sent for r in crowds]),
        ):
            figures.append(Figure(name, growth(in_range, values), "exponent", 1.0))
    return figures


def growth(x: Sequence[float], y: Sequence[float]) -> float:
    """The k of y ~ x^k that fits best."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def modules_on(trips: Sequence[FleetTrip]) -> float:
    """Time under way with the own modules on, as a share of that where riding is forbidden; below 1 riding pays."""
    alone = sum(trip.alone_s for trip in trips)
    return sum(trip.took_s - trip.coupled_s for trip in trips) / alone if alone else 1.0


def _tables(runs: Sequence[FleetRun]) -> list[Table]:
    costs: list[list[str]] = [
        [
            f"{r.robots} robots",
            f"{r.real_time_factor:.0f} ×",
            f"{r.processor_us:.0f} µs",
            f"{r.in_range:.1f}",
            f"{r.sent:.2f} /s",
            f"{r.received:.2f} /s",
            f"{r.rides}",
            f"{100.0 * r.ridden_share:.1f} %",
            f"{r.delay_s:+.1f} s",
            f"{100.0 * modules_on(r.trips):.1f} %",
        ]
        for r in runs
    ]
    head = ["", "real time", "per robot s", "in range", "sent", "received", "rides", "ridden", "delay", "modules on"]
    pays: list[list[str]] = []
    for low, high in _LENGTHS_M:
        for r in runs:
            trips = [trip for trip in r.trips if low <= trip.metres < high]
            if not trips:
                continue
            riders = [trip for trip in trips if trip.ridden_m > 0.0]
            driven = sum(trip.driven_m for trip in trips)
            ridden = sum(trip.ridden_m for trip in trips)
            off, late = sum(trip.coupled_s for trip in trips), sum(trip.delay_s for trip in trips)
            label = f"from {low:g} m" if np.isinf(high) else f"{low:g} m to {high:g} m"
            pays.append(
                [
                    f"{label}, {r.robots} robots",
                    f"{len(trips)}",
                    f"{100.0 * len(riders) / len(trips):.0f} %",
                    f"{100.0 * ridden / driven:.1f} %",
                    f"{late / len(trips):+.1f} s",
                    f"{np.mean([t.delay_s for t in riders]):+.1f} s" if riders else "",
                    f"{100.0 * modules_on(trips):.1f} %",
                    "" if not riders else "pays" if off > late else "does not pay",
                ]
            )
    columns = ["", "trips", "with a ride", "ridden", "delay", "riders' delay", "modules on", ""]
    return [Table("Fleets", head, costs), Table("When riding pays: trips of", columns, pays)]


def _draw(path: Path, runs: Sequence[FleetRun]) -> None:
    picture = Picture(figsize=(14.0, 4.4), layout="constrained")
    speed, load, gain = picture.subplots(1, 3)
    sizes = [r.robots for r in runs]
    speed.loglog(sizes, [r.real_time_factor for r in runs], "o-", color="C0")
    speed.axhline(_LEAST_FACTOR, color="0.4", linestyle="--", linewidth=1, label=f"{_LEAST_FACTOR:g} × real time")
    speed.set(xlabel="robots", ylabel="× real time", title="One grid world on one core")
    speed.set_xticks(sizes, [str(size) for size in sizes])
    speed.legend(frameon=False)
    in_range = [r.in_range for r in runs]
    load.loglog(in_range, [r.received for r in runs], "o-", color="C0", label="messages received (1/s)")
    load.loglog(in_range, [r.sent for r in runs], "s-", color="C2", label="messages sent (1/s)")
    load.loglog(in_range, [r.processor_us / 10.0 for r in runs], "^-", color="C1", label="processor time (10 µs/s)")
    ends = np.array([in_range[0], in_range[-1]])
    load.loglog(ends, runs[-1].received * ends / ends[1], ":", color="0.5", label="as robots in range")
    load.set(xlabel="robots in radio range", ylabel="of a robot", title="What a robot costs")
    load.legend(frameon=False, fontsize=8)
    gain.semilogx(sizes, [100.0 * r.ridden_share for r in runs], "o-", color="C1", label="metres ridden (%)")
    gain.semilogx(sizes, [100.0 * modules_on(r.trips) for r in runs], "s-", color="C2", label="modules on (%)")
    gain.semilogx(sizes, [r.delay_s for r in runs], "^-", color="C3", label="delay of a trip (s)")
    gain.axhline(100.0, color="0.4", linestyle="--", linewidth=1)
    gain.set(xlabel="robots", title="What riding gains and costs")
    gain.set_xticks(sizes, [str(size) for size in sizes])
    gain.legend(frameon=False, fontsize=8)
    for axes in (speed, load, gain):
        axes.grid(True, which="both", alpha=0.25)
    FigureCanvasAgg(picture).print_png(str(path))


def _show(folder: Path, scenario: Scenario, progress: Progress) -> None:
    """A fleet as picture and animation."""
    world = build(scenario)
    world.run(_PICTURE_S)
    draw_state(folder / "fleet_state.png", world, "Fleet")
    recorder = Recorder(world, _GIF_PERIOD_S)
    world.run(_PICTURE_S + _GIF_S)
    progress("animation", 0, 1)
    animate(folder / "fleet_ride.gif", world, recorder.frames, "Fleet")
    progress("animation", 1, 1)
