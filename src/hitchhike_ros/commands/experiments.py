"""usage: rosrun hitchhike_ros experiments NAME... | all [OPTIONS]

Does the papers' experiments and prints the figures beside the papers'. Needs no ROS master: rides start their own.
What needs third-party data (../shared/data beside the package) is left out where that is missing.

  --runs N             so many runs with seeds one after the other (1)
  --seed N             first seed (0)
  --report DIR         folder for everything that is left: tables, pictures, report.html, a folder for each ride with
                       its bag and logs (runs/experiments); rides that ended well there are not driven again
  --json FILE          write the figures, with versions and seeds, as JSON
  --quick              only the rides of the quick set, among those that are named
  --port N             of the ROS master (any free one)
  --check              the exit status also says whether every bound holds

Exit status: 0 when everything ended as it should, 1 when not, 2 for wrong usage, 130 after Ctrl-C; what was driven
until then is kept, and the same command goes on from there.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import msgspec
import rospkg

from hitchhike_ros.commands.launches import interrupt
from hitchhike_ros.commands.scenario_runs import RECORD, drive
from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.bench.registry import EXPERIMENTS, Options, load
from hitchhike_ros.experiments.report.cost_tables import ledger
from hitchhike_ros.experiments.report.html_report import write_report
from hitchhike_ros.experiments.report.ride_report import figure_table, summary_table
from hitchhike_ros.experiments.report.screen import ProgressBars, console, show, text_of
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.report.versions import versions
from hitchhike_ros.experiments.scenarios.ride_record import load_record
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario, in_order, load_scenarios
from hitchhike_ros.experiments.scoring.figures import Figure, Summary, all_hold
from hitchhike_ros.experiments.scoring.results import ScenarioResult

_ALL = "all"


@dataclass(frozen=True)
class _Done:
    """What one experiment has given: figures of one run, or of several; whether it ended as it should; its tables."""

    name: str
    figures: Sequence[Figure] | Sequence[Summary]
    ok: bool
    tables: Sequence[Table] = ()


def main() -> NoReturn:
    """Entry point of ``rosrun hitchhike_ros experiments``."""
    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGHUP, interrupt)
    try:
        sys.exit(_run())
    except HitchhikeError as exc:
        print(f"experiments: {exc}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("\nInterrupted; everything that was started has ended. The same command goes on.", file=sys.stderr)
        sys.exit(130)


def _run() -> int:
    package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
    scenarios = load_scenarios(package / "config" / "experiments")
    arguments = _arguments(package, scenarios)
    report: Path = arguments.report.resolve()
    names = [*EXPERIMENTS, *scenarios] if _ALL in arguments.names else list(dict.fromkeys(arguments.names))
    done = [_grid(name, arguments, package, report) for name in names if name in EXPERIMENTS and not arguments.quick]
    rides = in_order(scenarios[name] for name in names if name in scenarios)
    results: list[ScenarioResult] = []
    try:
        _drive_all(rides, results, arguments, report, _data(package))
    finally:
        if results:
            _leave(report, results, done)
    done += [_Done(result.scenario.name, result.figures, result.ok) for result in results]
    if arguments.json is not None:
        _write_json(arguments, package, done)
    broken = [d.name for d in done if not d.ok or (arguments.check and not all_hold(d.figures))]
    ended = sum(d.ok for d in done)
    print(f"{ended} of {len(done)} experiments ended as they should; {report}", flush=True)
    if broken:
        print(f"Not: {', '.join(broken)}", file=sys.stderr)
    return 1 if broken else 0


def _drive_all(
    rides: Sequence[RideScenario],
    results: list[ScenarioResult],
    arguments: argparse.Namespace,
    report: Path,
    data: Path,
) -> None:
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    for i, scenario in enumerate(rides):
        where = f"[{i + 1}/{len(rides)}] {scenario.name}: {scenario.title}"
        if arguments.quick and not scenario.quick:
            continue
        if scenario.needs and not (data / scenario.needs).exists():
            print(f"{where}: left out, {data / scenario.needs} is missing", flush=True)
            continue
        print(where, flush=True)
        result = drive(scenario, seeds, report, arguments.port, lambda text: print(text, flush=True))
        results.append(result)
        show(console(), summary_table(result.figures, list(seeds)))


def _grid(name: str, arguments: argparse.Namespace, package: Path, report: Path) -> _Done:
    options = Options(package, _data(package), report, arguments.seed, seeds=arguments.runs)
    with ProgressBars(console(sys.stderr)) as progress:
        findings = load(name).run(options, progress)
    tables = [*findings.tables, figure_table(findings.figures)]
    console().print(name)
    show(console(), *tables)
    (report / f"{name}.txt").write_text(text_of(*tables) + "\n", encoding="utf-8")
    return _Done(name, findings.figures, True, tables)


def _data(package: Path) -> Path:
    """Where third-party data is."""
    return package.parent / "shared" / "data"


def _leave(report: Path, results: Sequence[ScenarioResult], others: Sequence[_Done]) -> None:
    """What a person reads of the rides, and of the other experiments."""
    (report / "rides.json").write_bytes(msgspec.json.format(msgspec.json.encode(list(results)), indent=2))
    extras = {done.name: list(done.tables) for done in others} | dict(_ledgers(results))
    print(f"Report: {write_report(report, results, extras)}", flush=True)


def _ledgers(results: Sequence[ScenarioResult]) -> Iterator[tuple[str, list[Table]]]:
    """By the names of those that were driven alone: what the ride costs beside that, of the first seed of both."""
    by_name = {result.scenario.name: result for result in results if result.ok}
    for name, alone in by_name.items():
        ridden = by_name.get(alone.scenario.alone_of)
        if ridden is None or ridden.scenario.launch.get("drives"):
            continue
        records = [load_record(Path(result.runs[0].folder) / RECORD) for result in (ridden, alone)]
        yield name, ledger(records[0], records[1])


def _write_json(arguments: argparse.Namespace, package: Path, done: Sequence[_Done]) -> None:
    content = {
        "versions": versions(package),
        "seed": arguments.seed,
        "runs": arguments.runs,
        "ok": {d.name: d.ok for d in done},
        "figures": {d.name: d.figures for d in done},
    }
    arguments.json.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2))


def _arguments(package: Path, scenarios: dict[str, RideScenario]) -> argparse.Namespace:
    """The command line; whatever is wrong with it is said before anything starts."""
    known = dict(EXPERIMENTS)
    known |= {name: f"{s.title} ({s.source})" for name, s in scenarios.items()} | {_ALL: "all of them"}
    width = max(map(len, known))
    names = "\n".join(f"  {name:<{width}}  {what}" for name, what in known.items())
    usage = f"{str(__doc__).removeprefix('usage: ')}\nexperiments:\n{names}\n"
    parser = argparse.ArgumentParser("experiments", usage=usage, add_help=True, allow_abbrev=False)
    parser.add_argument("names", nargs="+", metavar="NAME")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", "--output", type=Path, default=Path("runs/experiments"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--port", type=int)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    # argparse would print the whole usage before its message.
    trouble = ""
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        trouble = f"{', '.join(unknown)}: no such experiment, expected some of {', '.join(known)}"
    elif arguments.runs < 1:
        trouble = f"--runs {arguments.runs}: expected at least 1"
    elif arguments.port is not None and _answers(arguments.port):
        trouble = f"--port {arguments.port}: something listens there, expected a port for a ROS master of its own"
    else:
        trouble = _unwritable(arguments.report) or (_unwritable(arguments.json.parent) if arguments.json else "")
    if trouble:
        print(f"experiments: {trouble}", file=sys.stderr)
        sys.exit(2)
    return arguments


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("localhost", port)) == 0


def _unwritable(folder: Path) -> str:
    """Why nothing can be written to a folder, which is made where it is missing; or nothing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as exc:
        return f"{folder}: {os.strerror(exc.errno or 0)}, expected a folder that can be written to"
