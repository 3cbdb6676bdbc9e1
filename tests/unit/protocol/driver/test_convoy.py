"""Where the robots of a convoy are, from what its riders say late and one after another."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import between, compose, distance, wrap_angle
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.protocol.driver.convoy import Convoy, Offer, Rider
from hitchhike_ros.protocol.matching import Stretch
from hitchhike_ros.protocol.messages import Ack
from protocol_helpers import MARKER_POSE, REAR_MARKER, SIGMA, WEST, messages


def _rider(name: str) -> Rider:
    return Rider(
        Offer(name, "ride", WEST, Stretch(Polyline([(3.0, 5.72), (23.0, 5.72)]), 0.0, 20.0)), REAR_MARKER, coupled=True
    )


def test_what_is_told_of_the_robot_ahead_is_of_one_time() -> None:
    """Driver and first rider in a bend at 0.5 m/s. The rider's look, 0.4 s old, put together with where the driver is
    now, had its place 0.2 m off and its heading 0.33 rad."""
    radius, omega, mount = 0.6, 0.5 / 0.6, MARKER_POSE
    convoy = Convoy(replace(REAR_MARKER, marker_id=0, marker_pose=mount))
    riders = [_rider(name) for name in ("first", "second")]
    for rider in riders:
        convoy.add(rider)

    def driver(t: float) -> Pose2D:
        return Pose2D(radius * math.sin(omega * t), radius * (1.0 - math.cos(omega * t)), omega * t)

    def first(t: float) -> Pose2D:
        return compose(driver(t - 2.0), Pose2D(0.0, 0.05))

    errors = []
    for k in range(40):
        now = 10.0 + 0.1 * k
        convoy.note(PoseEstimate(now, driver(now), np.array(SIGMA)))
        if k % 5 == 4:
            seen = between(first(now - 0.4), compose(driver(now - 0.4), mount))
            ack = replace(messages()[Ack], seen=seen, seen_age_s=0.4)
            riders[0].hear(ack, now)
        if k >= 10:
            told = convoy.pose_ahead_of(riders[1], PoseEstimate(now, driver(now), np.array(SIGMA)), np.zeros((3, 3)))
            truth = first(told.stamp)
            errors.append(
                (distance(told.pose, truth), abs(wrap_angle(told.pose.theta - truth.theta)), now - told.stamp)
            )
    assert np.max([e[0] for e in errors]) < 0.01
    assert np.max([e[1] for e in errors]) < 0.02
    assert 0.3 < np.max([e[2] for e in errors]) < 0.95


def test_looks_of_two_riders_at_different_times_are_put_together_at_one() -> None:
    convoy = Convoy(replace(REAR_MARKER, marker_id=0, marker_pose=MARKER_POSE))
    riders = [_rider(name) for name in ("first", "second", "third")]
    for rider in riders:
        convoy.add(rider)

    def place(k: int, t: float) -> Pose2D:
        """On one line, the gaps growing as the robots set off one after another."""
        return Pose2D(0.5 * t - 1.2 * k - 0.05 * k * t, 0.0, 0.0)

    for step in range(30):
        now = 10.0 + 0.1 * step
        convoy.note(PoseEstimate(now, place(0, now), np.array(SIGMA)))
        for k, (rider, every, age) in enumerate(((riders[0], 5, 0.1), (riders[1], 4, 0.35)), start=1):
            if step % every == 0:
                seen = between(place(k, now - age), compose(place(k - 1, now - age), MARKER_POSE))
                rider.hear(replace(messages()[Ack], seen=seen, seen_age_s=age), now)
        if step > 10:
            told = convoy.pose_ahead_of(riders[2], PoseEstimate(now, place(0, now), np.array(SIGMA)), np.zeros((3, 3)))
            assert told.pose.x == pytest.approx(place(2, told.stamp).x, abs=1e-6)
            assert now - told.stamp >= 0.35 - 1e-9


def test_an_older_look_that_comes_later_is_not_the_newest() -> None:
    rider = _rider("first")
    rider.hear(replace(messages()[Ack], seen_age_s=0.1), 10.0)
    rider.hear(replace(messages()[Ack], seen=Pose2D(2.0), seen_age_s=0.5), 10.1)
    assert rider.seen is not None
    assert (rider.seen.stamp, rider.seen.pose.x) == (pytest.approx(9.9), pytest.approx(0.95))
