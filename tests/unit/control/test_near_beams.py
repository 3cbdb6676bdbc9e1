"""Beams that were near and then say nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.control.near_beams import NearBeams
from hitchhike_ros.core.datatypes import LaserScan


def scan(stamp: float, *ranges: float, angle_min: float = 0.0, increment: float = 0.1) -> LaserScan:
    return LaserScan(stamp, angle_min, increment, 0.1, 8.0, np.array(ranges))


def filled(beams: NearBeams, x: LaserScan) -> list[float]:
    return beams.fill(x).ranges.astype(float).tolist()


def test_a_beam_that_was_near_tells_of_what_may_have_come_closer() -> None:
    beams = NearBeams()
    beams.fill(scan(0.0, 0.35, 0.35, 0.5, math.nan))
    seen = filled(beams, scan(0.1, math.nan, 0.0, math.nan, math.nan))
    assert seen == pytest.approx([0.25, 0.25, math.nan, math.nan], nan_ok=True)
    assert filled(beams, scan(0.3, math.nan, 0.0, math.nan, 0.0))[:2] == [-math.inf, -math.inf]


def test_it_is_held_for_a_while_and_no_longer_than_until_the_beam_speaks() -> None:
    beams = NearBeams()
    beams.fill(scan(0.0, 0.3, 0.3, -math.inf))
    beams.fill(scan(1.0, math.nan, math.inf, math.nan))
    assert filled(beams, scan(5.0, *[math.nan] * 3)) == pytest.approx([-math.inf, math.nan, -math.inf], nan_ok=True)
    assert np.isnan(beams.fill(scan(5.1, *[math.nan] * 3)).ranges).all()


def test_a_beam_that_never_spoke_or_fails_far_from_everything_is_left_out() -> None:
    beams = NearBeams()
    for stamp in (0.0, 0.1):
        assert np.isnan(beams.fill(scan(stamp, 0.0, math.nan, 0.05)).ranges).all()
    beams.fill(scan(0.2, 3.0, math.inf, 0.41))
    assert np.isnan(beams.fill(scan(0.3, 0.0, 0.0, 0.0)).ranges).all()


def test_a_beam_more_or_less_does_not_make_it_forget() -> None:
    beams = NearBeams()
    beams.fill(scan(0.0, 3.0, 0.2, 3.0))
    assert filled(beams, scan(0.05, math.nan, math.nan, math.nan, math.nan)) == pytest.approx(
        [math.nan, 0.15, math.nan, math.nan], nan_ok=True
    )
    later = scan(0.06, math.nan, math.nan, angle_min=0.1)
    assert filled(beams, later) == pytest.approx([0.14, math.nan], nan_ok=True)


def test_of_a_time_that_ran_back_nothing_is_remembered() -> None:
    beams = NearBeams()
    beams.fill(scan(9.0, 0.2))
    assert np.isnan(beams.fill(scan(1.0, math.nan)).ranges).all()
    beams.fill(scan(1.1, 0.2))
    beams.clear()
    assert np.isnan(beams.fill(scan(1.2, math.nan)).ranges).all()


_RANGE = st.sampled_from([math.nan, 0.0, 0.2, 0.3, 2.0, math.inf, -math.inf])


@given(st.lists(st.lists(_RANGE, min_size=4, max_size=4), max_size=12))
def test_what_a_beam_says_stays_and_nothing_becomes_free(scans: list[list[float]]) -> None:
    beams = NearBeams()
    for k, ranges in enumerate(scans):
        before = scan(0.1 * k, *ranges)
        after = beams.fill(before)
        said = ~np.isnan(before.ranges)
        np.testing.assert_array_equal(after.ranges[said], before.ranges[said])
        assert not (after.ranges[~said] > 0.4).any()
