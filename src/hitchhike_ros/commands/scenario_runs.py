"""Drives scenarios one after the other with the real nodes, and keeps what each run leaves."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import rospkg

from hitchhike_ros.commands.launches import RideProcesses
from hitchhike_ros.commands.octomaps import newest_octomaps
from hitchhike_ros.core.errors import HitchhikeError, InputFileError
from hitchhike_ros.experiments.report.versions import versions
from hitchhike_ros.experiments.scenarios.ride_record import load_record
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scenarios.run_digest import run_digest
from hitchhike_ros.experiments.scoring.cost_ledger import cost_figures
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.octomap_scores import octomap_figures
from hitchhike_ros.experiments.scoring.operator_counts import NAME as COUNTS
from hitchhike_ros.experiments.scoring.operator_counts import count_figures, load_counts, share_figures
from hitchhike_ros.experiments.scoring.results import RunResult, ScenarioResult
from hitchhike_ros.experiments.scoring.ride_scores import score_in
from hitchhike_ros.simulation.world_file import WorldFile, load_world

_DEADLINE_S = 1500.0  # wall time of one run on a busy machine (chosen)
_RESULT = "result.json"
RECORD = "record.json"


class _Digest(msgspec.Struct, frozen=True):
    """Of what a run was driven with, so that nothing stale is shown as new."""

    digest: str


class _Kept(_Digest, frozen=True):
    """What is kept of a run."""

    result: RunResult


def drive(
    scenario: RideScenario,
    seeds: Sequence[int],
    output: Path,
    port: int | None,
    report: Callable[[str], None],
    shown: bool = True,
) -> ScenarioResult:
    """All runs of a scenario, those left out that ended well before; ``shown``: what happens stands on the terminal.

    Raises:
        HitchhikeError: the scenario's world cannot be used.
    """
    package = Path(rospkg.RosPack().get_path("hitchhike_ros"))
    runs = []
    for seed in seeds:
        folder = output / scenario.name / f"seed-{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        world = load_world(scenario.write_world(folder))
        digest = run_digest(scenario, world, package, code_folders(), versions(package))
        result = _kept(folder, digest)
        if result is None:
            result = _drive_one(scenario, world, seed, folder, port, shown)
            _keep(folder, digest, result)
            report(
                f"  seed {seed}: {result.trouble or 'as it should end'}, {result.sim_s:.0f} s in {result.wall_s:.0f} s"
            )
        else:
            report(f"  seed {seed}: done before, in {folder}")
        if scenario.alone_of and result.ok:
            # Not kept: the ride may have been driven anew since.
            beside = figures_beside(output / scenario.alone_of / folder.name, folder)
            result = replace(result, figures=(*result.figures, *beside))
        runs.append(result)
    return ScenarioResult(scenario, tuple(runs))


def code_folders() -> list[Path]:
    """Where the modules of this package are: in the devel space the compiled ones are apart from the others."""
    return [Path(folder) for folder in importlib.import_module("hitchhike_ros").__path__]


def drive_unseen(scenario: RideScenario, seed: int, output: Path) -> RunResult:
    """One run, as a benchmark wants it: with nothing on the terminal.

    Raises:
        HitchhikeError: the scenario's world cannot be used.
    """
    return drive(scenario, [seed], output, None, lambda _text: None, shown=False).runs[0]


def _drive_one(
    scenario: RideScenario, world: WorldFile, seed: int, folder: Path, port: int | None, shown: bool
) -> RunResult:
    monitor = {"tables": False, "deadline_s": _DEADLINE_S}
    for left in (RECORD, COUNTS):
        (folder / left).unlink(missing_ok=True)
    trouble = ""
    with RideProcesses(world, seed, folder, scenario.launch, monitor, port, shown) as ride:
        try:
            ride.run()
        except HitchhikeError as exc:
            trouble = str(exc)
    if not (folder / RECORD).is_file():
        return RunResult(seed, str(folder), "; ".join([trouble or "no record", *ride.trouble()]), (), 0.0, 0.0)
    record = load_record(folder / RECORD)
    scored = score_in(world, scenario, record)
    figures = list(scored.figures)
    if scenario.launch.get("map_3d") and scenario.rides:
        figures += octomap_figures(_octomaps(folder, world), scored.rides)
    if (counts := load_counts(folder)) is not None:
        figures += count_figures(counts)
        if not counts.completed:
            trouble = trouble or "the human who teleoperates did not see all robots arrive"
    return RunResult(seed, str(folder), trouble or scored.trouble, tuple(figures), *record.lasted)


def figures_beside(ridden: Path, alone: Path) -> list[Figure]:
    """What the ride cost or saved that left the folder ``ridden``, beside the run without it; nothing without both."""
    counts = [load_counts(folder) for folder in (ridden, alone)]
    if counts[0] is not None and counts[1] is not None:
        return share_figures(counts[0], counts[1])
    if not (ridden / RECORD).is_file():
        return []
    return cost_figures(load_record(ridden / RECORD), load_record(alone / RECORD))


def _octomaps(folder: Path, world: WorldFile) -> dict[str, bytes]:
    """The robots' newest OctoMaps from the bag of a run; they are left as ``ROBOT.bt``."""
    bag = folder / "ride.bag"
    maps = newest_octomaps(bag) if bag.is_file() else {}
    for name in world.robots:
        if name in maps:
            (folder / f"{name}.bt").write_bytes(maps[name])
    return maps


def _kept(folder: Path, digest: str) -> RunResult | None:
    """The run that ended well before, None where there is none of this digest."""
    try:
        content = (folder / _RESULT).read_bytes()
        if msgspec.json.decode(content, type=_Digest).digest != digest:
            return None
        result = msgspec.json.decode(content, type=_Kept).result
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as exc:
        raise InputFileError(folder / _RESULT, "", str(exc), "what an earlier run left, or no such file") from exc
    return result if result.ok else None


def _keep(folder: Path, digest: str, result: RunResult) -> None:
    (folder / _RESULT).write_bytes(msgspec.json.encode(_Kept(digest, result)))
