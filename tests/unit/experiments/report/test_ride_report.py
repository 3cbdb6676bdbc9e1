"""What a person sees of a ride: the live line, the tables, the picture."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from hitchhike_ros.core.datatypes import Obstacle, Pose2D
from hitchhike_ros.experiments.report.ride_picture import draw_ride
from hitchhike_ros.experiments.report.ride_report import (
    RideProgress,
    box_table,
    change,
    cpu_table,
    figure_table,
    live_line,
    module_names,
    progress,
    summary_table,
)
from hitchhike_ros.experiments.report.screen import text_of
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.boxes import match_boxes
from hitchhike_ros.experiments.scoring.figures import Figure, summarize
from hitchhike_ros.experiments.scoring.node_costs import node_costs
from hitchhike_ros.experiments.scoring.rides import Ride, find_ride
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.status import ModuleSwitches
from synthetic_ride import RIDING, synthetic_ride

RIDER = ModuleSwitches(PP=False, OBS=False, LZN=False, MAP=False, COM=True, VS=True)
NOW = RideProgress("Riding", 12.4, 20.4, 0.81, "turtlebot", RIDER, 54.2, 0.83)


def at(stamp: float) -> RideRecord:
    """The synthetic ride as it was at one time."""
    record = synthetic_ride()
    for robot in record.robots.values():
        robot.statuses = [s for s in robot.statuses if s.time_stamp <= stamp]
        robot.newest_status = robot.statuses[-1] if robot.statuses else None
        robot.truth = [p for p in robot.truth if p.stamp <= stamp]
    return record


@pytest.mark.parametrize("columns", [20, 40, 60, 80, 120, 200])
def test_the_live_line_fits_and_begins_with_the_step(columns: int) -> None:
    file = io.StringIO()
    Console(file=file, width=columns).print(live_line(NOW))
    (line,) = file.getvalue().splitlines()
    assert len(line) <= columns
    assert line.startswith("Riding")
    assert columns < 80 or ("12.4/20.4 m" in line and "gap 0.81 m" in line and "pp obs lzn map COM VS" in line)


def test_a_change_of_step_or_modules_is_worth_a_line() -> None:
    assert change(NOW) == change(replace(NOW, gap_m=0.9, ridden_m=13.0, sim_s=60.0))
    assert len({change(NOW), change(replace(NOW, step="Handing over")), change(replace(NOW, modules=None))}) == 3


@pytest.mark.parametrize(
    ("stamp", "step"),
    [
        (0.1, "Starting"),
        (6.0, "Waiting for a request"),
        (11.0, "Asking for a ride"),
        (16.0, "Taking the offer"),
        (24.5, "Coupling"),
        (30.0, "Riding"),
        (65.9, "Handing over"),
        (69.0, "Taking over the pose"),
        (72.0, "Driving on alone"),
        (89.0, "Arrived"),
    ],
)
def test_the_step_follows_both_robots(stamp: float, step: str) -> None:
    record = at(stamp)
    assert progress(record, find_ride(record), None).step == step


def test_progress_tells_distance_gap_and_modules_on_the_ride() -> None:
    record = at(45.0)
    driver = record.robots["p3dx"]
    assert driver.newest_status is not None
    assert driver.newest_status.ride is not None
    driver.add_status(replace(driver.newest_status, ride=replace(driver.newest_status.ride, ridden_m=7.5)))
    now = progress(record, find_ride(record), 0.7)
    assert (now.ridden_m, now.ride_m, now.rider, now.modules) == (7.5, 20.4, "turtlebot", RIDER)
    assert now.gap_m == pytest.approx(np.hypot(0.85, 0.1))
    record = at(72.0)
    assert progress(record, find_ride(record), 0.7).gap_m is None


def test_modules_that_are_off_are_small() -> None:
    assert module_names(RIDER) == "pp obs lzn map COM VS"


def test_a_figure_stands_beside_the_papers() -> None:
    table = figure_table([Figure("gap_error_rms", 0.056, "m", 0.1), Figure("wait", None, "s", peer=21.67)])
    assert [list(row) for row in table.rows] == [
        ["gap error rms (m)", "0.056", "", "", "≤ 0.1", "✓"],
        ["wait (s)", "–", "21.7", "", "", ""],
    ]
    assert table.header == ["", "ours", "paper", "ratio", "bound", ""]


def test_boxes_stand_beside_the_true_ones() -> None:
    boxes = [Obstacle("a", 1.0, 2.0, 0.3, 0.4), Obstacle("b", 9.0, 2.0, 0.3, 0.4)]
    rows = box_table(match_boxes(boxes, [Obstacle("x", 1.0, 2.0, 0.5, 0.4)])).rows
    assert list(rows[0][-3:]) == ["0.100", "0.200", "✗"]
    assert "not found" in rows[1]


def test_cpu_is_told_in_percent_of_a_core() -> None:
    record = synthetic_ride()
    rows = [line.split() for line in text_of(cpu_table(node_costs(record, find_ride(record)))).split("\n")]
    assert rows[0] == ["CPU", "in", "all", "coupling", "riding", "alone", "memory"]
    assert rows[2] == ["/turtlebot/slam", "15.2", "s", "30.0", "%", "1.0", "%", "30.0", "%", "140", "MB"]


def test_a_summary_tells_how_many_runs_held() -> None:
    runs = summarize([[Figure("couple", value, "s", 15.0, peer=15.33)] for value in (12.0, 16.0, 13.0)])
    row = text_of(summary_table(runs, [4, 5, 6])).split("\n")[1].split()
    assert row == ["couple", "(s)", "13.0", "16.0", "15.3", "≤", "15", "✗", "2/3"]


@pytest.mark.parametrize("ride", [None, Ride("turtlebot", "p3dx", riding_at=RIDING)])
def test_the_picture_shows_map_and_trajectories(tmp_path: Path, ride: Ride | None) -> None:
    data = np.zeros((300, 675), np.int8)
    data[:115] = 100
    grid = OccupancyGrid(data, 0.04, Pose2D())
    draw_ride(tmp_path / "map.png", synthetic_ride(), ride, grid, Sites(), "Title")
    picture = cv2.imread(str(tmp_path / "map.png"))
    assert picture.shape[1] == 1400
    blue = (np.abs(picture.astype(int) - (0xB2, 0x72, 0x00)) < 12).all(axis=2)  # the driver's line
    assert blue.any(axis=0).sum() > 1000
