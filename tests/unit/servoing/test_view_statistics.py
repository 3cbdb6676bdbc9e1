"""The numbers that calibrate_view shows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hitchhike_ros.core.geometry import matrix_from_xyz_rpy
from hitchhike_ros.servoing.view_statistics import MarkerView, ViewStatistics, sighting

# A marker's frame (x normal, z up) that faces the camera (z ahead, y down).
FACING = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def marker_at(x: float, y: float, z: float, turned: float) -> np.ndarray:
    T = FACING @ matrix_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, turned))
    T[:3, 3] = x, y, z
    return T


@pytest.mark.parametrize("yaw", [-1.0, 0.0, 0.4])
def test_a_marker_seen_from_the_camera(yaw: float) -> None:
    seen = sighting("36h11 id: 0", marker_at(-0.3, 0.1, 0.9, yaw))
    assert seen.range_m == pytest.approx(math.sqrt(0.91))
    assert seen.bearing_rad == pytest.approx(math.atan2(0.3, 0.9))  # left in the image is positive
    assert seen.yaw_rad == pytest.approx(yaw)


def test_share_rate_and_spread_are_of_late_and_the_summary_of_all() -> None:
    view = ViewStatistics()
    for k in range(100):  # 10 s at 10 Hz; the first half without a marker, then every fourth image misses it
        seen = MarkerView("36h11 id: 0", 1.0 + 0.01 * (-1) ** k, 0.1, -0.2) if k >= 50 and k % 4 != 1 else None
        view.add(0.1 * k, seen)
    assert view.rate_hz == pytest.approx(10.0)
    line = view.line()
    assert line.startswith("36h11 id: 0  range 0.990 m ± ")
    spread = int(line.split("± ")[1].split(" mm")[0])
    assert spread == pytest.approx(9.5, abs=0.6)
    assert "bearing +5.7°" in line
    assert "yaw -11.5°" in line
    assert "seen in 76 % of 10.0 Hz" in line
    assert view.summary() == "marker seen in 38 of 100 images (38 %), from 0.99 m to 1.01 m"


def test_no_image_and_no_marker_are_told_apart() -> None:
    view = ViewStatistics()
    assert (view.line(), view.summary()) == ("no image yet", "no image came")
    view.add(0.0, None)
    view.add(0.1, None)
    assert view.line().startswith("no marker")
    assert view.summary() == "marker seen in 0 of 2 images (0 %)"


def test_a_clock_that_starts_again_starts_a_new_window() -> None:
    view = ViewStatistics()
    view.add(100.0, None)
    view.add(0.0, None)
    view.add(0.5, None)
    assert view.rate_hz == pytest.approx(2.0)
