"""Images and points without lens distortion, as straight lines need them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray
from hitchhike_ros.core.errors import VisionError

GrayImage = npt.NDArray[np.uint8]
# The straight picture may be larger than the lens's by this share on each side; what lies farther out is cut off.
_MARGIN = 0.25


class Lens:
    """A camera's plumb_bob lens, taken out of points and of the part of an image that is looked at.

    ``K`` (3, 3) is that of the straight picture, which shows all of the lens's, so it may be larger. Without
    distortion both are the same, and nothing is copied.
    """

    def __init__(self, info: CameraInfo) -> None:
        self.info, self.K = info, info.K
        self._size = (info.width, info.height)
        self._canvas: GrayImage | None = None
        if info.D.any():
            self._prepare()

    def _prepare(self) -> None:
        w, h = self._size
        u, v = np.linspace(0.0, w - 1.0, 20), np.linspace(0.0, h - 1.0, 20)
        rim = np.vstack([np.c_[u, 0 * u], np.c_[u, 0 * u + h - 1], np.c_[0 * v, v], np.c_[0 * v + w - 1, v]])
        straight = self._straightened(rim)
        if not np.isfinite(straight).all():
            K, D = self.info.K.tolist(), self.info.D.tolist()
            raise VisionError(f"K and D of camera_info are {K} and {D}, expected a lens that can be straightened")
        limit = _MARGIN * np.array([w, h])
        low = np.floor(np.clip(straight.min(axis=0), -limit, 0.0))
        high = np.ceil(np.clip(straight.max(axis=0), np.array([w, h]) - 1.0, np.array([w, h]) - 1.0 + limit))
        width, height = (high - low + 1).astype(int)
        self._size = (int(width), int(height))
        self.K = self.info.K.copy()
        self.K[:2, 2] -= low
        self._maps = cv2.initUndistortRectifyMap(self.info.K, self.info.D, np.eye(3), self.K, self._size, cv2.CV_16SC2)
        self._canvas = np.zeros(self._size[::-1], np.uint8)

    def is_of(self, info: CameraInfo) -> bool:
        """Whether ``info`` describes the same camera."""
        own = self.info
        return info is own or (
            (info.width, info.height) == (own.width, own.height)
            and np.array_equal(info.K, own.K)
            and np.array_equal(info.D, own.D)
        )

    def points(self, corners: FloatArray) -> FloatArray:
        """Points (N, 2) px of the image as px of the straight picture."""
        if self._canvas is None:
            return corners
        return self._straightened(corners)

    def lensed(self, points: FloatArray) -> FloatArray:
        """The reverse of :meth:`points`."""
        if self._canvas is None:
            return points
        rays = (np.c_[points, np.ones(len(points))] @ np.linalg.inv(self.K).T)[:, None]
        return np.asarray(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.info.K, self.info.D)[0][:, 0])

    def straight(self, gray: GrayImage, corners: FloatArray, border: float = 0.5) -> GrayImage:
        """The straight picture around a marker with ``corners`` (4, 2) px, black elsewhere; valid until the next call.

        ``border`` is how much farther it reaches than the marker, as a share of the marker's size.
        """
        if self._canvas is None:
            return gray
        low, high = corners.min(axis=0), corners.max(axis=0)
        reach = border * float((high - low).max()) + 8.0
        u0, v0 = np.maximum(np.floor(low - reach), 0).astype(int)
        u1, v1 = np.minimum(np.ceil(high + reach) + 1, self._size).astype(int)
        self._canvas[:] = 0
        if u0 < u1 and v0 < v1:
            window = np.s_[v0:v1, u0:u1]
            self._canvas[window] = cv2.remap(gray, self._maps[0][window], self._maps[1][window], cv2.INTER_LINEAR)
        return self._canvas

    def _straightened(self, points: FloatArray) -> FloatArray:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
        straight = cv2.undistortPointsIter(
            np.ascontiguousarray(points[:, None, :]), self.info.K, self.info.D, np.eye(3), self.K, criteria
        )
        return np.asarray(straight[:, 0], dtype=float)
