"""The safety limiter: who comes between is braked for, and what is beside the way is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flat_world import TURTLEBOT as LIMITS
from hitchhike_ros.control.safety_limiter import MAX_AGE_S, SILENCE_S, SafetyLimiter
from hitchhike_ros.core.datatypes import LaserScan, Pose2D, Twist2D
from hitchhike_ros.mapping.laser import ScanParameters

LASER = Pose2D(0.1)


def scan(*discs: tuple[float, float, float], stamp: float = 0.0) -> LaserScan:
    """Of discs (x, y, radius) in the base frame."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, 512)
    ranges = np.full(angles.size, math.inf)
    for x, y, radius in discs:
        along = (x - LASER.x) * np.cos(angles) + y * np.sin(angles)
        across = (x - LASER.x) * np.sin(angles) - y * np.cos(angles)
        hit = (np.abs(across) < radius) & (along > 0.0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(radius**2 - across[hit] ** 2))
    return LaserScan(stamp, -math.pi / 2, angles[1] - angles[0], 0.02, 8.0, ranges)


def limiter(*discs: tuple[float, float, float]) -> SafetyLimiter:
    safety = SafetyLimiter(LIMITS, LASER)
    safety.see(scan(*discs), 0.0)
    return safety


def test_nothing_in_the_way_changes_nothing():
    for twist in (Twist2D(0.7, 0.0), Twist2D(0.5, 0.8), Twist2D()):
        assert limiter((3.0, 0.0, 0.2), (0.6, 0.6, 0.25)).limit(0.1, twist) == (twist, False)


def test_a_driver_at_its_gap_is_no_obstacle_and_one_that_stands_before_the_bumper_is():
    assert limiter((1.1, 0.0, 0.2)).limit(0.1, Twist2D(0.5)) == (Twist2D(0.5), False)
    twist, limited = limiter((0.42, 0.0, 0.2)).limit(0.1, Twist2D(0.5))
    assert (twist.v, limited) == (0.0, True)


def test_the_curve_counts_not_the_view_ahead():
    left, straight, right = (limiter((0.38, 0.32, 0.1)).limit(0.1, Twist2D(0.5, w))[0].v for w in (0.9, 0.0, -0.9))
    assert left < 0.5
    assert straight == right == 0.5


@settings(max_examples=50)
@given(st.floats(0.3, 1.5), st.floats(-0.5, 0.5), st.floats(0.05, 0.7), st.floats(-1.2, 1.2))
def test_whatever_passes_can_still_be_braked_and_the_curvature_is_kept(x, y, v, omega):
    safety, wanted = limiter((x, y, 0.1)), Twist2D(v, omega)
    before = math.hypot(x, y) - 0.1 - 0.176
    twist, _ = safety.limit(0.0, wanted)
    assert twist.v * omega == pytest.approx(twist.omega * v)
    pose, dt = np.zeros(3), 0.01
    v, omega, nearest, t = twist.v, twist.omega, before, 0.0
    while v > 0.0:  # 0.15 s until it acts, then braking by the wheels' 1 m/s2
        t += dt
        v, omega = (v, omega) if t < 0.15 else (v - 1.0 * dt, omega - math.copysign(min(abs(omega), 3.0 * dt), omega))
        pose += np.array([v * math.cos(pose[2]), v * math.sin(pose[2]), omega]) * dt
        nearest = min(nearest, math.hypot(x - pose[0], y - pose[1]) - 0.1 - 0.176)
    assert nearest >= min(0.0, before) - 0.02


WANTED = Twist2D(0.5)


def test_without_a_fresh_scan_nothing_passes():
    safety = SafetyLimiter(LIMITS, LASER)
    assert (safety.limit(0.0, WANTED), safety.problem(0.0)) == ((Twist2D(), True), "no scan yet")
    safety.see(scan(), 0.0)
    assert (safety.limit(0.34, WANTED), safety.problem(0.34)) == ((WANTED, False), "")
    assert safety.expires() == SILENCE_S < 0.5
    assert (safety.limit(SILENCE_S, WANTED), safety.problem(0.4)) == ((Twist2D(), True), "no scan for 0.4 s")
    safety.see(scan(stamp=2.0), 2.0)
    assert safety.limit(2.1, WANTED) == (WANTED, False)
    safety.forget()
    assert safety.problem(2.1) == "no scan yet"


def test_a_scan_that_comes_late_counts_for_less_and_one_of_another_time_for_nothing():
    safety = SafetyLimiter(LIMITS, LASER)
    safety.see(scan(stamp=1.0), 1.3)  # a laser at 5 Hz, stamped by its first beam
    assert (safety.problem(1.59), safety.expires()) == ("", 1.0 + MAX_AGE_S)
    assert safety.problem(1.62) == "scan is 0.6 s old, expected less than 0.6 s"
    safety.see(scan(stamp=1.0), 5.0)
    assert (safety.limit(5.0, WANTED), safety.problem(5.0)) == (
        (Twist2D(), True),
        "scan is 4.0 s old, expected less than 0.6 s",
    )
    safety.see(scan(stamp=9.0), 5.1)
    assert (safety.limit(5.1, WANTED), safety.problem(5.1)) == (
        (Twist2D(), True),
        "scan: stamp is 3.9 s ahead, expected the past",
    )
    safety.see(scan(stamp=math.nan), 5.2)
    assert safety.limit(5.2, WANTED) == (Twist2D(), True)
    safety.see(scan(stamp=9.0), 9.0)
    assert safety.limit(5.0, WANTED) == (Twist2D(), True)  # the clock ran back


@pytest.mark.parametrize("value", [math.nan, 0.0, 0.019, -1.0])
def test_bad_beams_are_left_out_and_too_many_of_them_let_nothing_pass(value: float):
    safety, free, ranges = SafetyLimiter(LIMITS, LASER), scan(), np.full(512, 3.0)
    ranges[:460] = value
    assert safety.see(replace(free, ranges=ranges), 0.0)
    assert safety.bad_share == pytest.approx(460 / 512)
    assert safety.limit(0.1, WANTED) == (WANTED, False)
    ranges[:461] = value
    assert not safety.see(replace(free, ranges=ranges), 0.0)
    assert safety.limit(0.1, WANTED) == (Twist2D(), True)
    assert safety.problem(0.1) == (
        "scan: 461 of 512 beams are NaN or below range_min 0.02 m, expected at most 90% (scan/max_bad_share)"
    )
    strict = SafetyLimiter(LIMITS, LASER, ScanParameters(0.0))
    assert not strict.see(replace(free, ranges=[*ranges[461:], value]), 0.0)


def test_a_bad_beam_does_not_hide_the_box_beside_it():
    """One NaN of 512 once switched the limiter off."""
    box = scan((0.42, 0.0, 0.2))
    for bad in (0, 255, slice(0, 512, 2), slice(0, 200)):
        ranges = box.ranges.copy()
        ranges[bad] = math.nan
        safety = SafetyLimiter(LIMITS, LASER)
        safety.see(replace(box, ranges=ranges), 0.0)
        assert safety.limit(0.0, WANTED) == (Twist2D(), True)


def test_what_is_too_close_to_be_measured_is_braked_for():
    ranges = scan().ranges.copy()
    ranges[250:262] = -math.inf
    safety = SafetyLimiter(LIMITS, Pose2D(0.18))
    safety.see(replace(scan(), ranges=ranges), 0.0)
    assert safety.limit(0.0, WANTED) == (Twist2D(), True)


@pytest.mark.parametrize("value", [math.nan, 0.0, -math.inf])
def test_what_was_near_and_says_nothing_has_come_closer(value: float):
    safety = limiter((0.35, 0.0, 0.1))
    gone = scan().ranges.copy()
    gone[np.isfinite(scan((0.35, 0.0, 0.1)).ranges)] = value
    for stamp in (0.1, 0.5, 2.0, 5.0):
        safety.see(replace(scan(stamp=stamp), ranges=gone), stamp)
        assert safety.limit(stamp, Twist2D(0.2)) == (Twist2D(), True)
    safety.see(scan(stamp=5.05), 5.05)  # it has gone
    safety.see(replace(scan(stamp=5.1), ranges=np.where(np.isneginf(gone), np.inf, gone)), 5.1)
    assert safety.limit(5.1, Twist2D(0.2)) == (Twist2D(0.2), False)


@settings(max_examples=100)
@given(
    st.floats(0.2, 0.35), st.floats(-0.2, 0.2), st.lists(st.booleans(), min_size=64, max_size=64), st.floats(0.05, 0.7)
)
def test_no_bad_beam_lets_the_robot_go_faster_at_what_is_near(x, y, bad, v):
    disc = (x + 0.1, y, 0.1)
    whole, holey = limiter(disc), limiter(disc)
    second = scan(disc, stamp=0.1)
    whole.see(second, 0.1)
    holey.see(replace(second, ranges=np.where(np.repeat(bad, 8), math.nan, second.ranges)), 0.1)
    assert holey.limit(0.1, Twist2D(v))[0].v <= whole.limit(0.1, Twist2D(v))[0].v or holey.problem(0.1)


@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.floats(0.1, 1.6), st.floats(-1.2, 1.2), st.floats(0.03, 0.3)), min_size=1, max_size=3),
    st.floats(0.05, 0.7),
    st.floats(-3.0, 3.0),
)
def test_what_is_taken_for_beside_the_way_would_have_passed(discs, v, omega):
    quick, whole = limiter(*discs), limiter(*discs)
    whole._apart_m = math.inf  # as if something were in the way, so that everything is computed
    assert quick.limit(0.0, Twist2D(v, omega)) == whole.limit(0.0, Twist2D(v, omega))


def test_while_nothing_is_in_the_way_no_field_of_distances_is_computed():
    safety = limiter((1.1, 0.0, 0.2), (0.3, 0.6, 0.1), (0.3, -0.6, 0.1))
    assert safety.limit(0.1, Twist2D(0.5)) == (Twist2D(0.5), False)
    assert safety._field is None
    safety.see(scan((0.55, 0.0, 0.1)), 0.0)
    safety.limit(0.1, Twist2D(0.5))
    assert safety._field is not None
