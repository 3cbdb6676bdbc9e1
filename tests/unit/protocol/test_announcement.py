"""A robot's own path: where along it places are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.protocol.announcement import OwnPath

metres = st.floats(-50.0, 50.0, width=32)
paths = arrays(float, st.tuples(st.integers(1, 12), st.just(2)), elements=metres)
places = arrays(float, st.tuples(st.integers(0, 8), st.just(2)), elements=metres)


@given(paths, places)
def test_all_places_at_once_are_each_as_one_by_one(points: FloatArray, at: FloatArray) -> None:
    path = OwnPath(points)
    away, arcs = path.all_nearest(at)
    assert away.shape == arcs.shape == (len(at),)
    for (x, y), one_away, arc in zip(at.tolist(), away.tolist(), arcs.tolist(), strict=True):
        expected_away, expected_arc = path.nearest(x, y)
        assert one_away == pytest.approx(expected_away, abs=1e-6)
        # Where two places of the path are as near, either may be found.
        there = path.at(arc)
        assert math.dist((there.x, there.y), (x, y)) == pytest.approx(one_away, abs=1e-6)
        assert arc == pytest.approx(expected_arc, abs=1e-6) or one_away <= expected_away + 1e-9


@given(paths, places)
def test_no_place_of_the_path_is_nearer(points: FloatArray, at: FloatArray) -> None:
    path = OwnPath(points)
    away, arcs = path.all_nearest(at)
    along = [path.at(arc) for arc in np.linspace(0.0, path.length_m, 50)]
    for place, one in zip(at.tolist(), away.tolist(), strict=True):
        assert one <= min(math.dist((p.x, p.y), place) for p in along) + 1e-6
    assert ((arcs >= 0.0) & (arcs <= path.length_m + 1e-9)).all()


def test_places_along_a_corner() -> None:
    path = OwnPath(np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0)]))
    away, arcs = path.all_nearest(np.array([(3.0, 4.0), (-3.0, -4.0), (11.0, 3.0), (10.0, 9.0)]))
    assert away == pytest.approx([4.0, 5.0, 1.0, 4.0])
    assert arcs == pytest.approx([3.0, 0.0, 13.0, 15.0])


def test_a_path_of_one_point_and_no_places() -> None:
    away, arcs = OwnPath(np.array([(1.0, 2.0)])).all_nearest(np.array([(4.0, 6.0), (1.0, 2.0)]))
    assert (away.tolist(), arcs.tolist()) == ([5.0, 0.0], [0.0, 0.0])
    for points in ([(1.0, 2.0)], [(1.0, 2.0), (3.0, 2.0)]):
        away, arcs = OwnPath(np.array(points)).all_nearest(np.empty((0, 2)))
        assert away.shape == arcs.shape == (0,)
