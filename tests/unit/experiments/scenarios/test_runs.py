"""Runs on all cores: every job once, results in the order of the jobs, errors raised, and what is written of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.experiments.scenarios.runs import run_all, write_results
from hitchhike_ros.experiments.scoring.figures import Figure


def double(job: int) -> int:
    if job == 13:
        raise PlanningError("no way")
    return 2 * job


def leave_a_trace(job: Path) -> None:
    if job.name == "0":
        raise PlanningError("no way")
    job.touch()


def test_results_come_in_the_order_of_the_jobs() -> None:
    said: list[tuple[str, int, int]] = []
    assert run_all("jobs", double, range(5), lambda *news: said.append(news)) == (0, 2, 4, 6, 8)
    assert said == [("jobs", k, 5) for k in range(1, 6)]


def test_what_a_job_raises_is_raised() -> None:
    with pytest.raises(PlanningError, match="no way"):
        run_all("jobs", double, [1, 13], lambda *_said: None)


def test_nothing_is_begun_after_a_job_has_failed(tmp_path: Path) -> None:
    jobs = [tmp_path / str(k) for k in range(2000)]
    with pytest.raises(PlanningError, match="no way"):
        run_all("jobs", leave_a_trace, jobs, lambda *_said: None)
    assert len(list(tmp_path.iterdir())) < len(jobs) - 1


def test_results_of_runs_are_written_one_a_line(tmp_path: Path) -> None:
    runs = (Figure("a", 1.5, "m"), Figure("b", None, "s", bound=2.0))
    write_results(tmp_path / "runs.json", {"first": runs, "none": (), "second": runs[:1]})
    text = (tmp_path / "runs.json").read_text()
    read = json.loads(text)
    assert [run["name"] for run in read["first"]] == ["a", "b"]
    assert read["first"][1]["value"] is None
    assert read["none"] == [] and len(read["second"]) == 1
    assert sum("{" in line for line in text.splitlines()[1:]) == 3
