"""What avoidance and mapping find in the drives along the corridor."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hitchhike_ros.core.datatypes import Obstacle
from hitchhike_ros.experiments.bench import avoidance, mapping
from hitchhike_ros.experiments.bench.corridor_drives import DriveResult
from hitchhike_ros.experiments.bench.registry import Benchmark, Options
from simulated_room import PACKAGE

GOOD = DriveResult(0, "p3dx", "Goal reached", (), 25.0, 0.05, 0.02, 3, 3, (), 0.02, 0.03, 1.0, 23.3)


@pytest.mark.parametrize(
    ("bench", "change", "broken"),
    [
        (avoidance, {}, set()),
        (avoidance, {"contacts": ("anna",)}, {"contacts with boxes, people and walls"}),
        (avoidance, {"outcome": "Navigation failed: no way"}, {"drives that reach their goal"}),
        (avoidance, {"goal_error_m": 0.2}, {"goal error, worst"}),
        (mapping, {}, set()),
        (mapping, {"found": 2}, {"boxes found"}),
        (mapping, {"phantoms": (Obstacle("obs4", 8.0, 5.0, 0.5, 0.5),)}, {"people and phantoms on the map"}),
        (mapping, {"place_error_m": 0.09}, {"box place error, worst"}),
        (mapping, {"size_error_m": 0.09}, {"box size error, worst"}),
    ],
)
def test_one_bad_drive_breaks_its_bound_and_no_other(
    bench: Benchmark, change: dict, broken: set[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drives = (GOOD, replace(GOOD, **change))
    monkeypatch.setattr(avoidance, "corridor_drives", lambda _package, _seeds, _progress: drives)
    figures = bench.run(Options(PACKAGE, PACKAGE, tmp_path), lambda *_: None).figures
    assert {figure.name for figure in figures if figure.ok is False} == broken
    (written,) = json.loads((tmp_path / "drives.json").read_text()).values()
    assert [run["seed"] for run in written] == [0, 0]
