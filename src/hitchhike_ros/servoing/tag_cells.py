"""The black and white cells of AprilTags, to print and to simulate."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.errors import VisionError

DICTIONARIES = {
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
# White cells around the black edge: one is enough for detectors, two leave room for a blurred edge (chosen).
QUIET_CELLS = 2


def tag_cells(family: str, tag_id: int) -> npt.NDArray[np.bool_]:
    """The cells (N, N) of an upright tag with its white border, top row first; true is white.

    Raises:
        VisionError: unknown family, or the family has no such id.
    """
    if family not in DICTIONARIES:
        raise VisionError(f"tag family is {family!r}, expected one of {', '.join(DICTIONARIES)}")
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
    if not 0 <= tag_id < len(dictionary.bytesList):
        raise VisionError(f"tag id is {tag_id}, expected 0 to {len(dictionary.bytesList) - 1} in family {family}")
    tag = dictionary.generateImageMarker(tag_id, dictionary.markerSize + 2) > 0
    return np.pad(tag, QUIET_CELLS, constant_values=True)
