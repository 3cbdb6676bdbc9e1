"""The safety limiter: who comes between is braked for, and what is beside the way is not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flat_world import TURTLEBOT as LIMITS
from hitchhike_ros.control.safety_limiter import SafetyLimiter
from hitchhike_ros.core.datatypes import LaserScan, Pose2D, Twist2D

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
    safety.see(scan(*discs))
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


def test_an_old_scan_or_one_that_cannot_be_read_lets_everything_pass():
    safety = limiter((0.4, 0.0, 0.2))
    assert safety.limit(2.0, Twist2D(0.5)) == (Twist2D(0.5), False)
    safety.see(LaserScan(0.1, 0.0, 0.01, 0.02, 8.0, np.full(10, math.nan)))
    assert safety.limit(0.1, Twist2D(0.5)) == (Twist2D(0.5), False)


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
    safety.see(scan((0.55, 0.0, 0.1)))
    safety.limit(0.1, Twist2D(0.5))
    assert safety._field is not None
