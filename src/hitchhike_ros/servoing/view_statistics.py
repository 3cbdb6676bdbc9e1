"""Where, how often and how steadily a camera sees a marker, for a person who mounts it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray

# Rate and steadiness are those of the last images of this long (chosen).
WINDOW_S = 2.0


@dataclass(frozen=True)
class MarkerView:
    """A marker in one image, as the camera has it: bearing positive to the left; yaw 0 when it faces the camera,
    positive when it is turned to its own left, which is to the right in the image."""

    code: str
    range_m: float
    bearing_rad: float
    yaw_rad: float


def sighting(code: str, T_camera_marker: FloatArray) -> MarkerView:
    """From the marker's pose (4, 4) in the camera's optical frame (z ahead, x right, y down); its x is its normal."""
    x, y, z = T_camera_marker[:3, 3]
    normal = T_camera_marker[:3, 0]
    return MarkerView(code, float(np.sqrt(x * x + y * y + z * z)), math.atan2(-x, z), math.atan2(normal[0], -normal[2]))


class ViewStatistics:
    """Counts images as they come, each with what was seen in it or None."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, MarkerView | None]] = deque()
        self.images = self.seen = 0
        self._nearest, self._farthest = math.inf, -math.inf

    def add(self, stamp: float, seen: MarkerView | None) -> None:
        """An image of time ``stamp`` in s."""
        if self._recent and stamp < self._recent[-1][0]:  # the clock was reset
            self._recent.clear()
        self._recent.append((stamp, seen))
        while stamp - self._recent[0][0] > WINDOW_S:
            self._recent.popleft()
        self.images += 1
        if seen is not None:
            self.seen += 1
            self._nearest, self._farthest = min(self._nearest, seen.range_m), max(self._farthest, seen.range_m)

    @property
    def rate_hz(self) -> float:
        """Images a second, lately."""
        span = self._recent[-1][0] - self._recent[0][0] if self._recent else 0.0
        return (len(self._recent) - 1) / span if span > 0.0 else 0.0

    def line(self) -> str:
        """What is seen now; the spread of the range and the share of images are those of the last two seconds."""
        if not self._recent:
            return "no image yet"
        found = [seen for _, seen in self._recent if seen is not None]
        share = f"seen in {100 * len(found) / len(self._recent):.0f} % of {self.rate_hz:.1f} Hz"
        newest = self._recent[-1][1]
        if newest is None:
            return f"no marker · {share}"
        spread = 1e3 * float(np.std([seen.range_m for seen in found if seen.code == newest.code]))
        bearing, yaw = math.degrees(newest.bearing_rad), math.degrees(newest.yaw_rad)
        place = f"range {newest.range_m:.3f} m ± {spread:.0f} mm  bearing {bearing:+.1f}°  yaw {yaw:+.1f}°"
        return f"{newest.code}  {place}  {share}"

    def summary(self) -> str:
        """One sentence on all images so far."""
        if not self.images:
            return "no image came"
        share = 100 * self.seen / self.images
        text = f"marker seen in {self.seen} of {self.images} images ({share:.0f} %)"
        return text + (f", from {self._nearest:.2f} m to {self._farthest:.2f} m" if self.seen else "")
