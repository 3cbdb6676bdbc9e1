"""What the report draws over time and over the map, on a ride with round numbers."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.experiments.report.curves import SIZES, SVG, Size
from hitchhike_ros.experiments.report.report_map import map_picture, replay
from hitchhike_ros.experiments.report.report_plots import TimeAxis, following_plots, robot_bars, time_axis
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.network_rides import network_rides
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from synthetic_ride import DECOUPLING, END, GAP_ERROR_M, RELEASED, RIDING, synthetic_ride

MARKERS = {0: "p3dx"}


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
    assert gap.legend == lateral.legend == (("turtlebot behind p3dx", 1),)
    for plot, expected in ((gap, GAP_ERROR_M), (lateral, 0.1)):
        for name, size in SIZES.items():
            times, errors = drawn(plot.pictures[name], size, axis)
            # The camera of a robot 0.1 m to the left is a little farther off than the gap along the corridor.
            assert np.median(errors) == pytest.approx(expected, abs=0.007)
            assert times.min() >= RIDING - 0.5 and times.max() <= DECOUPLING + 1.0


def drawn(picture: str, size: Size, axis: TimeAxis) -> tuple[FloatArray, FloatArray]:
    """Times and values of the only curve of a picture, by the labels beside it."""
    root = ElementTree.fromstring(picture)
    (curve,) = [g.find(f"{{{SVG}}}path") for g in root.iter(f"{{{SVG}}}g") if g.find(f"{{{SVG}}}title") is not None]
    assert curve is not None
    points = np.array(re.findall(r"[ML] (\S+) (\S+)", curve.get("d", "")), dtype=float)
    labels = [(float(t.get("y", "")), t.text or "") for t in root.iter(f"{{{SVG}}}text") if float(t.get("x", "")) < 0.0]
    (y0, text0), *_, (y1, text1) = labels
    v0, v1 = (float(text.replace("−", "-")) for text in (text0, text1))
    baseline = _zero_line(root) - (y0 + (0.0 - v0) * (y1 - y0) / (v1 - v0))  # of a text below its middle
    values = v0 + (points[:, 1] - baseline - y0) * (v1 - v0) / (y1 - y0)
    return axis.start + points[:, 0] / size.width * axis.span, values


def _zero_line(root: ElementTree.Element) -> float:
    (zero,) = [p for p in root.iter(f"{{{SVG}}}path") if "stroke: var(--dim)" in p.get("style", "")]
    return float(zero.get("d", "").split()[2])


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
