"""usage: rosrun hitchhike_ros bench NAME... [OPTIONS]

Measures what the package does, with peers beside it in the same run where there are any. Needs no ROS master.

  --json FILE    write the figures, with versions and seed, as JSON
  --output DIR   folder for pictures (runs/bench)
  --data DIR     third-party data (../shared/data beside the package)
  --seed N       first seed (0)
  --seeds N      so many, where a benchmark has seeds to choose from: faults (10000)
  --quick        fewer seeds and smaller sizes, to see that it works
  --check        the exit status also says whether every bound holds
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import msgspec
import rospkg

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.bench.registry import BENCHMARKS, Options, load
from hitchhike_ros.experiments.report.ride_report import figure_table
from hitchhike_ros.experiments.report.screen import ProgressBars, console, show
from hitchhike_ros.experiments.report.versions import versions
from hitchhike_ros.experiments.scoring.figures import Figure, all_hold


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros bench``."""
    package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
    parser = argparse.ArgumentParser("bench", usage=str(__doc__).removeprefix("usage: "), add_help=True)
    parser.add_argument("names", nargs="+", choices=BENCHMARKS, metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--output", type=Path, default=Path("runs/bench"))
    parser.add_argument("--data", type=Path, default=package.parent / "shared" / "data")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    if arguments.seeds is not None and arguments.seeds < 1:
        parser.error(f"--seeds {arguments.seeds}: expected 1 or more")
    try:
        arguments.output.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        parser.error(f"--output {arguments.output}: {exc.strerror}, expected a folder that can be written")
    options = Options(package, arguments.data, arguments.output, arguments.seed, arguments.quick, arguments.seeds)
    figures: dict[str, list[Figure]] = {}
    screen, progress = console(), ProgressBars(console(sys.stderr))
    for name in arguments.names:
        try:
            with progress:
                findings = load(name).run(options, progress)
        except HitchhikeError as exc:
            sys.exit(f"bench {name}: {exc}")
        figures[name] = list(findings.figures)
        screen.print(name)
        show(screen, *findings.tables, figure_table(figures[name], "peer"))
    if arguments.json is not None:
        report = {"versions": versions(package), "seed": options.seed, "quick": options.quick, "figures": figures}
        arguments.json.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2))
    if arguments.check and not all(all_hold(found) for found in figures.values()):
        sys.exit(1)
