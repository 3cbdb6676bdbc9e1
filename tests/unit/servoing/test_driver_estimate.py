"""The driver from its marker as seen and from what it tells: its axle, its heading, its speed, and how well known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import compose, wrap_angle
from hitchhike_ros.servoing.driver_estimate import DriverEstimate
from hitchhike_ros.servoing.follow_parameters import FollowParameters

MOUNTS = [
    Pose2D(-0.30, 0.0, math.pi),
    Pose2D(-0.18, 0.0, math.pi),
    Pose2D(-0.55, 0.12, math.pi),
    Pose2D(-0.25, -0.20, math.pi - 0.4),
    Pose2D(0.05, 0.3, math.pi / 2),
]
EXACT = np.diag([1e-8, 1e-8, 1e-8])


@pytest.mark.parametrize("mount", MOUNTS)
def test_axle_and_heading_follow_from_where_the_marker_is_mounted(mount: Pose2D) -> None:
    """As though every robot were a P3DX, the axle of the third was 0.28 m off, and the heading of the last 1.6 rad."""
    base = Pose2D(2.0, -1.0, 0.7)
    driver = DriverEstimate(FollowParameters(), 0.0, compose(base, mount), EXACT, mount)
    assert driver.axle == pytest.approx((base.x, base.y), abs=1e-9)
    assert wrap_angle(driver.heading - base.theta) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("radius_m", [0.6, -1.5])
def test_the_speed_is_that_of_the_axle_in_a_bend(mount: Pose2D, radius_m: float) -> None:
    """A marker 0.2 m beside the middle goes a third slower or faster than the axle in the sharper bend."""
    speed, omega = 0.4, 0.4 / radius_m

    def base(t: float) -> Pose2D:
        return Pose2D(radius_m * math.sin(omega * t), radius_m * (1.0 - math.cos(omega * t)), wrap_angle(omega * t))

    driver = DriverEstimate(FollowParameters(), 0.0, compose(base(0.0), mount), EXACT, mount)
    for step in range(1, 40):
        driver.update(0.1 * step, compose(base(0.1 * step), mount), EXACT)
    assert driver.speed == pytest.approx(speed, abs=0.01)
    assert driver.axle == pytest.approx((base(3.9).x, base(3.9).y), abs=0.01)


def _normalised_error(images: int, told_anew: bool, passed_on: bool, age_s: float = 0.0) -> tuple[float, float]:
    """Mean squared normalised error of the speed over seeds, and the rms error: a driver at 0.5 m/s is seen in images
    at 10 Hz, and tells its speed once, or with each image, with an error of its own each time."""
    params, scores, errors = FollowParameters(), [], []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        start = rng.normal(0.0, 0.15)
        covariance = np.diag([0.15**2, 1e-4, 1e-6])  # from far away
        driver = DriverEstimate(params, 0.0, Pose2D(start, 0.0, math.pi), covariance)
        told, told_at = rng.normal(0.5, params.feed_forward_sigma_mps), -age_s
        driver.tell_speed(told, told_at)
        for k in range(1, images + 1):
            x = 0.05 * k + rng.normal(0.0, 0.15)
            driver.update(0.1 * k, Pose2D(x, 0.0, math.pi), covariance)
            if told_anew:
                told, told_at = rng.normal(0.5, params.feed_forward_sigma_mps), 0.1 * k
            if passed_on or told_anew:
                driver.tell_speed(told, told_at)
        error = float(driver._state[1]) - 0.5
        scores.append(error**2 / float(driver._P[1, 1]))
        errors.append(error)
    return float(np.mean(scores)), float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("images", [3, 5, 8])
def test_one_told_speed_counts_once(images: int) -> None:
    """Fused with each of five images as if it were five, the squared normalised error was 2.6, not 1 at the most."""
    passed_on, error = _normalised_error(images, told_anew=False, passed_on=True)
    assert passed_on < 1.1
    assert error == pytest.approx(_normalised_error(images, told_anew=False, passed_on=False)[1])


def test_speeds_that_are_told_anew_count_each() -> None:
    score, error = _normalised_error(5, told_anew=True, passed_on=True)
    assert score < 1.1
    assert error < 0.85 * _normalised_error(5, told_anew=False, passed_on=True)[1]


def test_without_a_time_only_another_speed_is_news() -> None:
    told_once, told_twice, changed = (
        DriverEstimate(FollowParameters(), 0.0, Pose2D(1.0, 0.0, math.pi), EXACT) for _ in range(3)
    )
    for driver, speeds in ((told_once, [0.4]), (told_twice, [0.4, 0.4]), (changed, [0.4, 0.6])):
        for speed in speeds:
            driver.tell_speed(speed)
    assert told_twice.speed == told_once.speed
    assert changed.speed > told_once.speed


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_speed_of_another_time_says_less(sign: float) -> None:
    """Whether the message or the image is the older one."""
    speeds = []
    for age_s in (0.0, 0.3, 1.0):
        driver = DriverEstimate(FollowParameters(), 5.0, Pose2D(1.0, 0.0, math.pi), EXACT)
        driver.tell_speed(0.5, 5.0 - sign * age_s)
        speeds.append(driver.speed)
    assert speeds[0] > speeds[1] > speeds[2] > 0.0


def test_a_driver_that_says_that_it_stands_is_believed_once() -> None:
    driver = DriverEstimate(FollowParameters(), 0.0, Pose2D(1.0, 0.0, math.pi), EXACT)
    driver.tell_speed(0.5, 0.0)
    before = driver.speed
    driver.tell_speed(0.0, 0.1)
    after = driver.speed
    driver.tell_speed(0.0, 0.1)
    assert before > after == driver.speed
