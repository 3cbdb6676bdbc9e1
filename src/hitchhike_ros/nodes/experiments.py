"""usage: rosrun hitchhike_ros experiments NAME... [OPTIONS]

Does the papers' experiments and prints the figures beside the papers'. Needs no ROS master.

  --runs N             so many runs with seeds one after the other; figures are the worst of them (1)
  --json FILE          write the figures, with versions and seeds, as JSON
  --report DIR         folder for tables and pictures (runs/experiments)
  --scheduler ADDRESS  of a Dask cluster to run on; by default this machine's cores
  --seed N             first seed (0)
  --check              the exit status also says whether every bound holds
"""

from __future__ import annotations

import argparse
import platform
import sys
from pathlib import Path

import msgspec
import rospkg

from hitchhike_ros.errors import HitchhikeError
from hitchhike_ros.experiments.experiment import NAMES, Options, load
from hitchhike_ros.experiments.figures import Figure, all_hold
from hitchhike_ros.experiments.ride_report import figure_table
from hitchhike_ros.experiments.terminal import has_colours
from hitchhike_ros.nodes.bench import clear_progress, show_progress


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros experiments``."""
    package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
    names = "\n".join(f"  {name:<10} {what}" for name, (_, what) in NAMES.items())
    usage = f"{str(__doc__).removeprefix('usage: ')}\nexperiments:\n{names}\n"
    parser = argparse.ArgumentParser("experiments", usage=usage, add_help=True)
    parser.add_argument("names", nargs="+", choices=NAMES, metavar="NAME")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", "--output", type=Path, default=Path("runs/experiments"))
    parser.add_argument("--scheduler")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error(f"--runs {arguments.runs}: expected at least 1")
    try:
        arguments.report.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        parser.error(f"--report {arguments.report}: {exc.strerror}, expected a folder that can be written")
    options = Options(package, arguments.report, arguments.runs, arguments.seed, arguments.scheduler)
    figures: dict[str, list[Figure]] = {}
    for name in arguments.names:
        try:
            findings = load(name).run(options, show_progress)
        except HitchhikeError as exc:
            sys.exit(f"experiments {name}: {exc}")
        clear_progress()
        figures[name] = list(findings.figures)
        texts = [*findings.tables, figure_table(figures[name], has_colours(sys.stdout))]
        print("\n\n".join([name, *texts]) + "\n", flush=True)
        plain = [*findings.tables, figure_table(figures[name], False)]
        (options.report / f"{name}.txt").write_text("\n\n".join(plain) + "\n", encoding="utf-8")
        print(f"Tables and pictures are in {options.report}", flush=True)
    if arguments.json is not None:
        versions = {"python": platform.python_version(), "machine": platform.machine()}
        report = {"versions": versions, "seed": options.seed, "runs": options.runs, "figures": figures}
        arguments.json.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2))
    if arguments.check and not all(all_hold(found) for found in figures.values()):
        sys.exit(1)
