"""The report of the experiments: one file that says what was measured, whatever is missing."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import msgspec

from hitchhike_ros.experiments.report.html_report import write_report
from hitchhike_ros.experiments.scenarios.ride_record import save_record
from hitchhike_ros.experiments.scenarios.ride_scenario import ExpectedRide, RideScenario
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.results import RunResult, ScenarioResult
from repository import ROOT
from synthetic_ride import synthetic_ride

PACKAGE = ROOT
WORLD = {"base": str(PACKAGE / "maps" / "p17_exp1.world.yaml")}
SCENARIO = RideScenario("Boxes & <people>", "P17 §7.1", WORLD, rides=(ExpectedRide("turtlebot", "p3dx"),), name="ride")
FIGURES = (Figure("couple", 5.43, "s", 15.33, peer=15.33), Figure("gap_error_rms", 0.2345, "m", 0.1))
VOID = {"meta", "link", "br", "hr", "img", "input"}


class WellFormed(HTMLParser):
    """Keeps the elements that are open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes <{self.open[-1:]}>"
        self.open.pop()


def report(folder: Path, *results: ScenarioResult) -> str:
    text = write_report(folder, results).read_text(encoding="utf-8")
    parser = WellFormed()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:|//)|url\(\s*["']?https?:|@import""", text)
    return text


def result(folder: Path, trouble: str = "", record: bool = True) -> ScenarioResult:
    run = folder / "ride" / "seed-3"
    run.mkdir(parents=True)
    SCENARIO.write_world(run)
    if record:
        save_record(synthetic_ride(), run / "record.json")
        (run / "ride.json").write_bytes(msgspec.json.encode({"versions": {"numpy": "1.24.2"}}))
    return ScenarioResult(SCENARIO, (RunResult(3, str(run), trouble, FIGURES if record else (), 90.0, 60.0),))


def test_it_says_what_was_measured_beside_the_paper(tmp_path: Path) -> None:
    text = report(tmp_path, result(tmp_path))
    for expected in ("P17 §7.1", "15.3", "5.4", "0.23", "turtlebot", "obs1"):
        assert expected in text
    assert "Boxes &amp; &lt;people&gt;" in text
    assert "<people>" not in text


def test_what_a_ride_saves_stands_in_the_summary_beside_the_papers_figures(tmp_path: Path) -> None:
    good = result(tmp_path)
    (run,) = good.runs
    saved = (Figure("ride_cpu_ratio", 0.37, "", 0.4), Figure("riding_cpu_ratio", 0.26, ""))
    summary = report(tmp_path, replace(good, runs=(replace(run, figures=FIGURES + saved),))).partition("</section>")[0]
    assert "0.37" in summary and "≤ 0.4" in summary and "5.4" in summary
    assert "0.26" not in summary and "gap error" not in summary


def test_a_run_that_failed_says_why_even_without_a_record(tmp_path: Path) -> None:
    text = report(tmp_path, result(tmp_path, "node /p3dx/slam died & <gone>", record=False))
    assert "node /p3dx/slam died &amp; &lt;gone&gt;" in text


def test_a_broken_bound_is_marked(tmp_path: Path) -> None:
    good = result(tmp_path)
    (run,) = good.runs
    held = replace(good, runs=(replace(run, figures=FIGURES[:1]),))
    assert report(tmp_path, good).count("✗") > report(tmp_path, held).count("✗")
