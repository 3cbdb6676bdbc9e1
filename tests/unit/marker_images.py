"""Images of tags with known poses: photographs that come with ViSP, and flat markers drawn by OpenCV."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray

VISP_DATA = Path("/usr/share/visp-images-data/ViSP-images/AprilTag")
CAMERA = CameraInfo(640, 480, np.array([[554.26, 0.0, 319.5], [0.0, 554.26, 239.5], [0.0, 0.0, 1.0]]))
# Camera in the optical frame (z forward, x right, y down), level, 0.3 m up and 0.1 m ahead of the base.
T_BASE_CAMERA = np.array([[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]])


def visp_image(name: str) -> np.ndarray:
    path = VISP_DATA / name
    if not path.is_file():
        pytest.skip(f"needs {path} of the Debian package visp-images-data")
    return read_gray(path)


def read_gray(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return image


def read_corners(path: Path) -> dict[int, FloatArray]:
    """ViSP's ground truth: a line with the id (or a message that ends in it), then four lines of two numbers."""
    corners: dict[int, list[list[float]]] = {}
    for line in filter(None, map(str.strip, path.read_text().splitlines())):
        words = line.split()
        if len(words) == 1:
            current = corners.setdefault(int(re.sub(r".*:_", "", line)), [])
        else:
            current.append([float(word) for word in words])
    return {marker_id: np.array(points) for marker_id, points in corners.items()}


def marker_pose(distance: float, yaw: float = 0.0, pitch: float = 0.0, x: float = 0.0, y: float = 0.0) -> FloatArray:
    """T_camera_marker of a marker that is square-on at zero angles; yaw turns it about the camera's y axis."""
    square_on = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.0, yaw, 0.0]))[0] @ cv2.Rodrigues(np.array([pitch, 0.0, 0.0]))[0] @ square_on
    T[:3, 3] = x, y, distance
    return T


def render_marker(
    marker_id: int, T_camera_marker: FloatArray, size_m: float = 0.16, seed: int = 0, camera: CameraInfo = CAMERA
) -> np.ndarray:
    """A 36h11 marker before a grey wall, slightly blurred and noisy, (H, W) uint8."""
    cell, over = 40, 4
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # OpenCV's drawing of the tag stands on its head.
    tag = cv2.rotate(cv2.aruco.generateImageMarker(dictionary, marker_id, 8 * cell), cv2.ROTATE_180)
    plate = cv2.copyMakeBorder(tag, cell, cell, cell, cell, cv2.BORDER_CONSTANT, value=255)
    step, middle = size_m / (8 * cell), (plate.shape[0] - 1) / 2
    # The tag's pixel (u right, v down) to the marker's frame (y right, z up).
    A = np.array([[0.0, 0.0, 0.0], [step, 0.0, -middle * step], [0.0, -step, middle * step], [0.0, 0.0, 1.0]])
    fine = np.array([[over, 0.0, (over - 1) / 2], [0.0, over, (over - 1) / 2], [0.0, 0.0, 1.0]])
    image = cv2.warpPerspective(
        plate, fine @ camera.K @ T_camera_marker[:3] @ A, (over * camera.width, over * camera.height), borderValue=120
    )
    image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    noise = np.random.default_rng(seed).normal(0.0, 3.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)
