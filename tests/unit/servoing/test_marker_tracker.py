"""Carrying one marker: through blur and cover, with a lens, and what makes it detect again; QR codes."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import marker_images as images
from hitchhike_ros import _visp_tracker
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.core.geometry import pose_from_matrix, wrap_angle
from hitchhike_ros.experiments.bench.tag_images import LIGHTS, Conditions, marker_pose, tag_image
from hitchhike_ros.servoing.lens import Lens
from hitchhike_ros.servoing.marker_detector import MarkerDetector, MarkerDetectorParameters
from hitchhike_ros.servoing.marker_tracker import MarkerTracker
from hitchhike_ros.servoing.qr_codes import code_id
from hitchhike_ros.servoing.square_pose import project_corners

CAMERA, T_BASE_CAMERA = images.CAMERA, images.T_BASE_CAMERA
SIZE = 0.16
# A camera, turned by pi: what it saw lies behind it.
ROUND = np.diag([-1.0, 1.0, -1.0, 1.0])
D = np.array([-0.28, 0.09, 0.001, -0.0005, 0.0])


def pixels(T):
    return project_corners(T, SIZE) * 554.26 + (319.5, 239.5)


def picture(T, conditions=None, seed=0, camera=CAMERA, **options):
    return tag_image(T, camera, np.random.default_rng(seed), conditions, **options)


def see(tracker, image, stamp, target=0, camera=CAMERA, **options):
    return tracker.see(image, camera, T_BASE_CAMERA, stamp, target=target, **options)


def turning(n=12):
    """A marker at 1.2 m that turns through square-on."""
    for i in range(n):
        yield 0.1 * i, marker_pose(1.2 + 0.02 * i, 0.6 - 0.1 * i, 0.02, 0.1 - 0.01 * i, 0.05)


def test_it_is_carried_with_the_precision_of_a_detection():
    tracker, errors, carried = MarkerTracker(), [], 0
    for stamp, T in turning():
        [seen] = see(tracker, picture(T), stamp)
        carried += tracker.tracking
        errors.append(np.abs(seen.corners - pixels(T)).max())
        assert abs(wrap_angle(pose_from_matrix(T_BASE_CAMERA @ seen.T_camera_marker).theta
                              - pose_from_matrix(T_BASE_CAMERA @ T).theta)) < math.radians(2.0)  # fmt: skip
    assert carried >= 9
    assert max(errors) < 0.25


def test_it_is_carried_where_detection_fails():
    """A bar over one of its sides and some of its cells: no quadrilateral is closed any more."""
    tracker = MarkerTracker()
    assert see(tracker, picture(marker_pose(1.0, 0.3)), 0.0)
    T = marker_pose(1.0, 0.3, 0.0, 0.01)
    barred = picture(T)
    lower_left, lower_right = pixels(T)[:2]
    foot = np.rint(lower_left + 0.6 * (lower_right - lower_left)).astype(int)
    barred[foot[1] - 14 : foot[1] + 60, foot[0] - 8 : foot[0] + 8] = 150
    assert MarkerDetector().detect(barred, CAMERA) == []
    [seen] = see(tracker, barred, 0.1)
    assert tracker.tracking
    assert np.abs(seen.corners - pixels(T)).max() < 0.3


def test_a_covered_marker_is_lost_and_found_again():
    tracker = MarkerTracker()
    T = marker_pose(1.0, 0.3)
    image = picture(T)
    assert see(tracker, image, 0.0)
    covered = image.copy()
    middle = np.rint(pixels(T).mean(axis=0)).astype(int)
    covered[middle[1] - 60 : middle[1] + 60, middle[0] - 60 : middle[0] + 60] = 90
    assert see(tracker, covered, 0.1) == []
    assert tracker.why_detected
    assert see(tracker, image, 0.2)


def test_another_pattern_in_its_place_is_not_taken_for_it():
    tracker = MarkerTracker()
    T = marker_pose(1.0, 0.3)
    assert see(tracker, picture(T, marker_id=0), 0.0)
    seen = see(tracker, picture(T, marker_id=5), 0.1)
    assert [d.id for d in seen] == [5]
    assert not tracker.tracking


class CountedModel:
    """ViSP's model-based tracker, and what is asked of it."""

    def __init__(self, model):
        self.model, self.calls = model, []

    def start(self, *arguments):
        self.calls.append("start")
        return self.model.start(*arguments)

    def track(self, *arguments):
        self.calls.append("track")
        return self.model.track(*arguments)


def counted(tracker):
    tracker._model = CountedModel(tracker._model)
    return tracker._model.calls


def test_the_model_based_tracker_rests_while_lines_suffice():
    tracker = MarkerTracker()
    calls = counted(tracker)
    for i in range(40):  # faster and faster, up to 5 px from image to image
        T = marker_pose(0.8, 0.1, 0.0, -0.1 + 0.18e-3 * min(i, 20) ** 2 + 0.0072 * max(i - 20, 0))
        [seen] = see(tracker, picture(T), 0.1 * i)
        assert np.abs(seen.corners - pixels(T)).max() < 0.2
        assert tracker.tracking == (i not in (0, 21))
    assert not calls


@pytest.mark.parametrize("camera", [CAMERA, replace(CAMERA, D=D)], ids=["pinhole", "lens"])
def test_the_model_based_tracker_follows_where_lines_do_not_reach(camera):
    tracker = MarkerTracker()
    calls = counted(tracker)
    for i, distance in enumerate([0.8, 0.8, 0.70, 0.79, 0.69, 0.69, 0.69]):  # its corners to and fro by some 8 px
        T = marker_pose(distance, 0.3)
        [seen] = see(tracker, picture(T, seed=i, camera=camera), 0.1 * i, camera=camera)
        assert tracker.tracking == (i > 0)
        assert np.linalg.norm(seen.T_camera_marker[:3, 3] - T[:3, 3]) < 0.003
        truth = pixels(T) if camera is CAMERA else lens_truth(T, camera)
        assert np.abs(seen.corners - truth).max() < 0.2
    # It starts once, and goes on as long as it is needed.
    assert calls == ["start", "track", "track", "track"]


def test_where_the_camera_turns_by_leaps_the_picture_is_enough():
    tracker = MarkerTracker()
    calls = counted(tracker)
    for i, x in enumerate([0.0, 0.0, 0.025, -0.005, 0.02, 0.02]):  # to and fro by some 20 px
        T = marker_pose(0.8, 0.3, 0.0, x)
        [seen] = see(tracker, picture(T, seed=i), 0.1 * i)
        assert tracker.tracking == (i > 0)
        assert np.abs(seen.corners - pixels(T)).max() < 0.2
    assert not calls


def test_what_moves_because_the_camera_turns_is_sought_where_it_went(monkeypatch):
    """By lines alone: nothing is found again by its picture, although it moves by up to 30 px and to and fro."""
    monkeypatch.setattr("hitchhike_ros.servoing.marker_tracker.patch_shift", lambda *_args: None)
    tracker = MarkerTracker()
    calls = counted(tracker)
    for i, heading in enumerate([3.1, 3.1, 3.15, 3.12, 3.17, 3.12]):  # through pi and back
        c, s = math.cos(heading), math.sin(heading)
        turn = np.array([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0], [0.0, 0.0, 0.0, 1.0]])
        T = turn @ ROUND @ marker_pose(0.8, 0.3, 0.0, 0.03)
        [seen] = see(tracker, picture(T, seed=i), 0.1 * i, heading=wrap_angle(heading))
        assert tracker.tracking == (i > 0)
        assert np.abs(seen.corners - pixels(T)).max() < 0.2
    assert not calls


def test_how_far_the_model_based_tracker_is_behind_does_not_matter():
    """Lines carry the marker first; where it then leaps is found from the image before, not from its detection."""
    tracker = MarkerTracker()
    calls = counted(tracker)
    for i in range(12):
        see(tracker, picture(marker_pose(0.8, 0.2, 0.0, 0.003 * i)), 0.1 * i)
    assert tracker.tracking
    T = marker_pose(0.70, 0.2, 0.0, 0.003 * 11)
    [seen] = see(tracker, picture(T), 1.2)
    assert tracker.tracking
    assert calls == ["start", "track"]
    assert np.abs(seen.corners - pixels(T)).max() < 0.2


@pytest.mark.parametrize(("right", "down"), [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1)])
@pytest.mark.parametrize("distance", [0.6, 1.5, 2.5])
def test_a_marker_that_moved_by_a_cell_is_not_seen_where_it_was(distance, right, down):
    tracker = MarkerTracker()
    cell = SIZE / 8
    see(tracker, picture(marker_pose(distance, 0.1)), 0.0)
    T = marker_pose(distance, 0.1, 0.0, right * cell, down * cell)
    [seen] = see(tracker, picture(T), 0.1)
    assert np.abs(seen.corners - pixels(T)).max() < 0.5


@pytest.mark.parametrize("marker_id", [1, 2, 3, 7, 11])
def test_another_marker_that_takes_its_place_on_the_move_is_not_taken_for_it(marker_id):
    tracker = MarkerTracker()
    for i in range(4):
        see(tracker, picture(marker_pose(0.8, 0.1, 0.0, 0.003 * i)), 0.1 * i)
    assert tracker.tracking
    seen = see(tracker, picture(marker_pose(0.8, 0.1, 0.0, 0.012), marker_id=marker_id), 0.4)
    assert [d.id for d in seen] == [marker_id]
    assert not tracker.tracking


def test_patterns_are_alike_as_far_as_they_correlate():
    image = picture(marker_pose(0.8, 0.4))
    corners = pixels(marker_pose(0.8, 0.4))
    own = _visp_tracker.pattern(image, corners, 8)
    # The same places by OpenCV.
    unit = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    middle = (np.arange(8) + 0.5) / 8
    grid = np.stack(np.meshgrid(middle, middle), axis=-1)
    at = cv2.perspectiveTransform(grid, cv2.getPerspectiveTransform(unit, corners.astype(np.float32)))
    grey = cv2.remap(image, at.astype(np.float32), None, cv2.INTER_LINEAR).astype(float).ravel()
    assert own @ own == pytest.approx(1.0)
    assert np.corrcoef(own, grey)[0, 1] > 0.999
    darker = _visp_tracker.pattern((0.3 * image + 20).astype(np.uint8), corners, 8)
    assert own @ darker > 0.999
    assert own @ _visp_tracker.pattern(255 - image, corners, 8) == pytest.approx(-1.0, abs=1e-3)
    assert not _visp_tracker.pattern(np.full((480, 640), 90, np.uint8), corners, 8).any()
    with pytest.raises(VisionError, match="cells is 0"):
        _visp_tracker.pattern(image, corners, 0)


def test_a_jump_is_detected():
    tracker = MarkerTracker()
    assert see(tracker, picture(marker_pose(1.0, 0.3)), 0.0)
    T = marker_pose(1.0, 0.3, 0.0, 0.3)
    [seen] = see(tracker, picture(T), 0.1)
    assert np.abs(seen.corners - pixels(T)).max() < 0.3


def test_now_and_then_it_looks_around():
    tracker = MarkerTracker()
    image = picture(marker_pose(1.0, 0.3))
    how = []
    for i in range(26):
        see(tracker, image, 0.1 * i)
        how.append(tracker.tracking)
    assert how == [False] + 20 * [True] + [False] + 4 * [True]


def test_other_sizes_and_targets_are_detected_anew():
    tracker = MarkerTracker()
    image = picture(marker_pose(1.0, 0.3))
    see(tracker, image, 0.0)
    [larger] = see(tracker, image, 0.1, sizes_m={0: 0.32})
    assert larger.T_camera_marker[2, 3] == pytest.approx(2.0, rel=0.01)
    see(tracker, image, 0.2, target=3)
    assert not tracker.tracking
    see(tracker, image, 0.3, target=None)
    see(tracker, image, 0.4, target=None)
    assert tracker.tracking


def test_small_slanted_tags_are_sought_after_some_images():
    tracker = MarkerTracker()
    image = picture(marker_pose(3.0, 1.2), Conditions(LIGHTS["dim"]))
    assert MarkerDetector().detect(image, CAMERA) == []
    assert any(see(tracker, image, 0.1 * i) for i in range(5))


@pytest.mark.parametrize("target", [0, None])
def test_a_bad_image_is_named_while_it_is_carried(target):
    tracker = MarkerTracker()
    image = picture(marker_pose(1.0, 0.3))
    see(tracker, image, 0.0)
    with pytest.raises(VisionError, match="640 x 480"):
        see(tracker, image[:240].copy(), 0.1, target)
    with pytest.raises(VisionError, match="focal lengths"):
        see(tracker, image, 0.2, target, camera=replace(CAMERA, K=np.zeros((3, 3))))
    with pytest.raises(VisionError, match="size of marker 0"):
        see(tracker, image, 0.3, target, sizes_m={0: 0.0})
    assert see(tracker, image, 0.4, target)


def test_a_distorted_marker_is_carried():
    camera = replace(CAMERA, D=D)
    tracker, carried = MarkerTracker(), 0
    for i in range(4):
        T = marker_pose(0.7, 0.4 - 0.05 * i, 0.0, 0.2, 0.12)
        [seen] = see(tracker, picture(T, camera=camera), 0.1 * i, camera=camera)
        carried += tracker.tracking
        assert np.linalg.norm(seen.T_camera_marker[:3, 3] - T[:3, 3]) < 0.003
    assert carried == 3


@settings(max_examples=30)
@given(st.floats(0.0, 639.0), st.floats(0.0, 479.0))
def test_a_lens_and_back(u, v):
    lens = Lens(replace(CAMERA, D=D))
    point = np.array([[u, v]])
    assert np.allclose(lens.lensed(lens.points(point)), point, atol=1e-3)


def test_a_lens_straightens_pictures_as_points():
    camera = replace(CAMERA, D=D)
    lens = Lens(camera)
    T = marker_pose(0.7, 0.4, 0.0, 0.2, 0.12)
    straight = lens.points(lens_truth(T, camera))
    found, _ = _visp_tracker.fit_square(lens.straight(picture(T, camera=camera), straight), straight, 3.0, 2.0)
    assert np.abs(found - straight).max() < 0.1


def lens_truth(T, camera):
    rays = np.c_[project_corners(T, SIZE), np.ones(4)]
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.D)[0][:, 0]


def test_a_side_drawn_without_mixed_pixels_is_known_to_a_pixel():
    image = np.full((200, 200), 220, np.uint8)
    image[50:150, 50:150] = 20
    corners = np.array([[50.0, 150.0], [150.0, 150.0], [150.0, 50.0], [50.0, 50.0]]) - 0.5
    found, covariance = _visp_tracker.fit_square(image, corners + 0.8, 3.0, 2.0)
    assert np.abs(found - corners).max() < 0.02
    assert np.allclose(np.sqrt(np.diag(covariance)), 0.42, atol=0.03)
    found, covariance = _visp_tracker.fit_square(cv2.GaussianBlur(image, (0, 0), 0.7), corners + 0.8, 3.0, 2.0)
    assert np.abs(found - corners).max() < 0.02
    assert np.sqrt(np.diag(covariance)).max() < 0.02


def test_clipped_white_is_owned_up_to():
    image = np.full((200, 200), 250, np.uint8)
    image[50:150, 50:150] = 20
    corners = np.array([[50.0, 150.0], [150.0, 150.0], [150.0, 50.0], [50.0, 50.0]]) - 0.5
    soft = cv2.GaussianBlur(image, (0, 0), 0.8)
    _, unclipped = _visp_tracker.fit_square(soft, corners, 3.0, 2.0)
    bright = np.minimum(soft.astype(float) * 1.3, 255.0).astype(np.uint8)
    found, clipped = _visp_tracker.fit_square(bright, corners, 3.0, 2.0)
    assert np.abs(found - corners).max() > 0.03
    assert np.sqrt(np.diag(unclipped)).max() < 0.01
    assert np.sqrt(np.diag(clipped)).min() > 0.04


def test_no_square_no_corners():
    corners = np.array([[50.0, 150.0], [150.0, 150.0], [150.0, 50.0], [50.0, 50.0]])
    assert _visp_tracker.fit_square(np.full((200, 200), 100, np.uint8), corners, 3.0, 2.0) is None
    with pytest.raises(_visp_tracker.InvalidInputError, match="finite"):
        _visp_tracker.fit_square(np.zeros((200, 200), np.uint8), np.full((4, 2), math.nan), 3.0, 2.0)


def test_covariance_of_drawn_markers_is_that_of_the_errors():
    """Mean NEES of 30 views; the bench has hundreds and their band."""
    rng = np.random.default_rng(21)
    nees = []
    detector = MarkerDetector()
    for k in range(30):
        distance = rng.uniform(1.0, 2.5)
        x, y = distance * rng.uniform(-0.2, 0.2), distance * rng.uniform(-0.1, 0.1)
        T = marker_pose(distance, rng.uniform(0.4, 0.9), rng.normal(0.0, 0.03), x, y)
        motion = (rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0))
        conditions = Conditions(list(LIGHTS.values())[k % 3], rng.uniform(0.4, 1.0), motion, noise=3.0)
        image = tag_image(T, CAMERA, rng, conditions, marker_id=k % 30)
        for seen in detector.detect(image, CAMERA):
            R = seen.T_camera_marker[:3, :3] @ T[:3, :3].T
            error = np.concatenate([seen.T_camera_marker[:3, 3] - T[:3, 3], cv2.Rodrigues(R)[0].ravel()])
            nees.append(error @ np.linalg.solve(seen.covariance, error))
    assert len(nees) > 25
    assert 3.0 < np.mean(nees) < 9.0


@pytest.mark.parametrize("family", ["16h5", "25h9", "36h11"])
def test_families_are_carried(family):
    tracker = MarkerTracker(MarkerDetectorParameters(family=family))
    for i in range(3):
        T = marker_pose(0.8, 0.3 + 0.02 * i)
        [seen] = [d for d in see(tracker, picture(T, family=family, marker_id=4), 0.1 * i, 4) if d.id == 4]
        assert np.abs(seen.corners - pixels(T)).max() < 0.2
        assert seen.code.message == f"{family} id: 4"
    assert tracker.tracking


def test_a_qr_code_is_carried_and_says_who_it_is():
    tracker = MarkerTracker(MarkerDetectorParameters(family="qr"))
    for i in range(3):
        T = marker_pose(0.7, 0.4 - 0.02 * i, 0.0, 0.02)
        [seen] = see(tracker, picture(T, family="qr", marker_id="p3dx"), 0.1 * i, code_id("p3dx"))
        assert seen.code.message == "p3dx"
        assert np.abs(seen.corners - pixels(T)).max() < 2.0
        assert np.linalg.norm(seen.T_camera_marker[:3, 3] - T[:3, 3]) < 0.02
    assert tracker.tracking


@given(st.text(max_size=12), st.text(max_size=12))
def test_messages_have_ids(a, b):
    assert code_id(a) == code_id(a) >= 0
    assert code_id(a) < 2**31
    if a.isascii() and a.isdigit() and len(a) <= 9:
        assert code_id(a) == int(a)
        assert code_id(b) != code_id(a) or (b.isascii() and b.isdigit() and int(b) == int(a))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda t: t.track(np.zeros((480, 640), np.uint8)), "not been started"),
        (lambda t: t.start(np.zeros((4, 4), np.uint8), (1, 1, 0, 0), np.eye(4), 0.1), "4 x 4"),
        (lambda t: t.start(np.zeros((48, 64), np.uint8), (0, 1, 0, 0), np.eye(4), 0.1), "focal"),
        (lambda t: t.start(np.zeros((48, 64), np.uint8), (1, 1, 0, 0), np.eye(4), 0.1), "in front"),
        (lambda t: t.start(np.zeros((48, 64), np.uint8), (1, 1, 0, 0), np.eye(4), 0.0), "size"),
        (lambda t: t.start(np.zeros((48, 64), np.uint8), (1, 1, 0, 0), np.eye(3), 0.1), "4, 4"),
    ],
)
def test_unusable_arguments_of_the_model_tracker_are_named(call, named):
    with pytest.raises(_visp_tracker.InvalidInputError, match=named):
        call(_visp_tracker.ModelTracker())
