"""How far a part of an image has moved, roughly: its picture is found again at the size of a stamp."""

from __future__ import annotations

import cv2
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.servoing.lens import GrayImage

# The part is compared in pictures so large, and sought so far from where it was (chosen: a robot that turns by 0.2
# rad/s sees things move by some 100 px/s).
_STAMP_PX, _REACH_PX = 32.0, 24.0
# A part whose grey levels correlate no better than this is another one (chosen).
_MIN_LIKENESS = 0.7


def patch_shift(before: GrayImage, now: GrayImage, corners: FloatArray) -> FloatArray | None:
    """What has to be added to pixels (N, 2) of the one image for those of the other: (2,) px, to a thirtieth of
    the part's size.

    Args:
        before, now: (H, W) uint8 of one size.
        corners: (N, 2) px around the part in the image before.

    Returns:
        None where the part is not found again.
    """
    size = np.array(now.shape[::-1])
    margin = 0.1 * float(np.ptp(corners, axis=0).max())
    low = np.clip(np.floor(corners.min(axis=0) - margin).astype(int), 0, size)
    high = np.clip(np.ceil(corners.max(axis=0) + margin).astype(int) + 1, 0, size)
    scale = max(1.0, float((high - low).max()) / _STAMP_PX)
    reach = int(np.ceil(_REACH_PX / scale))
    # The window is cut on the stamp's own raster. Beyond the image its rim is repeated.
    shape = np.ceil((high - low) / scale).astype(int)
    if (shape < 4).any():
        return None
    part = _stamp(before, low, scale, shape)
    window = _stamp(now, low - reach * scale, scale, shape + 2 * reach)
    likeness = np.asarray(cv2.matchTemplate(window, part, cv2.TM_CCOEFF_NORMED), dtype=float)
    _, best, _, (u, v) = cv2.minMaxLoc(likeness)
    if not best >= _MIN_LIKENESS:
        return None
    shift = np.array([u + _peak(likeness[v], u), v + _peak(likeness[:, u], v)]) - reach
    return np.asarray(shift * scale)


def _stamp(image: GrayImage, low: FloatArray, scale: float, shape: FloatArray) -> GrayImage:
    """A part of an image that begins at ``low`` px, smaller by ``scale``: ``shape`` (width, height)."""
    to_image = np.array([[scale, 0.0, low[0] + 0.5 * (scale - 1.0)], [0.0, scale, low[1] + 0.5 * (scale - 1.0)]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    stamp = cv2.warpAffine(image, to_image, shape.tolist(), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(stamp, dtype=np.uint8)


def _peak(values: FloatArray, at: int) -> float:
    """Vertex of the parabola through the greatest value and its two neighbours, in steps from the greatest."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, middle, after = (float(v) for v in values[at - 1 : at + 2])
    bend = before - 2.0 * middle + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0
