"""P18 §8.1 in the grid simulator: every number comes out of runs of the robots' own machines, beside the paper's.

Without a network (P17, ``local``) a driver receives a request when it has come to the hitchhiker; with one
(``network``) robots agree from afar. The paper's waits include 10 s and 8 s of communication that it sets; here the
delay is the network's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Picture

from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.report.tables import Table, mark
from hitchhike_ros.experiments.scenarios.grid_waits import (
    DRIVERS,
    Job,
    WaitOutcome,
    make_world,
    orders,
    scenario_of,
)
from hitchhike_ros.experiments.scenarios.grid_waits import run as run_one
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import run_all, write_results
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.protocol.parameters import Mode
from hitchhike_ros.simulation.grid.drawing import Recorder, animate, draw_state

# P18 §8.1.1 to §8.1.3: seconds in all without a network and with it, in the order of the runs.
_PAPER_NO_DRIVERS, _PAPER_DENIED = (450.0, 30.0), (180.0, 24.0)
_PAPER_REACHED_S = 56.0
# Waits without a network are as the paper's within this; and the product of wait and speed within that of the issue.
_OFF_PERCENT, _SPREAD_PERCENT = 5.0, 5.0
_MODES: tuple[Mode, Mode] = ("local", "network")
_GIF_PERIOD_S = 2.0


@dataclass(frozen=True)
class _Results:
    """The outcomes of all runs of one seed."""

    no_drivers: dict[Mode, list[WaitOutcome]]
    denied: dict[Mode, list[WaitOutcome]]
    speed: dict[Mode, list[WaitOutcome]]
    profiles: dict[Mode, list[WaitOutcome]]
    delays: dict[float, list[WaitOutcome]]


def run(options: Options, progress: Progress) -> Findings:
    """Figures are the worst of all seeds, tables and pictures those of the first.

    Raises:
        WorldFileError: a scenario cannot be used.
    """
    results = _results(options, progress)
    _pictures(options, results[0], progress)
    return Findings(_worst([_figures(each) for each in results]), _tables(results[0]))


def _jobs(maps: Path, seed: int) -> list[Job]:
    """All runs of one seed."""
    where = str(maps)
    base = scenario_of(Job(where, "speed", "network")).settings
    runs = int(scenario_of(Job(where, "no_drivers", "network")).settings["runs"])
    jobs = []
    for mode in _MODES:
        jobs += [Job(where, "no_drivers", mode, runs * seed + k) for k in range(runs)]
        jobs += [Job(where, "priority", mode, seed, driver=name) for name in DRIVERS]
        factors = base["factors"] if mode == "network" else [1.0]
        jobs += [Job(where, "speed", mode, seed, factor=float(factor)) for factor in factors]
        jobs += [
            Job(where, "profiles", mode, seed, places=places, profiles=profiles)
            for places in orders()
            for profiles in orders()
        ]
    for delay in base["delays_s"]:
        one = Job(where, "no_drivers", "network", seed, float(delay))
        jobs.append(one)
        jobs += [replace(one, experiment="priority", driver=name) for name in DRIVERS]
        jobs += [replace(one, experiment="speed", factor=float(factor)) for factor in base["factors"]]
    return jobs


def _results(options: Options, progress: Progress) -> list[_Results]:
    """Of every seed."""
    maps = options.package / "maps"
    seeds = range(options.seed, options.seed + (options.seeds or 1))
    jobs = [job for seed in seeds for job in _jobs(maps, seed)]
    outcomes = run_all("runs", run_one, jobs, progress)
    write_results(options.output / "grid_runs.json", {"grid": outcomes})
    per_seed = len(jobs) // len(seeds)
    return [_sorted(outcomes[k * per_seed : (k + 1) * per_seed]) for k in range(len(seeds))]


def _sorted(outcomes: Sequence[WaitOutcome]) -> _Results:
    def those(experiment: str) -> dict[Mode, list[WaitOutcome]]:
        plain = [o for o in outcomes if o.job.experiment == experiment and o.job.delay_s is None]
        return {mode: [o for o in plain if o.job.mode == mode] for mode in _MODES}

    swept = sorted((o for o in outcomes if o.job.delay_s is not None), key=lambda o: o.job.delay_s or 0.0)
    delays = {float(delay or 0.0): list(of_it) for delay, of_it in groupby(swept, key=lambda o: o.job.delay_s)}
    return _Results(those("no_drivers"), those("priority"), those("speed"), those("profiles"), delays)


def _figures(results: _Results) -> list[Figure]:
    """Of one seed."""
    figures, off = [], []
    for name, outcomes, paper in (
        ("no_drivers", results.no_drivers, _PAPER_NO_DRIVERS),
        ("denied", results.denied, _PAPER_DENIED),
    ):
        local, network = (_total(outcomes[mode]) for mode in _MODES)
        off.append(abs(local / paper[0] - 1.0))
        figures.append(Figure(f"{name}_wait_local", local, "s", peer=paper[0]))
        figures.append(Figure(f"{name}_wait_network", network, "s", paper[1], peer=paper[1]))
    reached = results.speed["local"][0].wait_s
    off.append(abs(reached / _PAPER_REACHED_S - 1.0))
    figures.append(Figure("reached_wait_local", reached, "s", peer=_PAPER_REACHED_S))
    for outcome in results.speed["network"]:
        factor = outcome.job.factor or 1.0
        name = f"wait_at_{factor:g}_times_the_speed"
        figures.append(Figure(name, outcome.wait_s, "s", peer=_PAPER_REACHED_S / factor))
    products = np.array([o.wait_s * (o.job.factor or 1.0) for o in results.speed["network"]])
    spread = float(100.0 * np.abs(products / products[0] - 1.0).max())
    figures.append(Figure("wait_times_speed_off", spread, "%", _SPREAD_PERCENT))
    figures.append(Figure("waits_local_off_the_paper", 100.0 * max(off), "%", _OFF_PERCENT))
    rows = _rows(results)
    wrong = sum(not row.right("local") for row in rows)
    figures.append(Figure("table_1_wrong_local", wrong, "rows", peer=12.0))
    figures.append(
        Figure("table_1_right_network", sum(row.right("network") for row in rows), "rows", 18, "higher", 18.0)
    )
    figures.append(Figure("table_1_rows_as_the_paper", sum(row.as_paper for row in rows), "rows", 18, "higher", 18.0))
    everyone = [o for group in (results.no_drivers, results.denied, results.speed, results.profiles)
                for mode in _MODES for o in group[mode]]  # fmt: skip
    arrived = sum(o.arrived for o in everyone)
    figures.append(Figure("runs_in_which_all_arrive", arrived, "runs", len(everyone), "higher"))
    return figures


@dataclass(frozen=True)
class _Row:
    """A row of Table 1: whom two distance orders of one nearest driver gave, by mode. Robots are 0 to 2."""

    nearest: int
    profiles: tuple[int, ...]
    chosen: dict[Mode, tuple[int | None, ...]]

    def right(self, mode: Mode) -> bool:
        return set(self.chosen[mode]) == {self.profiles[0]}

    @property
    def as_paper(self) -> bool:
        """Without a network the nearest, with it the best profile, in both distance orders."""
        return set(self.chosen["local"]) == {self.nearest} and self.right("network")


def _rows(results: _Results) -> list[_Row]:
    chosen: dict[tuple[int, tuple[int, ...]], dict[Mode, list[int | None]]] = {}
    for mode in _MODES:
        for outcome in results.profiles[mode]:
            key = outcome.job.places.index(0), outcome.job.profiles
            who = None if outcome.driver is None else DRIVERS.index(outcome.driver)
            chosen.setdefault(key, {m: [] for m in _MODES})[mode].append(who)
    return [
        _Row(nearest, profiles, {mode: tuple(of_it) for mode, of_it in chosen[nearest, profiles].items()})
        for nearest in range(3)
        for profiles in orders()
    ]


def _total(outcomes: Sequence[WaitOutcome]) -> float:
    return float(sum(outcome.wait_s for outcome in outcomes))


def _tables(results: _Results) -> list[Table]:
    """Beside the paper's, of one seed."""
    waits: list[list[str]] = []
    for label, outcomes, paper in (
        ("§8.1.1 no drivers, 3 runs", results.no_drivers, _PAPER_NO_DRIVERS),
        ("§8.1.2 denied by priority, 20, 30, 40 m", results.denied, _PAPER_DENIED),
    ):
        for k, mode in enumerate(_MODES):
            each = " + ".join(f"{outcome.wait_s:.1f}" for outcome in outcomes[mode])
            how = "with a network" if k else "without"
            waits.append([f"{label}, {how}", each, f"{_total(outcomes[mode]):.1f}", f"{paper[k]:g}"])
    waits.append(["§8.1.3 reached without a network", "", f"{results.speed['local'][0].wait_s:.1f}", "56"])
    for outcome in results.speed["network"]:
        factor = outcome.job.factor or 1.0
        label = f"§8.1.3 with one, {factor:g} × the speed"
        waits.append([label, "", f"{outcome.wait_s:.1f}", f"{_PAPER_REACHED_S / factor:.1f}"])
    return [
        Table("Waits of the hitchhiker (s)", ["", "runs", "in all", "paper"], waits),
        _delay_table(results),
        _table_1(results),
    ]


def _delay_table(results: _Results) -> Table:
    rows: list[list[str]] = []
    for delay, outcomes in results.delays.items():
        alone = [o.wait_s for o in outcomes if o.job.experiment == "no_drivers"]
        denied = [o.wait_s for o in outcomes if o.job.experiment == "priority"]
        tuned = [f"{o.wait_s:.1f}" for o in outcomes if o.job.experiment == "speed"]
        rows.append([f"{delay:g} s", f"{3.0 * alone[0]:.1f}", f"{sum(denied):.1f}", *tuned])
    factors = [f"{o.job.factor:g} ×" for o in next(iter(results.delays.values())) if o.job.experiment == "speed"]
    return Table("Delay each way", ["", "no drivers, 3 runs", "denied, 3 runs", *factors], rows)


def _table_1(results: _Results) -> Table:
    """P18 Table 1, with a mark for right and wrong."""
    rows: list[list[str]] = []
    for row in _rows(results):
        others = [k + 1 for k in range(3) if k != row.nearest]
        near = row.nearest + 1
        order = f"d{near}<d{others[0]}<d{others[1]} or d{near}<d{others[1]}<d{others[0]}"
        scores = ">".join(f"P{k + 1}" for k in row.profiles)
        cells: list[str] = [f"{order}   {scores}"]
        for mode in _MODES:
            names = dict.fromkeys("nobody" if k is None else f"P{k + 1}" for k in row.chosen[mode])
            cells.append(f"{', '.join(names)} {mark(row.right(mode))}")
        rows.append([*cells, "as the paper" if row.as_paper else "not as the paper"])
    return Table("Table 1: whose profile drives", ["", "without a network", "with it", ""], rows)


def _pictures(options: Options, results: _Results, progress: Progress) -> None:
    """Plots of waits, and one ride with a network as picture and animation."""
    _draw_waits(options.output / "grid_waits.png", results)
    job = Job(str(options.package / "maps"), "profiles", "network", options.seed, places=(0, 1, 2), profiles=(2, 1, 0))
    world = make_world(job)
    recorder = Recorder(world, _GIF_PERIOD_S)
    world.run(70.0)
    draw_state(options.output / "grid_state.png", world, "P18 §8.1.4, best profile")
    world.run(scenario_of(job).duration_s, world.idle)
    progress("animation", 0, 1)
    animate(options.output / "grid_ride.gif", world, recorder.frames, "P18 §8.1.4, best profile")
    progress("animation", 1, 1)


def _draw_waits(path: Path, results: _Results) -> None:
    picture = Picture(figsize=(13.0, 4.2), layout="constrained")
    bars, tuning, delays = picture.subplots(1, 3)
    groups = (("no drivers\n(§8.1.1)", results.no_drivers, _PAPER_NO_DRIVERS),
              ("denied\n(§8.1.2)", results.denied, _PAPER_DENIED))  # fmt: skip
    x = np.arange(len(groups))
    for k, (mode, label) in enumerate(zip(_MODES, ("without a network", "with a network"), strict=True)):
        ours = [_total(outcomes[mode]) for _, outcomes, _ in groups]
        places = x + 0.4 * (k - 0.5)
        drawn = bars.bar(places - 0.09, ours, 0.18, color=f"C{k}", label=label)
        bars.bar(places + 0.09, [p[k] for _, _, p in groups], 0.18, color=f"C{k}", alpha=0.35, label="paper's")
        bars.bar_label(drawn, fmt="%.0f", fontsize=8)
    bars.set_xticks(x, [label for label, _, _ in groups])
    bars.set(ylabel="waited in three runs (s)", title="Nobody to ride with")
    bars.legend(frameon=False, fontsize=8)
    factors = np.array([o.job.factor or 1.0 for o in results.speed["network"]])
    fine = np.linspace(factors.min(), factors.max(), 50)
    tuning.plot(fine, _PAPER_REACHED_S / fine, color="0.6", label="56 s / factor")
    tuning.plot(factors, [o.wait_s for o in results.speed["network"]], "o", color="C1", label="ours, with a network")
    tuning.plot(1.0, results.speed["local"][0].wait_s, "x", color="C0", label="ours, without")
    tuning.set(xlabel="driver's speed (× 1 m/s)", ylabel="wait (s)", title="Velocity tuning (§8.1.3)", ylim=(0, None))
    tuning.legend(frameon=False, fontsize=8)
    times = list(results.delays)
    for name, label, times_runs in (("no_drivers", "no drivers, 3 runs", 3.0), ("priority", "denied, 3 runs", 1.0)):
        waits = [times_runs * sum(o.wait_s for o in results.delays[d] if o.job.experiment == name) for d in times]
        delays.plot(times, waits, "o-", label=label)
    delays.plot([4.0, 4.0], [30.0, 24.0], "k+", markersize=10, label="paper's 30 s and 24 s")
    delays.set(xlabel="delay of the network, each way (s)", ylabel="waited (s)", title="Waits are the network's delay")
    delays.legend(frameon=False, fontsize=8)
    for axes in (bars, tuning, delays):
        axes.grid(True, alpha=0.25)
    FigureCanvasAgg(picture).print_png(str(path))


def _worst(every: Sequence[Sequence[Figure]]) -> list[Figure]:
    """Over seeds: each figure's worst, which the bounds are for."""
    names = Counter(figure.name for figures in every for figure in figures)
    worst = []
    for name in names:
        of_it = [figure for figures in every for figure in figures if figure.name == name]
        pick = min if of_it[0].better == "higher" else max
        worst.append(pick(of_it, key=lambda figure: figure.value or 0.0))
    return worst
