"""How rides along courses, couplings and lost drivers are scored and judged."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.experiments.bench import following as bench_following
from hitchhike_ros.experiments.bench.coupling_scores import CouplingResult
from hitchhike_ros.experiments.bench.following import coupling_figures, course_figures, lost_figures
from hitchhike_ros.experiments.bench.following_scores import RideResult, score_ride
from hitchhike_ros.experiments.bench.registry import Options
from hitchhike_ros.experiments.scenarios.couplings import WALL
from hitchhike_ros.experiments.scenarios.following_rides import DRIVER, RIDER, STRAIGHT
from hitchhike_ros.experiments.scenarios.lost_drivers import LostResult
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord, TimedPose
from hitchhike_ros.protocol.status import RideStatus, ServoCommand, Status
from simulated_room import PACKAGE

RESULT = RideResult(0, "", 10.0, 0.01, 0.02, 0.03, 0, ())


LOST = LostResult(0, "", "Goal reached", "Goal reached", ("riding", "settling"), (), 30.0, 0.1, True, 0.5)


def record_of(offset: float) -> RideRecord:
    """A ride of 10 s along x, the rider's camera and the driver's marker 0.8 m + ``offset`` apart, 0.02 m beside."""
    robots = {name: RobotRecord(Pose2D(0.1), Pose2D(-0.3, 0.0, math.pi)) for name in (DRIVER, RIDER)}
    for stamp in np.arange(0.0, 12.0, 0.1):
        x = 0.5 * float(stamp)
        robots[DRIVER].truth.append(TimedPose(float(stamp), x, 0.0, 0.0))
        robots[RIDER].truth.append(TimedPose(float(stamp), x - 1.2 - offset, 0.02, 0.0))
    shared, servo = RideStatus("r", DRIVER, RIDER), ServoCommand("follow", 0, gap_m=0.8)
    for name, role, states in (
        (DRIVER, "driver", ("aligning", "driving", "decoupling")),
        (RIDER, "hitchhiker", ("coupling", "riding", "settling")),
    ):
        for stamp, state in zip((0.0, 1.0, 11.0), states, strict=True):
            own = servo if state == "riding" else None
            robots[name].add_status(Status(stamp, name, role, state, servo=own, ride=shared))
    return RideRecord("test", 0, (), robots)


def test_errors_are_those_of_the_truth() -> None:
    result = score_ride(record_of(0.05), 0, "")
    assert result.completed
    assert result.ridden_m == pytest.approx(5.0, abs=0.1)
    assert result.gap_rms_m == pytest.approx(0.05, abs=1e-3)
    assert result.lateral_rms_m == pytest.approx(0.02, abs=1e-3)


def test_a_ride_that_does_not_come_about_has_no_errors_and_is_not_forgiven() -> None:
    record = record_of(0.0)
    record.robots[DRIVER].statuses.pop()
    result = score_ride(record, 0, "")
    assert not result.completed
    assert [f.ok for f in course_figures(STRAIGHT, (RESULT, result)) if f.bound is not None] == [False, True, True]


def test_each_bound_of_the_courses_breaks_for_its_own_reason() -> None:
    assert [f.ok for f in course_figures(STRAIGHT, (RESULT, RESULT)) if f.bound is not None] == [True, True, True]
    assert [f.ok for f in course_figures(STRAIGHT, (replace(RESULT, contacts=("wall",)),)) if f.bound is not None] == [
        True,
        False,
        True,
    ]
    assert [f.ok for f in course_figures(STRAIGHT, (replace(RESULT, lost=1),)) if f.bound is not None] == [
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("change", "ok"),
    [
        ({}, [True, True, True]),
        ({"rider_end": "seeking at the end"}, [False, True, True]),
        ({"goal_error_m": 0.6}, [False, True, True]),
        ({"contacts": ("a wall",)}, [True, False, True]),
        ({"rides_on_s": 2.5}, [True, True, False]),
        ({"rides_on_s": None}, [True, True, False]),
        ({"rides_on_s": None, "short": False}, [True, True, True]),
    ],
)
def test_each_bound_of_the_lost_drivers_breaks_for_its_own_reason(change, ok) -> None:
    figures = lost_figures((LOST, replace(LOST, **change)))
    assert [f.ok for f in figures if f.bound is not None] == ok


@pytest.mark.parametrize(
    ("couple_s", "decouple_s", "contacts", "broken"),
    [
        (11.0, 1.0, (), []),
        (13.0, 1.0, (), ["coupling by the left wall, from any heading: median"]),
        (11.0, None, (), ["decoupling by the left wall, from any heading: median"]),
        (11.0, 1.0, ("driver and walls at 3.0 s",), ["coupling by the left wall, from any heading: contacts"]),
    ],
)
def test_couplings_are_judged_by_their_medians_and_none_may_fail(couple_s, decouple_s, contacts, broken) -> None:
    results = tuple(CouplingResult(seed, couple_s, decouple_s, contacts) for seed in range(3))
    assert [figure.name for figure in coupling_figures(WALL, results) if figure.ok is False] == broken


def test_the_whole_benchmark_writes_every_run_and_gives_every_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its hour is not spent here: the runs are made up."""
    made_up: dict[str, Any] = {
        "coupling": CouplingResult(0, 5.0, 1.0, ()),
        "drivers": LOST,
    }

    def run_all(what: str, _run: object, seeds: range, _progress: object) -> tuple[Any, ...]:
        return tuple(made_up.get(what.split(maxsplit=1)[0], RESULT) for _ in seeds)

    monkeypatch.setattr(bench_following, "run_all", run_all)
    figures = bench_following.run(Options(PACKAGE, PACKAGE, tmp_path), lambda *_: None).figures
    assert all(figure.ok for figure in figures if figure.bound is not None)
    assert sum(figure.bound is not None for figure in figures) >= 20
    written = json.loads((tmp_path / "following.json").read_text())
    assert sorted(len(runs) for runs in written.values()) == [20, 20, 20, 20, 20, 20, 50]
