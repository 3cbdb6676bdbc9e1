"""The cost ledger as a person reads it."""

from __future__ import annotations

from collections.abc import Sequence

from hitchhike_ros.experiments.report.ride_report import figure_table
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.cost_ledger import (
    Comparison,
    ModuleCost,
    Stretch,
    compare,
    cost_figures,
    ride_steps,
)
from hitchhike_ros.experiments.scoring.rides import find_ride


def ledger(ridden: RideRecord, alone: RideRecord) -> list[Table]:
    """The whole ledger of a ride beside the same way alone, a table each."""
    ride, comparisons = find_ride(ridden), compare(ridden, alone)
    parts = [figure_table(cost_figures(ridden, alone), title="What the ride saves")]
    parts += [comparison_table(comparison) for comparison in comparisons]
    for comparison in comparisons[-1:]:
        parts.append(ledger_table(comparison.rider.modules, "With the ride, from goal to goal"))
        parts.append(ledger_table(comparison.alone.modules, "Alone, from goal to goal"))
    if ride is not None:
        parts.append(steps_table(ride_steps(ridden, ride)))
    return parts


def ledger_table(costs: Sequence[ModuleCost], title: str = "Costs") -> Table:
    """One line a robot and module: CPU, memory at most, messages and bytes in and out."""
    rows: list[list[str]] = [[f"{c.robot}/{c.module}" if c.robot else c.module, *_cells(c)] for c in costs]
    return Table(title, ["", "CPU", "peak", "messages in", "in", "messages out", "out"], rows)


def steps_table(steps: Sequence[Stretch]) -> Table:
    """What each part of the run cost: seconds and metres, CPU, CPU a metre, and what went in and out."""
    rows: list[list[str]] = [
        [
            step.name,
            f"{step.seconds:.1f} s",
            f"{step.metres:.2f} m",
            f"{step.total.cpu_s:.2f} s",
            "" if step.cpu_s_per_metre is None or step.metres < 1.0 else f"{step.cpu_s_per_metre:.3f}",
            f"{100.0 * step.total.cpu_s / step.seconds:.1f} %",
            f"{step.total.bytes_in / 1e6:.1f} MB",
            f"{step.total.bytes_out / 1e6:.2f} MB",
        ]
        for step in steps
    ]
    header = ["", "time", "way", "CPU", "CPU s/m", "of a core", "in", "out"]
    return Table("Parts of the run", header, rows)


def comparison_table(comparison: Comparison) -> Table:
    """Each module as a rider beside alone: CPU seconds a metre and their ratio, bytes in."""
    rider, alone = comparison.rider, comparison.alone
    names = list(dict.fromkeys(cost.module for part in (rider, alone) for cost in part.modules))
    rows: list[list[str]] = []
    for name in names:
        pair = [(part.module(name), part.metres) for part in (rider, alone)]
        rows.append([name, *_compared(pair, comparison.module_ratio(name))])
    rows.append(["all", *_compared([(part.total, part.metres) for part in (rider, alone)], comparison.ratio)])
    title = f"{comparison.name}: {rider.metres:.1f} m ridden, {alone.metres:.1f} m alone"
    return Table(title, ["", "rider s/m", "alone s/m", "ratio", "rider kB/m", "alone kB/m"], rows)


def _compared(pair: Sequence[tuple[ModuleCost | None, float]], ratio: float | None) -> list[str]:
    seconds = ["" if cost is None or not metres else f"{cost.cpu_s / metres:.4f}" for cost, metres in pair]
    kilobytes = ["" if cost is None or not metres else f"{cost.bytes_in / metres / 1e3:.1f}" for cost, metres in pair]
    return [*seconds, "" if ratio is None else f"{ratio:.2f}", *kilobytes]


def _cells(cost: ModuleCost) -> list[str]:
    return [
        f"{cost.cpu_s:.2f} s",
        f"{cost.peak_mb:.0f} MB",
        f"{cost.messages_in:.0f}",
        f"{cost.bytes_in / 1e6:.2f} MB",
        f"{cost.messages_out:.0f}",
        f"{cost.bytes_out / 1e6:.2f} MB",
    ]
