"""Benchmark of the eye: markers in photographs, poses of drawn ones, turns through square-on, and cost beside peers.

The drawn pictures are those of a real sensor (``tag_images``), and their poses are known. Peers are looked for by name:
python3-apriltag (Debian) and pupil-apriltags (PyPI) detect with the settings of our detector, on the same images in
turn. Times are processor time of the thread that works (nothing here uses another): what else the machine does matters
less.
"""

from __future__ import annotations

import importlib
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray
from hitchhike_ros.core.geometry import pose_from_matrix, wrap_angle
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.bench.tag_images import LIGHTS, Conditions, marker_pose, tag_image
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.servoing.lens import GrayImage
from hitchhike_ros.servoing.marker_detector import (
    T_TAG_MARKER,
    MarkerDetection,
    MarkerDetector,
    MarkerDetectorParameters,
    TagDetector,
    planar_observation,
)
from hitchhike_ros.servoing.marker_tracker import MarkerTracker, ModelTracker
from hitchhike_ros.servoing.square_pose import project_corners

_T = TypeVar("_T")

CAMERA = CameraInfo(640, 480, np.array([[554.26, 0.0, 319.5], [0.0, 554.26, 239.5], [0.0, 0.0, 1.0]]))
# Level, 0.3 m up and 0.1 m ahead of the base.
T_BASE_CAMERA = np.array([[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]])
SIZE_M = 0.16
VISP_DATA = Path("/usr/share/visp-images-data/ViSP-images/AprilTag")
DISTANCES_M = (0.4, 0.8, 1.5, 2.2, 3.0)
YAWS_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)
PITCHES_DEG = (-15.0, 0.0, 15.0)
# Markers that lean by as much are not upright within the default.
_LEAN_SIGMA_RAD = 0.2
# Beyond this the yaw's own bound holds.
_ASKEW_DEG = 15.0
# The yaw has flipped when it lies on the other side of square-on and is wrong by more than this.
_FLIP_DEG = 10.0
RATE_HZ = 10.0


@dataclass(frozen=True)
class Row:
    """One view of the grid: what was shown, and how far off what was seen is; NaN where nothing was.
    ``fast`` says that it took no thorough search."""

    distance: float
    yaw_deg: float
    light: str
    fast: bool
    range_error: float = math.nan
    yaw_error_deg: float = math.nan
    nees: float = math.nan


def run(options: Options, progress: Progress) -> Findings:
    """All figures of the benchmark; a sheet of annotated pictures is ``tracking.png`` in the output folder."""
    figures = _photographs(options)
    figures += _grid(options, progress)
    figures += _sequences(options, progress)
    figures += _cost(options, progress)
    return Findings(figures)


# Photographs.


def _photographs(options: Options) -> list[Figure]:
    """Tags found, of those that ViSP's own detector finds in full resolution, and their corners beside the data's."""
    figures = []
    detector = MarkerDetector(MarkerDetectorParameters(quad_decimate=1.0))
    for name, image, reference in _labelled(options.data):
        h, w = image.shape
        info = CameraInfo(w, h, np.array([[w, 0.0, (w - 1) / 2], [0.0, w, (h - 1) / 2], [0.0, 0.0, 1.0]]))
        found = detector.detect(image, info)
        ids, _ = TagDetector("36h11").detect(image)
        apart = [_apart(d.corners, reference) for d in found]
        figures += [
            Figure(f"{name}_tags_found", len(found), "count", len(ids), "higher", len(reference)),
            Figure(f"{name}_corner_apart_median", float(np.median(apart)), "px", 1.0),
            Figure(f"{name}_corner_apart_max", float(np.max(apart)), "px", 1.0),
        ]
    return figures


def _labelled(data: Path) -> Iterator[tuple[str, GrayImage, FloatArray]]:
    """Photographs with the corners (N, 4, 2) px (column, row) that came with them, in whatever order."""
    photograph, truth = VISP_DATA / "AprilTag.pgm", VISP_DATA / "ground_truth_detection.txt"
    if photograph.is_file():
        lines = [line.split() for line in truth.read_text().splitlines()]
        # Row first, and AprilTag's half pixel.
        yield "visp_image", _read(photograph), _quads([w for w in lines if len(w) == 2])[..., ::-1] - 0.5
    else:
        print(f"left out: no {photograph} (Debian package visp-images-data)", file=sys.stderr)
    photographs = sorted((data / "apriltag").glob("*.jpg"))
    if not photographs:
        print(f"left out: no photographs in {data / 'apriltag'}", file=sys.stderr)
    for path in photographs:
        rows = [re.findall(r"[-\d.]+", line)[1:] for line in path.with_suffix(".txt").read_text().splitlines()]
        yield path.stem.split("_")[0], _read(path), _quads(rows) - 0.5


def _quads(words: Sequence[Sequence[str]]) -> FloatArray:
    return np.array([float(w) for row in words for w in row]).reshape(-1, 4, 2)


def _read(path: Path) -> GrayImage:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def _apart(corners: FloatArray, reference: FloatArray) -> float:
    """Median distance of four corners from those of the tag in the reference whose middle is nearest, px."""
    middles = reference.mean(axis=1)
    quad = reference[np.linalg.norm(middles - corners.mean(axis=0), axis=1).argmin()]
    return float(np.median(np.linalg.norm(corners[:, None] - quad[None], axis=2).min(axis=1)))


# Poses.


def _grid(options: Options, progress: Progress) -> list[Figure]:
    """Every pose alone, with blur and noise at random, in three lights."""
    rng = np.random.default_rng(options.seed)
    distances = DISTANCES_M[::2] if options.quick else DISTANCES_M
    views = [
        (distance, sign * yaw, pitch, light)
        for distance in distances
        for yaw in YAWS_DEG
        for sign in ((1.0, -1.0) if yaw else (1.0,))
        for pitch in PITCHES_DEG
        for light in LIGHTS
    ]
    rows, sheet = [], []
    for k, (distance, yaw_deg, pitch_deg, light) in enumerate(views):
        x, y = distance * rng.uniform(-0.3, 0.3), distance * rng.uniform(-0.15, 0.15)
        T = marker_pose(distance, math.radians(yaw_deg), math.radians(pitch_deg), x, y)
        image = tag_image(T, CAMERA, rng, _conditions(rng, light), marker_id=k % 30)
        # A detector of its own for each: no view helps another.
        detector = MarkerDetector(MarkerDetectorParameters(upright_sigma_rad=_LEAN_SIGMA_RAD))
        detected = [d for d in detector.detect(image, CAMERA) if d.id == k % 30]
        fast = bool(detected)
        if not fast:  # as the tracker does after some images
            detected = [d for d in detector.detect(image, CAMERA, thorough=True) if d.id == k % 30]
        found = detector.resolve(detected, T_BASE_CAMERA, 0.0)
        rows.append(_row(found, T, distance, yaw_deg, light, fast))
        if k % (len(views) // 12) == 0:
            sheet.append(_annotated(image, found))
        progress("drawn poses", k + 1, len(views))
    _write_sheet(options.output / "tracking.png", sheet)
    return _grid_figures(rows)


def _conditions(rng: np.random.Generator, light: str) -> Conditions:
    motion = tuple(rng.uniform(-1.0, 1.0, 2).tolist())
    return Conditions(LIGHTS[light], rng.uniform(0.4, 1.0), motion, rng.uniform(1.0, 4.0))


def _row(
    found: Sequence[MarkerDetection], T: FloatArray, distance: float, yaw_deg: float, light: str, fast: bool
) -> Row:
    if not found:
        return Row(distance, yaw_deg, light, fast)
    error = _error(found[0].T_camera_marker, T)
    seen = float(np.linalg.norm(found[0].T_camera_marker[:3, 3])) / float(np.linalg.norm(T[:3, 3]))
    yaw = wrap_angle(_yaw(found[0].T_camera_marker) - _yaw(T))
    nees = float(error @ np.linalg.solve(found[0].covariance, error))
    return Row(distance, yaw_deg, light, fast, abs(seen - 1.0), abs(math.degrees(yaw)), nees)


def _error(T: FloatArray, truth: FloatArray) -> FloatArray:
    """Translation and rotation vector (6,), both along the camera's axes."""
    turn, _ = cv2.Rodrigues(T[:3, :3] @ truth[:3, :3].T)
    return np.concatenate([T[:3, 3] - truth[:3, 3], turn.ravel()])


def _yaw(T_camera_marker: FloatArray) -> float:
    return pose_from_matrix(T_BASE_CAMERA @ T_camera_marker).theta


def _grid_figures(rows: Sequence[Row]) -> list[Figure]:
    seen = [row for row in rows if not math.isnan(row.nees)]
    askew = [row for row in seen if abs(row.yaw_deg) > _ASKEW_DEG - 1e-9]
    figures = [
        Figure("grid_views", len(rows), "count"),
        Figure("grid_range_error_median", 100.0 * _median(row.range_error for row in seen), "%", 1.0),
        Figure("grid_range_error_p95", 100.0 * _percentile((row.range_error for row in seen), 95), "%"),
        Figure("grid_yaw_error_median_beyond_15_deg", _median(row.yaw_error_deg for row in askew), "deg", 2.0),
        Figure("grid_yaw_error_median_within_15_deg", _median(r.yaw_error_deg for r in seen if r not in askew), "deg"),
    ]
    for distance in sorted({row.distance for row in rows}):
        there = [row for row in rows if row.distance == distance]
        found = [row for row in there if row in seen]
        figures += [
            Figure(f"grid_seen_at_{distance}_m", 100.0 * len(found) / len(there), "%"),
            Figure(f"grid_seen_in_one_image_at_{distance}_m", _share(row.fast for row in there), "%"),
            Figure(f"grid_range_error_median_at_{distance}_m", 100.0 * _median(r.range_error for r in found), "%", 1.0),
            Figure(f"grid_yaw_error_median_at_{distance}_m", _median(r.yaw_error_deg for r in found), "deg"),
        ]
    far = [row for row in rows if row.distance == max(DISTANCES_M) and abs(row.yaw_deg) <= 45.0]
    figures.append(
        Figure("grid_seen_at_3.0_m_within_45_deg", _share(not math.isnan(r.nees) for r in far), "%", 99.0, "higher")
    )
    return figures + _nees_figures("grid_nees", [row.nees for row in seen])


def _nees_figures(name: str, nees: Sequence[float]) -> list[Figure]:
    """Mean of n chi-square variables of 6 degrees of freedom, against its 95 % band."""
    half_width = 1.96 * math.sqrt(12.0 / max(len(nees), 1))
    mean = float(np.mean(nees))
    return [
        Figure(f"{name}_mean", mean, "", 6.0 + half_width),
        Figure(f"{name}_mean_from_below", mean, "", 6.0 - half_width, "higher"),
        Figure(f"{name}_median", _median(nees), ""),
        Figure(f"{name}_beyond_99_percent", _share(value > 16.81 for value in nees), "%"),
    ]


def _median(values: Iterator[float] | Sequence[float]) -> float:
    return _percentile(values, 50)


def _percentile(values: Iterator[float] | Sequence[float], q: float) -> float:
    return float(np.percentile(list(values), q))


def _share(hits: Iterator[bool]) -> float:
    found = list(hits)
    return 100.0 * sum(found) / max(len(found), 1)


# Sequences.


def _sequences(options: Options, progress: Progress) -> list[Figure]:
    """A driver ahead that turns from one side through square-on to the other, or back, and comes and goes: the tracker
    as the node uses it. A flip is a yaw on the wrong side of square-on."""
    rng = np.random.default_rng(options.seed + 1)
    n, frames = (4, 40) if options.quick else (20, 60)
    flips = lost = carried = 0
    nees: list[float] = []
    yaw_errors: list[float] = []
    range_errors: list[float] = []
    shown = 0
    for k in range(n):
        tracker = MarkerTracker()
        light = list(LIGHTS)[k % 3]
        conditions = _conditions(rng, light)
        flipped = False
        for i, T in enumerate(_drive(rng, frames)):
            image = tag_image(T, CAMERA, rng, conditions, marker_id=k)
            seen = tracker.see(image, CAMERA, T_BASE_CAMERA, i / RATE_HZ, target=k)
            shown += 1
            if not seen:
                lost += 1
                continue
            carried += tracker.tracking
            own = seen[0].T_camera_marker
            error = wrap_angle(_yaw(own) - _yaw(T))
            flipped |= abs(error) > math.radians(_FLIP_DEG) and _side(own) != _side(T)
            covariance = planar_observation(seen[0], T_BASE_CAMERA, 0.0).covariance
            a, b = pose_from_matrix(T_BASE_CAMERA @ own), pose_from_matrix(T_BASE_CAMERA @ T)
            planar = np.array([a.x - b.x, a.y - b.y, wrap_angle(a.theta - b.theta)])
            nees.append(float(planar @ np.linalg.solve(covariance, planar)))
            yaw_errors.append(abs(math.degrees(error)))
            range_errors.append(abs(float(np.linalg.norm(own[:3, 3]) / np.linalg.norm(T[:3, 3])) - 1.0))
            progress("frames of sequences", k * frames + i + 1, n * frames)
        flips += flipped
    return [
        Figure("sequences", n, "count"),
        Figure("sequences_with_a_flip", flips, "count", 0),
        Figure("sequence_frames_lost", 100.0 * lost / shown, "%"),
        Figure("sequence_frames_carried", 100.0 * carried / shown, "%"),
        Figure("sequence_range_error_median", 100.0 * _median(range_errors), "%", 1.0),
        Figure("sequence_yaw_error_median", _median(yaw_errors), "deg", 2.0),
        Figure("sequence_yaw_error_p95", _percentile(yaw_errors, 95), "deg"),
        # Frames of one sequence err alike, so this has no band of its own; 3 is expected.
        Figure("sequence_planar_nees_mean", float(np.mean(nees)), ""),
    ]


def _drive(rng: np.random.Generator, frames: int) -> Iterator[FloatArray]:
    """Poses of a marker that turns through square-on while it is between 0.6 and 3 m away."""
    start, end = rng.uniform(0.6, 3.0, 2)
    side, reach = rng.choice([-1.0, 1.0]), rng.uniform(0.4, 0.9)
    wiggle, phase = rng.uniform(0.0, 0.15), rng.uniform(0.0, 2.0 * math.pi)
    pitch = rng.normal(0.0, 0.03)
    for i in range(frames):
        f = i / (frames - 1)
        distance = start + f * (end - start)
        yaw = side * reach * math.cos(math.pi * f)  # from one side to the other
        x = distance * wiggle * math.sin(phase + 4.0 * f)
        yield marker_pose(distance, yaw, pitch, x, 0.05 * distance)


def _side(T_camera_marker: FloatArray) -> bool:
    """On which side of its line of sight the marker's normal lies."""
    sight, normal = T_camera_marker[[0, 2], 3], T_camera_marker[[0, 2], 0]
    return bool(sight[0] * normal[1] - sight[1] * normal[0] > 0.0)


# Cost.


def _cost(options: Options, progress: Progress) -> list[Figure]:
    """Median time of a frame, ours and the peers' detection and our tracking in turn on the images of a drive."""
    rng = np.random.default_rng(options.seed + 2)
    n, frames = (2, 40) if options.quick else (5, 60)
    peers = {name: make() for name, make in _PEERS.items()}
    detector, tracker = MarkerDetector(), MarkerTracker()
    models = {
        "edges": ModelTracker(keypoints=False),
        "keypoints": ModelTracker(edges=False),
        "edges_and_keypoints": ModelTracker(),
    }
    times: dict[str, list[float]] = {}
    corner_errors: dict[str, list[float]] = {}

    def timed(name: str, call: Callable[..., _T], *arguments: Any, **options: Any) -> _T:
        began = time.thread_time()
        result = call(*arguments, **options)
        times.setdefault(name, []).append(time.thread_time() - began)
        return result

    intrinsics = (CAMERA.K[0, 0], CAMERA.K[1, 1], CAMERA.K[0, 2], CAMERA.K[1, 2])
    for k in range(n):
        conditions = _conditions(rng, list(LIGHTS)[k % 3])
        for i, T in enumerate(_drive(rng, frames)):
            image = _furnished(tag_image(T, CAMERA, rng, conditions, marker_id=k))
            truth = _pixels(T)
            found = timed("detection", detector.detect, image, CAMERA)
            _keep(corner_errors, "detection", [d.corners for d in found if d.id == k], truth)
            for name, peer in peers.items():
                if peer is not None:
                    corners = timed(name, peer, image, k)
                    _keep(corner_errors, name, corners, truth)
            stamp = 100.0 * k + i / RATE_HZ
            seen = timed("frame", tracker.see, image, CAMERA, T_BASE_CAMERA, stamp, target=k)
            if tracker.tracking:
                times.setdefault("tracking", []).append(times["frame"][-1])
            _keep(corner_errors, "tracking", [d.corners for d in seen], truth)
            for name, model in models.items():
                # What ViSP's tracker gives by itself, started from the true pose of the image before.
                if i:
                    tracked = timed(name, model.track, image)
                    own = [] if tracked is None else [_pixels(tracked[0] @ T_TAG_MARKER)]
                    _keep(corner_errors, f"model_{name}", own, truth)
                model.start(image, intrinsics, T @ np.linalg.inv(T_TAG_MARKER), SIZE_M)
            progress("frames timed", k * frames + i + 1, n * frames)
    median = {name: 1e3 * float(np.median(values)) for name, values in times.items()}
    figures = [
        Figure("detection_time_median", median["detection"], "ms", 12.0),
        Figure("tracking_time_median", median["tracking"], "ms", 6.0),
        Figure("tracking_time_p95", 1e3 * _percentile(times["tracking"], 95), "ms"),
        Figure("frame_time_median", median["frame"], "ms"),
    ]
    figures += [Figure(f"{name}_time_median", median.get(name), "ms") for name in peers]
    figures += [Figure(f"visp_{name}_time_median", median[name], "ms") for name in models]
    for name, errors in corner_errors.items():
        figures += [
            Figure(f"{name}_corner_error_rms", float(np.sqrt(np.mean(np.square(errors)))), "px"),
            Figure(f"{name}_corner_error_median", _median(errors), "px"),
        ]
    return figures


def _pixels(T: FloatArray) -> FloatArray:
    return project_corners(T, SIZE_M) * np.array([CAMERA.K[0, 0], CAMERA.K[1, 1]]) + CAMERA.K[:2, 2]


def _keep(errors: dict[str, list[float]], name: str, corners: Sequence[FloatArray], truth: FloatArray) -> None:
    """Distances (px) of the corners of the first marker; corners may begin anywhere and go either way."""
    if len(corners):
        apart = np.linalg.norm(np.asarray(corners[0])[:, None] - truth[None], axis=2).min(axis=1)
        errors.setdefault(name, []).extend(apart.tolist())


def _furnished(image: GrayImage) -> GrayImage:
    """With edges outside of the middle, as a room has them: a detector looks at all of them."""
    for column in range(20, image.shape[1], 80):
        cv2.rectangle(image, (column, 4), (column + 40, 24), 60, 2)
        cv2.rectangle(image, (column, 456), (column + 40, 474), 30, -1)
    return image


def _debian() -> Callable[[GrayImage, int], list[FloatArray]] | None:
    module = _peer("apriltag", "python3-apriltag of Debian")
    if module is None:
        return None
    detector = module.apriltag("tag36h11", threads=1, decimate=2.0)

    def detect(image: GrayImage, marker_id: int) -> list[FloatArray]:
        found = detector.detect(image)
        return [d["lb-rb-rt-lt"] - 0.5 for d in found if d["id"] == marker_id]

    return detect


def _pupil() -> Callable[[GrayImage, int], list[FloatArray]] | None:
    module = _peer("pupil_apriltags", "pupil-apriltags of PyPI")
    if module is None:
        return None
    detector = module.Detector("tag36h11", nthreads=1, quad_decimate=2.0)

    def detect(image: GrayImage, marker_id: int) -> list[FloatArray]:
        return [d.corners - 0.5 for d in detector.detect(image) if d.tag_id == marker_id]

    return detect


_PEERS = {"python3_apriltag": _debian, "pupil_apriltags": _pupil}


def _peer(name: str, package: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"left out: {package} is not installed", file=sys.stderr)
        return None


# Pictures.


def _annotated(image: GrayImage, found: Sequence[MarkerDetection]) -> npt.NDArray[np.uint8]:
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for detection in found:
        cv2.polylines(picture, [np.rint(detection.corners).astype(np.int32)], True, (0, 255, 0), 1, cv2.LINE_AA)
        axes = _pixels_of_axes(detection.T_camera_marker)
        for tip, colour in zip(axes[1:], ((0, 0, 255), (0, 255, 0), (255, 0, 0)), strict=True):
            cv2.line(picture, axes[0].tolist(), tip.tolist(), colour, 2, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def _pixels_of_axes(T: FloatArray) -> npt.NDArray[np.int32]:
    points = (T @ np.vstack([np.c_[np.zeros(3), 0.08 * np.eye(3)], np.ones(4)]))[:3]
    uv = CAMERA.K @ points
    return np.rint((uv[:2] / uv[2]).T).astype(np.int32)


def _write_sheet(path: Path, pictures: Sequence[npt.NDArray[np.uint8]]) -> None:
    """Twelve pictures, four in a row."""
    rows = [np.hstack(pictures[i : i + 4]) for i in range(0, len(pictures) - 3, 4)]
    cv2.imwrite(str(path), cv2.resize(np.vstack(rows), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
