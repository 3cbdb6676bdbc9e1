"""Where the marker ahead was, and the rider, at a time between two images."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, Twist2D
from hitchhike_ros.core.geometry import between, compose, move
from hitchhike_ros.protocol.hitchhiker.sightings import Sightings

MOUNT = Pose2D(-0.3, 0.0, math.pi)


def _own(t: float) -> Pose2D:
    return move(Pose2D(2.0, -1.0, 0.5), Twist2D(0.5, 0.4), t)


def _marker(t: float) -> Pose2D:
    return compose(move(Pose2D(3.2, -0.5, 0.6), Twist2D(0.5, 0.4), t), MOUNT)


def _image(t: float, sigma: float = 0.01, yaw_error: float = 0.0) -> MarkerObservation:
    seen = between(_own(t), _marker(t))
    return MarkerObservation(t, 0, Pose2D(seen.x, seen.y, seen.theta + yaw_error), sigma**2 * np.eye(3))


def _seen(*stamps: float) -> Sightings:
    sightings = Sightings()
    for stamp in stamps:
        sightings.add(_image(stamp), _own(stamp))
    return sightings


@pytest.mark.parametrize("stamp", [10.0, 10.1, 10.25, 10.39, 10.4, 11.0])
def test_between_images_both_robots_go_on_steadily(stamp: float) -> None:
    """The nearer of the two images was up to 0.1 m off."""
    sighting = _seen(10.0, 10.4, 11.0).at(stamp)
    assert sighting is not None
    assert sighting.stamp == sighting.seen.stamp == stamp
    assert astuple(sighting.own) == pytest.approx(astuple(_own(stamp)), abs=1e-9)
    assert astuple(sighting.place) == pytest.approx(astuple(_marker(stamp)), abs=0.004)


def test_a_yaw_that_is_seen_badly_does_not_bend_the_way() -> None:
    sightings = Sightings()
    for stamp, error in ((10.0, 0.3), (10.5, -0.3)):
        sightings.add(_image(stamp, yaw_error=error), _own(stamp))
    sighting = sightings.at(10.25)
    assert sighting is not None
    assert math.dist((sighting.place.x, sighting.place.y), (_marker(10.25).x, _marker(10.25).y)) < 0.01


@pytest.mark.parametrize("stamp", [9.9, 11.41, 12.0, 99.0])
def test_before_the_first_and_after_the_last_image_nothing_is_known(stamp: float) -> None:
    assert _seen(10.0, 10.4, 11.0, 11.4).at(stamp) is None
    assert Sightings().at(stamp) is None


def test_nor_between_images_that_are_far_apart() -> None:
    sightings = _seen(10.0, 10.7, 11.5)
    assert sightings.at(10.3) is not None
    assert sightings.at(11.0) is None
    assert sightings.at(11.5) is not None


def test_the_covariance_is_that_of_the_nearest_image() -> None:
    sightings = Sightings()
    for stamp, sigma in ((10.0, 0.01), (10.4, 0.03)):
        sightings.add(_image(stamp, sigma), _own(stamp))
    for stamp, sigma in ((10.1, 0.01), (10.3, 0.03)):
        sighting = sightings.at(stamp)
        assert sighting is not None
        assert sighting.seen.covariance[0, 0] == pytest.approx(sigma**2)


def test_images_of_three_seconds_are_kept_each_once_and_in_order() -> None:
    sightings = _seen(*np.arange(0.0, 10.0, 0.5).tolist())
    assert sightings.newest == 9.5
    assert sightings.at(6.5) is not None
    assert sightings.at(6.0) is None
    sightings.add(_image(9.2), _own(9.2))  # late
    sightings.add(_image(9.5), _own(9.5))
    assert sightings.newest == 9.5
    sightings.add(_image(1.0), _own(1.0))  # the clock was set back
    assert (sightings.newest, sightings.at(9.5)) == (1.0, None)
