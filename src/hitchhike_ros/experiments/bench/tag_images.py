"""Pictures of one marker as a camera would take them, with a known pose.

Each pixel is the mean of what falls on it: the print is drawn through its homography (and the lens) several times finer
than the image and averaged down, then the light, the blur of lens and motion and the sensor's noise are applied. The
simulator's renderers sample each pixel once, at its centre: an edge along a row then lies on whole pixels, which throws
the yaw of a marker seen square-on by some degrees. A real sensor does not do that, so the tracker's precision is
measured on these pictures.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray
from hitchhike_ros.servoing.tag_cells import QUIET_CELLS, tag_cells

_FINE = 6
_CELL_PX = 48
# Of the wall behind, as a share of the paper's white.
_WALL = 0.55


@dataclass(frozen=True)
class Light:
    """Grey levels of the print's black and white, and how much brighter the right edge of the image is than the left
    one (a share)."""

    black: float
    white: float
    slope: float = 0.0


LIGHTS = {"even": Light(20.0, 220.0), "dim": Light(12.0, 60.0), "window": Light(40.0, 200.0, 0.8)}


@dataclass(frozen=True)
class Conditions:
    """What comes between the print and the picture.

    ``blur_px`` is the standard deviation of the lens's blur, ``motion_px`` how far the image moves (right, down) while
    the shutter is open, ``noise`` the standard deviation of a pixel in grey levels.
    """

    light: Light = LIGHTS["even"]
    blur_px: float = 0.6
    motion_px: tuple[float, float] = (0.0, 0.0)
    noise: float = 3.0


def marker_pose(distance: float, yaw: float = 0.0, pitch: float = 0.0, x: float = 0.0, y: float = 0.0) -> FloatArray:
    """T_camera_marker of a marker that is square-on at zero angles; yaw turns it about the camera's y axis."""
    square_on = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.0, yaw, 0.0]))[0] @ cv2.Rodrigues(np.array([pitch, 0.0, 0.0]))[0] @ square_on
    T[:3, 3] = x, y, distance
    return T


def tag_image(
    T_camera_marker: FloatArray,
    camera: CameraInfo,
    rng: np.random.Generator,
    conditions: Conditions | None = None,
    *,
    family: str = "36h11",
    marker_id: int | str = 0,
    size_m: float = 0.16,
) -> npt.NDArray[np.uint8]:
    """A marker before an even wall, (H, W) uint8. Of family ``qr`` the id is the code's message."""
    c = conditions or Conditions()
    image = np.full((camera.height, camera.width), _WALL)
    printed = _print_of(family, marker_id)
    H = camera.K @ T_camera_marker[:3] @ _print_to_marker(len(printed) // _CELL_PX, size_m)
    corners = np.array([[0.0, 0.0], [printed.shape[1], 0.0], list(printed.shape[::-1]), [0.0, printed.shape[0]]]) - 0.5
    window = _window(_distorted(_mapped(H, corners), camera), camera, 4 + 4 * c.blur_px + max(map(abs, c.motion_px)))
    if window is not None:
        u0, v0, u1, v1 = window
        fine = _drawn(printed, H, camera, window)
        fine = _moved(fine, c.motion_px)
        if c.blur_px > 0.0:
            # A pixel's own area is no part of the lens's blur.
            fine = np.asarray(cv2.GaussianBlur(fine, (0, 0), c.blur_px * _FINE), dtype=np.float32)
        image[v0:v1, u0:u1] = cv2.resize(fine, (u1 - u0, v1 - v0), interpolation=cv2.INTER_AREA)
    grey = c.light.black + (c.light.white - c.light.black) * image
    grey *= 1.0 + c.light.slope * (np.linspace(0.0, 1.0, camera.width) - 0.5)
    grey += rng.normal(0.0, c.noise, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@functools.lru_cache(maxsize=8)
def _print_of(family: str, marker_id: int | str) -> npt.NDArray[np.float32]:
    """Its white is 1, black 0."""
    return np.kron(_cells(family, marker_id), np.ones((_CELL_PX, _CELL_PX))).astype(np.float32)


def _cells(family: str, marker_id: int | str) -> npt.NDArray[np.bool_]:
    """The cells (N, N) with their white border, top row first; true is white."""
    if family == "qr":
        code = cv2.QRCodeEncoder.create().encode(str(marker_id)) > 0
        black = np.argwhere(~code)
        code = code[black[0][0] : black[-1][0] + 1, black[:, 1].min() : black[:, 1].max() + 1]
        return np.pad(code, QUIET_CELLS, constant_values=True)
    # OpenCV's drawings of tags stand on their heads in AprilTag's eyes.
    return np.rot90(tag_cells(family, int(marker_id)), 2)


def _print_to_marker(cells: int, size_m: float) -> FloatArray:
    """(4, 3): pixels of the print (u right, v down, 1) to the marker's frame (y right, z up), homogeneous."""
    step = size_m / ((cells - 2 * QUIET_CELLS) * _CELL_PX)
    middle = (cells * _CELL_PX - 1) / 2
    return np.array([[0.0, 0.0, 0.0], [step, 0.0, -middle * step], [0.0, -step, middle * step], [0.0, 0.0, 1.0]])


def _mapped(H: FloatArray, points: FloatArray) -> FloatArray:
    mapped = np.c_[points, np.ones(len(points))] @ H.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _distorted(points: FloatArray, camera: CameraInfo) -> FloatArray:
    """Where the lens puts what a pinhole would show at (N, 2) px."""
    if not camera.D.any():
        return points
    rays = np.linalg.solve(camera.K, np.c_[points, np.ones(len(points))].T).T
    return np.asarray(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.D)[0][:, 0])


def _window(corners: FloatArray, camera: CameraInfo, border: float) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the part of the image that the print may touch."""
    lower, upper = corners.min(axis=0) - border, corners.max(axis=0) + border
    u0, v0 = (max(0, math.floor(x)) for x in lower)
    u1, v1 = min(camera.width, math.ceil(upper[0])), min(camera.height, math.ceil(upper[1]))
    return (u0, v0, u1, v1) if u0 < u1 and v0 < v1 else None


def _drawn(
    printed: npt.NDArray[np.float32], H: FloatArray, camera: CameraInfo, window: tuple[int, int, int, int]
) -> npt.NDArray[np.float32]:
    """The window, ``_FINE`` times finer."""
    u0, v0, u1, v1 = window
    shape = ((v1 - v0) * _FINE, (u1 - u0) * _FINE)
    if not camera.D.any():
        shift = (_FINE - 1) / 2
        fine = np.array([[_FINE, 0.0, shift - _FINE * u0], [0.0, _FINE, shift - _FINE * v0], [0.0, 0.0, 1.0]])
        warped = cv2.warpPerspective(printed, fine @ H, shape[::-1], flags=cv2.INTER_LINEAR, borderValue=[_WALL])
        return np.asarray(warped, dtype=np.float32)
    # What the lens does changes little from pixel to pixel: it is worked out for each, and interpolated between them.
    points = np.stack(np.meshgrid(np.arange(u0, u1), np.arange(v0, v1)), axis=-1).reshape(-1, 1, 2).astype(float)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    straight = cv2.undistortPointsIter(points, camera.K, camera.D, np.eye(3), camera.K, criteria)
    source = _mapped(np.linalg.inv(H), np.asarray(straight[:, 0], dtype=float)).reshape(v1 - v0, u1 - u0, 2)
    fine = cv2.resize(source.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
    drawn = cv2.remap(printed, fine[..., 0], fine[..., 1], cv2.INTER_LINEAR, borderValue=[_WALL])
    return np.asarray(drawn, dtype=np.float32)


def _moved(fine: npt.NDArray[np.float32], motion_px: tuple[float, float]) -> npt.NDArray[np.float32]:
    """The mean over the time that the shutter is open; the given pose is that of its middle."""
    length = math.hypot(*motion_px)
    if length == 0.0:
        return fine
    n = max(2, math.ceil(length * _FINE))
    total = np.zeros_like(fine)
    for f in (np.arange(n) + 0.5) / n - 0.5:
        shift = np.array([[1.0, 0.0, f * motion_px[0] * _FINE], [0.0, 1.0, f * motion_px[1] * _FINE]])
        total += cv2.warpAffine(fine, shift, fine.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    return total / n
