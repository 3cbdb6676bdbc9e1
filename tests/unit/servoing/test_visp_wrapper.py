"""The compiled module alone: photographs, refusals."""

from __future__ import annotations

import threading

import numpy as np
import pytest

import marker_images as images
from hitchhike_ros import _visp_tracker
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.servoing.square_pose import SquareView, project_corners, solve


@pytest.mark.parametrize("decimate", [1.0, 2.0])
def test_finds_what_the_photograph_of_visp_shows(decimate):
    image = images.visp_image("AprilTag.pgm")
    truth = images.read_corners(images.VISP_DATA / "ground_truth_detection.txt")
    ids, corners = _visp_tracker.TagDetector("36h11", quad_decimate=decimate).detect(image)
    found = dict(zip(ids.tolist(), corners, strict=True))
    assert set(found) <= set(truth)
    # Decimation loses the smallest tags, not the accuracy of the others.
    assert len(found) == len(truth) if decimate == 1.0 else len(found) >= len(truth) - 2
    for marker_id, points in found.items():
        # The file counts row first in its corners.
        assert np.abs(points[:, ::-1] - truth[marker_id]).max() < 1.0


@pytest.mark.parametrize(
    ("file", "family"),
    [
        ("tag36_11", "36h11"),
        ("tag25_09", "25h9"),
        ("tag16_05", "16h5"),
        ("tag21_07", "circle21h7"),
    ],
)
def test_families(file, family):
    image = images.visp_image(f"benchmark/640x480/{file}_640x480.png")
    truth = images.read_corners(images.VISP_DATA / f"benchmark/640x480/corners_{file}.txt")
    ids, corners = _visp_tracker.TagDetector(family).detect(image)
    found = dict(zip(ids.tolist(), corners, strict=True))
    assert set(found) == set(truth)
    for marker_id, points in found.items():
        assert np.abs(points - truth[marker_id]).max() < 1.0


def test_finds_the_tags_of_a_photograph_taken_outdoors(shared_data):
    [photograph] = (shared_data / "apriltag").glob("*.jpg")
    reference = []
    for line in photograph.with_suffix(".txt").read_text().splitlines():
        numbers = [float(n) for n in line.replace("(", " ").replace(")", " ").replace(",", " ").split()]
        reference.append(np.array(numbers[1:]).reshape(4, 2))
    ids, corners = _visp_tracker.TagDetector("36h11").detect(images.read_gray(photograph))
    assert set(ids.tolist()) == {0}
    # ViSP's own detector finds all but one of the 25 (18 px) tags.
    assert len(ids) >= 24
    middles = np.array([c.mean(axis=0) for c in reference])
    for points in corners:
        nearest = reference[int(np.argmin(np.linalg.norm(middles - points.mean(axis=0), axis=1)))]
        # The reference's corners come in the opposite order and without edge refinement.
        order = [int(np.argmin(np.linalg.norm(nearest - p, axis=1))) for p in points]
        assert sorted(order) == [0, 1, 2, 3]
        assert np.median(np.linalg.norm(points - nearest[order], axis=1)) < 1.0


@pytest.mark.parametrize("tag", range(5))
def test_pose_agrees_with_ground_truth(tag):
    image = images.visp_image("benchmark/640x480/tag36_11_640x480.png")
    truth = np.loadtxt(images.VISP_DATA / f"benchmark/640x480/cMo_{tag}.txt")
    ids, corners = _visp_tracker.TagDetector("36h11").detect(image)
    normalised = (corners[ids.tolist().index(tag)] - (320.0, 240.0)) / 700.0
    view = SquareView.with_sigma(normalised, 0.1 / 700.0, 0.2 if tag < 3 else 0.1)
    T = solve(view)[0].T_camera_marker
    assert np.linalg.norm(T[:3, 3] - truth[:3, 3]) < 0.01 * truth[2, 3]
    # The file's z axis points away from the viewer or towards: compare the planes.
    assert abs(T[:3, 0] @ truth[:3, 2]) > np.cos(np.radians(1.5))
    residual = project_corners(T, view.size_m) - normalised
    assert np.sqrt((residual**2).sum(axis=1).mean()) * 700.0 < 0.5


@pytest.mark.parametrize(
    ("image", "named"),
    [
        (np.zeros((480, 640)), "float64"),
        (np.zeros((480, 640, 3), np.uint8), "3 dimensions"),
        (np.zeros((0, 640), np.uint8), "640 x 0"),
        (np.zeros((4, 4), np.uint8), "4 x 4"),
        (np.zeros((480, 1280), np.uint8)[:, ::2], "contiguous"),
        (np.zeros((640, 480), np.uint8).T, "contiguous"),
    ],
)
def test_unusable_images_are_refused_rather_than_converted(image, named):
    with pytest.raises(VisionError, match=named):
        _visp_tracker.TagDetector().detect(image)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: _visp_tracker.TagDetector("99h9"), "99h9.*36h11"),
        (lambda: _visp_tracker.TagDetector(quad_decimate=0.5), "quad_decimate"),
        (lambda: _visp_tracker.TagDetector(threads=0), "threads"),
    ],
)
def test_unusable_arguments_are_named(call, named):
    with pytest.raises(_visp_tracker.InvalidInputError, match=named) as caught:
        call()
    assert isinstance(caught.value, VisionError)


def test_an_image_is_read_where_it_is_and_left_as_it_was():
    image = images.render_marker(3, images.marker_pose(0.8))
    buffer = image.tobytes()
    # What numpy.frombuffer makes of a message's bytes is read-only; a writable copy would be needed otherwise.
    view = np.frombuffer(buffer, np.uint8).reshape(image.shape)
    ids, _ = _visp_tracker.TagDetector(quad_decimate=2.0).detect(view)
    assert ids.tolist() == [3]
    assert buffer == image.tobytes()


def test_python_goes_on_while_a_detection_runs():
    image = np.random.default_rng(0).integers(0, 255, (900, 1200), dtype=np.uint8)
    done = threading.Event()
    detector = _visp_tracker.TagDetector()

    def detect() -> None:
        detector.detect(image)
        done.set()

    thread = threading.Thread(target=detect)
    thread.start()
    turns = 0
    while not done.is_set():
        turns += 1
    thread.join()
    # With the interpreter locked this loop would turn over only before and after the detection.
    assert turns > 1000


def test_one_detector_serves_several_threads():
    detector = _visp_tracker.TagDetector(quad_decimate=2.0)
    pictures = [images.render_marker(i, images.marker_pose(1.0), seed=i) for i in range(4)]
    found: dict[int, list[int]] = {}

    def work(i: int) -> None:
        for _ in range(5):
            found.setdefault(i, []).extend(detector.detect(pictures[i])[0].tolist())

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {i: [i] * 5 for i in range(4)}
