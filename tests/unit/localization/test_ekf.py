"""The filter's equations, its Jacobians and its consistency."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D, Twist2D
from hitchhike_ros.core.geometry import between, compose, move, wrap_angle
from hitchhike_ros.localization.ekf import (
    Ekf,
    EkfParameters,
    LandmarkObservation,
    Landmarks,
    expected_landmarks,
    expected_marker,
    mahalanobis_squared,
    pose_error,
)
from hitchhike_ros.localization.motion import MotionNoise

POSES = st.builds(Pose2D, st.floats(-10, 10), st.floats(-10, 10), st.floats(-3.1, 3.1))
P0 = np.diag([0.04, 0.09, 0.01])
LANDMARKS = Landmarks(np.array([[4.0, 1.0], [4.0, -1.0], [-3.0, 2.0]]), np.array([0.0, 1.0, 0.0]))


def seen(pose: Pose2D, index: int, signature: float | None = None, **sigma: float) -> LandmarkObservation:
    (r, b), s = expected_landmarks(pose, LANDMARKS.positions)[0][index], LANDMARKS.signatures[index]
    return LandmarkObservation(
        float(r),
        float(b),
        s if signature is None else signature,
        sigma.get("range_m", 0.05),
        sigma.get("bearing", 0.02),
    )


def perturbed(pose: Pose2D, step: np.ndarray) -> Pose2D:
    return Pose2D(pose.x + step[0], pose.y + step[1], pose.theta + step[2])


@given(POSES, st.floats(-20, 20), st.floats(-20, 20))
def test_landmark_jacobian_equals_numerical_one(pose, x, y):
    if math.hypot(x - pose.x, y - pose.y) < 0.5:
        return
    position, h = np.array([[x, y]]), 1e-6
    H = expected_landmarks(pose, position)[1][0]
    for column, step in enumerate(np.eye(3) * h):
        plus, minus = (expected_landmarks(perturbed(pose, sign * step), position)[0] for sign in (1, -1))
        d = plus - minus
        np.testing.assert_allclose(H[:, column], [d[0, 0] / (2 * h), wrap_angle(d[0, 1]) / (2 * h)], atol=1e-6)


@given(POSES, POSES)
def test_marker_jacobian_equals_numerical_one(pose, marker):
    _, H = expected_marker(pose, marker)
    h = 1e-6
    for column, step in enumerate(np.eye(3) * h):
        plus, minus = (expected_marker(perturbed(pose, sign * step), marker)[0] for sign in (1, -1))
        numerical = pose_error(plus, minus) / (2 * h)
        np.testing.assert_allclose(H[:, column], numerical, atol=1e-6)


def test_prediction_grows_the_covariance_and_moves_the_mean():
    ekf = Ekf(Pose2D(1.0, 2.0, 0.5), P0)
    ekf.predict(Twist2D(0.5, 0.0), 0.1)
    assert ekf.pose == move(Pose2D(1.0, 2.0, 0.5), Twist2D(0.5, 0.0), 0.1)
    assert np.linalg.det(ekf.covariance) > np.linalg.det(P0)
    still = Ekf(Pose2D(), P0)
    still.predict(Twist2D(0.0, 0.0), 0.1)
    np.testing.assert_allclose(still.covariance, P0)


def test_a_landmark_pulls_the_mean_to_the_truth_and_shrinks_the_covariance():
    truth, ekf = Pose2D(0.1, -0.2, 0.05), Ekf(Pose2D(), P0)
    for index in (0, 1, 2):
        assert ekf.update_landmark(seen(truth, index), LANDMARKS) == index
    assert np.linalg.norm(pose_error(ekf.pose, truth)[:2]) < 0.03
    assert np.linalg.eigvalsh(P0 - ekf.covariance).min() > 0


def test_signature_tells_landmarks_apart_that_distance_does_not():
    ekf = Ekf(Pose2D(0.0, 0.0, 0.0), np.diag([0.5, 0.5, 0.2]))
    middle = seen(Pose2D(), 0)
    ambiguous = LandmarkObservation(middle.range_m, 0.0, 1.0, 0.5, 0.3)
    assert ekf.associate(ambiguous, LANDMARKS) == 1
    assert ekf.associate(LandmarkObservation(middle.range_m, 0.0, 0.0, 0.5, 0.3), LANDMARKS) == 0


def test_an_observation_of_nothing_known_is_refused():
    ekf = Ekf(Pose2D(), P0 * 0.01)
    before = ekf.pose, ekf.covariance
    assert ekf.update_landmark(LandmarkObservation(2.0, 1.2, 0.0, 0.05, 0.02), LANDMARKS) is None
    assert ekf.update_landmark(LandmarkObservation(2.0, 1.2, 0.0, 0.05, 0.02), LANDMARKS, index=0) is None
    assert ekf.update_landmark(seen(Pose2D(), 0), Landmarks(np.zeros((0, 2)), np.zeros(0))) is None
    assert ekf.pose == before[0]
    np.testing.assert_array_equal(ekf.covariance, before[1])


def test_bearing_innovations_wrap():
    truth = Pose2D(0.0, 0.0, math.pi - 0.01)
    behind = Landmarks(np.array([[2.0, 0.0]]), np.zeros(1))
    ekf = Ekf(Pose2D(0.0, 0.0, -math.pi + 0.01), np.diag([0.01, 0.01, 0.01]))
    r, b = expected_landmarks(truth, behind.positions)[0][0]
    assert ekf.update_landmark(LandmarkObservation(r, b, 0.0, 0.05, 0.001), behind) == 0
    assert abs(wrap_angle(ekf.pose.theta - truth.theta)) < 0.02


def test_a_known_marker_gives_the_whole_pose():
    truth, marker = Pose2D(3.0, 5.7, 0.1), Pose2D(5.2, 6.62, math.pi)
    ekf = Ekf(Pose2D(2.8, 5.9, 0.0), P0)
    Q = np.diag([1e-4, 1e-4, 1e-4])
    assert ekf.update_marker(MarkerObservation(0.0, 10, between(truth, marker), Q), marker)
    assert np.abs(pose_error(ekf.pose, truth)).max() < 0.02
    flipped = compose(between(truth, marker), Pose2D(0.0, 0.0, 1.5))
    assert not ekf.update_marker(MarkerObservation(0.0, 10, flipped, Q), marker)


def test_information_only_moves_what_it_knows():
    ekf = Ekf(Pose2D(1.0, 2.0, 0.0), P0)
    A = np.diag([0.0, 1e4, 0.0])
    ekf.update_information(A, A @ [8.0, 0.3, 0.0])
    assert ekf.pose.x == pytest.approx(1.0)
    assert ekf.pose.y == pytest.approx(2.3, abs=1e-3)
    assert ekf.covariance[0, 0] == pytest.approx(0.04)
    assert ekf.covariance[1, 1] == pytest.approx(1 / (1 / 0.09 + 1e4), rel=1e-6)
    certain = Ekf(Pose2D(1.0, 2.0, 0.0), np.zeros((3, 3)))
    certain.update_information(np.eye(3), np.array([8.0, 0.3, 0.0]))
    assert certain.pose == Pose2D(1.0, 2.0, 0.0)


def test_joseph_form_stays_sound_with_nearly_exact_observations():
    ekf = Ekf(Pose2D(), np.diag([1e2, 1e2, 1.0]))
    for index in (0, 1, 2) * 30:
        ekf.update_landmark(seen(Pose2D(), index, range_m=1e-6, bearing=1e-7), LANDMARKS, index=index)
    P = ekf.covariance
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() >= -1e-18


@pytest.mark.parametrize(
    "covariance",
    [np.diag([1.0, 1.0, -1.0]), np.full((3, 3), math.nan), np.eye(2), np.array([[1, 1, 0], [0, 1, 0], [0, 0, 1.0]])],
)
def test_what_is_no_covariance_is_refused(covariance):
    with pytest.raises(ValueError, match="covariance"):
        Ekf(Pose2D(), covariance)


def test_the_covariance_is_honest():
    """Mean NEES over runs with the modelled noise lies in its 99 % band."""
    rng = np.random.default_rng(4)
    noise = MotionNoise(0.01, 0.001, 0.01, 0.01)
    nees = []
    for _ in range(60):
        P = np.diag([0.01, 0.01, 0.001])
        truth = Pose2D(0.0, 0.0, 0.0)
        start = rng.multivariate_normal(np.zeros(3), P)
        ekf = Ekf(perturbed(truth, start), P, EkfParameters(noise, gate=30.0))
        for step in range(40):
            twist = Twist2D(0.5, 0.4 if step % 20 < 10 else -0.4)
            v, w = rng.multivariate_normal([twist.v, twist.omega], noise.covariance(twist, 0.1))
            truth = move(truth, Twist2D(v, w), 0.1)
            ekf.predict(twist, 0.1)
            if step % 4 == 3:
                o = seen(truth, step // 4 % 3)
                noisy = LandmarkObservation(
                    o.range_m + 0.05 * rng.normal(), o.bearing_rad + 0.02 * rng.normal(), o.signature, 0.05, 0.02
                )
                assert ekf.update_landmark(noisy, LANDMARKS) is not None
        nees.append(mahalanobis_squared(pose_error(ekf.pose, truth), ekf.covariance))
    # chi-square with 180 degrees of freedom: 99 % within [134, 232]
    assert 134 / 60 < np.mean(nees) < 232 / 60
