"""Images and calibrations of cameras, as their drivers send them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import CompressedImage, Image

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.core.datatypes import CameraInfo
from hitchhike_ros.core.errors import ParameterError, SensorDataError
from hitchhike_ros.modules.inputs import CameraImage
from hitchhike_ros.ros_io.images import (
    ENCODINGS,
    camera_info_from_msg,
    camera_info_to_msg,
    gray_from_compressed,
    gray_from_msg,
    image_to_msg,
    rgb_from_compressed,
    rgb_from_msg,
)
from hitchhike_ros.ros_io.inlets import inlet_of

HEIGHT, WIDTH = 48, 64


def scene() -> np.ndarray:
    """Colours (H, W, 3) that change slowly, so that neighbours of a Bayer pattern or of YUV 4:2:2 are alike."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    channels = [60 + 2 * x, 200 - 2 * y, 40 + x + y]
    return np.stack(channels, axis=-1).astype(np.uint8)


def mosaic(rgb: np.ndarray, pattern: str) -> np.ndarray:
    """What a sensor sees behind the filter ``pattern``, the colours of its first two rows: rggb."""
    out = np.zeros(rgb.shape[:2], np.uint8)
    for k, colour in enumerate(pattern):
        row, column = divmod(k, 2)
        out[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)]
    return out


def yuv422(rgb: np.ndarray, order: str) -> np.ndarray:
    """(H, W, 2) with the bytes of two pixels in the order of ``order``: uyvy or yuyv (BT.601, as cameras send it)."""
    r, g, b = (rgb[..., k].astype(float) for k in range(3))
    y = 16 + 0.257 * r + 0.504 * g + 0.098 * b
    u = 128 - 0.148 * r - 0.291 * g + 0.439 * b
    v = 128 + 0.439 * r - 0.368 * g - 0.071 * b
    luma, chroma = np.round(y), np.where(np.arange(rgb.shape[1]) % 2 == 0, u, np.roll(v, 1, axis=1)).round()
    pair = (chroma, luma) if order == "uyvy" else (luma, chroma)
    return np.stack(pair, axis=-1).astype(np.uint8)


def encoded(name: str, rgb: np.ndarray) -> np.ndarray:
    """The picture as ``name`` says, of 8 bits."""
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    if name.startswith("bayer"):
        return mosaic(rgb, name[6:10])
    if name in ("yuv422", "uyvy"):
        return yuv422(rgb, "uyvy")
    if name.startswith("yu"):
        return yuv422(rgb, "yuyv")
    bgr, alpha = rgb[..., ::-1], np.full((*gray.shape, 1), 255, np.uint8)
    rgba, bgra = (np.concatenate([colours, alpha], axis=-1) for colours in (rgb, bgr))
    numbered = {"8UC1": gray, "16UC1": gray, "8UC3": bgr, "8UC4": bgra}
    named = {"mono": gray, "rgb": rgb, "bgr": bgr, "rgba": rgba, "bgra": bgra}
    return numbered[name] if name in numbered else named[name.rstrip("0123456789")]


def message(name: str, rgb: np.ndarray, *, big_endian: bool = False, padding: int = 0) -> Image:
    """As a driver sends it, each row followed by ``padding`` bytes."""
    values = encoded(name, rgb)
    rows = values.reshape(values.shape[0], -1)
    if ENCODINGS[name].dtype == "u2":
        wide = rows.astype(np.uint16) * 256 + 77
        rows = wide.astype(">u2" if big_endian else "<u2").view(np.uint8).reshape(len(rows), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    msg = Image(height=rgb.shape[0], width=rgb.shape[1], encoding=name, is_bigendian=big_endian)
    msg.step, msg.data = rows.shape[1], rows.tobytes()
    return msg


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("name", ENCODINGS)
def test_every_encoding_shows_the_same_scene(name: str, big_endian: bool, padding: int) -> None:
    rgb = scene()
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(int)
    msg = message(name, rgb, big_endian=big_endian, padding=padding)
    inside = (slice(2, -2), slice(2, -2))  # a Bayer pattern is guessed at the rim
    found = gray_from_msg(msg)
    assert found.flags.c_contiguous
    assert found.dtype == np.uint8
    assert np.abs(found.astype(int) - gray)[inside].max() <= (18 if name.startswith(("yu", "uy")) else 4)
    colours = rgb_from_msg(msg).astype(int)
    shown = np.repeat(gray[..., None], 3, axis=-1) if "mono" in name or name.endswith("UC1") else rgb.astype(int)
    assert np.abs(colours - shown)[inside].max() <= 6


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_compressed_image_shows_the_same_scene(suffix: str) -> None:
    rgb = scene()
    data = cv2.imencode(suffix, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))[1].tobytes()
    msg = CompressedImage(format=f"rgb8; {suffix[1:]} compressed bgr8", data=data)
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(int)
    assert np.abs(gray_from_compressed(msg).astype(int) - gray).max() <= 6
    assert np.abs(rgb_from_compressed(msg).astype(int) - rgb).max() <= 16


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xe0 no picture", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_what_is_no_compressed_image_is_refused(data: bytes) -> None:
    with pytest.raises(SensorDataError, match="compressed image of"):
        gray_from_compressed(CompressedImage(format="jpeg", data=data))


def test_an_unknown_encoding_is_refused_with_those_that_are_known() -> None:
    msg = message("mono8", scene())
    msg.encoding = "nv21"
    with pytest.raises(SensorDataError, match=r"'nv21', expected one of mono8, .*bayer_grbg16"):
        gray_from_msg(msg)


@pytest.mark.parametrize("name", ["mono8", "bgr16", "yuv422", "bayer_rggb8"])
def test_data_that_is_too_short_is_refused(name: str) -> None:
    msg = message(name, scene())
    msg.data = msg.data[:-1]
    with pytest.raises(SensorDataError, match=f"expected {HEIGHT} rows of {WIDTH} {name}"):
        gray_from_msg(msg)


INFO = CameraInfo(640, 480, np.array([[554.0, 0.0, 320.5], [0.0, 552.0, 241.5], [0.0, 0.0, 1.0]]), np.full(5, 0.01))


def calibration(binning: tuple[int, int] = (0, 0), roi: tuple[int, int, int, int] = (0, 0, 0, 0)) -> CameraInfoMsg:
    msg = camera_info_to_msg(INFO, 0.0, "camera")
    msg.binning_x, msg.binning_y = binning
    msg.roi.x_offset, msg.roi.y_offset, msg.roi.width, msg.roi.height = roi
    return msg


@pytest.mark.parametrize("binning", [(0, 0), (1, 1), (2, 2), (2, 4)])
@pytest.mark.parametrize("roi", [(0, 0, 0, 0), (0, 0, 640, 480), (80, 40, 320, 240), (321, 17, 300, 400)])
def test_a_point_is_seen_where_the_part_of_the_image_has_it(
    binning: tuple[int, int], roi: tuple[int, int, int, int]
) -> None:
    info = camera_info_from_msg(calibration(binning, roi))
    point = np.array([0.3, -0.2, 2.0])
    full = INFO.K @ point / point[2]
    part = info.K @ point / point[2]
    scale = np.maximum(binning, 1)
    assert part[:2] == pytest.approx((full[:2] - roi[:2]) / scale)
    size = (640, 480) if roi[2] == 0 else roi[2:]
    assert (info.width, info.height) == (size[0] // scale[0], size[1] // scale[1])
    assert info.D.tolist() == INFO.D.tolist()


@pytest.mark.parametrize("roi", [(600, 0, 41, 480), (0, 300, 640, 181), (0, 0, 640, 0), (0, 0, 0, 480)])
def test_a_part_that_is_not_in_the_image_is_refused(roi: tuple[int, int, int, int]) -> None:
    with pytest.raises(SensorDataError, match=r"roi of .* expected a part of the image of 640 x 480 pixels"):
        camera_info_from_msg(calibration(roi=roi))


def test_images_come_raw_or_compressed(ros: FakeRos, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    monkeypatch.setattr("rospy.resolve_name", lambda topic: f"/p3dx/{topic}")
    assert inlet_of(CameraImage).topic == "camera/image_raw"
    ros.params["~image_transport"] = "compressed"
    inlet = inlet_of(CameraImage)
    assert (inlet.topic, inlet.cls) == ("/p3dx/camera/image_raw/compressed", CompressedImage)
    data = cv2.imencode(".png", scene())[1].tobytes()
    image = inlet.convert(CompressedImage(data=data))
    assert image.gray().shape == (HEIGHT, WIDTH)
    assert image.rgb()[0, 0].tolist() == scene()[0, 0, ::-1].tolist()
    ros.params["~image_transport"] = "theora"
    with pytest.raises(ParameterError, match=r"theora.*raw or compressed"):
        inlet_of(CameraImage)


def test_a_picture_that_was_sent_is_the_same() -> None:
    rgb = scene()
    assert (rgb_from_msg(image_to_msg(rgb, 0.0, "camera", "rgb8")) == rgb).all()
