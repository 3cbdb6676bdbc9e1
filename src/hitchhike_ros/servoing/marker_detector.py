"""Markers in a camera image: AprilTags found by ViSP and QR codes by OpenCV, as poses with covariances.

A detector finds the corners to a tenth of a pixel. Lines fitted to the marker's sides give them twice as exactly, and
the scatter about these lines gives their covariance.

Frames: the marker's x axis is its outward normal, z points up on its plane (so y points to the right of who looks at
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
from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, MarkerObservation, Positive, UnitInterval
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.core.geometry import pose_from_matrix, wrap_angle
from hitchhike_ros.servoing import qr_codes
from hitchhike_ros.servoing.lens import GrayImage, Lens
from hitchhike_ros.servoing.square_pose import PoseSolution, SquareView, solve, square_on_poses

# ViSP's own default, for comparisons.
TagDetector = _visp_tracker.TagDetector
# AprilTag puts the centre of the top left pixel at (0.5, 0.5); measured on rendered tags to within 0.03 px.
PIXEL_CENTRE = 0.5
# ViSP's tag frame is x right, y up, z towards the viewer.
T_TAG_MARKER = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
# Cells along a side of those families whose sides are straight edges from black (inside) to white.
_CELLS = {"36h11": 8, "25h9": 7, "16h5": 6}
# Where there are no cells to tell apart, a marker's likeness to itself is sampled on as many places (chosen).
_PLACES = 21
# Before tags are sought in a smaller image (chosen: finds as many at 3 m as none, in half the time).
_SMOOTHING_PX = 0.8
# The sides' lines are sought within this of where they are expected, px (chosen); and with what lies within this share
# of a cell, and these px, they are measured.
_SEEK_PX, _MEASURE_CELLS, _MEASURE_PX = 6.0, 0.35, (0.75, 2.0)
# What the scatter does not tell of a corner's error in px: rounding, and the pattern inside, whose blur reaches the
# side where cells are small (px⁴). Measured on rendered tags.
_FLOOR_PX, _BLURRED_PX = 0.0037, 0.8
# Leans no farther apart than this, in standard deviations of a marker's lean, lead to one pose (chosen).
_ONE_LEAN = 2.0
# Cosine between normals that are one, as of optima that were reached from two sides: 1° (chosen).
_ONE_NORMAL = 0.99985
# -2 log likelihood of a marker that is not upright: one in some hundred is mounted otherwise (chosen).
_NOT_UPRIGHT = 12.0


@dataclass(frozen=True)
class MarkerDetectorParameters:
    """Section ``marker_detector``."""

    family: str = "36h11"
    """One of 36h11, 25h9, 16h5, circle21h7; or qr."""
    marker_size_m: Positive = 0.16
    """Outer edge of the black square (QR: of the code) of markers whose size nobody tells."""
    size_sigma: UnitInterval = 0.001
    """How well that size is known, as a share of it: a print is checked with a ruler (chosen)."""
    quad_decimate: Annotated[float, msgspec.Meta(ge=1)] = 2.0
    """Quads are sought in an image this much smaller; corners are refined in the full one."""
    threads: Annotated[int, msgspec.Meta(ge=1)] = 1
    refine_edges: bool = True
    decode_sharpening: UnitInterval = 0.25
    corner_sigma_px: Positive = 0.5
    """Noise of a corner's coordinate where no lines can be fitted to the sides: QR codes, circle21h7 (chosen)."""
    upright_sigma_rad: Positive = 0.05
    """How well markers are mounted upright: decides between the two poses of a square, and says of one that is seen
    square-on that what makes it narrow is its yaw (chosen)."""
    yaw_step_sigma_rad: Positive = 0.15
    """How much a marker's yaw changes from one image to the next; decides likewise (chosen)."""
    memory_s: Positive = 0.5
    """How long the previous yaw counts (chosen)."""


@dataclass(frozen=True)
class Code:
    """What a marker says: its number, and the message as visp_auto_tracker words it."""

    id: int
    message: str


@dataclass(frozen=True, eq=False)
class MarkerDetection:
    """A marker in one image.

    ``corners`` is (4, 2) px: lower left, lower right, upper right, upper left of the marker; ``view`` is what they say
    without the lens. ``solutions`` holds one or two poses, the likeliest first; ``weight`` in [0.5, 1] is the
    probability of the first.
    """

    code: Code
    corners: FloatArray
    view: SquareView
    solutions: tuple[PoseSolution, ...]
    weight: float

    @property
    def id(self) -> int:
        """The marker's number."""
        return self.code.id

    @property
    def T_camera_marker(self) -> FloatArray:
        """The likeliest pose, (4, 4)."""
        return self.solutions[0].T_camera_marker

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of that pose, as in :class:`PoseSolution`; it includes the distance to the other pose."""
        first, *others = self.solutions
        covariance = self.weight * first.covariance
        for other in others:
            R = other.T_camera_marker[:3, :3] @ first.T_camera_marker[:3, :3].T
            shift = other.T_camera_marker[:3, 3] - first.T_camera_marker[:3, 3]
            apart = np.concatenate([shift, cv2.Rodrigues(R)[0].ravel()])
            covariance = covariance + (1.0 - self.weight) * (other.covariance + np.outer(apart, apart))
        return covariance


class MarkerDetector:
    """Finds markers and resolves the square-on ambiguity over successive images.

    Raises:
        VisionError: the tag family is unknown or a parameter is out of ViSP's range.
    """

    def __init__(self, params: MarkerDetectorParameters | None = None) -> None:
        self.params = params or MarkerDetectorParameters()
        p = self.params
        self._qr = qr_codes.QrDetector() if p.family == qr_codes.FAMILY else None
        # The second one, for a thorough search, looks at every pixel.
        self._tags = tuple(
            TagDetector(
                p.family,
                quad_decimate=decimate,
                threads=p.threads,
                refine_edges=p.refine_edges,
                decode_sharpening=p.decode_sharpening,
            )
            for decimate in ((p.quad_decimate, 1.0) if self._qr is None else ())
        )
        self.has_sides = p.family in _CELLS
        self.cells = _CELLS.get(p.family, _PLACES)
        self._lens: Lens | None = None
        self._previous: dict[int, tuple[float, float]] = {}

    def detect(
        self,
        gray: GrayImage,
        camera_info: CameraInfo,
        sizes_m: Mapping[int, float] | None = None,
        *,
        thorough: bool = False,
    ) -> list[MarkerDetection]:
        """The markers in one grey image.

        Args:
            gray: (H, W) uint8, C-contiguous; it is read in place.
            camera_info: calibration of that image. Lens distortion is taken out of the corners and of the pictures
                around them, by OpenCV: ViSP's own camera model has one radial coefficient, plumb_bob five.
            sizes_m: sides of markers that are not of the usual size, by id.
            thorough: seek small and slanted tags too, which takes four times as long.

        Raises:
            VisionError: the image is no grey picture of the calibrated size, the calibration is senseless or a size
                is not positive.
        """
        if not isinstance(gray, np.ndarray):
            raise VisionError(f"image is a {type(gray).__name__}, expected a NumPy array (H, W) of uint8")
        _check_camera_info(camera_info, gray)
        sizes = sizes_m or {}
        for marker_id, size in sizes.items():
            if not (math.isfinite(size) and size > 0):
                raise VisionError(f"size of marker {marker_id} is {size} m, expected more than 0")
        lens = self.lens(camera_info)
        detections = []
        for code, corners in self._find(gray, thorough):
            straight = lens.points(corners)
            image = lens.straight(gray, straight)
            size = sizes.get(code.id, self.params.marker_size_m)
            detection = self.measure(code, image, lens, straight, size) or self._as_found(code, lens, straight, size)
            if detection is not None:
                detections.append(detection)
        return detections

    def lens(self, camera_info: CameraInfo) -> Lens:
        """The lens of a checked calibration."""
        if self._lens is None or not self._lens.is_of(camera_info):
            self._lens = Lens(camera_info)
        return self._lens

    def measure(
        self, code: Code, image: GrayImage, lens: Lens, corners: FloatArray, size_m: float
    ) -> MarkerDetection | None:
        """The marker whose corners (4, 2) are expected in the straight picture, by lines fitted to its sides.

        Families without straight sides keep the corners as expected. None where a side is not to be seen.
        """
        if not self.has_sides:
            return self._as_found(code, lens, corners, size_m)
        cell_px = _narrowest(corners) / self.cells
        measure_px = min(max(_MEASURE_CELLS * cell_px, _MEASURE_PX[0]), _MEASURE_PX[1])
        fitted = _visp_tracker.fit_square(image, corners, min(_SEEK_PX, 0.5 + 0.6 * cell_px), measure_px)
        if fitted is None or np.abs(fitted[0] - corners).max() > _SEEK_PX:
            return None
        found, covariance = fitted
        floor = _FLOOR_PX + _BLURRED_PX / cell_px**3
        return self._solved(code, lens, found, covariance + floor**2 * np.eye(8), size_m)

    def _find(self, gray: GrayImage, thorough: bool) -> list[tuple[Code, FloatArray]]:
        """Codes, and their corners (4, 2) px."""
        if self._qr is not None:
            return [(Code(qr_codes.code_id(message), message), corners) for message, corners in self._qr.detect(gray)]
        _visp_tracker.check_image(gray)
        if not thorough and self.params.quad_decimate > 1.0:
            # A coarser image is smoothed first: the noise of plain walls makes most of the search's work.
            gray = np.asarray(cv2.GaussianBlur(gray, (3, 3), _SMOOTHING_PX), dtype=np.uint8)
        ids, all_corners = self._tags[int(thorough)].detect(gray)
        family = self.params.family
        return [
            (Code(marker_id, f"{family} id: {marker_id}"), corners)
            for marker_id, corners in zip(ids.tolist(), all_corners - PIXEL_CENTRE, strict=True)
        ]

    def _as_found(self, code: Code, lens: Lens, corners: FloatArray, size_m: float) -> MarkerDetection | None:
        return self._solved(code, lens, corners, self.params.corner_sigma_px**2 * np.eye(8), size_m)

    def _solved(
        self, code: Code, lens: Lens, corners: FloatArray, covariance: FloatArray, size_m: float
    ) -> MarkerDetection | None:
        """From corners (4, 2) in the straight picture, px, and their covariance (8, 8)."""
        focal = lens.K.diagonal()[:2]
        points = (corners - lens.K[:2, 2]) / focal
        scale = np.concatenate([focal, focal, focal, focal])
        view = SquareView.with_covariance(points, covariance / (scale[:, None] * scale), size_m, self.params.size_sigma)
        solutions = solve(view)
        if not solutions:
            return None
        detection = MarkerDetection(code, lens.lensed(corners), view, solutions, 1.0)
        return _weighted(detection, [s.chi2 for s in solutions])

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
            modes = self._modes(best, T_base_camera)
            best = self._likeliest_first(replace(best, solutions=modes), T_base_camera, yaw_before)
            self._previous[best.id] = (stamp, pose_from_matrix(T_base_camera @ best.T_camera_marker).theta)
            resolved.append(best)
        return resolved

    def observe(
        self, detections: Iterable[MarkerDetection], T_base_camera: FloatArray, stamp: float
    ) -> list[MarkerObservation]:
        """The detections, resolved, as planar poses in ``base_footprint`` with covariances."""
        return [planar_observation(d, T_base_camera, stamp) for d in self.resolve(detections, T_base_camera, stamp)]

    def _modes(self, detection: MarkerDetection, T_base_camera: FloatArray) -> tuple[PoseSolution, ...]:
        """The likeliest pose and, where there is one, the other. Square-on, modes of the posterior replace them."""
        sigma = self.params.upright_sigma_rad
        first, *others = detection.solutions
        up = [T_base_camera[:3, :3] @ s.T_camera_marker[:3, 2] for s in detection.solutions]
        modes = list(square_on_poses(detection.view, first.T_camera_marker, T_base_camera, sigma)) or [first]
        # The two poses of a square differ in lean as well as in yaw; leans that are nearly one lead to the same modes.
        if others and np.linalg.norm(up[0] - up[1]) > _ONE_LEAN * sigma:
            start = others[0].T_camera_marker
            modes += square_on_poses(detection.view, start, T_base_camera, sigma) or others
        elif modes == [first]:
            modes += others
        return tuple(modes)

    def _likeliest_first(
        self, detection: MarkerDetection, T_base_camera: FloatArray, yaw_before: float | None
    ) -> MarkerDetection:
        p = self.params
        costs = []
        for solution in detection.solutions:
            T_base_marker = T_base_camera @ solution.T_camera_marker
            # A marker that hangs upside down counts as upright too.
            tilt = math.acos(min(1.0, abs(float(T_base_marker[2, 2]))))
            step = wrap_angle(pose_from_matrix(T_base_marker).theta - yaw_before) if yaw_before is not None else 0.0
            upright = min((tilt / p.upright_sigma_rad) ** 2, _NOT_UPRIGHT)
            costs.append(solution.chi2 + upright + (step / p.yaw_step_sigma_rad) ** 2)
        return _weighted(detection, costs)


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


def nearest(detections: Iterable[MarkerDetection]) -> MarkerDetection | None:
    """The one that is nearest to the camera."""
    return min(detections, key=lambda d: float(np.linalg.norm(d.T_camera_marker[:3, 3])), default=None)


def _narrowest(corners: FloatArray) -> float:
    """The shorter of a quadrilateral's two heights between opposite sides (middles), px."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
    area = abs((cx - ax) * (dy - by) - (cy - ay) * (dx - bx)) / 2.0
    # Lines between the middles of opposite sides.
    lengths = (math.hypot(ax + bx - cx - dx, ay + by - cy - dy), math.hypot(bx + cx - dx - ax, by + cy - dy - ay))
    return area / max(*(0.5 * length for length in lengths), 1.0)


def _weighted(detection: MarkerDetection, costs: list[float]) -> MarkerDetection:
    """The detection with the solution of least cost, -2 log likelihood, and with the next that is another pose."""
    order = sorted(range(len(costs)), key=costs.__getitem__)
    first, *others = (detection.solutions[i] for i in order)
    for other, cost in zip(others, (costs[i] for i in order[1:]), strict=True):
        if first.T_camera_marker[:3, 0] @ other.T_camera_marker[:3, 0] < _ONE_NORMAL:
            odds = math.exp(0.5 * (costs[order[0]] - cost))
            return replace(detection, solutions=(first, other), weight=1.0 / (1.0 + odds))
    return replace(detection, solutions=(first,), weight=1.0)


def _check_camera_info(info: CameraInfo, image: npt.NDArray[np.uint8]) -> None:
    if info.K.shape != (3, 3) or not np.isfinite(info.K).all():
        raise VisionError(f"K of camera_info is {info.K.tolist()}, expected a finite 3 x 3 matrix")
    if not (info.K[0, 0] > 0 and info.K[1, 1] > 0):
        raise VisionError(f"K of camera_info has focal lengths {info.K[0, 0]}, {info.K[1, 1]}, expected more than 0")
    if not np.isfinite(info.D).all() or info.D.size not in (0, 4, 5, 8, 12, 14):
        raise VisionError(f"D of camera_info is {info.D.tolist()}, expected 5 finite numbers (plumb_bob)")
    if not (info.width > 0 and info.height > 0):
        raise VisionError(f"camera_info is for {info.width} x {info.height} pixels, expected at least one")
    if image.shape[:2] != (info.height, info.width):
        raise VisionError(f"image is of shape {image.shape}, camera_info is for {info.width} x {info.height} pixels")
