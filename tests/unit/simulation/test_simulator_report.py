"""What the simulator says of itself, and how often."""

from __future__ import annotations

import pytest

from hitchhike_ros.simulation.simulator_report import Diagnosis, SimulatorReport


class Wall:
    """Wall time that a test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def wall() -> Wall:
    return Wall()


def diagnosis(report: SimulatorReport, wall: Wall, at: float) -> Diagnosis | None:
    wall.now = at
    return report.due(63.4, 2.0, {("r", "slam"): 3, ("r", "visual_servoing"): 1}, {"late_steps": 2})


def test_each_touch_is_told_once() -> None:
    report = SimulatorReport(30.0)
    assert report.touches([]) == []
    assert report.touches(["a", "b"]) == ["a", "b"]
    assert report.touches(["a", "b"]) == []
    assert report.touches(["a", "b", "c"]) == ["c"]


def test_after_a_restart_touches_are_new() -> None:
    report = SimulatorReport(30.0)
    report.touches(["a", "b"])
    report.restart()
    assert report.touches(["d", "e"]) == ["d", "e"]


def test_the_diagnosis_names_contacts_and_who_missed(wall: Wall) -> None:
    report = SimulatorReport(30.0, wall)
    well = diagnosis(report, wall, 101.0)
    values = {
        "real_time_factor": "2.00",
        "contacts": 0,
        "lockstep_misses": 4,
        "lockstep_misses_r_slam": 3,
        "lockstep_misses_r_visual_servoing": 1,
        "late_steps": 2,
    }
    assert well == Diagnosis(True, "running", values)
    report.touches(["a", "b"])
    assert diagnosis(report, wall, 102.0) == Diagnosis(False, "2 contacts", {**values, "contacts": 2})
    report.restart()
    assert diagnosis(report, wall, 103.0) == well


def test_it_comes_once_a_second_and_the_line_once_in_its_period(wall: Wall) -> None:
    report = SimulatorReport(3.0, wall)
    said = [diagnosis(report, wall, 100.0 + 0.25 * k) for k in range(1, 29)]
    assert [k for k, each in enumerate(said, 1) if each is not None] == [4, 8, 12, 16, 20, 24, 28]
    lines = [each.line for each in said if each is not None]
    assert [bool(line) for line in lines] == [False, False, True, False, False, True, False]
    assert lines[2].startswith("63 s simulated, real_time_factor 2.00, contacts 0, lockstep_misses 4, ")
