"""The pose of a square: least squares, and the posterior nearly square-on, beside what SciPy finds."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

import marker_images as images
from hitchhike_ros import _visp_tracker
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy, rotation_from_rpy
from hitchhike_ros.servoing.square_pose import SquareView, flat_yaw, project_corners, solve, square_on_poses

T_BASE_CAMERA = images.T_BASE_CAMERA
SIZE = 0.16
UPRIGHT = 0.05
HALF = 0.5 * SIZE * np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])


def projected(T):
    points = HALF @ T[:3, :3].T + T[:3, 3]
    return points[:, :2] / points[:, 2:]


def noisy_view(T, sigma_px, seed, size_sigma=0.0):
    """Corners with noise that is not alike for all of them, nor independent."""
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(8, 8))
    covariance = (mixed @ mixed.T / 8.0 + np.eye(8)) * (sigma_px / 554.0) ** 2 / 2.0
    noise = np.linalg.cholesky(covariance) @ rng.normal(size=8)
    view = SquareView.with_covariance(projected(T) + noise.reshape(4, 2), covariance, SIZE, size_sigma)
    return view, covariance


def moved(T, d):
    out = T.copy()
    out[:3, :3] = cv2.Rodrigues(np.asarray(d[3:], dtype=float))[0] @ T[:3, :3]
    out[:3, 3] += d[:3]
    return out


def test_errors_are_whitened():
    view, covariance = noisy_view(images.marker_pose(1.0), 0.2, 0)
    np.testing.assert_allclose(view.whitening @ covariance @ view.whitening.T, np.eye(8), atol=1e-9)
    with pytest.raises(VisionError, match="positive definite"):
        SquareView.with_covariance(np.zeros((4, 2)), np.zeros((8, 8)), SIZE)


@settings(max_examples=50)
@given(st.floats(0.3, 3.0), st.floats(-1.2, 1.2), st.floats(-0.3, 0.3), st.floats(-0.4, 0.4), st.integers(0, 99))
def test_exact_corners_give_the_exact_pose(distance, yaw, pitch, x, seed):
    T = images.marker_pose(distance, yaw, pitch, x * distance, 0.1 * distance)
    whitening = noisy_view(T, 0.1, seed)[0].whitening
    poses = [s.T_camera_marker for s in solve(SquareView(projected(T), whitening, SIZE))]
    np.testing.assert_allclose(project_corners(T, SIZE), projected(T), atol=1e-12)
    assert min(np.abs(pose - T).max() for pose in poses) < 1e-3
    assert np.abs(project_corners(poses[0], SIZE) - projected(T)).max() < 1e-6


@settings(max_examples=30)
@given(st.floats(0.4, 2.0), st.floats(0.5, 1.1), st.sampled_from([-1.0, 1.0]), st.integers(0, 99))
def test_least_squares_are_those_of_scipy(distance, yaw, side, seed):
    T = images.marker_pose(distance, side * yaw, 0.1, 0.1 * distance, -0.05 * distance)
    view, _ = noisy_view(T, 0.1, seed)
    best = solve(view)[0]

    def residuals(d):
        return view.whitening @ (projected(moved(best.T_camera_marker, d)) - view.points).ravel()

    found = least_squares(residuals, np.zeros(6), x_scale=[1e-3] * 6, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    sigma = np.sqrt(np.diag(best.covariance))
    assert np.abs(found.x / sigma).max() < 1e-3
    assert 2.0 * found.cost == pytest.approx(best.chi2, abs=1e-6)
    np.testing.assert_allclose(best.covariance, np.linalg.inv(found.jac.T @ found.jac), rtol=0.01, atol=1e-12)


def test_both_poses_of_a_nearly_square_on_square_come_best_first():
    T = images.marker_pose(2.0, 0.25)
    first, second = solve(SquareView.with_sigma(projected(T), 1e-4, SIZE))
    assert np.allclose(first.T_camera_marker, T, atol=1e-4)
    assert first.chi2 < 1e-6 < second.chi2
    # The other one is turned to the opposite side by about as much.
    normal, other = (s.T_camera_marker[:3, 0] for s in (first, second))
    assert other[0] == pytest.approx(-normal[0], abs=0.03)


def test_one_pose_where_only_one_fits():
    # Near by, what is farther off is smaller: the mirrored pose is no optimum.
    assert len(solve(SquareView.with_sigma(projected(images.marker_pose(0.3, 0.2)), 1e-4, SIZE))) == 1


def test_no_pose_of_what_is_no_square():
    assert solve(SquareView.with_sigma(np.zeros((4, 2)), 1e-4, SIZE)) == ()
    line = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])
    assert solve(SquareView.with_sigma(line, 1e-4, SIZE)) == ()


@pytest.mark.parametrize(
    ("points", "size", "named"),
    [(np.zeros((4, 2)), 0.0, "size"), (np.zeros((4, 2)), math.nan, "size"), (np.full((4, 2), np.nan), 0.16, "finite")],
)
def test_unusable_arguments_are_named(points, size, named):
    with pytest.raises(_visp_tracker.InvalidInputError, match=named):
        _visp_tracker.solve(points, np.eye(8), size)


def marginal(view, T_near, square_on, flat, *, upside):
    """Mean and covariance of the square's place and yaw, by SciPy's optima over a finer grid of yaws than ours, of the
    mode that holds T_near."""

    def pose(q):
        T = np.eye(4)
        T[:3, :3] = T_BASE_CAMERA[:3, :3].T @ rotation_from_rpy(*q[3:]) @ np.diag([1.0, upside, upside])
        T[:3, 3] = q[:3]
        return T

    def residuals(p, yaw):
        T = pose([*p, yaw])
        return np.concatenate([view.whitening @ (projected(T) - view.points).ravel(), p[3:] / UPRIGHT])

    yaws = square_on + flat * np.linspace(-1.5, 1.5, 121)
    optima, start = [], np.array([*T_near[:3, 3], 0.0, 0.0])
    for yaw in yaws:
        found = least_squares(residuals, start, x_scale=[1e-3] * 3 + [0.01] * 2, args=(yaw,))
        optima.append((2.0 * found.cost, *found.x, yaw, *np.linalg.inv(found.jac.T @ found.jac)[:3, :3].ravel()))
    rows = np.array(optima)
    weight = np.exp(-0.5 * (rows[:, 0] - rows[:, 0].min()))
    weight /= weight.sum()
    q = rows[:, [1, 2, 3, 6]]
    mean = weight @ q
    covariance = ((q - mean).T * weight) @ (q - mean)
    covariance[:3, :3] += (weight @ rows[:, 7:]).reshape(3, 3)
    return mean, covariance


@pytest.mark.parametrize("upside", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(6))
def test_square_on_the_posterior_is_that_of_scipy(seed, upside):
    rng = np.random.default_rng(seed)
    distance = rng.uniform(0.5, 1.5)
    T = images.marker_pose(distance, rng.uniform(-0.05, 0.05), rng.normal(0.0, 0.03), 0.03 * distance, 0.02)
    if upside < 0.0:
        T = T @ matrix_from_xyz_rpy((0.0, 0.0, 0.0), (math.pi, 0.0, 0.0))
    view, _ = noisy_view(T, rng.uniform(0.1, 0.4), seed)
    [own] = square_on_poses(view, T, T_BASE_CAMERA, UPRIGHT)
    sight = T_BASE_CAMERA[:3, :3] @ T[:3, 3]
    square_on = math.atan2(-sight[1], -sight[0])
    mean, covariance = marginal(view, T, square_on, flat_yaw(view, T[2, 3]), upside=upside)
    in_base = T_BASE_CAMERA[:3, :3] @ own.T_camera_marker[:3, 0]
    off = math.remainder(math.atan2(in_base[1], in_base[0]) - mean[3], 2.0 * math.pi)
    assert abs(off) < 0.02 * math.sqrt(covariance[3, 3])
    assert np.abs(own.T_camera_marker[:3, 3] - mean[:3]).max() < 0.02 * math.sqrt(covariance[2, 2])
    np.testing.assert_allclose(
        own.covariance[:3, :3], covariance[:3, :3], rtol=0.05, atol=0.02 * covariance[:3, :3].max()
    )
    # The yaw turns about the base's vertical, which the level camera sees as its y axis.
    assert own.covariance[4, 4] == pytest.approx(covariance[3, 3], rel=0.05)


def test_turned_far_the_corners_tell_the_pose():
    T = images.marker_pose(0.8, 0.8)
    view, _ = noisy_view(T, 0.1, 0)
    assert square_on_poses(view, solve(view)[0].T_camera_marker, T_BASE_CAMERA, UPRIGHT) == ()
