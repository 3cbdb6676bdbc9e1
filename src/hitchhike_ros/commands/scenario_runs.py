"""Drives scenarios one after the other with the real nodes, and keeps what each run leaves."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from hitchhike_ros.commands.launches import RideProcesses
from hitchhike_ros.commands.octomaps import newest_octomaps
from hitchhike_ros.core.errors import HitchhikeError, InputFileError
from hitchhike_ros.experiments.scenarios.ride_record import load_record
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario
from hitchhike_ros.experiments.scoring.cost_ledger import cost_figures
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide
from hitchhike_ros.experiments.scoring.operator_counts import NAME as COUNTS
from hitchhike_ros.experiments.scoring.operator_counts import count_figures, load_counts, share_figures
from hitchhike_ros.experiments.scoring.results import RunResult, ScenarioResult
from hitchhike_ros.experiments.scoring.ride_scores import score
from hitchhike_ros.simulation.world_file import WorldFile, load_world

_DEADLINE_S = 1500.0  # wall time of one run on a busy machine (chosen)
_RESULT = "result.json"
RECORD = "record.json"


class _Kept(msgspec.Struct, frozen=True):
    """What is kept of a run. ``digest`` is of what was asked for, so that a changed scenario is driven anew."""

    digest: str
    result: RunResult


def drive(
    scenario: RideScenario, seeds: Sequence[int], output: Path, port: int | None, say: Callable[[str], None]
) -> ScenarioResult:
    """All runs of a scenario, those left out that ended well before.

    Raises:
        HitchhikeError: the scenario's world cannot be used.
    """
    runs = []
    for seed in seeds:
        folder = output / scenario.name / f"seed-{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        world = load_world(scenario.write_world(folder))
        digest = _digest(scenario, world)
        result = _kept(folder, digest)
        if result is None:
            result = _drive_one(scenario, world, seed, folder, port)
            if scenario.alone_of and result.ok:
                beside = figures_beside(output / scenario.alone_of / folder.name, folder)
                result = replace(result, figures=(*result.figures, *beside))
            _keep(folder, digest, result)
            say(f"  seed {seed}: {result.trouble or 'as it should end'}, {result.sim_s:.0f} s in {result.wall_s:.0f} s")
        else:
            say(f"  seed {seed}: done before, in {folder}")
        runs.append(result)
    return ScenarioResult(scenario, tuple(runs))


def _drive_one(scenario: RideScenario, world: WorldFile, seed: int, folder: Path, port: int | None) -> RunResult:
    monitor = {"tables": False, "deadline_s": _DEADLINE_S}
    for left in (RECORD, COUNTS):
        (folder / left).unlink(missing_ok=True)
    trouble = ""
    with RideProcesses(world, seed, folder, scenario.launch, monitor, port) as ride:
        try:
            ride.run()
        except HitchhikeError as exc:
            trouble = str(exc)
    if not (folder / RECORD).is_file():
        return RunResult(seed, str(folder), "; ".join([trouble or "no record", *ride.trouble()]), (), 0.0, 0.0)
    record = load_record(folder / RECORD)
    goals = {name: entry.goal for name, entry in world.robots.items()}
    # The mode may stand in the file that the scenario's world is based on.
    local = all(entry.hitchhiking.get("mode", "local") == "local" for entry in world.robots.values())
    scored = score(scenario, record, markers_of(world), goals, local)
    sim_s, wall_s = record.lasted
    # Who steps between the two is braked for, and the gap is not held.
    figures = [replace(f, bound=None) if world.people and f.name == "gap_error_rms" else f for f in scored.figures]
    if scenario.launch.get("map_3d") and scenario.rides:
        figures += _octomap_figures(folder, world, scored.rides)
    if (counts := load_counts(folder)) is not None:
        figures += count_figures(counts)
        if not counts.completed:
            trouble = trouble or "the human who teleoperates did not see all robots arrive"
    return RunResult(seed, str(folder), trouble or scored.trouble, tuple(figures), sim_s, wall_s)


def figures_beside(ridden: Path, alone: Path) -> list[Figure]:
    """What the ride cost or saved that left the folder ``ridden``, beside the run without it; nothing without both."""
    counts = [load_counts(folder) for folder in (ridden, alone)]
    if counts[0] is not None and counts[1] is not None:
        return share_figures(counts[0], counts[1])
    if not (ridden / RECORD).is_file():
        return []
    return cost_figures(load_record(ridden / RECORD), load_record(alone / RECORD))


def _octomap_figures(folder: Path, world: WorldFile, rides: Sequence[NetworkRide]) -> list[Figure]:
    """Whether each hitchhiker has its driver's OctoMap bit for bit; it is left as ``ROBOT.bt``."""
    if not (folder / "ride.bag").is_file():
        return [Figure("octomap_equal", None, "", 1.0, "higher")]
    maps = newest_octomaps(folder / "ride.bag")
    for name in world.robots:
        if name in maps:
            (folder / f"{name}.bt").write_bytes(maps[name])
    equal = [maps.get(ride.hitchhiker) == maps.get(ride.driver) is not None for ride in rides]
    size = min((len(maps.get(ride.hitchhiker, b"")) for ride in rides), default=0)
    return [
        Figure("octomap_equal", float(bool(equal) and all(equal)), "", 1.0, "higher"),
        Figure("octomap_size", size / 1e3, "kB"),
    ]


def markers_of(world: WorldFile) -> dict[int, str]:
    """Whose back carries which marker."""
    return {entry.marker: name for name, entry in world.robots.items() if entry.marker is not None}


def _digest(scenario: RideScenario, world: WorldFile) -> str:
    asked = (scenario.launch, scenario.rides, scenario.denial, scenario.end, world)
    return hashlib.sha256(repr(asked).encode()).hexdigest()


def _kept(folder: Path, digest: str) -> RunResult | None:
    """The run that ended well before, None where there is none."""
    try:
        kept = msgspec.json.decode((folder / _RESULT).read_bytes(), type=_Kept)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as exc:
        raise InputFileError(folder / _RESULT, "", str(exc), "what an earlier run left, or no such file") from exc
    if kept.digest != digest or not kept.result.ok:
        return None
    return kept.result


def _keep(folder: Path, digest: str, result: RunResult) -> None:
    (folder / _RESULT).write_bytes(msgspec.json.encode(_Kept(digest, result)))
