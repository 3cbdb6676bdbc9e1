"""Markers in a camera image: AprilTags found by ViSP, as poses with covariances.

Frames: the marker's x axis is its outward normal, z points up on the plate (so y points to the right of who looks at
it). The camera's is the optical frame (z forward, x right, y down), pixels are counted from the centre of the top
left one, as in ROS and OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros import _visp_tracker
from hitchhike_ros.datatypes import CameraInfo, FloatArray, MarkerObservation, Positive, UnitInterval
from hitchhike_ros.errors import VisionError
from hitchhike_ros.geometry import pose_from_matrix, wrap_angle
from hitchhike_ros.servoing.square_pose import PoseSolution, SquareView, corner_jacobian, square_on_poses

# AprilTag puts the centre of the top left pixel at (0.5, 0.5); measured on rendered tags to within 0.03 px.
PIXEL_CENTRE = 0.5
# ViSP's tag frame is x right, y up, z towards the viewer.
T_TAG_MARKER = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class MarkerDetectorParameters:
    """Section ``marker_detector``."""

    family: str = "36h11"
    marker_size_m: Positive = 0.16
    """Outer edge of the black square of markers whose size nobody tells."""
    quad_decimate: Annotated[float, msgspec.Meta(ge=1)] = 2.0
    """Quads are sought in an image this much smaller; corners are refined in the full one."""
    threads: Annotated[int, msgspec.Meta(ge=1)] = 1
    refine_edges: bool = True
    decode_sharpening: UnitInterval = 0.25
    corner_sigma_px: Positive = 0.5
    """Noise of a corner's coordinate: 0.4 on rendered images, whose edges keep to whole pixels (chosen)."""
    upright_sigma_rad: Positive = 0.05
    """How well plates are mounted upright: decides between the two poses of a square, and says of one that is seen
    square-on that what makes it narrow is its yaw (chosen)."""
    yaw_step_sigma_rad: Positive = 0.15
    """How much a marker's yaw changes from one image to the next; decides likewise (chosen)."""
    memory_s: Positive = 0.5
    """How long the previous yaw counts (chosen)."""


@dataclass(frozen=True, eq=False)
class MarkerDetection:
    """A marker in one image.

    ``corners`` is (4, 2) px: lower left, lower right, upper right, upper left of the plate; ``view`` is what they say
    without the lens. ``solutions`` holds one or two poses, the likeliest first; ``weight`` in [0.5, 1] is the
    probability of the first.
    """

    id: int
    corners: FloatArray
    view: SquareView
    solutions: tuple[PoseSolution, ...]
    weight: float

    @property
    def T_camera_marker(self) -> FloatArray:
        """The likeliest pose, (4, 4)."""
        return self.solutions[0].T_camera_marker


class MarkerDetector:
    """Finds markers and resolves the square-on ambiguity over successive images.

    Raises:
        VisionError: the tag family is unknown or a parameter is out of ViSP's range.
    """

    def __init__(self, params: MarkerDetectorParameters | None = None) -> None:
        self.params = params or MarkerDetectorParameters()
        self._detector = _visp_tracker.TagDetector(
            self.params.family,
            quad_decimate=self.params.quad_decimate,
            threads=self.params.threads,
            refine_edges=self.params.refine_edges,
            decode_sharpening=self.params.decode_sharpening,
        )
        self._previous: dict[int, tuple[float, float]] = {}

    def detect(
        self, gray: npt.NDArray[np.uint8], camera_info: CameraInfo, sizes_m: Mapping[int, float] | None = None
    ) -> list[MarkerDetection]:
        """The markers in one grey image.

        Args:
            gray: (H, W) uint8, C-contiguous; it is read in place.
            camera_info: calibration of that image. Lens distortion is taken out of the corners, by OpenCV: ViSP's own
                camera model has one radial coefficient, plumb_bob five.
            sizes_m: side of the black square by marker id, where it is not ``marker_size_m``.

        Raises:
            VisionError: image, calibration or a marker's size cannot be used; it says which, and why.
        """
        if not isinstance(gray, np.ndarray):
            raise VisionError(f"image is a {type(gray).__name__}, expected a NumPy array (H, W) of uint8")
        _check_camera_info(camera_info, gray)
        sizes = sizes_m or {}
        for marker_id, size in sizes.items():
            if not (math.isfinite(size) and size > 0):
                raise VisionError(f"size of marker {marker_id} is {size} m, expected more than 0")
        ids, all_corners = self._detector.detect(gray)
        detections = []
        for marker_id, corners in zip(ids.tolist(), all_corners - PIXEL_CENTRE, strict=True):
            view = self._view(corners, camera_info, sizes.get(marker_id, self.params.marker_size_m))
            solutions = solve(view)
            if solutions:
                detection = MarkerDetection(marker_id, corners, view, solutions, 1.0)
                detections.append(_weighted(detection, [s.chi2 for s in solutions]))
        return detections

    def resolve(
        self, detections: Iterable[MarkerDetection], T_base_camera: FloatArray, stamp: float
    ) -> list[MarkerDetection]:
        """The detections with their likeliest pose first.

        Likelier is the pose that fits the corners better, whose marker stands upright in ``base_footprint``
        (``T_base_camera`` is (4, 4), camera in the optical frame) and whose yaw is near the one in the image before.
        Nearly square-on, mean and covariance of the posterior replace the least-squares pose.
        """
        resolved = []
        for detection in detections:
            then, yaw = self._previous.get(detection.id, (-math.inf, 0.0))
            yaw_before = yaw if 0.0 <= stamp - then <= self.params.memory_s else None
            best = self._likeliest_first(detection, T_base_camera, yaw_before)
            square_on = square_on_poses(best.view, best.T_camera_marker, T_base_camera, self.params.upright_sigma_rad)
            if square_on:
                best = self._likeliest_first(replace(best, solutions=square_on), T_base_camera, yaw_before)
            self._previous[best.id] = (stamp, pose_from_matrix(T_base_camera @ best.T_camera_marker).theta)
            resolved.append(best)
        return resolved

    def observe(
        self, detections: Iterable[MarkerDetection], T_base_camera: FloatArray, stamp: float
    ) -> list[MarkerObservation]:
        """The detections, resolved, as planar poses in ``base_footprint`` with covariances."""
        return [planar_observation(d, T_base_camera, stamp) for d in self.resolve(detections, T_base_camera, stamp)]

    def _likeliest_first(
        self, detection: MarkerDetection, T_base_camera: FloatArray, yaw_before: float | None
    ) -> MarkerDetection:
        p = self.params
        costs = []
        for solution in detection.solutions:
            T_base_marker = T_base_camera @ solution.T_camera_marker
            # Upright is also who hangs upside down.
            tilt = math.acos(min(1.0, abs(float(T_base_marker[2, 2]))))
            step = wrap_angle(pose_from_matrix(T_base_marker).theta - yaw_before) if yaw_before is not None else 0.0
            costs.append(solution.chi2 + (tilt / p.upright_sigma_rad) ** 2 + (step / p.yaw_step_sigma_rad) ** 2)
        return _weighted(detection, costs)

    def _view(self, corners: FloatArray, camera_info: CameraInfo, size_m: float) -> SquareView:
        K = camera_info.K
        points = np.asarray(cv2.undistortPoints(corners[:, None, :], K, camera_info.D)[:, 0, :], dtype=float)
        return SquareView(points, self.params.corner_sigma_px / math.sqrt(K[0, 0] * K[1, 1]), size_m)


def planar_jacobian(T_base_camera: FloatArray, T_camera_marker: FloatArray) -> FloatArray:
    """d(x, y, theta of T_base_marker)/d(pose), (3, 6), for the perturbation of :func:`corner_jacobian`."""
    R = T_base_camera[:3, :3]
    nx, ny, nz = R @ T_camera_marker[:3, 0]
    J = np.zeros((3, 6))
    J[:2, :3] = R[:2]
    along = nz / (nx**2 + ny**2)
    J[2, 3:] = np.array([-along * nx, -along * ny, 1.0]) @ R
    return J


def planar_observation(detection: MarkerDetection, T_base_camera: FloatArray, stamp: float) -> MarkerObservation:
    """A detection as a planar pose in ``base_footprint``.

    The covariance is that of the likeliest pose, from the corners' noise, and, as far as the other pose of the square
    may be the true one, the distance to that.
    """
    poses, covariances = [], []
    for solution in detection.solutions:
        J = planar_jacobian(T_base_camera, solution.T_camera_marker)
        poses.append(pose_from_matrix(T_base_camera @ solution.T_camera_marker))
        covariances.append(J @ solution.covariance @ J.T)
    covariance = covariances[0]
    if len(poses) == 2:
        apart = np.array(
            [poses[1].x - poses[0].x, poses[1].y - poses[0].y, wrap_angle(poses[1].theta - poses[0].theta)]
        )
        w = detection.weight
        covariance = w * covariance + (1 - w) * (covariances[1] + np.outer(apart, apart))
    return MarkerObservation(stamp, detection.id, poses[0], covariance)


def solve(view: SquareView) -> tuple[PoseSolution, ...]:
    """The least-squares poses, the better one first."""
    solutions = []
    for T_camera_tag, residual in _visp_tracker.square_poses(view.points, view.size_m):
        T = T_camera_tag @ T_TAG_MARKER
        J = corner_jacobian(T, view.size_m)
        information = J.T @ J / view.sigma**2
        if np.linalg.cond(information) < 1e12:
            solutions.append(PoseSolution(T, np.linalg.inv(information), 4 * (residual / view.sigma) ** 2))
    return tuple(solutions)


def _weighted(detection: MarkerDetection, costs: list[float]) -> MarkerDetection:
    """A detection whose solutions are sorted by their cost, -2 log likelihood."""
    order = sorted(range(len(costs)), key=costs.__getitem__)
    odds = math.exp(0.5 * (costs[order[0]] - costs[order[-1]])) if len(order) == 2 else 0.0
    return replace(detection, solutions=tuple(detection.solutions[i] for i in order), weight=1.0 / (1.0 + odds))


def _check_camera_info(info: CameraInfo, image: npt.NDArray[np.uint8]) -> None:
    if info.K.shape != (3, 3) or not np.isfinite(info.K).all():
        raise VisionError(f"K of camera_info is {info.K.tolist()}, expected a finite 3 x 3 matrix")
    if not (info.K[0, 0] > 0 and info.K[1, 1] > 0):
        raise VisionError(f"K of camera_info has focal lengths {info.K[0, 0]}, {info.K[1, 1]}, expected more than 0")
    if not np.isfinite(info.D).all() or info.D.size not in (0, 4, 5, 8, 12, 14):
        raise VisionError(f"D of camera_info is {info.D.tolist()}, expected 5 finite numbers (plumb_bob)")
    if image.shape[:2] != (info.height, info.width):
        raise VisionError(f"image is of shape {image.shape}, camera_info is for {info.width} x {info.height} pixels")
