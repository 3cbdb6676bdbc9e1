"""What a robot's computing costs: a ride beside driving the same way alone, one process beside separate nodes.

P17 Experiment 1 is driven with the real nodes on the system's clock, as robots run: with the ride and alone, by
separate nodes and in one process. One of each makes a round, with a seed of its own, and every second round goes
through them the other way round, so that what changes in the machine does not favour one of them.

Compared is the CPU time per metre of all processes of the hitchhiker, from asking for the ride until it drives by
itself again, and over the same way alone; and the memory of these processes meanwhile (PSS). A run in which more than
2 % of the simulator's steps were late meanwhile is repeated, not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, load_record
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario, load_scenario
from hitchhike_ros.experiments.scoring.cost_ledger import MAX_RIDE_COST, Stretch, compare, pss_mb, run_window
from hitchhike_ros.experiments.scoring.figures import Figure, median
from hitchhike_ros.experiments.scoring.rides import Window, find_ride

Wiring = Literal["separate", "one_process"]
WIRINGS: tuple[Wiring, ...] = ("separate", "one_process")
"""A node for each module of a robot, or all of them in the node ``robot``."""
Way = Literal["ridden", "alone"]

MOST_LATE = 0.02
"""With a greater share of late steps a run is repeated (design §6)."""
# Chosen. A ride by driving alone, with one process on both sides; one process by separate nodes: alone, as a rider, and
# in memory.
_MAX_RIDE_IN_ONE, _MAX_ALONE, _MAX_RIDER, _MAX_PSS = 0.30, 0.8, 0.6, 0.5
_ROUNDS, _QUICK_ROUNDS = 5, 1
_TRIES = 4  # of one run, before its round is given up
_HITCHHIKER = "turtlebot"
_SCENARIOS: Mapping[Way, str] = {"ridden": "p17_exp1", "alone": "p17_exp1_alone"}


@dataclass(frozen=True)
class Side:
    """What one run took of the machine; ``tries`` is how often it was driven."""

    cpu_s_per_metre: float
    pss_mb: float
    metres: float
    late: float
    tries: int


@dataclass(frozen=True)
class Pair:
    """A ride and the same way alone, by one wiring and with one seed."""

    wiring: Wiring
    seed: int
    rider: Side
    alone: Side

    @property
    def ratio(self) -> float:
        """CPU time per metre as a rider by that alone."""
        return self.rider.cpu_s_per_metre / self.alone.cpu_s_per_metre


@dataclass(frozen=True)
class _Run:
    """A run that may be judged."""

    record: RideRecord
    late: float
    tries: int


def run(options: Options, progress: Progress) -> Findings:
    """Drive what has not been driven yet, and compare.

    Raises:
        HitchhikeError: nothing can be driven here, or robots are not wired as the launch files are asked to.
    """
    if options.drive is None:
        raise HitchhikeError("this benchmark drives with the real nodes, and nobody has said how")
    folder, output = options.package / "config" / "experiments", options.output.resolve() / "cost"
    scenarios = {way: load_scenario(folder / f"{name}.yaml") for way, name in _SCENARIOS.items()}
    rounds = options.seeds or (_QUICK_ROUNDS if options.quick else _ROUNDS)
    seeds = range(options.seed, options.seed + rounds)
    order = [each for k, seed in enumerate(seeds) for each in one_round(seed, k % 2 == 1)]
    runs: dict[tuple[Wiring, Way, int], _Run] = {}
    trouble: list[str] = []
    for done, (wiring, way, seed) in enumerate(order):
        progress("runs", done, len(order))
        scenario = for_wiring(scenarios[way], wiring)

        def drive(attempt: int, scenario: RideScenario = scenario, wiring: Wiring = wiring, seed: int = seed) -> Path:
            assert options.drive is not None
            result = options.drive(scenario, seed, output / wiring / f"try-{attempt}")
            if result.trouble:
                raise HitchhikeError(result.trouble)
            return Path(result.folder)

        found, said = judged(drive, way)
        if found is not None and is_one_process(found.record) != (wiring == "one_process"):
            raise HitchhikeError(f"{scenario.name}: the robots were not wired as {wiring}, in spite of robot.launch")
        trouble += [f"{scenario.name}, {wiring}, seed {seed}: {text}" for text in said]
        if found is not None:
            runs[wiring, way, seed] = found
    progress("runs", len(order), len(order))
    pairs = [pair for wiring in WIRINGS for seed in seeds if (pair := _pair(runs, wiring, seed)) is not None]
    return Findings(
        figures(pairs, rounds), [_table(pairs), Table("Runs that were repeated", [""], [[t] for t in trouble])]
    )


def one_round(seed: int, backwards: bool) -> list[tuple[Wiring, Way, int]]:
    """The four runs of a seed, in the order in which they are driven."""
    ways: tuple[Way, ...] = ("ridden", "alone")
    runs = [(wiring, way, seed) for wiring in WIRINGS for way in ways]
    return runs[::-1] if backwards else runs


def for_wiring(scenario: RideScenario, wiring: Wiring) -> RideScenario:
    """The scenario on the system's clock with one wiring of both robots.

    It leaves no bag and makes no 3D map: to record, and to render a depth camera, makes the simulator late.
    """
    changes = {"system_clock": True, "one_process": wiring == "one_process", "bag": False, "map_3d": False}
    return replace(scenario, launch={**scenario.launch, **changes})


def is_one_process(record: RideRecord) -> bool:
    """Whether the hitchhiker ran in the node ``robot``."""
    return any(sample.node == f"/{_HITCHHIKER}/robot" for sample in record.cpu)


def judged(drive: Callable[[int], Path], way: Way) -> tuple[_Run | None, list[str]]:
    """Drive until the steps are in time, but not too often.

    Args:
        drive: drives once more; the folder of what was left. It raises HitchhikeError for a run that went wrong.
        way: where in the run the steps have to be in time.

    Returns:
        The run, None where all failed; and why each of the others does not count.
    """
    said: list[str] = []
    for attempt in range(_TRIES):
        try:
            record = load_record(drive(attempt) / "record.json")
        except HitchhikeError as exc:
            said.append(str(exc))
            continue
        window = _window(record, way)
        late = None if window is None else record.late_share(*window)
        if late is None:
            said.append("it is not known how many steps were late")
        elif late > MOST_LATE:
            said.append(f"{100.0 * late:.1f} % of the steps were late")
        else:
            return _Run(record, late, attempt + 1), said
    return None, said


def figures(pairs: Sequence[Pair], rounds: int) -> list[Figure]:
    """All figures; each is the median over the rounds that could be judged."""
    by = {wiring: {pair.seed: pair for pair in pairs if pair.wiring == wiring} for wiring in WIRINGS}
    found = []
    for wiring, bound in zip(WIRINGS, (MAX_RIDE_COST, _MAX_RIDE_IN_ONE), strict=True):
        own = list(by[wiring].values())
        found += [
            Figure(f"{wiring}_cpu_rider", median(p.rider.cpu_s_per_metre for p in own), "s/m"),
            Figure(f"{wiring}_cpu_alone", median(p.alone.cpu_s_per_metre for p in own), "s/m"),
            Figure(f"{wiring}_cpu_ratio", median(p.ratio for p in own), "", bound),
            Figure(f"{wiring}_pss_rider", median(p.rider.pss_mb for p in own), "MB"),
            Figure(f"{wiring}_pss_alone", median(p.alone.pss_mb for p in own), "MB"),
        ]
    both = [(by["one_process"][seed], by["separate"][seed]) for seed in by["separate"] if seed in by["one_process"]]
    alone = median(one.alone.cpu_s_per_metre / apart.alone.cpu_s_per_metre for one, apart in both)
    rider = median(one.rider.cpu_s_per_metre / apart.rider.cpu_s_per_metre for one, apart in both)
    memory = median(one.rider.pss_mb / apart.rider.pss_mb for one, apart in both)
    return [
        *found,
        Figure("one_process_by_separate_cpu_alone", alone, "", _MAX_ALONE),
        Figure("one_process_by_separate_cpu_rider", rider, "", _MAX_RIDER),
        Figure("one_process_by_separate_pss", memory, "", _MAX_PSS),
        Figure("rounds_not_judged", rounds - len(both), "", 0.0),
    ]


def _pair(runs: Mapping[tuple[Wiring, Way, int], _Run], wiring: Wiring, seed: int) -> Pair | None:
    """The two runs of a seed beside each other, None where one is missing or has not enough samples."""
    ridden, alone = runs.get((wiring, "ridden", seed)), runs.get((wiring, "alone", seed))
    if ridden is None or alone is None:
        return None
    ride = next((c for c in compare(ridden.record, alone.record) if c.name == "ride"), None)
    if ride is None:
        return None
    rider, lone = _side(ridden, ride.rider), _side(alone, ride.alone)
    return None if rider is None or lone is None else Pair(wiring, seed, rider, lone)


def _side(run: _Run, stretch: Stretch) -> Side | None:
    cpu, memory = stretch.cpu_s_per_metre, pss_mb(run.record, _HITCHHIKER, (stretch.begin, stretch.end))
    return None if cpu is None or memory is None else Side(cpu, memory, stretch.metres, run.late, run.tries)


def _window(record: RideRecord, way: Way) -> Window | None:
    """What is looked at of a run: the ride with what belongs to it, or the whole way alone."""
    if way == "alone":
        return run_window(record.robots[_HITCHHIKER])
    ride = find_ride(record)
    if ride is None or ride.requested_at is None or ride.released_at is None:
        return None
    return ride.requested_at, ride.released_at


def _table(pairs: Sequence[Pair]) -> Table:
    rows = [
        [
            f"{pair.wiring}, seed {pair.seed}",
            *(f"{side.cpu_s_per_metre:.4f}" for side in (pair.rider, pair.alone)),
            f"{pair.ratio:.3f}",
            *(f"{side.pss_mb:.0f} MB" for side in (pair.rider, pair.alone)),
            *(f"{100.0 * side.late:.1f} %" for side in (pair.rider, pair.alone)),
        ]
        for pair in pairs
    ]
    header = ["", "rider s/m", "alone s/m", "ratio", "rider PSS", "alone PSS", "rider late", "alone late"]
    return Table("Pairs of runs", header, rows)
