"""Poses between samples, the distance from a trail, and what a pose is off by."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.experiments.scenarios.ride_record import (
    RideRecord,
)
from hitchhike_ros.experiments.scoring.tracks import distances_from_trail, mahalanobis
from synthetic_ride import synthetic_ride


@pytest.fixture
def record() -> RideRecord:
    return synthetic_ride()


def test_lateral_error_counts_beside_the_trail_and_not_before_it() -> None:
    trail = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    points = np.array([[-0.5, 0.3], [0.5, 0.1], [0.9, 0.5], [1.0, 1.5]])
    assert distances_from_trail(points, trail) == pytest.approx([0.1, 0.1, 0.5])


def test_mahalanobis_needs_a_covariance() -> None:
    assert mahalanobis(np.array([0.3, 0.4, 0.0]), np.eye(3) * 0.01) == pytest.approx(5.0)
    assert mahalanobis(np.array([0.3, 0.4, 0.0]), np.zeros((3, 3))) is None
