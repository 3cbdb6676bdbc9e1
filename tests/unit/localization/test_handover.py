"""Handover of the pose at decoupling: geometry and honesty of the covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import between, compose, distance
from hitchhike_ros.localization.ekf import mahalanobis_squared, pose_error
from hitchhike_ros.localization.handover import handover

ANGLES = st.floats(-3.1, 3.1)
POSES = st.builds(Pose2D, st.floats(-20, 20), st.floats(-20, 20), ANGLES)
BACK = Pose2D(-0.31, 0.0, math.pi)
SIGMA_D = np.array([[0.004, 0.001, 0.0], [0.001, 0.002, 0.0002], [0.0, 0.0002, 0.0004]])
SIGMA_M = np.diag([0.0002, 0.0003, 0.001])
MOUNTING = np.diag([0.0003, 0.0004, 0.002])


def observed(driver: Pose2D, hitchhiker: Pose2D, covariance: np.ndarray = SIGMA_M) -> MarkerObservation:
    return MarkerObservation(7.0, 0, between(hitchhiker, compose(driver, BACK)), covariance)


@given(POSES, st.floats(0.3, 2.0))
def test_in_line_both_methods_give_the_same_pose(driver, gap):
    hitchhiker = compose(driver, Pose2D(-0.31 - gap, 0.0, 0.0))
    estimate = PoseEstimate(6.9, driver, SIGMA_D)
    for method in ("paper", "measured"):
        result = handover(method, estimate, observed(driver, hitchhiker), BACK)
        np.testing.assert_allclose(pose_error(result.pose, hitchhiker), 0.0, atol=1e-9)
        assert result.stamp == 7.0


@given(POSES, POSES)
def test_measured_is_exact_however_the_pair_stands(driver, hitchhiker):
    result = handover("measured", PoseEstimate(0.0, driver, SIGMA_D), observed(driver, hitchhiker), BACK)
    np.testing.assert_allclose(pose_error(result.pose, hitchhiker), 0.0, atol=1e-6)
    assert np.linalg.eigvalsh(result.covariance).min() > 0


@given(POSES, st.floats(0.2, 3.0), st.floats(-0.4, 0.4), ANGLES)
def test_paper_keeps_heading_distance_and_covariance(driver, gap, side, turn):
    hitchhiker = compose(driver, Pose2D(-0.31 - gap, side, turn))
    result = handover("paper", PoseEstimate(0.0, driver, SIGMA_D), observed(driver, hitchhiker), BACK)
    assert result.pose.theta == pytest.approx(driver.theta)
    assert distance(result.pose, driver) == pytest.approx(math.hypot(gap, side) + 0.31)
    np.testing.assert_array_equal(result.covariance, SIGMA_D)


def sample(method: str, seed: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Mean NEES over 400 noisy handovers, their covariance as found and as claimed."""
    rng = np.random.default_rng(seed)
    driver, nees, errors = Pose2D(12.0, 5.7, 0.4), [], []
    hitchhiker = compose(driver, Pose2D(-1.31, 0.06, 0.08))
    claimed = np.zeros((3, 3))
    for _ in range(400):
        d = np.array([driver.x, driver.y, driver.theta]) + rng.multivariate_normal(np.zeros(3), SIGMA_D)
        z = observed(driver, hitchhiker).pose
        m = np.array([z.x, z.y, z.theta]) + rng.multivariate_normal(np.zeros(3), SIGMA_M)
        measured = np.array([BACK.x, BACK.y, BACK.theta]) + rng.multivariate_normal(np.zeros(3), MOUNTING)
        result = handover(
            method,
            PoseEstimate(0.0, Pose2D(*d), SIGMA_D),
            MarkerObservation(0.0, 0, Pose2D(*m), SIGMA_M),
            Pose2D(*measured),
            MOUNTING,
        )
        errors.append(pose_error(result.pose, hitchhiker))
        nees.append(mahalanobis_squared(errors[-1], result.covariance))
        claimed += result.covariance / 400
    return float(np.mean(nees)), np.cov(np.array(errors).T), claimed


def test_measured_is_consistent():
    nees, found, claimed = sample("measured", seed=1)
    assert 2.7 < nees < 3.3  # chi-square, 3 degrees of freedom, 400 draws: 99 % within 2.68 to 3.33
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(claimed)), rtol=0.12)


def test_paper_is_overconfident_when_the_pair_is_not_in_line():
    nees, _, _ = sample("paper", seed=1)
    assert nees > 10.0


def test_an_unknown_method_is_named():
    with pytest.raises(ValueError, match="telepathy"):
        handover("telepathy", PoseEstimate(0.0, Pose2D(), SIGMA_D), observed(Pose2D(), Pose2D(-1.0)), BACK)
