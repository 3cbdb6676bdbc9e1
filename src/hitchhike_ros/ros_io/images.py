"""Converts images and calibrations of cameras: every encoding that their drivers send, compressed images, and images
that are binned or cut out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import CompressedImage, Image

from hitchhike_ros.core.datatypes import CameraInfo
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.ros_io.conversions import header

Pixels = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class _Encoding:
    """How pixels lie in a message: channels of ``dtype``, and OpenCV's codes that make them grey and RGB.

    None: they are so already.
    """

    dtype: str
    channels: int
    to_gray: int | None
    to_rgb: int | None


def _colours(channels: int, order: str) -> tuple[_Encoding, _Encoding]:
    """Of 8 and of 16 bits; ``order`` is that of the colours, as OpenCV writes it."""
    to_gray = getattr(cv2, f"COLOR_{order}2GRAY")
    to_rgb = None if order == "RGB" else getattr(cv2, f"COLOR_{order}2RGB")
    return _Encoding("u1", channels, to_gray, to_rgb), _Encoding("u2", channels, to_gray, to_rgb)


def _bayer(pattern: str) -> tuple[_Encoding, _Encoding]:
    """``pattern`` is OpenCV's name: the second and third pixel of the second row."""
    to_gray, to_rgb = (getattr(cv2, f"COLOR_Bayer{pattern}2{wanted}") for wanted in ("GRAY", "RGB"))
    return _Encoding("u1", 1, to_gray, to_rgb), _Encoding("u2", 1, to_gray, to_rgb)


_MONO8, _MONO16 = (_Encoding(dtype, 1, None, cv2.COLOR_GRAY2RGB) for dtype in ("u1", "u2"))
_RGB8, _RGB16 = _colours(3, "RGB")
_BGR8, _BGR16 = _colours(3, "BGR")
_RGBA8, _RGBA16 = _colours(4, "RGBA")
_BGRA8, _BGRA16 = _colours(4, "BGRA")
_RGGB8, _RGGB16 = _bayer("BG")
_BGGR8, _BGGR16 = _bayer("RG")
_GBRG8, _GBRG16 = _bayer("GR")
_GRBG8, _GRBG16 = _bayer("GB")
_UYVY = _Encoding("u1", 2, cv2.COLOR_YUV2GRAY_UYVY, cv2.COLOR_YUV2RGB_UYVY)
_YUYV = _Encoding("u1", 2, cv2.COLOR_YUV2GRAY_YUY2, cv2.COLOR_YUV2RGB_YUY2)

ENCODINGS = {
    "mono8": _MONO8,
    "8UC1": _MONO8,
    "mono16": _MONO16,
    "16UC1": _MONO16,
    "rgb8": _RGB8,
    "rgb16": _RGB16,
    "bgr8": _BGR8,
    "8UC3": _BGR8,
    "bgr16": _BGR16,
    "rgba8": _RGBA8,
    "rgba16": _RGBA16,
    "bgra8": _BGRA8,
    "8UC4": _BGRA8,
    "bgra16": _BGRA16,
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "yuv422_yuy2": _YUYV,
    "yuyv": _YUYV,
    "bayer_rggb8": _RGGB8,
    "bayer_rggb16": _RGGB16,
    "bayer_bggr8": _BGGR8,
    "bayer_bggr16": _BGGR16,
    "bayer_gbrg8": _GBRG8,
    "bayer_gbrg16": _GBRG16,
    "bayer_grbg8": _GRBG8,
    "bayer_grbg16": _GRBG16,
}
"""Those of sensor_msgs/image_encodings that a camera's picture can have, and usb_cam's names for YUV 4:2:2."""


def image_from_msg(msg: Image) -> Pixels:
    """Return the pixels as they lie in the message, uint8 (H, W[, C]); a view on its data where they have 8 bits.

    Of 16 bits the upper 8 are taken, as cv_bridge does.

    Raises:
        SensorDataError: the encoding is none of :data:`ENCODINGS`, or the data is shorter than the header says.
    """
    encoding = ENCODINGS.get(msg.encoding)
    if encoding is None:
        raise SensorDataError(f"image encoding {msg.encoding!r}, expected one of {', '.join(ENCODINGS)}")
    values = _rows(msg, np.dtype(encoding.dtype), encoding.channels)
    pixels = values if encoding.dtype == "u1" else (values >> 8).astype(np.uint8)
    return pixels if encoding.channels == 1 else pixels.reshape(msg.height, msg.width, encoding.channels)


def gray_from_msg(msg: Image) -> Pixels:
    """Return grey values, uint8 (H, W), C-contiguous; copied only where pixels have colours or rows are padded.

    Raises:
        SensorDataError: as :func:`image_from_msg`.
    """
    pixels = image_from_msg(msg)
    return np.ascontiguousarray(_converted(pixels, ENCODINGS[msg.encoding].to_gray, msg))


def rgb_from_msg(msg: Image) -> Pixels:
    """Return colours, uint8 (H, W, 3).

    Raises:
        SensorDataError: as :func:`image_from_msg`.
    """
    return _converted(image_from_msg(msg), ENCODINGS[msg.encoding].to_rgb, msg)


def gray_from_compressed(msg: CompressedImage) -> Pixels:
    """Return grey values, uint8 (H, W), of a JPEG or PNG image.

    Raises:
        SensorDataError: the data is no such image.
    """
    return _decompressed(msg, cv2.IMREAD_GRAYSCALE)


def rgb_from_compressed(msg: CompressedImage) -> Pixels:
    """Return colours, uint8 (H, W, 3), of a JPEG or PNG image.

    Raises:
        SensorDataError: the data is no such image.
    """
    return np.asarray(cv2.cvtColor(_decompressed(msg, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), np.uint8)


def depth_from_msg(msg: Image) -> npt.NDArray[np.float32]:
    """Return depth (H, W) in m, NaN where there is none: of 32FC1, or of 16UC1 in mm with 0 for none (REP 118).

    Raises:
        SensorDataError: unknown encoding, or the data is shorter than the header says.
    """
    if msg.encoding not in ("32FC1", "16UC1"):
        raise SensorDataError(f"depth image encoding {msg.encoding!r}, expected one of 32FC1, 16UC1")
    values = _rows(msg, np.dtype("f4" if msg.encoding == "32FC1" else "u2"), 1)
    if msg.encoding == "32FC1":
        return values.astype(np.float32)
    return np.where(values == 0, np.float32(np.nan), values.astype(np.float32) / np.float32(1000.0))


def image_to_msg(image: np.ndarray, stamp: float, frame_id: str, encoding: str) -> Image:
    """An image (H, W[, C]) uint8, or (H, W) float32 with encoding 32FC1, as a message."""
    contiguous = np.ascontiguousarray(image)
    return Image(
        header=header(stamp, frame_id),
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        step=contiguous.strides[0],
        data=contiguous.tobytes(),
    )


def camera_info_from_msg(msg: CameraInfoMsg) -> CameraInfo:
    """Return the calibration of the images that are sent, which may be binned or a part of the full image.

    Width, height and K of the message are those of the full image; its region of interest is in pixels of the full
    image, and is cut out before pixels are binned, as image_geometry does it.

    Raises:
        SensorDataError: the region of interest is not in the image.
    """
    distortion = np.array(msg.D, dtype=float) if len(msg.D) else np.zeros(5)
    K, width, height, roi = np.array(msg.K, dtype=float).reshape(3, 3), msg.width, msg.height, msg.roi
    if roi.width or roi.height:
        if roi.x_offset + roi.width > width or roi.y_offset + roi.height > height or not (roi.width and roi.height):
            raise SensorDataError(
                f"roi of {roi.width} x {roi.height} pixels at ({roi.x_offset}, {roi.y_offset}) in it, "
                f"expected a part of the image of {width} x {height} pixels"
            )
        K[0, 2] -= roi.x_offset
        K[1, 2] -= roi.y_offset
        width, height = roi.width, roi.height
    for axis, binning in enumerate((msg.binning_x, msg.binning_y)):
        K[axis] /= max(binning, 1)
    return CameraInfo(width // max(msg.binning_x, 1), height // max(msg.binning_y, 1), K, distortion)


def camera_info_to_msg(info: CameraInfo, stamp: float, frame_id: str) -> CameraInfoMsg:
    """A calibration as a message."""
    msg = CameraInfoMsg(header=header(stamp, frame_id), width=info.width, height=info.height)
    msg.distortion_model = "plumb_bob"
    msg.D, msg.K = info.D.tolist(), info.K.ravel().tolist()
    msg.R = np.eye(3).ravel().tolist()
    msg.P = np.hstack([info.K, np.zeros((3, 1))]).ravel().tolist()
    return msg


def _rows(msg: Image, dtype: np.dtype[np.generic], channels: int) -> np.ndarray:
    """Values (H, W * channels) in the machine's byte order, without what pads the rows.

    Raises:
        SensorDataError: the data is shorter than the header says.
    """
    width = msg.width * channels * dtype.itemsize
    if msg.height == 0 or msg.width == 0 or msg.step < width or len(msg.data) < msg.step * msg.height:
        raise SensorDataError(
            f"image of {len(msg.data)} bytes with step {msg.step}, "
            f"expected {msg.height} rows of {msg.width} {msg.encoding}"
        )
    rows = np.frombuffer(msg.data, np.uint8, msg.step * msg.height).reshape(msg.height, msg.step)[:, :width]
    if dtype.itemsize == 1:
        return rows
    return np.ascontiguousarray(rows).view(dtype.newbyteorder(">" if msg.is_bigendian else "<"))


def _converted(pixels: Pixels, code: int | None, msg: Image) -> Pixels:
    if code is None:
        return pixels
    try:
        return np.asarray(cv2.cvtColor(pixels, code), np.uint8)
    except cv2.error as exc:  # as YUV 4:2:2 with an odd width
        raise SensorDataError(f"image of {msg.width} x {msg.height} {msg.encoding}: {exc.err}") from exc


def _decompressed(msg: CompressedImage, flags: int) -> Pixels:
    try:
        pixels = cv2.imdecode(np.frombuffer(msg.data, np.uint8), flags)
    except cv2.error as exc:
        raise SensorDataError(f"compressed image of {len(msg.data)} bytes: {exc.err}") from exc
    if pixels is None:
        raise SensorDataError(f"compressed image of {len(msg.data)} bytes, {msg.format!r}, expected JPEG or PNG")
    return np.asarray(pixels, np.uint8)
