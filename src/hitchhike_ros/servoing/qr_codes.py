"""QR codes as markers, found and read by OpenCV."""

from __future__ import annotations

import zlib

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray

FAMILY = "qr"


def code_id(message: str) -> int:
    """The id of the marker with this message: the number that it is, or else a number that every robot gets from it."""
    if message.isascii() and message.isdigit() and len(message) <= 9:
        return int(message)
    # Beyond all numbers of nine digits.
    return 2_000_000_000 + zlib.crc32(message.encode()) % 100_000_000


class QrDetector:
    """As ``_visp_tracker.TagDetector``, for QR codes that can be read."""

    def __init__(self) -> None:
        self._detector = cv2.QRCodeDetector()

    def detect(self, image: npt.NDArray[np.uint8]) -> list[tuple[str, FloatArray]]:
        """Messages and corners (4, 2) px: lower left, lower right, upper right, upper left of the code."""
        try:
            found, messages, corners, _ = self._detector.detectAndDecodeMulti(image)
        except cv2.error:  # its way to say that what looked like a code is none
            return []
        if not found:
            return []
        return [
            (message, np.asarray(points[::-1], dtype=float))
            for message, points in zip(messages, corners, strict=True)
            if message
        ]
