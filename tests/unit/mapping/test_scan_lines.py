"""Straight pieces of a scan: where they begin and end, and how they run."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D
from hitchhike_ros.mapping.laser import EndPoints, LaserNoise, end_points
from hitchhike_ros.mapping.scan_lines import LineParameters, ScanLine, extract_lines
from laser_world import LASER, boxes_of, take_scan

PARAMETERS, NOISE = LineParameters(), LaserNoise()


def seen(points: FloatArray, beams: FloatArray | None = None) -> EndPoints:
    """End points (N, 2) as of a laser in the origin whose beams are in their order."""
    ranges = np.hypot(points[:, 0], points[:, 1])
    return EndPoints(points, ranges, np.arange(len(points)) if beams is None else beams)


def wall(start: tuple[float, float], end: tuple[float, float], count: int = 40) -> FloatArray:
    return np.linspace(start, end, count)


def ends_of(chains: list[list[ScanLine]]) -> list[list[tuple[int, int]]]:
    return [[(line.first, line.last) for line in chain] for chain in chains]


@given(st.floats(-math.pi, math.pi), st.floats(0.3, 3.0))
def test_a_straight_wall_is_one_line_along_it(angle: float, away: float) -> None:
    c, s = math.cos(angle), math.sin(angle)
    points = wall((away, -1.0), (away, 1.0)) @ np.array([[c, s], [-s, c]])
    ((line,),) = extract_lines(seen(points), NOISE, PARAMETERS)
    assert (line.first, line.last) == (0, 39)
    assert line.centre == pytest.approx(np.array([away * c, away * s]), abs=1e-9)
    assert abs(line.direction @ [-s, c]) == pytest.approx(1.0)


def test_a_straight_wall_in_noise_is_one_line() -> None:
    box, rng = boxes_of([Obstacle("wall", -4.0, 1.0, 8.0, 0.2)]), np.random.default_rng(5)
    for _ in range(20):
        ends = end_points(take_scan(Pose2D(0.0, 0.0, 1.5), box, rng), LASER)
        chains = extract_lines(ends, NOISE, PARAMETERS)
        longest = max(itertools.chain(*chains), key=lambda line: line.last - line.first)
        assert longest.last - longest.first > 200
        assert abs(longest.direction[0] * math.cos(1.5) - longest.direction[1] * math.sin(1.5)) > 0.999


def test_walls_that_meet_are_two_lines_of_one_chain_that_share_the_corner() -> None:
    points = np.vstack([wall((2.0, -1.0), (2.0, 0.5)), wall((2.0, 0.5), (1.0, 0.5), 26)[1:]])
    chains = extract_lines(seen(points), NOISE, PARAMETERS)
    assert ends_of(chains) == [[(0, 39), (39, 64)]]
    (one, two), corner = chains[0], points[39]
    assert abs(one.direction @ two.direction) == pytest.approx(0.0, abs=1e-9)
    # The corner belongs to neither fit: half of the time it is a reading of the other wall.
    assert one.centre == pytest.approx((points[1] + points[38]) / 2.0)
    assert abs((corner - one.centre) @ one.direction) == pytest.approx(0.75, abs=0.05)


@pytest.mark.parametrize(("gap_m", "chains"), [(0.10, 1), (0.14, 2)])
def test_a_gap_ends_a_chain(gap_m: float, chains: int) -> None:
    points = np.vstack([wall((1.0, -1.0), (1.0, 0.0)), wall((1.0, gap_m), (1.0, 1.0))])
    assert len(extract_lines(seen(points), NOISE, PARAMETERS)) == chains


@pytest.mark.parametrize(("missing", "chains"), [(1, 1), (2, 2)])
def test_beams_that_see_nothing_end_a_chain(missing: int, chains: int) -> None:
    points, beams = wall((1.0, -1.0), (1.0, 1.0)), np.arange(40)
    beams[20:] += missing
    assert len(extract_lines(seen(points, beams), NOISE, PARAMETERS)) == chains


def test_a_bend_within_the_noise_is_none_and_a_deeper_one_is() -> None:
    for depth, count in ((0.03, 1), (0.3, 2)):
        points = np.vstack([wall((2.0, -1.0), (2.0 - depth, 0.0)), wall((2.0 - depth, 0.0), (2.0, 1.0))[1:]])
        assert [len(chain) for chain in extract_lines(seen(points), NOISE, PARAMETERS)] == [count], depth


def test_pieces_that_are_one_line_after_all_are_joined() -> None:
    """An outlier splits a wall twice; what lies on both sides of it is the same wall."""
    points = wall((1.0, -1.0), (1.0, 1.0), 60)
    points[30] -= (0.11, 0.0)
    assert max(line.last - line.first for line in itertools.chain(*extract_lines(seen(points), NOISE, PARAMETERS))) < 59
    points[30] += (0.07, 0.0)
    assert ends_of(extract_lines(seen(points), NOISE, PARAMETERS)) == [[(0, 59)]]


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_points_are_no_line(count: int) -> None:
    assert extract_lines(seen(wall((1.0, 0.0), (1.0, 0.2), 5)[:count]), NOISE, PARAMETERS) == []
    points = np.vstack([wall((1.0, -1.0), (1.0, 0.0)), wall((1.0, 1.0), (1.0, 1.2), 5)])
    assert ends_of(extract_lines(seen(points), NOISE, PARAMETERS)) == [[(0, 39)]]


def test_pieces_are_the_least_squares_lines_of_their_points() -> None:
    points = np.vstack([wall((1.0, 0.5), (1.5, 0.5), 18), wall((1.5, 0.5), (1.6, 1.0), 18)[1:]])
    noisy = seen(points + np.random.default_rng(0).normal(0.0, 0.004, points.shape))
    [chain] = extract_lines(noisy, NOISE, PARAMETERS)
    assert [(line.first, line.last) for line in chain] == [(0, 17), (17, 34)]
    for line in chain:
        inner = noisy.points[line.first + 1 : line.last]  # the ends belong to two pieces
        _, _, vectors = np.linalg.svd(inner - inner.mean(axis=0))
        np.testing.assert_allclose(line.centre, inner.mean(axis=0))
        assert abs(line.direction @ vectors[0]) == pytest.approx(1.0, abs=1e-9)
        assert np.hypot(*line.direction) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("gap", "x", "missing", "chains"),
    [
        (0.115, 0.5, 0, 1),
        (0.125, 0.5, 0, 2),
        (0.155, 4.0, 0, 1),
        (0.19, 4.0, 0, 2),
        (0.05, 0.5, 1, 1),
        (0.05, 0.5, 2, 2),
    ],
)
def test_a_chain_ends_at_a_gap(gap: float, x: float, missing: int, chains: int) -> None:
    """Of the way between neighbours, by what noise may make of it, or of beams that hit nothing."""
    along = np.concatenate([np.arange(8) * 0.01, 0.07 + gap + np.arange(8) * 0.01])
    beams = np.concatenate([np.arange(8), np.arange(8) + 8 + missing])
    points = np.column_stack([np.full(16, x), along])
    found = extract_lines(EndPoints(points, np.full(16, x), beams), NOISE, PARAMETERS)
    assert [[(line.first, line.last) for line in chain] for chain in found] == (
        [[(0, 15)]] if chains == 1 else [[(0, 7)], [(8, 15)]]
    )


@pytest.mark.parametrize(("count", "chains"), [(5, 0), (6, 1)])
def test_a_chain_has_six_points(count: int, chains: int) -> None:
    ends = seen(wall((1.0, 0.0), (1.1, 0.2), count))
    assert len(extract_lines(ends, NOISE, PARAMETERS)) == chains
    apart = np.vstack([ends.points, ends.points + [2.0, 3.0]])
    assert len(extract_lines(seen(apart), NOISE, PARAMETERS)) == 2 * chains


@pytest.mark.parametrize(("off", "pieces"), [(0.041, 1), (0.043, 3)])
def test_a_wall_is_split_where_it_bends_by_more_than_four_centimetres(off: float, pieces: int) -> None:
    """Of the line through all, which a tooth of two points among forty moves by a twentieth of its height."""
    points = np.column_stack([np.arange(40) * 0.03, np.full(40, 0.3)])
    points[19:21, 1] += off
    [chain] = extract_lines(seen(points), NOISE, PARAMETERS)
    assert (len(chain) == 1) == (pieces == 1)


def test_far_away_a_bend_within_the_noise_is_none() -> None:
    """Three and a half standard deviations of a range: 10.5 cm at 3 m, from the line through all."""
    for off, straight in ((0.109, True), (0.112, False)):
        points = np.column_stack([np.arange(40) * 0.03 - 0.6, np.full(40, 3.0)])
        points[19:21, 1] += off
        ends = EndPoints(points, np.full(40, 3.0), np.arange(40))
        [chain] = extract_lines(ends, NOISE, PARAMETERS)
        assert (len(chain) == 1) == straight
