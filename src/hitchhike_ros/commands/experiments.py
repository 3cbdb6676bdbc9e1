"""Does the papers' experiments and prints the figures beside the papers'.

Needs no ROS master: rides start their own. What needs third-party data (../shared/data beside the package) is left out
where that is missing.

Exit status: 0 when everything ended as it should, 1 when not, 2 for wrong usage, 130 after Ctrl-C; what was driven
until then is kept, and the same command goes on from there.
"""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

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
    runs_option,
    seed_option,
)
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


def command_of(package: Path, scenarios: Mapping[str, RideScenario]) -> click.Command:
    """The command line, with the names of all experiments."""
    known = EXPERIMENTS | {name: f"{s.title} ({s.source})" for name, s in scenarios.items()} | {_ALL: "all of them"}
    width = max(map(len, known)) + 2
    names_help = "\b\nExperiments:\n" + "\n".join(f"  {name:<{width}}{what}" for name, what in known.items())

    @click.command("experiments", help=help_of(__doc__), epilog=names_help, context_settings=SETTINGS)
    @click.argument("names", nargs=-1, required=True, type=click.Choice(list(known)), metavar="NAME...")
    @runs_option("So many runs with seeds one after the other.")
    @seed_option
    @folder_option(
        "--report",
        "--output",
        default="runs/experiments",
        text="Folder for everything that is left: tables, pictures, report.html, a folder for each ride with its bag "
        "and logs. Rides that ended well there are not driven again.",
    )
    @json_option
    @click.option("--quick", is_flag=True, help="Only the rides of the quick set, among those that are named.")
    @click.option("--port", metavar="N", type=int, callback=_free, help="Of the ROS master.  [default: any free one]")
    @check_option
    def command(
        names: Sequence[str],
        runs: int,
        seed: int,
        output: Path,
        json_file: Path | None,
        quick: bool,
        port: int | None,
        check: bool,
    ) -> int:
        if _ALL in names:
            names = [*EXPERIMENTS, *scenarios]
        names = list(dict.fromkeys(names))
        options = Options(package, package.parent / "shared" / "data", output.resolve(), seed, quick, runs)
        done = [_compute(name, options) for name in names if name in EXPERIMENTS and not quick]
        rides = in_order(scenarios[name] for name in names if name in scenarios)
        results: list[ScenarioResult] = []
        try:
            _drive_all(rides, results, options, port)
        finally:
            if results:
                _leave(options.output, results, done)
        done += [_Done(result.scenario.name, result.figures, result.ok) for result in results]
        if json_file is not None:
            _write_json(json_file, options, done)
        broken = [d.name for d in done if not d.ok or (check and not all_hold(d.figures))]
        ended = sum(d.ok for d in done)
        print(f"{ended} of {len(done)} experiments ended as they should; {options.output}", flush=True)
        if broken:
            print(f"Not: {', '.join(broken)}", file=sys.stderr)
        return 1 if broken else 0

    return command


def _drive_all(
    rides: Sequence[RideScenario], results: list[ScenarioResult], options: Options, port: int | None
) -> None:
    seeds = range(options.seed, options.seed + (options.seeds or 1))
    for i, scenario in enumerate(rides):
        where = f"[{i + 1}/{len(rides)}] {scenario.name}: {scenario.title}"
        if options.quick and not scenario.quick:
            continue
        if scenario.needs and not (options.data / scenario.needs).exists():
            print(f"{where}: left out, {options.data / scenario.needs} is missing", flush=True)
            continue
        print(where, flush=True)
        result = drive(scenario, seeds, options.output, port, lambda text: print(text, flush=True))
        results.append(result)
        print(flush=True)
        show(console(), summary_table(result.figures, list(seeds)))


def _compute(name: str, options: Options) -> _Done:
    """An experiment that no robot is driven for."""
    with ProgressBars(console(sys.stderr)) as progress:
        findings = load(name).run(options, progress)
    tables = [*findings.tables, figure_table(findings.figures)]
    console().print(name)
    show(console(), *tables)
    (options.output / f"{name}.txt").write_text(text_of(*tables) + "\n", encoding="utf-8")
    return _Done(name, findings.figures, True, tables)


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


def _write_json(file: Path, options: Options, done: Sequence[_Done]) -> None:
    content = {
        "versions": versions(options.package),
        "seed": options.seed,
        "runs": options.seeds,
        "ok": {d.name: d.ok for d in done},
        "figures": {d.name: d.figures for d in done},
    }
    file.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2))


def _free(_context: click.Context, _option: click.Parameter, port: int | None) -> int | None:
    """The port, where nothing listens on it."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        if port is not None and probe.connect_ex(("localhost", port)) == 0:
            raise click.BadParameter(f"{port}: something listens there, expected a port for a ROS master of its own")
    return port


def main() -> NoReturn:
    """Entry point of ``rosrun hitchhike_ros experiments``."""
    package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
    try:
        scenarios = load_scenarios(package / "config" / "experiments")
    except HitchhikeError as exc:
        sys.exit(f"experiments: {exc}")
    run(
        command_of(package, scenarios),
        "Interrupted; everything that was started has ended. The same command goes on.",
    )
