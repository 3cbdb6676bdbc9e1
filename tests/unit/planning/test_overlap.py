"""The common stretch of two paths."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.planning.overlap import Overlap, common_path

TOLERANCE = 0.3
STEP = TOLERANCE / 5  # the common stretch is found to this resolution


def line(*corners: tuple[float, float], step: float = 0.1) -> np.ndarray:
    """Points ``step`` apart along the polyline through ``corners``."""
    corners_ = np.array(corners, dtype=float)
    arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners_, axis=0), axis=1))])
    at = np.linspace(0.0, arcs[-1], max(2, int(arcs[-1] / step) + 1))
    return np.column_stack([np.interp(at, arcs, corners_[:, axis]) for axis in (0, 1)])


@st.composite
def winding_paths(draw):
    """Paths that turn left and right but go on to the east, so that no two parts of one run close to each other."""
    turns = draw(st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=20))
    headings = np.array(turns)
    steps = np.column_stack([np.cos(headings), np.sin(headings)])
    return np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])


@given(winding_paths())
@settings(max_examples=60)
def test_a_path_shares_all_of_itself_and_nothing_with_its_reverse(path):
    overlap = common_path(path, path, TOLERANCE)
    assert overlap.length_m == pytest.approx(path_length(path))
    assert (overlap.nearest.x, overlap.nearest.y) == pytest.approx(tuple(path[0]))
    assert (overlap.farthest.x, overlap.farthest.y) == pytest.approx(tuple(path[-1]))
    assert common_path(path, path[::-1], TOLERANCE) == Overlap()


@given(winding_paths(), st.floats(0.1, 0.9), st.floats(0.1, 0.9))
@settings(max_examples=60)
def test_a_part_is_found_where_it_is(path, one, other):
    low, high = sorted((one, other))
    total = path_length(path)
    assume((high - low) * total > 1.0)
    fine = line(*map(tuple, path), step=0.01)
    part = fine[int(low * len(fine)) : int(high * len(fine))]
    overlap = common_path(path, part, TOLERANCE)
    # The last bit before and behind the part is within the tolerance too.
    slack = TOLERANCE + 2 * STEP
    assert overlap.start_a_m == pytest.approx(low * total, abs=slack)
    assert overlap.end_a_m == pytest.approx(high * total, abs=slack)
    assert (overlap.start_b_m, overlap.end_b_m) == pytest.approx((0.0, path_length(part)), abs=slack)


@given(winding_paths(), st.floats(-math.pi, math.pi), st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
@settings(max_examples=60)
def test_it_does_not_depend_on_where_the_map_lies(path, angle, shift):
    other = path + np.linspace(0, 1, len(path))[:, None] * [0.0, 0.8]
    R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    here = common_path(path, other, TOLERANCE)
    there = common_path(path @ R.T + shift, other @ R.T + shift, TOLERANCE)
    assert there.length_m == pytest.approx(here.length_m, abs=3 * STEP)


@given(winding_paths())
@settings(max_examples=60)
def test_both_paths_find_about_the_same_length(path):
    other = path + np.linspace(0, 1, len(path))[:, None] * [0.0, 0.8]
    there, back = common_path(path, other, TOLERANCE), common_path(other, path, TOLERANCE)
    assert back.length_m == pytest.approx(there.length_m, abs=0.25 * path_length(path) + 4 * TOLERANCE)
    for overlap in (there, back):
        assert overlap.length_m == pytest.approx(overlap.end_a_m - overlap.start_a_m)
        assert overlap.end_b_m >= overlap.start_b_m


@pytest.mark.parametrize(("offset", "shared"), [(0.0, 10.0), (0.29, 10.0), (0.31, 0.0)])
def test_the_tolerance_is_the_distance_of_paths_in_line(offset, shared):
    overlap = common_path(line((0, 0), (10, 0)), line((0, offset), (10, offset)), TOLERANCE)
    assert overlap.length_m == pytest.approx(shared)


def test_paths_that_meet_and_part():
    driver = line((0, 0), (20, 0), (20, 10))
    hitchhiker = line((3, -5), (3, 0), (20, 0), (20, -10))
    overlap = common_path(driver, hitchhiker, TOLERANCE)
    assert overlap.nearest.x == pytest.approx(3.0, abs=0.4)
    assert overlap.farthest.x == pytest.approx(20.0, abs=0.4)
    assert overlap.farthest.y == pytest.approx(0.0, abs=0.3)
    assert overlap.nearest.theta == pytest.approx(0.0, abs=0.1)
    assert overlap.length_m == pytest.approx(17.0, abs=0.6)
    assert overlap.start_b_m == pytest.approx(5.0, abs=0.4)


def test_the_staircase_of_a_grid_path_runs_along_the_line_it_stands_for():
    steps = np.array([[0.1, 0.0], [0.1, 0.1]] * 50)
    staircase = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    straight = line((0, 0), (10, 5))
    assert common_path(staircase, straight, TOLERANCE).length_m == pytest.approx(path_length(staircase), abs=STEP)


def test_crossing_is_not_sharing():
    assert common_path(line((0, 0), (10, 0)), line((5, -5), (5, 5)), TOLERANCE).length_m == 0.0


def test_a_short_interruption_is_bridged_and_a_long_one_is_not():
    straight = line((0, 0), (30, 0))

    def detour(length: float) -> np.ndarray:
        return line((0, 0), (10, 0), (10.5, 0.5), (10.5 + length, 0.5), (11 + length, 0), (30, 0))

    assert common_path(straight, detour(0.2), TOLERANCE, gap_m=2.0).length_m == pytest.approx(30.0)
    long = common_path(straight, detour(4.0), TOLERANCE, gap_m=2.0)
    assert (long.start_a_m, long.end_a_m) == pytest.approx((0.0, 30.0))
    assert long.length_m == pytest.approx(30.0 - 5.0, abs=1.2), "what lies between is not shared"


@pytest.mark.parametrize("short", [np.empty((0, 2)), np.array([[1.0, 0.0]]), np.array([[1.0, 0.0], [1.0, 0.0]])])
def test_paths_without_length_share_nothing(short):
    path = line((0, 0), (10, 0))
    assert common_path(path, short, TOLERANCE) == common_path(short, path, TOLERANCE) == Overlap()
