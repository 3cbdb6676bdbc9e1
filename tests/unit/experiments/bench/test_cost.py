"""The benchmark of costs: the order of the runs, which of them count, and what the figures compare."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.bench import cost
from hitchhike_ros.experiments.bench.cost import MOST_LATE, Pair, Side, figures, for_wiring, judged, one_round
from hitchhike_ros.experiments.bench.registry import Options
from hitchhike_ros.experiments.scenarios.ride_record import (
    MemorySample,
    RideRecord,
    StepSample,
    save_record,
)
from hitchhike_ros.experiments.scenarios.ride_scenario import RideScenario, load_scenario
from hitchhike_ros.experiments.scoring.results import RunResult
from repository import ROOT
from synthetic_ride import END, RELEASED, REQUESTED, synthetic_ride

SCENARIO = load_scenario(ROOT / "config" / "experiments" / "p17_exp1.yaml")


def record_of(late: float, cpu: float = 1.0, pss_mb: float = 100.0, node: str = "slam") -> RideRecord:
    """The ride on paper with that share of late steps, and so many CPU seconds and MB by ``node`` of its rider."""
    record = synthetic_ride()
    steps = round(10.0 * END)
    record.steps = [StepSample(0.0, 0, 0), StepSample(END, steps, round(late * steps))]
    record.cpu = [
        replace(sample, cpu_s=cpu * sample.cpu_s, node=f"/turtlebot/{node}")
        if sample.node == "/turtlebot/slam"
        else sample
        for sample in record.cpu
    ]
    record.memory = [
        MemorySample(stamp, name, size)
        for stamp in (REQUESTED + 1.0, RELEASED - 1.0)
        for name, size in (("/turtlebot/slam", 0.7 * pss_mb), ("/turtlebot/comm", 0.3 * pss_mb), ("/p3dx/slam", 999.0))
    ]
    return record


def left(folder: Path, record: RideRecord) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    save_record(record, folder / "record.json")
    return folder


def pair(wiring: cost.Wiring, seed: int, rider: float, alone: float, pss_mb: float) -> Pair:
    return Pair(wiring, seed, Side(rider, pss_mb, 20.0, 0.0, 1), Side(alone, pss_mb + 10.0, 20.0, 0.0, 1))


def test_every_second_round_goes_the_other_way_round() -> None:
    there = one_round(3, backwards=False)
    assert there == [
        ("separate", "ridden", 3),
        ("separate", "alone", 3),
        ("one_process", "ridden", 3),
        ("one_process", "alone", 3),
    ]
    assert one_round(3, backwards=True) == there[::-1]


def test_robots_run_on_the_systems_clock_by_one_wiring() -> None:
    for wiring, one in (("separate", False), ("one_process", True)):
        launch = for_wiring(SCENARIO, wiring).launch
        assert launch == {"system_clock": True, "one_process": one, "bag": False, "map_3d": False}


def test_late_runs_and_those_that_went_wrong_are_repeated(tmp_path: Path) -> None:
    def drive(attempt: int) -> Path:
        if attempt == 1:
            raise HitchhikeError("node /p3dx/slam died")
        late = {0: 0.021, 2: MOST_LATE}[attempt]
        return left(tmp_path / str(attempt), record_of(late))

    run, said = judged(drive, "ridden")
    assert run is not None
    assert (run.tries, run.late) == (3, pytest.approx(MOST_LATE, abs=1e-3))
    assert said == ["2.1 % of the steps were late", "node /p3dx/slam died"]


def test_repeating_has_an_end(tmp_path: Path) -> None:
    asked: list[int] = []

    def drive(attempt: int) -> Path:
        asked.append(attempt)
        return left(tmp_path / str(attempt), record_of(0.5))

    run, said = judged(drive, "alone")
    assert (run, asked, said) == (None, [0, 1, 2, 3], 4 * ["50.0 % of the steps were late"])


def test_a_run_in_simulated_time_cannot_be_judged(tmp_path: Path) -> None:
    run, said = judged(lambda attempt: left(tmp_path / str(attempt), synthetic_ride()), "ridden")
    assert run is None
    assert set(said) == {"it is not known how many steps were late"}


def test_late_steps_count_where_the_run_is_looked_at(tmp_path: Path) -> None:
    record = record_of(0.0)
    record.steps = [
        StepSample(0.0, 0, 0),
        StepSample(REQUESTED - 1.0, 90, 90),
        StepSample(RELEASED + 1.0, 700, 90),
        StepSample(END, 900, 290),
    ]
    run, said = judged(lambda _attempt: left(tmp_path, record), "ridden")
    assert run is not None
    assert (run.late, said) == (0.0, [])


def test_figures_are_medians_of_rounds() -> None:
    pairs = [pair("separate", seed, rider, 0.10, 800.0) for seed, rider in ((0, 0.03), (1, 0.05), (2, 0.04))]
    pairs += [pair("one_process", seed, rider, 0.06, 200.0) for seed, rider in ((0, 0.015), (1, 0.015), (2, 0.03))]
    found = {figure.name: figure for figure in figures(pairs, 3)}
    assert {name: (f.value, f.bound, f.ok) for name, f in found.items() if f.bound is not None} == {
        "separate_cpu_ratio": (pytest.approx(0.4), 0.4, True),
        "one_process_cpu_ratio": (pytest.approx(0.25), 0.3, True),
        "one_process_by_separate_cpu_alone": (pytest.approx(0.6), 0.8, True),
        "one_process_by_separate_cpu_rider": (pytest.approx(0.5), 0.6, True),
        "one_process_by_separate_pss": (pytest.approx(0.25), 0.5, True),
        "rounds_not_judged": (0, 0.0, True),
    }
    assert found["separate_cpu_rider"].value == 0.04
    assert found["one_process_pss_alone"].value == 210.0


def test_a_round_that_was_not_judged_breaks_a_bound() -> None:
    found = {figure.name: figure for figure in figures([pair("separate", 0, 0.04, 0.1, 800.0)], 2)}
    assert found["rounds_not_judged"].value == 2
    assert found["one_process_cpu_ratio"].value is None
    assert [name for name, figure in found.items() if figure.ok is False] == [
        "one_process_cpu_ratio",
        "one_process_by_separate_cpu_alone",
        "one_process_by_separate_cpu_rider",
        "one_process_by_separate_pss",
        "rounds_not_judged",
    ]


def test_a_whole_benchmark(tmp_path: Path) -> None:
    """One process takes half of the time and a quarter of the memory; the first ride comes late once."""
    driven: list[tuple[str, str, int]] = []
    steps: list[tuple[int, int]] = []

    def drive(scenario: RideScenario, seed: int, output: Path) -> RunResult:
        folder = output / scenario.name / f"seed-{seed}"
        driven.append((output.parent.name, f"{scenario.name} {output.name}", seed))
        one = bool(scenario.launch["one_process"])
        first = not one and seed == 5 and scenario.name == "p17_exp1" and output.name == "try-0"
        cpu = (0.5 if one else 1.0) * (4.0 if scenario.name.endswith("alone") else 1.0)
        left(folder, record_of(0.1 if first else 0.0, cpu, 20.0 if one else 80.0, "robot" if one else "slam"))
        return RunResult(seed, str(folder), "", (), 90.0, 90.0)

    options = Options(ROOT, ROOT, tmp_path, seed=5, seeds=2, drive=drive)
    findings = cost.run(options, lambda _step, done, of: steps.append((done, of)))
    assert driven == [
        ("separate", "p17_exp1 try-0", 5),
        ("separate", "p17_exp1 try-1", 5),
        ("separate", "p17_exp1_alone try-0", 5),
        ("one_process", "p17_exp1 try-0", 5),
        ("one_process", "p17_exp1_alone try-0", 5),
        ("one_process", "p17_exp1_alone try-0", 6),
        ("one_process", "p17_exp1 try-0", 6),
        ("separate", "p17_exp1_alone try-0", 6),
        ("separate", "p17_exp1 try-0", 6),
    ]
    assert steps == [(k, 8) for k in range(9)]
    values = {figure.name: figure.value for figure in findings.figures}
    # The way alone begins and ends within 5 cm of where the ride did.
    assert values["separate_cpu_ratio"] == values["one_process_cpu_ratio"] == pytest.approx(0.25, rel=0.12)
    assert values["one_process_by_separate_cpu_rider"] == pytest.approx(0.5)
    assert values["one_process_by_separate_pss"] == pytest.approx(0.25)
    assert values["rounds_not_judged"] == 0
    pairs, repeated = findings.tables
    assert [row[0] for row in pairs.rows] == [f"{w}, seed {s}" for w in cost.WIRINGS for s in (5, 6)]
    assert repeated.rows == [["p17_exp1, separate, seed 5: 10.0 % of the steps were late"]]


def test_robots_that_are_not_wired_as_asked_are_no_benchmark(tmp_path: Path) -> None:
    def drive(scenario: RideScenario, seed: int, output: Path) -> RunResult:
        return RunResult(seed, str(left(output / scenario.name, record_of(0.0))), "", (), 90.0, 90.0)

    with pytest.raises(HitchhikeError, match="not wired as one_process"):
        cost.run(Options(ROOT, ROOT, tmp_path, quick=True, drive=drive), lambda *_: None)


def test_who_cannot_drive_says_so(tmp_path: Path) -> None:
    with pytest.raises(HitchhikeError, match="real nodes"):
        cost.run(Options(ROOT, ROOT, tmp_path), lambda *_: None)


def test_no_node_without_memory() -> None:
    record = record_of(0.0)
    assert cost.pss_mb(record, "turtlebot", (REQUESTED, RELEASED)) == pytest.approx(100.0)
    assert cost.pss_mb(record, "turtlebot", (END, END + 1.0)) is None
    assert cost.pss_mb(record, "nobody", (REQUESTED, RELEASED)) is None
