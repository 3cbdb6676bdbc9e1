"""usage: launch_scripts/demo [OPTIONS]

Drives the ride of P17 Experiment 1 in simulation, through real ROS nodes: shows it in one line while it runs, then
prints its figures beside the paper's. Needs no ROS master: it starts one of its own on a free port, and Ctrl-C ends
everything that it started.

  --world FILE            world file instead of maps/p17_exp1.world.yaml
  --seed N                of all noise (0)
  --runs N                so many rides with seeds N, N + 1, …, and a table over all of them (1)
  --output DIR            folder for what a ride leaves (runs/DATE-TIME); with several, one folder each inside it
  --rviz auto|true|false  show it in rviz; auto: when there is a display and rviz (auto)
  --json FILE             write the figures, with versions and seeds, as JSON
  --check                 the exit status also says whether every bound holds
  --help                  print this

A ride leaves ride.json (figures, boxes, CPU, modules over time), record.json (all that was recorded, for scoring it
again), map.png, ride.bag (every topic but images), awards.sqlite (what the driver earned; rosrun hitchhike_ros awards
reads it) and log/ (of roslaunch and of every node).
Exit status: 0 when every ride was completed, 1 when not, 2 for wrong usage, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import rospkg

from hitchhike_ros.commands.launches import RideProcesses, interrupt, say
from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.report.ride_report import summary_table
from hitchhike_ros.experiments.report.screen import console, show
from hitchhike_ros.experiments.scoring.figures import Figure, summarize
from hitchhike_ros.simulation.world_file import WorldFile, load_world


@dataclass(frozen=True)
class Options:
    """The command line."""

    world: WorldFile
    seed: int
    runs: int
    output: Path
    rviz: bool
    json: Path | None
    check: bool


def main() -> NoReturn:
    """Entry point of ``rosrun hitchhike_ros ride_demo``."""
    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGHUP, interrupt)
    try:
        sys.exit(_run(_options(sys.argv[1:])))
    except HitchhikeError as exc:
        print(f"demo: {exc}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("\nInterrupted; everything that was started has ended.", file=sys.stderr)
        sys.exit(130)


def _run(options: Options) -> int:
    seeds = list(range(options.seed, options.seed + options.runs))
    reports: list[dict[str, Any]] = []
    failed = False
    for i, seed in enumerate(seeds):
        folder = options.output if options.runs == 1 else options.output / f"seed-{seed}"
        count = f"Ride {i + 1} of {options.runs}: " if options.runs > 1 else ""
        say(f"{count}{options.world.path.name}, seed {seed}, logs in {_shown(folder / 'log')}")
        failure = ""
        launch = {"rviz": options.rviz}
        monitor = {"check": options.check, "tables": options.runs == 1}
        with RideProcesses(options.world, seed, folder, launch, monitor) as ride:
            try:
                failed |= ride.run() != 0
            except HitchhikeError as exc:
                failure = f"Failed: {exc}"
        report = folder / "ride.json"
        if report.is_file():
            reports.append(json.loads(report.read_bytes()))
        if failure or not reports or not reports[-1]["completed"]:
            failed = True
            print("\n".join(line for line in (failure, *ride.trouble(), f"Logs: {ride.logs}") if line), file=sys.stderr)
    _summarize(options, seeds, reports)
    return 1 if failed or len(reports) < len(seeds) else 0


def _summarize(options: Options, seeds: Sequence[int], reports: Sequence[dict[str, Any]]) -> None:
    """The table over several runs, and the JSON."""
    runs = [msgspec.convert(report["figures"], list[Figure]) for report in reports]
    figures: Sequence[object] = runs[0] if len(runs) == options.runs == 1 else summarize(runs)
    if options.runs > 1 and runs:
        completed = sum(report["completed"] for report in reports)
        print(f"\n{completed} of {options.runs} rides completed\n")
        show(console(), summary_table(summarize(runs), [report["seed"] for report in reports]))
    if options.json is not None:
        content = {
            "world": options.world.path.name,
            "seeds": list(seeds),
            "versions": reports[0]["versions"] if reports else {},
            "completed": sum(report["completed"] for report in reports),
            "figures": figures,
            "runs": list(reports),
        }
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2))


def _options(arguments: list[str]) -> Options:
    if {"-h", "--help"} & set(arguments):
        print(__doc__)
        sys.exit(0)
    parser = argparse.ArgumentParser("launch_scripts/demo", add_help=False, allow_abbrev=False)
    parser.add_argument("--world", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=_count, default=1)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--rviz", choices=("auto", "true", "false"), default="auto")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args(arguments)
    default = Path(rospkg.RosPack().get_path("hitchhike_ros")) / "maps" / "p17_exp1.world.yaml"
    world = load_world((given.world or default).resolve())
    output = (given.output or Path("runs") / time.strftime("%Y-%m-%d-%H%M%S")).resolve()
    try:
        output.mkdir(parents=True, exist_ok=True)
        if given.json is not None:
            given.json.parent.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise HitchhikeError(f"{exc.filename}: {exc.strerror}, expected a folder that can be written to") from exc
    shows = given.rviz == "true" or (
        given.rviz == "auto" and bool(os.environ.get("DISPLAY")) and shutil.which("rviz") is not None
    )
    return Options(world, given.seed, given.runs, output, shows, given.json, given.check)


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value}, expected at least 1")
    return value


def _shown(path: Path) -> str:
    """The path as a person would type it."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)
