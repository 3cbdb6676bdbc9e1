"""What the report draws over time and over the map, on a ride with round numbers."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hitchhike_ros.experiments.report.report_map import map_picture, replay
from hitchhike_ros.experiments.report.report_plots import following_plots, nice_ticks, robot_bars, time_axis
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.network_rides import network_rides
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from synthetic_ride import DECOUPLING, END, GAP_ERROR_M, RELEASED, RIDING, synthetic_ride

MARKERS = {0: "p3dx"}


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.0, 10.0, [0, 2, 4, 6, 8, 10]), (-0.03, 0.07, [-0.02, 0, 0.02, 0.04, 0.06]), (3.0, 3.0, [3.0])],
)
def test_ticks_are_round(low: float, high: float, expected: list[float]) -> None:
    assert nice_ticks(low, high, 5) == pytest.approx(expected)


def test_bars_say_what_a_robot_did_and_which_modules_were_on() -> None:
    record = synthetic_ride()
    axis = time_axis(record)
    assert (axis.start, axis.end) == pytest.approx((0.0, END))
    bars = robot_bars("turtlebot", record.robots["turtlebot"], axis)
    texts = [bar.text for bar in bars.states]
    assert texts[1:4] == ["requesting", "locking", "coupling"] and texts[-1] == "idle"
    (riding,) = [bar for bar in bars.states if bar.text == "riding"]
    assert riding.left == pytest.approx(100.0 * RIDING / END, abs=0.01) and riding.kind == "riding"
    on = dict(bars.modules)
    (alone, after) = on["PP"]  # off from riding to relocalizing at 68 s
    assert alone.left + alone.width == pytest.approx(100.0 * RIDING / END, abs=0.01)
    assert after.left == pytest.approx(100.0 * 68.0 / END, abs=0.01)


def test_curves_are_the_errors_that_were_made() -> None:
    record = synthetic_ride()
    axis = time_axis(record)
    gap, lateral = following_plots(record, network_rides(record, MARKERS), MARKERS, axis)
    assert gap.curves[0].label == "turtlebot behind p3dx"
    for plot, expected in ((gap, GAP_ERROR_M), (lateral, 0.1)):
        numbers = np.array(
            [[float(n) for n in pair] for pair in re.findall(r"[ML]([\d.]+) ([\d.]+)", plot.curves[0].path)]
        )
        zero, other = (next(t for t in plot.ticks if float(t.text) == v) for v in (0.0, float(plot.ticks[-1].text)))
        per_metre = (zero.percent - other.percent) / float(other.text)
        errors = (zero.percent - numbers[:, 1] / 10.0) / per_metre
        # The camera of a robot 0.1 m to the left is a little farther off than the gap along the corridor.
        assert np.median(errors) == pytest.approx(expected, abs=0.007)
        assert 10.0 * axis.percent(RIDING) - 1.0 <= numbers[:, 0].min()
        assert numbers[:, 0].max() <= 10.0 * axis.percent(DECOUPLING + 1.0)
        assert len({tick.text for tick in plot.ticks}) == len(plot.ticks)


def test_a_run_in_which_nothing_was_recorded_has_no_picture() -> None:
    record = RideRecord("nothing", 0, (), {})
    assert map_picture(record, [], None, Sites()) is None
    assert following_plots(record, [], {}, time_axis(record)) == []
    assert replay(record, time_axis(record))["robots"] == []


def test_the_map_has_y_upward_and_says_where_one_rode() -> None:
    record = synthetic_ride()
    rides = network_rides(record, MARKERS)
    picture = map_picture(record, rides, OccupancyGrid(np.zeros((20, 30), dtype=np.int8), 0.5), Sites())
    assert picture is not None and picture.background is not None
    x, y, width, height = picture.view
    assert x < 1.8 < x + width and y < -5.72 < y + height
    driver, rider = picture.tracks
    assert driver.start == (3.0, -5.72) and driver.aboard == ()
    (aboard,) = rider.aboard
    last = record.robots["turtlebot"].truth[-1]
    assert aboard.split()[-1] == f"{last.x:.2f},{-last.y:.2f}"
    assert (picture.background.width, picture.background.height) == (15.0, 10.0)
    box = record.true_boxes[0]
    assert picture.true_boxes[0].y == pytest.approx(-(box.y + box.b))


def test_the_replay_is_where_robots_were() -> None:
    record = synthetic_ride()
    axis = time_axis(record)
    content = replay(record, axis)
    robots = content["robots"]
    assert isinstance(robots, list)
    step = content["step"]
    assert isinstance(step, float)
    k = round(RELEASED / step)
    truth = min(record.robots["p3dx"].truth, key=lambda p: abs(p.stamp - k * step))
    assert (robots[0]["x"][k], robots[0]["y"][k]) == pytest.approx((truth.x, -truth.y), abs=0.05)
