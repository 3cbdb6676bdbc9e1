"""A robot's own path: simplified, how far along it the robot is, and what it announces of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.protocol.announcement import NODES_M, OwnPath, announced_driver

METRES = st.floats(-50.0, 50.0, width=32)
PATHS = arrays(float, st.tuples(st.integers(1, 12), st.just(2)), elements=METRES)
CORNER = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0)])


@given(st.lists(st.tuples(st.floats(0.05, 1.0), st.floats(-1.0, 1.0)), min_size=1, max_size=30))
def test_the_simplified_path_is_nowhere_far_from_the_plan(steps: list[tuple[float, float]]) -> None:
    """As of a plan: it does not come back to where it was."""
    points = np.vstack([(0.0, 0.0), np.cumsum(steps, axis=0)])
    line = OwnPath(points).line
    _, away = line.project_all(points)
    assert away.max() < 0.16
    assert (line.points[0].tolist(), math.dist(line.points[-1], points[-1]) < 2e-3) == (points[0].tolist(), True)


def test_a_straight_plan_is_two_points_and_a_corner_stays() -> None:
    straight = np.column_stack([np.linspace(0.0, 8.0, 161), np.zeros(161)])
    assert OwnPath(straight).line.points.tolist() == [[0.0, 0.0], [8.0, 0.0]]
    bent = OwnPath(np.vstack([straight, [(8.0, 3.0)]]))
    assert bent.line.points.tolist() == [[0.0, 0.0], [8.0, 0.0], [8.0, 3.0]]


def test_it_comes_along_its_path_and_never_back() -> None:
    path = OwnPath(CORNER)
    assert path.advance(Pose2D(3.0, 0.2))
    assert (path.come_m, path.left_m) == (pytest.approx(3.0), pytest.approx(12.0))
    assert path.advance(Pose2D(2.0, 0.0))
    assert path.come_m == pytest.approx(3.0)
    assert path.advance(Pose2D(10.3, 2.0))
    assert path.come_m == pytest.approx(12.0)
    assert not path.advance(Pose2D(10.0, 6.6))
    assert path.come_m == pytest.approx(12.0)
    assert path.advance(Pose2D(10.0, 6.4))
    assert path.left_m == 0.0


def test_what_is_announced_is_what_is_ahead_with_times_from_now_on() -> None:
    path = OwnPath(CORNER)
    path.advance(Pose2D(4.0, 0.0))
    expected = [(4.0, 0.0, 3.0), (10.0, 0.0, 15.0), (10.0, 5.0, 25.0)]
    assert [tuple(point) for point in path.waypoints(0.5, in_s=3.0)] == [pytest.approx(point) for point in expected]
    path.come_m = 9.9995  # so near a corner is passed over
    assert [tuple(point) for point in path.waypoints(0.5)] == [
        pytest.approx(point) for point in [(9.9995, 0.0, 0.0), (10.0, 5.0, 10.001)]
    ]
    path.advance(Pose2D(10.0, 5.0))
    assert path.waypoints(0.5) == ()
    assert OwnPath(np.array([(1.0, 2.0)])).waypoints(0.5) == ()


@given(PATHS)
def test_nodes_are_no_farther_apart_than_where_a_ride_may_end(points: FloatArray) -> None:
    path = OwnPath(points)
    nodes, arcs = path.nodes()
    assert (arcs[0], arcs[-1]) == (0.0, path.line.end_m)
    assert np.diff(arcs).max() <= NODES_M + 1e-9
    assert nodes == pytest.approx(path.line.at(arcs))


def test_a_path_that_was_announced_has_nodes_along_the_way() -> None:
    driver = announced_driver("p3dx", OwnPath(CORNER).waypoints(0.5, in_s=2.0), 100.0, 2, 0.6)
    steps = np.hypot(*np.diff(driver.path, axis=0).T)
    assert (len(driver.path), steps.max()) == (7, pytest.approx(2.5))
    assert driver.path[[0, 4, -1]].tolist() == CORNER.tolist()
    assert driver.times == pytest.approx(102.0 + np.arange(7) * 5.0)
