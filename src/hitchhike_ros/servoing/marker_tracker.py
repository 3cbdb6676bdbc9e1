"""One marker carried from image to image, which finds it where it is blurred, cut or too far to be read.

A detection starts it. From then on lines are fitted to the marker's sides where they are expected, as in a detection.
They are expected where the motion between the last two images leads to, or else where the marker's picture is found
again. The pattern between the sides has to be the one that was detected. That tells the marker from another marker, and
its sides from other edges.

If no sides are found, the marker has leapt or changed its looks. Then ViSP's model-based tracker (moving edges on the
sides, KLT points on the pattern), started on the image before, tells where the square has gone. The lines are fitted
there. The tracker's own result is two to eight times less exact (``bench tracking``), as its edges are sought at whole
pixels and its points drift. It takes several times as long as the lines, so it is called only where they fail.

Detection is called again when the marker is lost, when the picture does not fit the model or the detected pattern, and
once in a while to see what else is in view.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from hitchhike_ros import _visp_tracker
from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, Positive, UnitInterval
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.core.geometry import wrap_angle
from hitchhike_ros.servoing.lens import GrayImage, Lens
from hitchhike_ros.servoing.marker_detector import (
    T_TAG_MARKER,
    MarkerDetection,
    MarkerDetector,
    MarkerDetectorParameters,
    nearest,
)
from hitchhike_ros.servoing.patch_shift import patch_shift
from hitchhike_ros.servoing.square_pose import project_corners

# ViSP's own default, for comparisons.
ModelTracker = _visp_tracker.ModelTracker
# How much farther than the marker pictures are straightened, as a share of its size: for lines, which are sought within
# some px, and for the model-based tracker.
_LINES_BORDER, _MODEL_BORDER = 0.1, 1.0


@dataclass(frozen=True)
class MarkerTrackerParameters:
    """Section ``marker_tracker``; all values are chosen."""

    detect_period_s: Positive = 2.0
    """After so long all markers are looked for, wherever the one is. What else a robot that follows comes past is in
    sight for longer."""
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
    """The marker that is carried: where it is in the newest image, and its pattern when it was detected.

    ``corners`` (4, 2) px and their ``motion`` (4, 2) px/s are those of the straight picture, the motion without what
    the camera made by turning; ``heading`` is where it looked, rad. ``modelled`` says that the model-based tracker has
    come to this image.
    """

    seen: MarkerDetection
    image: GrayImage
    lens: Lens
    stamp: float
    heading: float
    corners: FloatArray
    motion: FloatArray
    modelled: bool
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
        self._missed = 0
        self.why_detected = ""

    @property
    def tracking(self) -> bool:
        """Whether the newest image was looked at only where the marker was expected."""
        return self._carried is not None and not self.why_detected

    def reset(self) -> None:
        """Drop the marker; the next image is searched."""
        self._carried = None

    def see(
        self,
        gray: GrayImage,
        camera_info: CameraInfo,
        T_base_camera: FloatArray,
        stamp: float,
        *,
        heading: float = 0.0,
        target: int | None = None,
        sizes_m: Mapping[int, float] | None = None,
    ) -> list[MarkerDetection]:
        """The markers in one image, each with its likeliest pose first.

        Args:
            gray: (H, W) uint8, C-contiguous; kept until the next one has been seen, so it must not change.
            camera_info: calibration of that image.
            T_base_camera: (4, 4), for :meth:`MarkerDetector.resolve`.
            stamp: time of the image in s.
            heading: of the camera in a frame that stands still, such as odom, rad; what turns with it is expected
                elsewhere.
            target: the marker to carry, None for the nearest one. While it is carried, others are seen only when all
                are looked for.
            sizes_m: as in :meth:`MarkerDetector.detect`.

        Raises:
            VisionError: image, calibration or size cannot be used.
        """
        self.why_detected = self._idle_because(gray, camera_info, stamp, target, sizes_m or {})
        if self._carried is not None and not self.why_detected:
            carried = self._carry(self._carried, gray, stamp, heading)
            if carried is not None:
                detection, modelled = carried
                [seen] = self.detector.resolve([detection], T_base_camera, stamp)
                self._carried = self._gone_on(self._carried, seen, gray, stamp, heading, modelled=modelled)
                return [seen]
        thorough = self._missed % self.params.thorough_every == self.params.thorough_every - 1
        detected = self.detector.detect(gray, camera_info, sizes_m, thorough=thorough)
        found = self.detector.resolve(detected, T_base_camera, stamp)
        wanted = nearest(d for d in found if target in (None, d.id))
        self._missed = 0 if wanted is not None else self._missed + 1
        self._carried = None if wanted is None else self._started(wanted, gray, camera_info, stamp, heading)
        return found

    def _carry(
        self, carried: _Carried, gray: GrayImage, stamp: float, heading: float
    ) -> tuple[MarkerDetection, bool] | None:
        """The marker where it has gone, and whether the model-based tracker has come there.

        None when it has to be detected, and ``why_detected`` says why.
        """
        for expected in self._expected(carried, gray, stamp, heading):
            detection = self._measured(carried, gray, expected, _LINES_BORDER)
            if detection is not None:
                return detection, False
        tracked = self._tracked(carried, gray)
        if tracked is None:
            return None
        detection = self._measured(carried, gray, tracked, _MODEL_BORDER)
        if detection is None:
            return None
        drift = np.abs(_corners(detection, carried.lens) - tracked).max()
        return detection, bool(drift <= self.params.max_drift_px)

    def _expected(self, carried: _Carried, gray: GrayImage, stamp: float, heading: float) -> Iterator[FloatArray]:
        """Corners (4, 2) px near which the lines of the sides may be sought."""
        if not self.detector.has_sides:
            return
        turned = _turned(carried.corners, carried.lens, heading - carried.heading)
        yield turned + carried.motion * (stamp - carried.stamp)
        before = carried.seen.corners
        shift = patch_shift(carried.image, gray, before)
        if shift is not None:
            yield carried.lens.points(before + shift)

    def _measured(
        self, carried: _Carried, gray: GrayImage, expected: FloatArray, border: float
    ) -> MarkerDetection | None:
        """The marker near corners (4, 2) px, if its pattern is there."""
        image = carried.lens.straight(gray, expected, border)
        seen = carried.seen
        detection = self.detector.measure(seen.code, image, carried.lens, expected, seen.view.size_m)
        if detection is None:
            self.why_detected = "its sides are not to be seen"
            return None
        pattern = _visp_tracker.pattern(image, _corners(detection, carried.lens), self.detector.cells)
        likeness = float(pattern @ carried.pattern)
        if not likeness >= self.params.min_likeness:
            self.why_detected = f"pattern has a likeness of {likeness:.2f}"
            return None
        self.why_detected = ""
        return detection

    def _tracked(self, carried: _Carried, gray: GrayImage) -> FloatArray | None:
        """Corners (4, 2) px where the model-based tracker has followed the marker to, from the image before."""
        seen, lens = carried.seen, carried.lens
        if not carried.modelled:
            image = lens.straight(carried.image, carried.corners, _MODEL_BORDER)
            intrinsics = (lens.K[0, 0], lens.K[1, 1], lens.K[0, 2], lens.K[1, 2])
            T_camera_tag = seen.T_camera_marker @ np.linalg.inv(T_TAG_MARKER)
            try:
                self._model.start(image, intrinsics, T_camera_tag, seen.view.size_m)
            except VisionError:  # too few edges or points to track: it stays with detection
                self.why_detected = "too little for the model-based tracker"
                return None
        tracked = self._model.track(lens.straight(gray, carried.corners, _MODEL_BORDER))
        if tracked is None:
            self.why_detected = "lost by the model-based tracker"
            return None
        T_camera_tag, error_deg, _, _ = tracked
        if not error_deg <= self.params.max_projection_error_deg:
            self.why_detected = f"projection error {error_deg:.0f} deg"
            return None
        return _pixels(project_corners(T_camera_tag @ T_TAG_MARKER, seen.view.size_m), lens.K)

    def _idle_because(
        self, gray: GrayImage, info: CameraInfo, stamp: float, target: int | None, sizes_m: Mapping[int, float]
    ) -> str:
        if self._carried is None:
            return "nothing carried"
        seen = self._carried.seen
        if (
            target not in (None, seen.id)
            or sizes_m.get(seen.id, self.detector.params.marker_size_m) != seen.view.size_m
        ):
            return "another marker is wanted"
        if not self._carried.lens.is_of(info) or gray.shape != (info.height, info.width):
            return "another calibration"
        if not 0.0 <= stamp - self._carried.detected_at <= self.params.detect_period_s:
            return "time to look around"
        return ""

    def _started(
        self, seen: MarkerDetection, gray: GrayImage, info: CameraInfo, stamp: float, heading: float
    ) -> _Carried:
        """From a detection."""
        lens = self.detector.lens(info)
        corners = _corners(seen, lens)
        pattern = _visp_tracker.pattern(lens.straight(gray, corners, _LINES_BORDER), corners, self.detector.cells)
        before, motion = self._carried, np.zeros((4, 2))
        if before is not None and before.lens is lens and before.seen.id == seen.id:
            motion = _motion(before, corners, stamp, heading)
        return _Carried(seen, gray, lens, stamp, heading, corners, motion, False, stamp, pattern)

    def _gone_on(
        self, before: _Carried, seen: MarkerDetection, gray: GrayImage, stamp: float, heading: float, *, modelled: bool
    ) -> _Carried:
        corners = _corners(seen, before.lens)
        motion = _motion(before, corners, stamp, heading)
        return _Carried(
            seen, gray, before.lens, stamp, heading, corners, motion, modelled, before.detected_at, before.pattern
        )


def _motion(before: _Carried, corners: FloatArray, stamp: float, heading: float) -> FloatArray:
    """Motion (4, 2) of the corners since the image before, in px/s, without what the camera's turning made."""
    elapsed = stamp - before.stamp
    turned = _turned(before.corners, before.lens, heading - before.heading)
    return (corners - turned) / elapsed if elapsed > 0.0 else np.zeros((4, 2))


def _turned(corners: FloatArray, lens: Lens, angle: float) -> FloatArray:
    """Where corners (4, 2) px are seen once an upright camera has turned to the left by ``angle`` rad."""
    x = (corners[:, 0] - lens.K[0, 2]) / lens.K[0, 0]
    turned = corners.copy()
    turned[:, 0] += lens.K[0, 0] * (1.0 + x * x) * wrap_angle(angle)
    return turned


def _corners(detection: MarkerDetection, lens: Lens) -> FloatArray:
    """In the straight picture, (4, 2) px."""
    return _pixels(detection.view.points, lens.K)


def _pixels(points: FloatArray, K: FloatArray) -> FloatArray:
    """Normalised image coordinates (..., 2) as px."""
    return points * np.array([K[0, 0], K[1, 1]]) + K[:2, 2]
