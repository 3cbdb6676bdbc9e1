"""The facade: poses in our frames, covariances, the square-on ambiguity, bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import marker_images as images
from hitchhike_ros.core.datatypes import CameraInfo
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy, pose_from_matrix, wrap_angle
from hitchhike_ros.experiments.bench.tag_images import LIGHTS, Conditions, tag_image
from hitchhike_ros.servoing.marker_detector import (
    Code,
    MarkerDetection,
    MarkerDetector,
    MarkerDetectorParameters,
    planar_jacobian,
    planar_observation,
)
from hitchhike_ros.servoing.square_pose import SquareView, corner_jacobian, project_corners, solve

CAMERA, T_BASE_CAMERA = images.CAMERA, images.T_BASE_CAMERA
SIZE = 0.16
LONG = 100.0  # s, after which the previous image counts no more


def perturbed(T, d):
    """T -> [exp(w) R, t + dt] for d = (dt, w)."""
    out = T.copy()
    out[:3, :3] = cv2.Rodrigues(np.asarray(d[3:], dtype=float))[0] @ T[:3, :3]
    out[:3, 3] += d[:3]
    return out


def numerical(f, n=6, h=1e-6):
    steps = np.eye(n) * h
    return np.stack([(f(s) - f(-s)) / (2 * h) for s in steps], axis=-1)


def angle_between(Ra, Rb):
    return float(np.linalg.norm(cv2.Rodrigues(Ra.T @ Rb)[0]))


@given(st.floats(0.3, 4.0), st.floats(-1.2, 1.2), st.floats(-0.4, 0.4), st.floats(-0.5, 0.5), st.floats(-0.4, 0.4))
def test_jacobians_agree_with_numerical_ones(distance, yaw, pitch, x, y):
    T = images.marker_pose(distance, yaw, pitch, x * distance, y * distance)
    expected = numerical(lambda d: project_corners(perturbed(T, d), SIZE).ravel())
    assert np.allclose(corner_jacobian(T, SIZE), expected, atol=1e-6, rtol=1e-5)

    def planar(d):
        pose = pose_from_matrix(T_BASE_CAMERA @ perturbed(T, d))
        return np.array([pose.x, pose.y, wrap_angle(pose.theta - math.pi)])

    assert np.allclose(planar_jacobian(T_BASE_CAMERA, T), numerical(planar), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("distance", [0.4, 0.8, 1.5, 3.0])
@pytest.mark.parametrize("yaw", [-0.8, -0.3, 0.5])
def test_pose_of_a_rendered_marker(distance, yaw):
    T = images.marker_pose(distance, yaw, 0.1, 0.1 * distance, -0.05 * distance)
    [found] = MarkerDetector().detect(images.render_marker(7, T), CAMERA)
    assert found.id == 7
    assert np.abs(found.corners - (project_corners(T, SIZE) * 554.26 + (319.5, 239.5))).max() < 0.35
    assert np.linalg.norm(found.T_camera_marker[:3, 3] - T[:3, 3]) < 0.01 * distance
    assert angle_between(found.T_camera_marker[:3, :3], T[:3, :3]) < math.radians(1.0 + 1.5 * distance)


def test_square_on_marker_straight_ahead_looks_back():
    detector = MarkerDetector()
    detections = detector.detect(images.render_marker(0, images.marker_pose(0.8)), CAMERA)
    [observation] = detector.observe(detections, T_BASE_CAMERA, 12.5)
    assert (observation.stamp, observation.marker_id) == (12.5, 0)
    assert observation.pose.x == pytest.approx(0.9, abs=0.01)
    assert observation.pose.y == pytest.approx(0.0, abs=0.005)
    assert abs(wrap_angle(observation.pose.theta - math.pi)) < 0.12


def test_a_driver_that_turns_left_shows_a_normal_turned_left():
    # Driver ahead, heading 0.4 rad to the left: its rear marker's normal points back and to the right of it.
    detector = MarkerDetector()
    image = images.render_marker(0, images.marker_pose(0.8, yaw=-0.4))
    [observation] = detector.observe(detector.detect(image, CAMERA), T_BASE_CAMERA, 0.0)
    assert wrap_angle(observation.pose.theta - math.pi) == pytest.approx(0.4, abs=0.03)


def test_size_of_each_marker_scales_its_distance():
    T = images.marker_pose(1.0, 0.3)
    image = images.render_marker(4, T)
    [plain] = MarkerDetector().detect(image, CAMERA)
    [larger] = MarkerDetector().detect(image, CAMERA, sizes_m={4: 0.32})
    [other] = MarkerDetector().detect(image, CAMERA, sizes_m={5: 0.32})
    assert plain.T_camera_marker[2, 3] == pytest.approx(1.0, rel=0.01)
    assert larger.T_camera_marker[2, 3] == pytest.approx(2.0, rel=0.01)
    assert other.T_camera_marker[2, 3] == plain.T_camera_marker[2, 3]


def test_lens_distortion_is_taken_out():
    T = images.marker_pose(0.6, 0.4, 0.0, 0.18, 0.1)
    D = np.array([-0.28, 0.09, 0.001, -0.0005, 0.0])
    straight = images.render_marker(2, T)
    # Where each pixel of the distorted image comes from in the straight one.
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    source = cv2.undistortPoints(np.stack([u, v], -1).reshape(-1, 1, 2), CAMERA.K, D, P=CAMERA.K).reshape(480, 640, 2)
    distorted = cv2.remap(straight, source.astype(np.float32), None, cv2.INTER_LINEAR)
    [found] = MarkerDetector().detect(distorted, replace(CAMERA, D=D))
    [unaware] = MarkerDetector().detect(distorted, CAMERA)
    assert np.linalg.norm(found.T_camera_marker[:3, 3] - T[:3, 3]) < 0.006
    assert np.linalg.norm(unaware.T_camera_marker[:3, 3] - T[:3, 3]) > 0.012


def detections_with_noise(detector, T, sigma_px, rng, marker_id=0):
    """As ``detect``, from corners with noise of which the spread is known, without an image."""
    corners = project_corners(T, SIZE) * 554.26 + (319.5, 239.5) + rng.normal(0.0, sigma_px, (4, 2))
    return [detection_of(detector, corners, marker_id)]


def exact_detector(sigma_px):
    """A detector that knows the corners' noise."""
    return MarkerDetector(MarkerDetectorParameters(corner_sigma_px=sigma_px))


def detection_of(detector, corners, marker_id=0):
    view = SquareView.with_sigma((corners - (319.5, 239.5)) / 554.26, detector.params.corner_sigma_px / 554.26, SIZE)
    return MarkerDetection(Code(marker_id, ""), corners, view, solve(view), 1.0)


@pytest.mark.parametrize(
    ("distance", "yaw", "sigma_px"),
    [(0.5, 0.5, 0.2), (0.8, 0.3, 0.2), (1.5, 0.8, 0.2), (2.5, -0.9, 0.2), (0.8, 0.5, 0.5)],
)
def test_covariance_is_that_of_the_errors(distance, yaw, sigma_px):
    rng, n = np.random.default_rng(1), 400
    T = images.marker_pose(distance, yaw, 0.0, 0.1 * distance)
    truth = pose_from_matrix(T_BASE_CAMERA @ T)
    nees = []
    detector = exact_detector(sigma_px)
    for i in range(n):
        [seen] = detector.observe(detections_with_noise(detector, T, sigma_px, rng), T_BASE_CAMERA, LONG * i)
        error = np.array([seen.pose.x - truth.x, seen.pose.y - truth.y, wrap_angle(seen.pose.theta - truth.theta)])
        nees.append(error @ np.linalg.solve(seen.covariance, error))
    # The mean of n chi-square variables of 3 degrees of freedom, 99.9 % band; a little low where the flip counts.
    half_width = 3.3 * math.sqrt(6 / n)
    assert 3 - half_width - 0.2 < np.mean(nees) < 3 + half_width


def test_six_dimensional_covariance_is_that_of_the_errors():
    rng, n = np.random.default_rng(2), 400
    T = images.marker_pose(0.8, 0.6, 0.1, 0.1)
    detector = exact_detector(0.2)
    nees = []
    for _ in range(n):
        [seen] = detections_with_noise(detector, T, 0.2, rng)
        R = seen.T_camera_marker[:3, :3] @ T[:3, :3].T
        error = np.concatenate([seen.T_camera_marker[:3, 3] - T[:3, 3], cv2.Rodrigues(R)[0].ravel()])
        nees.append(error @ np.linalg.solve(seen.solutions[0].covariance, error))
    assert abs(np.mean(nees) - 6) < 3.3 * math.sqrt(12 / n)


def test_ambiguity_is_owned_up_to_in_the_covariance():
    """At 3 m and nearly square-on both poses fit: the yaw's error is large and must not be called small."""
    rng, n = np.random.default_rng(3), 300
    T = images.marker_pose(3.0, 0.35)
    truth = pose_from_matrix(T_BASE_CAMERA @ T)
    normalised, flips = [], 0
    detector = exact_detector(0.2)
    for i in range(n):
        [seen] = detector.observe(detections_with_noise(detector, T, 0.2, rng), T_BASE_CAMERA, LONG * i)
        error = wrap_angle(seen.pose.theta - truth.theta)
        flips += abs(error) > 0.4
        normalised.append(error**2 / seen.covariance[2, 2])
    assert flips > 10
    assert np.mean(normalised) < 2.0


def rounded(corners, _rng):
    """Where the corners are when edges along the pixels' rows are drawn without antialiasing."""
    return np.round(corners)


def white(sigma_px):
    return lambda corners, rng: corners + rng.normal(0.0, sigma_px, corners.shape)


def yaws_nearly_square_on(detector, distance, yaw_max, disturb, n):
    """Errors of the yaws observed, their sigmas and the errors of the least-squares yaws, each (n,) rad."""
    rng = np.random.default_rng(8)
    rows = []
    for i in range(n):
        x, y = distance * rng.uniform(-0.3, 0.3), distance * rng.uniform(-0.1, 0.1)
        T = images.marker_pose(distance, rng.uniform(-yaw_max, yaw_max), 0.0, x, y)
        detection = detection_of(detector, disturb(project_corners(T, SIZE) * 554.26 + (319.5, 239.5), rng))
        [seen] = detector.observe([detection], T_BASE_CAMERA, LONG * i)
        truth = pose_from_matrix(T_BASE_CAMERA @ T).theta
        least_squares = pose_from_matrix(T_BASE_CAMERA @ detection.T_camera_marker).theta
        error = wrap_angle(seen.pose.theta - truth)
        rows.append((error, math.sqrt(seen.covariance[2, 2]), wrap_angle(least_squares - truth)))
    return np.array(rows).T


@pytest.mark.parametrize(
    ("disturb", "lowest_nees"), [(rounded, 0.3), (white(0.2), 0.1), (white(0.35), 0.3)], ids=["edges", "0.2", "0.35"]
)
@pytest.mark.parametrize(("distance", "yaw_max"), [(0.5, 0.1), (0.8, 0.1), (0.8, 0.3), (2.0, 0.2)])
def test_yaw_nearly_square_on_is_right_within_its_covariance(distance, yaw_max, disturb, lowest_nees):
    error, sigma, _ = yaws_nearly_square_on(MarkerDetector(), distance, yaw_max, disturb, 150)
    assert lowest_nees < np.mean((error / sigma) ** 2) < 1.4
    assert np.abs(error / sigma).max() < 3.5


@pytest.mark.parametrize("sigma_px", [0.3, 0.5])
def test_yaw_nearly_square_on_is_better_than_by_least_squares(sigma_px):
    """Far off, where the corners' noise throws the least-squares yaw to either side."""
    error, sigma, least_squares = yaws_nearly_square_on(exact_detector(sigma_px), 2.0, 0.2, white(sigma_px), 300)
    assert np.std(error) < 0.93 * np.std(least_squares)
    assert 0.7 < np.mean((error / sigma) ** 2) < 1.3


def test_six_dimensional_covariance_nearly_square_on_is_that_of_the_errors():
    rng, n = np.random.default_rng(9), 300
    detector = exact_detector(0.45)
    nees = []
    for i in range(n):
        T = images.marker_pose(0.8, rng.uniform(-0.1, 0.1), rng.normal(0.0, 0.05), 0.1, -0.1)
        [seen] = detector.resolve(detections_with_noise(detector, T, 0.45, rng), T_BASE_CAMERA, LONG * i)
        R = seen.T_camera_marker[:3, :3] @ T[:3, :3].T
        error = np.concatenate([seen.T_camera_marker[:3, 3] - T[:3, 3], cv2.Rodrigues(R)[0].ravel()])
        nees.append(error @ np.linalg.solve(seen.solutions[0].covariance, error))
    assert abs(np.mean(nees) - 6) < 1.0


def test_square_on_pose_of_a_plate_that_hangs_upside_down():
    detector = MarkerDetector()
    upside_down = matrix_from_xyz_rpy((0.0, 0.0, 0.0), (math.pi, 0.0, 0.0))
    T = images.marker_pose(0.8, 0.15, 0.0, 0.2, -0.1) @ upside_down
    detections = detections_with_noise(detector, T, 0.01, np.random.default_rng(10))
    [seen] = detector.resolve(detections, T_BASE_CAMERA, 0.0)
    assert seen.solutions != detections[0].solutions
    assert angle_between(seen.T_camera_marker[:3, :3], T[:3, :3]) < 0.04
    assert np.linalg.norm(seen.T_camera_marker[:3, 3] - T[:3, 3]) < 0.003


def test_a_plate_that_leans_much_keeps_its_least_squares_pose():
    detector = MarkerDetector()
    detections = detections_with_noise(detector, images.marker_pose(0.5, 0.05, 0.6), 0.05, np.random.default_rng(11))
    [seen] = detector.resolve(detections, T_BASE_CAMERA, 0.0)
    assert any(np.array_equal(seen.T_camera_marker, s.T_camera_marker) for s in detections[0].solutions)


@pytest.mark.parametrize("lean", [15.0, -15.0])
def test_a_plate_that_leans_far_off_is_not_taken_for_an_upright_one(lean):
    """Its lean says how it is turned: a posterior that starts upright would end beside it, and be sure."""
    rng = np.random.default_rng(1)
    detector = MarkerDetector(MarkerDetectorParameters(corner_sigma_px=0.06, upright_sigma_rad=0.2))
    T = images.marker_pose(3.0, math.radians(5.0), math.radians(lean), 0.5, math.copysign(0.3, -lean))
    for i in range(12):
        [least_squares] = detections = detections_with_noise(detector, T, 0.06, rng)
        [seen] = detector.resolve(detections, T_BASE_CAMERA, LONG * i)
        error = angle_between(seen.T_camera_marker[:3, :3], T[:3, :3])
        assert error < 3.0 * angle_between(least_squares.T_camera_marker[:3, :3], T[:3, :3]) + 0.02


def test_a_plate_whose_mirrored_pose_is_square_on_too_stays_doubtful():
    """Leaning by 15°, seen from below: the corners alone hardly tell it from one that leans by 2°."""
    rng = np.random.default_rng(2)
    detector = MarkerDetector(MarkerDetectorParameters(corner_sigma_px=0.06, upright_sigma_rad=0.2))
    T = images.marker_pose(2.2, 0.0, math.radians(15.0), 0.065, -0.326)
    for i in range(30):
        [seen] = detector.resolve(detections_with_noise(detector, T, 0.06, rng), T_BASE_CAMERA, LONG * i)
        error = cv2.Rodrigues(seen.T_camera_marker[:3, :3] @ T[:3, :3].T)[0].ravel()
        assert error @ np.linalg.solve(seen.covariance[3:, 3:], error) < 40.0


def test_what_the_size_is_off_by_the_range_is_off_by():
    view, T = SquareView.with_sigma(np.zeros((4, 2)), 1e-4, SIZE), images.marker_pose(1.5, 0.3, 0.0, 0.2, 0.1)
    larger = project_corners(T, 1.001 * SIZE)
    far = T.copy()
    far[:3, 3] /= 1.001
    np.testing.assert_allclose(project_corners(far, SIZE), larger, atol=1e-6)
    assert not view.size_covariance(T).any()
    known = replace(view, size_sigma=0.001).size_covariance(T)
    np.testing.assert_allclose(known[:3, :3], np.outer(far[:3, 3] - T[:3, 3], far[:3, 3] - T[:3, 3]), rtol=5e-3)
    assert not known[3:].any() and not known[:, 3:].any()


@pytest.mark.parametrize("distance", [0.4, 1.0, 2.0])
def test_noise_of_pixels_gives_corners_the_noise_that_they_claim(distance):
    """However much of a blurred edge the window about it cuts off. In dim light noise is all that there is."""
    rng, T = np.random.default_rng(1), images.marker_pose(distance, 0.3, 0.1, 0.02, 0.01)
    found, covariances = [], []
    for _ in range(40):
        image = tag_image(T, CAMERA, rng, Conditions(LIGHTS["dim"], 0.7, (0.3, 0.2), 3.0))
        [seen] = MarkerDetector().detect(image, CAMERA)
        found.append(seen.corners.ravel())
        covariances.append(np.linalg.inv(seen.view.whitening.T @ seen.view.whitening) * 554.26**2)
    claimed = np.mean(covariances, axis=0)
    apart = np.array(found) - np.mean(found, axis=0)
    # Mean of 40 chi-square variables of 8 degrees of freedom about their mean: 4 sigma.
    assert abs(np.mean(np.einsum("ni,ij,nj->n", apart, np.linalg.inv(claimed), apart)) - 8.0) < 2.6


def test_previous_image_decides_between_two_poses():
    """A driver seen askew that draws away to 3 m: alone, some frames flip; in sequence, none does."""
    rng = np.random.default_rng(4)
    alone, in_sequence = 0, 0
    detector, forgetful = MarkerDetector(), MarkerDetector()
    # Close by the yaw is plain; then the driver draws away.
    for i, distance in enumerate(np.linspace(0.8, 3.0, 80)):
        T = images.marker_pose(float(distance), 0.4)
        truth = pose_from_matrix(T_BASE_CAMERA @ T)
        detections = detections_with_noise(detector, T, 0.4, rng)
        [remembered] = detector.observe(detections, T_BASE_CAMERA, 0.1 * i)
        [fresh] = forgetful.observe(detections, T_BASE_CAMERA, LONG * i)
        in_sequence += abs(wrap_angle(remembered.pose.theta - truth.theta)) > 0.5
        alone += abs(wrap_angle(fresh.pose.theta - truth.theta)) > 0.5
    assert alone > 0
    assert in_sequence == 0


@pytest.mark.parametrize("roll", [0.0, math.pi])
def test_upright_marker_is_preferred_to_a_leaning_one(roll):
    """A marker above the camera's height: its mirrored pose leans. Hung upside down it is as good."""
    rng = np.random.default_rng(5)
    leaning = 0
    detector = MarkerDetector()
    T = images.marker_pose(2.0, 0.0, 0.0, 0.0, -0.5) @ matrix_from_xyz_rpy((0.0, 0.0, 0.0), (roll, 0.0, 0.0))
    for i in range(50):
        [resolved] = detector.resolve(detections_with_noise(detector, T, 0.4, rng), T_BASE_CAMERA, LONG * i)
        leaning += angle_between(resolved.T_camera_marker[:3, :3], T[:3, :3]) > math.radians(18)
    assert leaning == 0


def test_memory_fades():
    detector = MarkerDetector()
    T = images.marker_pose(0.8, 0.4)
    rng = np.random.default_rng(6)
    detector.observe(detections_with_noise(detector, T, 0.1, rng), T_BASE_CAMERA, 0.0)
    [weighted] = detector.resolve(
        detections_with_noise(detector, images.marker_pose(2.5, -0.4), 0.1, rng), T_BASE_CAMERA, 10.0
    )
    seen = planar_observation(weighted, T_BASE_CAMERA, 10.0)
    assert wrap_angle(seen.pose.theta - math.pi) == pytest.approx(0.4, abs=0.15)


@settings(max_examples=30)
@given(st.floats(0.4, 3.0), st.floats(-1.2, 1.2))
def test_covariances_are_symmetric_and_positive(distance, yaw):
    detector = MarkerDetector()
    T = images.marker_pose(distance, yaw)
    [seen] = detector.observe(detections_with_noise(detector, T, 0.2, np.random.default_rng(7)), T_BASE_CAMERA, 0.0)
    assert np.allclose(seen.covariance, seen.covariance.T, rtol=1e-6)
    assert np.linalg.eigvalsh(seen.covariance)[0] > 0


IMAGE = np.zeros((480, 640), np.uint8)


FAR_OFF = np.array([[50.0, 0.0, 32.0], [5.0, 50.0, 1e300], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("image", "info", "named"),
    [
        (np.zeros((0, 0), np.uint8), replace(CAMERA, width=0, height=0), "0 x 0"),
        (np.zeros((5, 5), np.uint8), replace(CAMERA, width=5, height=5), "5 x 5"),
        (IMAGE.astype(np.float32), CAMERA, "float32"),
        (np.zeros((480, 640, 3), np.uint8), CAMERA, "3 dimensions"),
        (b"bytes", CAMERA, "bytes"),
        (np.zeros((240, 320), np.uint8), CAMERA, "640 x 480"),
        (IMAGE, replace(CAMERA, K=np.zeros((3, 3))), "focal lengths"),
        (IMAGE, replace(CAMERA, K=np.full((3, 3), np.nan)), "finite"),
        (IMAGE, replace(CAMERA, K=np.eye(2)), "3 x 3"),
        (IMAGE, replace(CAMERA, D=np.full(5, np.inf)), "D of camera_info"),
        (IMAGE, replace(CAMERA, D=np.zeros(3)), "D of camera_info"),
        (IMAGE, replace(CAMERA, K=FAR_OFF, D=np.array([2.0, -1e38, -2.0, 1.5, -2.0])), "a lens"),
        (IMAGE[:0], replace(CAMERA, height=0, D=np.full(5, 0.1)), "expected at least one"),
    ],
)
def test_bad_images_and_calibrations_are_named(image, info, named):
    with pytest.raises(VisionError, match=named):
        MarkerDetector().detect(image, info)


@pytest.mark.parametrize("size", [0.0, -0.1, math.nan, math.inf])
def test_a_marker_without_size_is_named(size):
    with pytest.raises(VisionError, match="size of marker 3"):
        MarkerDetector().detect(IMAGE, CAMERA, sizes_m={3: size})


def test_unknown_family_is_named():
    with pytest.raises(VisionError, match="99h9"):
        MarkerDetector(MarkerDetectorParameters(family="99h9"))


def test_an_empty_scene_holds_no_marker():
    assert MarkerDetector().detect(IMAGE, CameraInfo(640, 480, CAMERA.K, np.zeros(0))) == []
