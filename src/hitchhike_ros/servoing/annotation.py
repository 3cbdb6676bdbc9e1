"""The camera's image with what was seen in it drawn in, for a person who watches."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.servoing.marker_detector import MarkerDetection

_GREEN = (0, 255, 0)  # the same as RGB and as BGR


def annotated(
    pixels: npt.NDArray[np.uint8], target: MarkerDetection | None, markers: int, *, carried: bool
) -> npt.NDArray[np.uint8]:
    """A copy of an image with the outline of one marker, and its distance and bearing as text.

    Args:
        pixels: (H, W, 3).
        target: the marker; without it the text says how many were seen.
        markers: how many were seen.
        carried: whether the marker was looked for where it was expected, or in all of the image.

    Returns:
        (H, W, 3).
    """
    picture, text = pixels.copy(), f"{markers} markers"
    if target is not None:
        cv2.polylines(picture, [np.rint(target.corners).astype(np.int32)], True, _GREEN, 2, cv2.LINE_AA)
        x, y, z = target.T_camera_marker[:3, 3]
        range_m, bearing_deg = np.linalg.norm((x, y, z)), np.degrees(np.arctan2(-x, z))
        how = "carried" if carried else "detected"
        text = f"{target.code.message} {how}: {range_m:.2f} m, bearing {bearing_deg:.0f} deg"
    cv2.putText(picture, text, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _GREEN, 2, cv2.LINE_AA)
    return picture
