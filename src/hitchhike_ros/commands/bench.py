"""Measures what the package does, with peers beside it in the same run where there are any.

Needs no ROS master.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import msgspec
import rospkg

from hitchhike_ros.commands.command_line import (
    SETTINGS,
    check_option,
    folder_option,
    help_of,
    json_option,
    run,
    seed_option,
)
from hitchhike_ros.commands.scenario_runs import drive_unseen
from hitchhike_ros.experiments.bench.registry import BENCHMARKS, Options, load
from hitchhike_ros.experiments.report.ride_report import figure_table
from hitchhike_ros.experiments.report.screen import ProgressBars, console, show
from hitchhike_ros.experiments.report.versions import versions
from hitchhike_ros.experiments.scoring.figures import Figure, all_hold

_NAMES = "\b\nBenchmarks:\n" + "\n".join(f"  {name:<14}{what}" for name, what in BENCHMARKS.items())


def _benchmarks(_context: click.Context, _parameter: click.Parameter, words: tuple[str, ...]) -> tuple[str, ...]:
    """Names of benchmarks, of one word or two."""
    names, rest = [], list(words)
    while rest:
        name = next((name for name in (" ".join(rest[:2]), rest[0]) if name in BENCHMARKS), None)
        if name is None:
            raise click.BadParameter(f"{rest[0]!r} is not one of {', '.join(repr(name) for name in BENCHMARKS)}.")
        names.append(name)
        del rest[: len(name.split())]
    return tuple(names)


@click.command("bench", help=help_of(__doc__), epilog=_NAMES, context_settings=SETTINGS)
@click.argument("names", nargs=-1, required=True, callback=_benchmarks, metavar="NAME...")
@json_option
@folder_option("--output", default="runs/bench", text="Folder for pictures, and for what each run came to.")
@click.option(
    "--data",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Third-party data.  [default: ../shared/data beside the package]",
)
@seed_option
@click.option(
    "--seeds",
    metavar="N",
    type=click.IntRange(min=1),
    help="So many, where a benchmark has seeds to choose from.  [default: 10000 of faults, 20000 of fuzz files, 5 of "
    "cost]",
)
@click.option("--quick", is_flag=True, help="Fewer seeds and smaller sizes, to see that it works.")
@check_option
def command(
    names: tuple[str, ...],
    json_file: Path | None,
    output: Path,
    data: Path | None,
    seed: int,
    seeds: int | None,
    quick: bool,
    check: bool,
) -> int:
    """Run benchmarks one after the other and print their figures."""
    package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
    data = data or package.parent / "shared" / "data"
    options = Options(package, data, output, seed, quick, seeds, drive_unseen)
    figures: dict[str, list[Figure]] = {}
    screen, progress = console(), ProgressBars(console(sys.stderr))
    for name in names:
        with progress:
            findings = load(name).run(options, progress)
        figures[name] = list(findings.figures)
        screen.print(name)
        show(screen, *findings.tables, figure_table(figures[name], "peer"))
    if json_file is not None:
        report = {"versions": versions(package), "seed": seed, "quick": quick, "figures": figures}
        json_file.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2))
    return 1 if check and not all(all_hold(found) for found in figures.values()) else 0


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros bench``."""
    run(command)
