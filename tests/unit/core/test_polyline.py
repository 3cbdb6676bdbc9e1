"""Paths by arc length: places along them against dense samples, and paths that grow and are forgotten."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.core.polyline import Polyline

METRES = st.floats(-20.0, 20.0, width=32)
CORNERS = arrays(float, st.tuples(st.integers(1, 10), st.just(2)), elements=METRES)
PLACES = arrays(float, st.tuples(st.integers(0, 6), st.just(2)), elements=METRES)
SHARES = st.floats(0.0, 1.0)
MILLIMETRE = 1e-3
L = np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)])


def samples(path: Polyline, count: int = 400) -> FloatArray:
    """Arc lengths (count,) all along a path, its corners among them."""
    return np.sort(np.concatenate([np.linspace(path.start_m, path.end_m, count), path.arcs]))


@given(CORNERS)
def test_it_goes_through_its_points_in_their_order(corners: FloatArray) -> None:
    path = Polyline(corners, 5.0)
    assert path.length_m == pytest.approx(path_length(corners), abs=0.02)  # a millimetre a corner
    assert (path.start_m, path.end_m) == (5.0, pytest.approx(5.0 + path.length_m))
    assert (np.diff(path.arcs) > 0.0).all()
    assert path.at(path.arcs) == pytest.approx(path.points)
    for s, (x, y) in zip(path.arcs.tolist(), path.points.tolist(), strict=True):
        assert path.point(s) == pytest.approx((x, y))
    left_out = [corner for corner in corners if np.hypot(*(path.points - corner).T).min() > MILLIMETRE]
    assert not left_out


@given(CORNERS, st.floats(-3.0, 60.0))
def test_one_place_is_as_many_are(corners: FloatArray, s: float) -> None:
    path = Polyline(corners)
    assert path.point(s) == pytest.approx(tuple(path.at(np.array([s]))[0]))
    pose = path.pose(s)
    assert (pose.x, pose.y) == path.point(s)


@given(CORNERS, SHARES)
def test_a_place_that_is_farther_on_is_reached_by_driving_so_far(corners: FloatArray, share: float) -> None:
    path = Polyline(corners)
    s = share * path.length_m
    passed = path.ahead(-1.0, s)
    assert path_length(passed.points) == pytest.approx(s, abs=2 * MILLIMETRE)
    assert passed.points[-1] == pytest.approx(path.point(s), abs=MILLIMETRE)


@given(CORNERS, METRES, METRES, SHARES, SHARES)
def test_no_place_of_the_stretch_is_nearer_than_the_projection(
    corners: FloatArray, x: float, y: float, one: float, other: float
) -> None:
    path = Polyline(corners, 2.0)
    first, last = (path.start_m + min(one, other) * path.length_m, path.start_m + max(one, other) * path.length_m)
    s, distance = path.project(x, y, first, last)
    assert first - 1e-9 <= s <= last + 1e-9
    assert math.dist(path.point(s), (x, y)) == pytest.approx(distance, abs=2 * MILLIMETRE)
    stretch = samples(path)
    stretch = stretch[(stretch >= first) & (stretch <= last)]
    others = np.hypot(*(path.at(np.append(stretch, [first, last])) - (x, y)).T)
    assert distance <= others.min() + 2 * MILLIMETRE
    assert (s, distance) == pytest.approx(path.ahead(first, last).project(x, y), abs=2 * MILLIMETRE)


@given(CORNERS, PLACES)
def test_all_places_at_once_are_each_as_one_by_one(corners: FloatArray, places: FloatArray) -> None:
    path = Polyline(corners, 2.0)
    arcs, distances = path.project_all(places)
    assert arcs.shape == distances.shape == (len(places),)
    for (x, y), s, distance in zip(places.tolist(), arcs.tolist(), distances.tolist(), strict=True):
        assert distance == pytest.approx(path.project(x, y)[1], abs=1e-9)
        assert math.dist(path.point(s), (x, y)) == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize(
    ("place", "stretch", "foot"),
    [
        ((1.0, -2.0), (), (1.0, 2.0)),
        ((-3.0, 4.0), (), (0.0, 5.0)),  # before the start
        ((3.0, 9.0), (), (7.0, 5.0)),  # past the end
        ((5.0, 1.0), (), (4.0, 2.0)),
        ((5.0, 1.0), (0.0, 2.5), (2.5, math.hypot(2.5, 1.0))),
        ((1.0, 0.0), (5.0, 6.0), (5.0, math.hypot(2.0, 2.0))),
        ((1.0, 0.0), (6.0, 5.0), (6.0, math.hypot(2.0, 3.0))),  # nothing is between: its first end
        ((1.0, 0.0), (9.0, 12.0), (7.0, math.hypot(2.0, 4.0))),
        ((1.5, 1.5), (), (1.5, 1.5)),  # as near to both pieces: the first
    ],
)
def test_projections_on_an_angle(
    place: tuple[float, float], stretch: tuple[float, ...], foot: tuple[float, float]
) -> None:
    assert Polyline(L).project(*place, *stretch) == pytest.approx(foot)


def test_poses_along_an_angle() -> None:
    path, north = Polyline(L), math.pi / 2
    assert [path.pose(s) for s in (-1.0, 0.0, 2.0)] == [Pose2D(0.0, 0.0), Pose2D(0.0, 0.0), Pose2D(2.0, 0.0)]
    assert [path.pose(s) for s in (3.0, 5.0, 7.0, 9.0)] == [
        *(Pose2D(3.0, 0.0, north), Pose2D(3.0, 2.0, north)),
        *(Pose2D(3.0, 4.0, north), Pose2D(3.0, 4.0, north)),
    ]


def test_tangents_look_along_the_chord_around_each_place() -> None:
    path, half = Polyline(L), math.sqrt(0.5)
    expected = [(1.0, 0.0), (1.0, 0.0), (half, half), (0.0, 1.0), (0.0, 1.0)]
    assert path.tangents(np.array([-1.0, 1.0, 3.0, 5.0, 9.0])) == pytest.approx(np.array(expected))
    # 0.3 m before the corner only the longer chord turns already.
    assert path.tangents(np.array([2.7]))[0] == pytest.approx([1.0, 0.0])
    assert path.tangents(np.array([2.7]), 0.5)[0] == pytest.approx(np.array([0.8, 0.2]) / math.hypot(0.8, 0.2))
    there_and_back = Polyline(np.array([(0.0, 0.0), (0.0, 1.0), (0.0, 0.0)]))
    assert there_and_back.tangents(np.array([1.0]))[0].tolist() == [1.0, 0.0]


def test_a_path_of_one_point() -> None:
    path = Polyline(np.array([(1.0, 2.0)]), 3.0)
    assert (path.length_m, path.start_m, path.end_m) == (0.0, 3.0, 3.0)
    assert path.project(4.0, 6.0) == (3.0, 5.0)
    arcs, distances = path.project_all(np.array([(4.0, 6.0), (1.0, 2.0)]))
    assert (arcs.tolist(), distances.tolist()) == ([3.0, 3.0], [5.0, 0.0])
    assert (path.point(9.0), path.pose(0.0)) == ((1.0, 2.0), Pose2D(1.0, 2.0, 0.0))
    assert path.tangents(np.array([3.0])).tolist() == [[1.0, 0.0]]
    assert path.ahead(0.0).points.tolist() == [[1.0, 2.0]]
    path.forget_before(9.0)
    path.forget_after(0.0)
    assert path.points.tolist() == [[1.0, 2.0]]


@given(CORNERS, SHARES, SHARES)
def test_a_part_is_where_the_whole_is(corners: FloatArray, one: float, other: float) -> None:
    path = Polyline(corners, 2.0)
    first, last = (path.start_m + min(one, other) * path.length_m, path.start_m + max(one, other) * path.length_m)
    part = path.ahead(first, last)
    assert (part.start_m, part.end_m) == (first, pytest.approx(last, abs=MILLIMETRE))
    assert (np.diff(part.arcs) > 0.0).all()
    stretch = samples(part)
    assert part.at(stretch) == pytest.approx(path.at(stretch), abs=2 * MILLIMETRE)
    rest = path.ahead(first)
    assert rest.end_m == pytest.approx(path.end_m, abs=MILLIMETRE)
    assert rest.at(samples(rest)) == pytest.approx(path.at(samples(rest)), abs=2 * MILLIMETRE)


@given(CORNERS, CORNERS, SHARES, SHARES)
def test_a_path_grows_and_is_forgotten(corners: FloatArray, more: FloatArray, back: float, on: float) -> None:
    path, whole = Polyline(corners), Polyline(np.vstack([corners, more]))
    for x, y in more.tolist():
        path.extend(x, y)
    assert path.end_m == pytest.approx(whole.end_m, abs=0.02)
    whole = path.ahead(0.0)
    begin, end = sorted((back * whole.end_m, on * whole.end_m))
    path.forget_before(begin)
    assert path.start_m <= begin
    assert len(path.arcs) == 1 or path.arcs[1] > begin
    path.forget_after(end)
    assert path.end_m == pytest.approx(end)
    assert (np.diff(path.arcs) > 0.0).all()
    kept = samples(path)
    assert path.at(kept) == pytest.approx(whole.at(kept), abs=2 * MILLIMETRE)
    assert path.arcs.tolist() == path._arcs


def test_what_ends_before_is_not_forgotten_and_the_first_point_stays() -> None:
    path = Polyline(L, 10.0)
    path.forget_after(20.0)
    path.forget_before(9.0)
    assert path.points.tolist() == L.tolist()
    path.forget_after(13.0)
    assert path.points.tolist() == L[:2].tolist()
    path.extend(3.0, 1.0)
    assert (path.end_m, path.points.tolist()) == (14.0, [[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]])
    path.forget_after(9.0)
    assert (path.end_m, path.points.tolist()) == (10.0, [[0.0, 0.0]])


def test_points_that_repeat_are_left_out() -> None:
    path = Polyline(np.array([(0.0, 0.0), (0.0, 0.0), (9e-4, 0.0), (2.0, 0.0), (2.0, 0.0), (2.0, 1.1e-3)]))
    assert path.points.tolist() == [[0.0, 0.0], [2.0, 0.0], [2.0, 1.1e-3]]
    # Many small steps are a way all the same.
    assert Polyline(np.column_stack([np.arange(51) * 4e-4, np.zeros(51)])).length_m == pytest.approx(
        0.02, abs=MILLIMETRE
    )


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 2)),
        np.zeros(2),
        np.zeros((3, 3)),
        np.array([(0.0, math.nan)]),
        np.array([(0.0, 1.0), (math.inf, 0.0)]),
    ],
)
def test_what_is_no_path_is_refused(points: FloatArray) -> None:
    with pytest.raises(PlanningError, match=r"^a path must be finite points \(N, 2\), got an array of shape \("):
        Polyline(points)


def test_a_corner_a_millimetre_ahead_is_passed_over() -> None:
    path = Polyline(L)
    assert path.ahead(2.9995, 6.9995).points.tolist() == [[2.9995, 0.0], [3.0, pytest.approx(3.9995)]]
    assert path.ahead(2.9985).points.tolist() == [[2.9985, 0.0], [3.0, 0.0], [3.0, 4.0]]
    assert path.ahead(2.9995, 3.0002).points.tolist() == [[2.9995, 0.0]]
    s, distance = path.project(4.0, 2.0, 2.9995)
    assert (s, distance) == (pytest.approx(5.0, abs=1e-3), pytest.approx(1.0, abs=1e-3))
    assert path.project(4.0, 2.0, 6.9995) == (6.9995, pytest.approx(math.hypot(1.0, 1.9995)))


def test_it_grows_by_steps_however_small() -> None:
    path = Polyline([(0.0, 0.0)])
    for k in range(1, 101):
        path.extend(1e-5 * k, 0.0)
        path.extend(1e-5 * k, 0.0)
    assert (path.end_m, len(path.points)) == (pytest.approx(1e-3), 101)
    assert path.point(5.5e-4) == (pytest.approx(5.5e-4), 0.0)


def test_corners_lie_strictly_between_two_arc_lengths() -> None:
    path = Polyline(L)
    assert path.corners(-1.0, 8.0) == [(0.0, 0.0, 0.0), (3.0, 3.0, 0.0), (7.0, 3.0, 4.0)]
    assert path.corners(0.0, 7.0) == [(3.0, 3.0, 0.0)]
    assert path.corners(3.0, 6.0) == []


def test_an_odometer_may_count_otherwise() -> None:
    path = Polyline([(0.0, 0.0)])
    path.extend(1.0, 0.0, 1.1)
    path.extend(5.0, 0.0, 1.1)  # it has not moved
    assert path.points.tolist() == [[0.0, 0.0], [1.0, 0.0]]
    assert path.point(0.55) == (0.5, 0.0)
