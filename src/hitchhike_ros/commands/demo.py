"""usage: launch_scripts/demo [--world FILE] [--seed N] [--runs N] [--output DIR] [--rviz auto|true|false] [--json FILE]
                           [--check] [--help]

Drives the ride of P17 Experiment 1 in simulation, through real ROS nodes: shows it in one line while it runs, then
prints its figures beside the paper's. Needs no ROS master: it starts one of its own on a free port, and Ctrl-C ends
everything that it started.

A ride leaves ride.json (figures, boxes, CPU, modules over time), record.json (all that was recorded, for scoring it
again), map.png, ride.bag (every topic but images), awards.sqlite (what the driver earned; rosrun hitchhike_ros awards
reads it) and log/ (of roslaunch and of every node).

Exit status: 0 when every ride was completed, 1 when not, 2 for wrong usage, 130 after Ctrl-C.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import click
import msgspec
import rospkg

from hitchhike_ros.commands.command_line import (
    SETTINGS,
    check_option,
    help_of,
    json_option,
    run,
    runs_option,
    seed_option,
    writable,
)
from hitchhike_ros.commands.launches import RideProcesses
from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.report.ride_files import SUMMARY
from hitchhike_ros.experiments.report.ride_report import summary_table
from hitchhike_ros.experiments.report.screen import console, show
from hitchhike_ros.experiments.scoring.figures import Figure, summarize
from hitchhike_ros.simulation.world_file import WorldFile, load_world


@dataclass(frozen=True)
class DemoOptions:
    """What is driven: which world, with which seeds, and where it is left."""

    world: WorldFile
    seeds: range
    output: Path
    rviz: bool
    check: bool


@click.command("demo", help=help_of((__doc__ or "").partition("\n\n")[2]), context_settings=SETTINGS)
@click.option(
    "--world",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="World file.  [default: maps/p17_exp1.world.yaml]",
)
@seed_option
@runs_option("So many rides with seeds N, N + 1, …, and a table over all of them.")
@click.option(
    "--output",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for what a ride leaves; with several, one folder each inside it.  [default: runs/DATE-TIME]",
)
@click.option(
    "--rviz",
    type=click.Choice(["auto", "true", "false"]),
    default="auto",
    show_default=True,
    help="Show it in rviz; auto: when there is a display and rviz.",
)
@json_option
@check_option
def command(
    world: Path | None, seed: int, runs: int, output: Path | None, rviz: str, json_file: Path | None, check: bool
) -> int:
    """Drive rides one after the other and say how they went."""
    default = Path(rospkg.RosPack().get_path("hitchhike_ros")) / "maps" / "p17_exp1.world.yaml"
    folder = writable((output or Path("runs") / time.strftime("%Y-%m-%d-%H%M%S")).resolve())
    shows = rviz == "true" or (rviz == "auto" and bool(os.environ.get("DISPLAY")) and shutil.which("rviz") is not None)
    options = DemoOptions(load_world((world or default).resolve()), range(seed, seed + runs), folder, shows, check)
    reports, well = _drive(options)
    _summarize(options, reports, json_file)
    return 0 if well else 1


def _drive(options: DemoOptions) -> tuple[list[dict[str, Any]], bool]:
    """What the rides have left to be read, and whether all went well."""
    reports: list[dict[str, Any]] = []
    well, count = True, len(options.seeds)
    for i, seed in enumerate(options.seeds):
        folder = options.output if count == 1 else options.output / f"seed-{seed}"
        which = f"Ride {i + 1} of {count}: " if count > 1 else ""
        print(f"{which}{options.world.path.name}, seed {seed}, logs in {_shown(folder / 'log')}", flush=True)
        failure = ""
        monitor = {"check": options.check, "tables": count == 1}
        with RideProcesses(options.world, seed, folder, {"rviz": options.rviz}, monitor) as ride:
            try:
                well &= ride.run() == 0
            except HitchhikeError as exc:
                failure = f"Failed: {exc}"
        report = folder / SUMMARY
        if report.is_file():
            reports.append(json.loads(report.read_bytes()))
        if failure or not report.is_file() or not reports[-1]["completed"]:
            well = False
            print("\n".join(line for line in (failure, *ride.trouble(), f"Logs: {ride.logs}") if line), file=sys.stderr)
    return reports, well


def _summarize(options: DemoOptions, reports: Sequence[dict[str, Any]], json_file: Path | None) -> None:
    """The table over several runs, and the JSON."""
    runs = [msgspec.convert(report["figures"], list[Figure]) for report in reports]
    completed, count = sum(report["completed"] for report in reports), len(options.seeds)
    figures: Sequence[object] = runs[0] if len(runs) == count == 1 else summarize(runs)
    if count > 1 and runs:
        print(f"\n{completed} of {count} rides completed\n", flush=True)
        show(console(), summary_table(summarize(runs), [report["seed"] for report in reports]))
    if json_file is not None:
        content = {
            "world": options.world.path.name,
            "seeds": list(options.seeds),
            "versions": reports[0]["versions"] if reports else {},
            "completed": completed,
            "figures": figures,
            "runs": list(reports),
        }
        json_file.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2))


def _shown(path: Path) -> str:
    """The path as a person would type it."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def main() -> NoReturn:
    """Entry point of ``rosrun hitchhike_ros ride_demo``."""
    run(command, "Interrupted; everything that was started has ended.")
