"""One marker carried from image to image, which finds it where it is blurred, cut or too far to be read.

A detection starts it. Then ViSP's model-based tracker (moving edges on the sides, KLT points on what is printed
between them) says where the square has gone, and lines fitted to its sides measure it there, as in a detection: what
the model-based tracker itself gives is two to eight times less exact (``bench tracking``), for its edges are sought at
whole pixels and its points drift. Detection is called again when the marker is lost, when the picture does not fit the
model or the pattern that was detected, and once in a while to see what else is there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import cv2
import msgspec
import numpy as np

from hitchhike_ros import _visp_tracker
from hitchhike_ros.datatypes import CameraInfo, FloatArray, Positive, UnitInterval
from hitchhike_ros.errors import VisionError
from hitchhike_ros.servoing.lens import GrayImage, Lens
from hitchhike_ros.servoing.marker_detector import (
    T_TAG_MARKER,
    MarkerDetection,
    MarkerDetector,
    MarkerDetectorParameters,
    nearest,
)
from hitchhike_ros.servoing.square_pose import project_corners

# ViSP's own, for who compares.
ModelTracker = _visp_tracker.ModelTracker


@dataclass(frozen=True)
class MarkerTrackerParameters:
    """Section ``marker_tracker``; all values are chosen."""

    detect_period_s: Positive = 1.0
    """After so long all markers are looked for, wherever the one is."""
    thorough_every: Annotated[int, msgspec.Meta(ge=1)] = 5
    """Of the images in which the marker is missed, every so-manieth is searched for small and slanted markers too."""
    max_projection_error_deg: Positive = 25.0
    """Mean angle between the model's sides and the picture's gradient: 2 near by, 8 at 3 m."""
    min_likeness: UnitInterval = 0.75
    """Correlation of the pattern with the one that was detected."""
    max_drift_px: Positive = 2.0
    """The model-based tracker starts anew when it is farther than this from the lines of the sides."""


@dataclass(frozen=True, eq=False)
class _Carried:
    """What is being carried: the last detection, when the marker was detected, and its pattern then."""

    seen: MarkerDetection
    detected_at: float
    pattern: FloatArray


class MarkerTracker:
    """Detects markers, and carries one of them.

    Raises:
        VisionError: the tag family is unknown or a parameter is out of ViSP's range.
    """

    def __init__(
        self, detector: MarkerDetectorParameters | None = None, params: MarkerTrackerParameters | None = None
    ) -> None:
        self.params = params or MarkerTrackerParameters()
        self.detector = MarkerDetector(detector)
        self._model = ModelTracker()
        self._carried: _Carried | None = None
        self._lens: Lens | None = None
        self._missed = 0
        self._drift_px = 0.0
        self._image: GrayImage | None = None
        self.why_detected = ""

    @property
    def tracking(self) -> bool:
        """Whether the newest image was looked at only where the marker was expected."""
        return self._carried is not None and not self.why_detected

    def reset(self) -> None:
        """Carry nothing; the next image is searched."""
        self._carried = None

    def see(
        self,
        gray: GrayImage,
        camera_info: CameraInfo,
        T_base_camera: FloatArray,
        stamp: float,
        *,
        target: int | None = None,
        sizes_m: Mapping[int, float] | None = None,
    ) -> list[MarkerDetection]:
        """The markers in one image, each with its likeliest pose first.

        Args:
            gray: (H, W) uint8, C-contiguous.
            camera_info: calibration of that image.
            T_base_camera: (4, 4), for :meth:`MarkerDetector.resolve`.
            stamp: time of the image in s.
            target: the marker to carry, None for the nearest one. While it is carried, others are seen only when all
                are looked for.
            sizes_m: as in :meth:`MarkerDetector.detect`.

        Raises:
            VisionError: image, calibration or size cannot be used.
        """
        carried = self._carry(gray, camera_info, stamp, target, sizes_m or {})
        if carried is not None:
            [seen] = self.detector.resolve([carried], T_base_camera, stamp)
            self._go_on(seen)
            return [seen]
        thorough = self._missed % self.params.thorough_every == self.params.thorough_every - 1
        detected = self.detector.detect(gray, camera_info, sizes_m, thorough=thorough)
        found = self.detector.resolve(detected, T_base_camera, stamp)
        wanted = nearest(d for d in found if target in (None, d.id))
        self._missed = 0 if wanted is not None else self._missed + 1
        self._carried = None
        if wanted is not None:
            self._lens = self.detector.lens(camera_info)
            self._start(gray, wanted, stamp)
        return found

    def _carry(
        self, gray: GrayImage, info: CameraInfo, stamp: float, target: int | None, sizes_m: Mapping[int, float]
    ) -> MarkerDetection | None:
        """The marker where it has gone; None when it has to be detected, and ``why_detected`` says why."""
        self.why_detected = self._idle_because(gray, info, stamp, target, sizes_m)
        if self.why_detected or self._carried is None or self._lens is None:
            return None
        seen, lens = self._carried.seen, self._lens
        image = lens.straight(gray, _pixels(seen.view.points, lens.K), border=1.0)
        tracked = self._model.track(image)
        if tracked is None:
            self.why_detected = "lost by the model-based tracker"
            return None
        T_camera_tag, error_deg, _, _ = tracked
        if not error_deg <= self.params.max_projection_error_deg:
            self.why_detected = f"projection error {error_deg:.0f} deg"
            return None
        expected = _pixels(project_corners(T_camera_tag @ T_TAG_MARKER, seen.view.size_m), lens.K)
        detection = self.detector.measure(seen.code, image, lens, expected, seen.view.size_m)
        if detection is None:
            self.why_detected = "its sides are not to be seen"
            return None
        corners = _pixels(detection.view.points, lens.K)
        likeness = _correlation(_pattern(image, corners, self.detector.cells), self._carried.pattern)
        if not likeness >= self.params.min_likeness:
            self.why_detected = f"pattern has a likeness of {likeness:.2f}"
            return None
        self._drift_px = float(np.abs(corners - expected).max())
        self._image = image
        return detection

    def _idle_because(
        self, gray: GrayImage, info: CameraInfo, stamp: float, target: int | None, sizes_m: Mapping[int, float]
    ) -> str:
        if self._carried is None or self._lens is None:
            return "nothing carried"
        seen = self._carried.seen
        if (
            target not in (None, seen.id)
            or sizes_m.get(seen.id, self.detector.params.marker_size_m) != seen.view.size_m
        ):
            return "another marker is wanted"
        if not self._lens.is_of(info) or gray.shape != (info.height, info.width):
            return "another calibration"
        if not 0.0 <= stamp - self._carried.detected_at <= self.params.detect_period_s:
            return "time to look around"
        return ""

    def _start(self, gray: GrayImage, seen: MarkerDetection, stamp: float) -> None:
        lens = self._lens
        assert lens is not None
        corners = _pixels(seen.view.points, lens.K)
        image = lens.straight(gray, corners, border=1.0)
        if self._begin(image, seen, lens):
            self._carried = _Carried(seen, stamp, _pattern(image, corners, self.detector.cells))

    def _go_on(self, seen: MarkerDetection) -> None:
        """Carry on from the measured pose where the model-based tracker has drifted away."""
        assert self._carried is not None and self._lens is not None and self._image is not None
        self._carried = _Carried(seen, self._carried.detected_at, self._carried.pattern)
        if self._drift_px > self.params.max_drift_px and not self._begin(self._image, seen, self._lens):
            self._carried = None

    def _begin(self, image: GrayImage, seen: MarkerDetection, lens: Lens) -> bool:
        K = lens.K
        try:
            self._model.start(
                image,
                (K[0, 0], K[1, 1], K[0, 2], K[1, 2]),
                seen.T_camera_marker @ np.linalg.inv(T_TAG_MARKER),
                seen.view.size_m,
            )
        except VisionError:  # too few edges or points to track: it stays with detection
            return False
        return True


def _pixels(points: FloatArray, K: FloatArray) -> FloatArray:
    """Normalised image coordinates (..., 2) as px."""
    return points * np.array([K[0, 0], K[1, 1]]) + K[:2, 2]


def _pattern(image: GrayImage, corners: FloatArray, cells: int) -> FloatArray:
    """Grey levels (cells²,) of the square with ``corners`` (4, 2) px, in the middle of each of cells x cells."""
    unit = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], dtype=np.float32)
    H = cv2.getPerspectiveTransform(unit, corners.astype(np.float32))
    middle = (np.arange(cells) + 0.5) / cells
    grid = np.stack(np.meshgrid(middle, middle), axis=-1)
    places = cv2.perspectiveTransform(grid, H).astype(np.float32)
    return np.asarray(cv2.remap(image, places[..., 0], places[..., 1], cv2.INTER_LINEAR), dtype=float).ravel()


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """Of two patterns, in [-1, 1]; 0 where one of them is even."""
    a, b = a - a.mean(), b - b.mean()
    power = float(a @ a) * float(b @ b)
    return float(a @ b) / math.sqrt(power) if power > 0.0 else 0.0
