"""The filter of several hypotheses: its joint association against brute force, and what it does with clutter."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.experiments.bench.hypotheses import Hypotheses, HypothesesParameters
from hitchhike_ros.localization.ekf import Ekf, LandmarkObservation, Landmarks, expected_landmarks, pose_error

POSITIONS = np.array([[4.0, 1.0], [4.0, 0.8], [3.0, -1.0], [5.0, 0.0]])
START, P0 = Pose2D(0.1, -0.1, 0.05), np.diag([0.01, 0.01, 0.002])
SIGMA_R, SIGMA_B = 0.1, 0.02
FAR = 1e9  # a gate that lets everything pass


def observation(range_m: float, bearing_rad: float) -> LandmarkObservation:
    return LandmarkObservation(range_m, bearing_rad, 0.0, SIGMA_R, SIGMA_B)


def view(truth: Pose2D, indices) -> list[LandmarkObservation]:
    return [observation(*expected_landmarks(truth, POSITIONS)[0][index]) for index in indices]


def joint_log_likelihood(picture, given_to, clutter_density: float) -> float:
    """Of all observations at once, linearised at the start, after Neira and Tardos (2001)."""
    expected, H = expected_landmarks(START, POSITIONS)
    paired = [(seen, k) for seen, k in zip(picture, given_to, strict=True) if k is not None]
    total = (len(picture) - len(paired)) * math.log(clutter_density)
    if not paired:
        return total
    nu = [(o.range_m - expected[k, 0], wrap_angle(o.bearing_rad - expected[k, 1])) for o, k in paired]
    rows = np.vstack([H[k] for _, k in paired])
    S = rows @ P0 @ rows.T + np.diag([SIGMA_R**2, SIGMA_B**2] * len(paired))
    return total + float(multivariate_normal(cov=S).logpdf(np.ravel(nu)))


def assignments(observations: int):
    """Every way to give observations to landmarks, no landmark twice."""
    for given_to in itertools.product((None, *range(len(POSITIONS))), repeat=observations):
        taken = [k for k in given_to if k is not None]
        if len(taken) == len(set(taken)):
            yield given_to


PICTURES = st.lists(st.builds(observation, st.floats(3.0, 5.2), st.floats(-0.5, 0.5)), min_size=1, max_size=3)


@settings(max_examples=40)
@given(PICTURES, st.sampled_from([0.01, 0.1, 1.0]))
def test_joint_association_is_as_likely_as_the_best_by_brute_force(picture, clutter_density):
    everything = HypothesesParameters(clutter_density=clutter_density, gate=FAR, most=200, merge=1e-12)
    chosen = Hypotheses(START, P0, everything).correct(picture, POSITIONS)
    assert chosen in set(assignments(len(picture)))  # no landmark twice
    best = max(joint_log_likelihood(picture, given_to, clutter_density) for given_to in assignments(len(picture)))
    # The filter is linearised anew after each observation of a picture.
    assert joint_log_likelihood(picture, chosen, clutter_density) >= best - 0.5


def test_a_pair_is_told_apart_jointly_where_the_nearest_would_be_taken_twice():
    truth = Pose2D(START.x, START.y, START.theta + 0.03)  # turned by half of what the pair is apart
    picture = view(truth, (0, 1))
    greedy = [Ekf(START, P0).associate(seen, Landmarks(POSITIONS, np.zeros(4))) for seen in picture]
    assert greedy == [1, 1]
    assert Hypotheses(START, P0).correct(picture, POSITIONS) == (0, 1)


def test_what_is_nowhere_in_the_map_changes_nothing():
    several = Hypotheses(START, P0)
    assert several.correct([observation(1.0, 0.4)], POSITIONS) == (None,)
    assert several.pose == pytest.approx(START)
    np.testing.assert_allclose(several.covariance, P0, atol=1e-12)
    assert several.correct([], np.zeros((0, 2))) == ()
    assert several.correct([observation(1.0, 0.4)], np.zeros((0, 2))) == (None,)


def test_clutter_in_a_picture_is_left_out():
    picture = [observation(1.5, 0.2), *view(START, (3, 2)), observation(2.0, -0.4)]
    assert Hypotheses(START, P0).correct(picture, POSITIONS) == (None, 3, 2, None)


def test_with_one_landmark_it_is_the_papers_filter():
    alone, one = Landmarks(POSITIONS[:1], np.zeros(1)), HypothesesParameters(clutter_density=1e-300, most=1)
    ekf, several = Ekf(START, P0), Hypotheses(START, P0, one)
    for _ in range(5):
        for estimator in (ekf, several):
            for twist in (Twist2D(0.5, 0.1), Twist2D(0.2, -0.2)):
                estimator.predict(twist, 0.1)
        (seen,) = view(Pose2D(ekf.pose.x + 0.01, ekf.pose.y, ekf.pose.theta), (0,))
        ekf.update_landmark(seen, alone, 0)
        assert several.correct([seen], alone.positions) == (0,)
    np.testing.assert_allclose(pose_error(several.pose, ekf.pose), 0.0, atol=1e-6)
    np.testing.assert_allclose(several.covariance, ekf.covariance, atol=1e-9)


@given(st.floats(0.05, 1.0))
def test_a_share_of_the_information_is_that_share(share):
    several = Hypotheses(START, P0, HypothesesParameters(clutter_density=1e-300, most=1))
    several.correct(view(START, (2,)), POSITIONS[2:3], share)
    H = expected_landmarks(START, POSITIONS)[1][2]
    information = np.linalg.inv(P0) + share * H.T @ np.diag([SIGMA_R**-2, SIGMA_B**-2]) @ H
    np.testing.assert_allclose(several.covariance, np.linalg.inv(information), atol=1e-9)


def test_hypotheses_made_one_keep_what_they_were_apart():
    pair = np.array([[4.0, 0.3], [4.0, -0.3]])
    between_them = observation(float(np.hypot(4.0, 0.3)), 0.0)
    apart, one = (
        Hypotheses(Pose2D(), P0, HypothesesParameters(clutter_density=1e-300, gate=FAR, merge=merge))
        for merge in (1e-12, FAR)
    )
    apart.correct([between_them], pair)
    one.correct([between_them], pair)
    assert (len(apart), len(one)) == (3, 1)
    np.testing.assert_allclose(apart.weights, [0.5, 0.5, 0.0], atol=1e-9)  # the last: it was neither
    np.testing.assert_allclose(pose_error(one.pose, Pose2D(apart.pose.x, 0.0, 0.0)), 0.0, atol=1e-9)
    off = np.array([apart.pose.y, apart.pose.theta])  # the other hypothesis is its mirror image
    expected = apart.covariance[1:, 1:] + np.outer(off, off)
    np.testing.assert_allclose(one.covariance[1:, 1:], expected, atol=1e-9)


def test_a_wrong_explanation_dies_when_later_pictures_speak_against_it():
    # Seen from here both landmarks of the pair fit, the wrong one better; the third landmark then decides.
    truth = Pose2D(START.x, START.y, START.theta - 0.09)
    several = Hypotheses(START, np.diag([1e-4, 1e-4, 0.01]))
    (first,) = view(truth, (1,))
    several.correct([first], POSITIONS[:2])
    assert len(several) > 1
    for _ in range(3):
        several.correct(view(truth, (2, 3)), POSITIONS)
    assert abs(wrap_angle(several.pose.theta - truth.theta)) < 0.02


@given(PICTURES, st.integers(1, 6))
def test_weights_are_probabilities_and_covariances_valid(picture, most):
    several = Hypotheses(START, P0, HypothesesParameters(most=most))
    for _ in range(3):
        several.predict(Twist2D(0.3, 0.1), 0.2)
        several.correct(picture, POSITIONS, 0.5)
        assert 1 <= len(several) <= most
        assert several.weights.sum() == pytest.approx(1.0)
        assert (np.diff(several.weights) <= 0.0).all()
        assert np.linalg.eigvalsh(several.covariance).min() > 0.0


def test_a_start_that_is_no_gaussian_is_refused():
    with pytest.raises(ValueError, match="covariance"):
        Hypotheses(START, -P0)
