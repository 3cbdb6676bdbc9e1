"""Images of maps, held against map_server's own rules, and bounded in time and memory."""

from __future__ import annotations

import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from hitchhike_ros.core.errors import MapFileError
from hitchhike_ros.mapping.map_file import load_map


def write(folder: Path, image: bytes, mode: str = "trinary", **changes: object) -> Path:
    fields = {
        "image": "image",
        "resolution": 0.05,
        "origin": "[0, 0, 0]",
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        "mode": mode,
        **changes,
    }
    (folder / "image").write_bytes(image)
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in fields.items()))
    return path


def map_server(pixels: np.ndarray, has_alpha: bool, mode: str, negate: bool, occupied: float, free: float) -> list:
    """Rows, lowest first, by the rules of map_server 1.17 of pixels (H, W, channels) in the order of SDL's memory."""
    grid = []
    for row in pixels[::-1].tolist():
        cells = []
        for pixel in row:
            counted = pixel if mode == "trinary" or not has_alpha else pixel[:-1]
            average = sum(counted) / len(counted)
            alpha = 1 if len(pixel) == 1 else pixel[-1]
            average = 255 - average if negate else average
            occupancy = (255 - average) / 255.0
            if mode == "raw":
                value = int(average) if int(average) <= 100 else -1  # more is no value of an occupancy grid
            elif occupancy > occupied:
                value = 100
            elif occupancy < free:
                value = 0
            elif mode == "trinary" or alpha < 1.0:
                value = -1
            else:
                value = int(1 + 98 * ((occupancy - free) / (occupied - free)))
            cells.append(value)
        grid.append(cells)
    return grid


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def bmp(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".bmp", pixels)[1].tobytes()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def raw_png(width: int, height: int, depth: int, colour: int, rows: bytes, *more: bytes, interlaced: int = 0) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + b"".join(more)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


RNG = np.random.default_rng(7)
GREY = RNG.integers(0, 256, (13, 9), dtype=np.uint8)
GREY[0] = [0, 1, 50, 88, 89, 90, 204, 205, 255]
COLOUR = RNG.integers(0, 256, (13, 9, 3), dtype=np.uint8)
COLOUR[0, :, 0] = 0
WITH_ALPHA = RNG.integers(0, 256, (13, 9, 4), dtype=np.uint8)
WITH_ALPHA[:5, :, 3] = 0
WITH_ALPHA[5:8, :, 3] = 255

# Each kind of image: its bytes, its pixels as SDL has them, and whether SDL sees alpha.
KINDS = {
    "P5": (b"P5\n# made\n9 13\n255\n" + GREY.tobytes(), GREY, False),
    "P2": (b"P2 9 13 255 " + b" ".join(b"%d" % v for v in GREY.ravel()), GREY, False),
    "P6": (b"P6 9 13 255\n" + COLOUR.tobytes(), COLOUR, False),
    "P3": (b"P3 9 13\n255 " + b"\n".join(b"%d" % v for v in COLOUR.ravel()), COLOUR, False),
    "grey PNG": (png(GREY), GREY, False),
    "PNG": (png(COLOUR[:, :, ::-1]), COLOUR, False),
    "PNG with alpha": (png(WITH_ALPHA), WITH_ALPHA, True),
    "grey BMP": (bmp(GREY), GREY, False),
    "BMP": (bmp(COLOUR), COLOUR, False),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize(("occupied", "free"), [(0.65, 0.196), (0.5, 0.5), (0.9, 0.1), (1.0, 0.0)])
def test_as_map_server(tmp_path, kind, mode, negate, occupied, free):
    image, pixels, has_alpha = KINDS[kind]
    path = write(tmp_path, image, mode, negate=negate, occupied_thresh=occupied, free_thresh=free)
    expected = map_server(np.atleast_3d(pixels), has_alpha, mode, bool(negate), occupied, free)
    assert load_map(path).data.tolist() == expected


@pytest.mark.parametrize(
    "name",
    [
        "maps/willow-2010-02-18-0.10",
        "radish/aces-all",
        "radish/freiburg-079r-half",
        "radish/freiburg-079r-odd",
        "radish/intel-all",
    ],
)
def test_maps_of_others_as_map_server(shared_data, name):
    path = shared_data / f"{name}.yaml"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    pixels = cv2.imread(str(path.with_suffix(".pgm")), cv2.IMREAD_UNCHANGED)
    lines = dict(line.split(":", 1) for line in path.read_text().splitlines() if ":" in line)
    occupied, free = float(lines["occupied_thresh"]), float(lines["free_thresh"])
    values = [
        map_server(np.full((1, 1, 1), v), False, "trinary", bool(int(lines["negate"])), occupied, free)[0][0]
        for v in range(256)
    ]
    np.testing.assert_array_equal(load_map(path).data, np.array(values)[pixels[::-1]])


@pytest.mark.parametrize("maxval", [1, 2, 15, 100, 254, 255, 256, 1000, 4095, 65535])
@pytest.mark.parametrize("kind", ["P5", "P2"])
def test_samples_are_scaled_from_their_maxval(tmp_path, kind, maxval):
    samples = [0, maxval // 3, maxval // 2, maxval]
    data = np.array(samples, ">u2" if maxval > 255 else np.uint8).tobytes()
    body = data if kind == "P5" else " ".join(map(str, samples)).encode()
    path = write(tmp_path, f"{kind} 4 1 {maxval}\n".encode() + body)
    scaled = np.array([[[value * 255 // maxval] for value in samples]])
    assert load_map(path).data.tolist() == map_server(scaled, False, "trinary", False, 0.65, 0.196)
    assert load_map(path).data[0, [0, 3]].tolist() == [100, 0]


@pytest.mark.parametrize(
    "image",
    [b"P1 9 2\n1 0 0 0 0 0 0 0 1\n000000011", b"P1\n#a\n9 2 100000001#b 1\n000000011", b"P4 9 2\n\x80\x80\x01\x80"],
)
def test_bits_are_black_where_they_are_set(tmp_path, image):
    expected = [[0, 0, 0, 0, 0, 0, 0, 100, 100], [100, 0, 0, 0, 0, 0, 0, 0, 100]]
    assert load_map(write(tmp_path, image)).data.tolist() == expected


def test_numbers_and_comments_of_a_plain_image_go_over_pieces(tmp_path):
    samples = RNG.integers(0, 256, (300, 701))
    comments = ("# 12 \n", " ")
    text = "".join(f"{v}{comments[i % 1001 > 0]}" for i, v in enumerate(samples.ravel()))
    found = load_map(write(tmp_path, b"P2\n701 300\n255\n" + text.encode(), "raw")).data
    np.testing.assert_array_equal(found, np.where(samples > 100, -1, samples)[::-1])


def test_a_png_of_16_bits_keeps_the_upper_8_as_sdl_image_does(tmp_path):
    samples = np.array([[0x0000, 0x18FF, 0x64FF, 0x6500, 0xFFFF]], np.uint16)
    assert load_map(write(tmp_path, png(samples), "raw")).data.tolist() == [[0, 0x18, 0x64, -1, -1]]
    colour = np.repeat(samples[:, :, None], 3, axis=2)
    assert load_map(write(tmp_path, png(colour), "raw")).data.tolist() == [[0, 0x18, 0x64, -1, -1]]
    with_alpha = np.dstack([colour, np.array([[0, 0, 1, 65535, 65535]], np.uint16)])
    assert load_map(write(tmp_path, png(with_alpha), "raw")).data.tolist() == [[0, 0x18, 0x64, -1, -1]]


@pytest.mark.parametrize(("depth", "row"), [(1, b"\x00\x50"), (2, b"\x00\x33"), (4, b"\x00\x0f\x0f")])
def test_few_bits_a_pixel(tmp_path, depth, row):
    grey = raw_png(4, 1, depth, 0, row)
    assert load_map(write(tmp_path, grey)).data.tolist() == [[100, 0, 100, 0]]
    palette = bytes([10, 10, 10] + [250, 254, 252] * (2**depth - 1))
    coloured = raw_png(4, 1, depth, 3, row, chunk(b"PLTE", palette))
    assert load_map(write(tmp_path, coloured)).data.tolist() == [[100, 0, 100, 0]]


def test_grey_with_alpha_and_a_palette_with_alpha(tmp_path):
    # SDL_image makes three colours and alpha of both.
    grey = raw_png(3, 1, 8, 4, b"\x00" + bytes([0, 255, 100, 0, 100, 255]))
    assert load_map(write(tmp_path, grey, "raw")).data.tolist() == [[0, 100, 100]]
    assert load_map(write(tmp_path, grey, "scale")).data.tolist() == [
        [100, -1, 1 + int(98 * (155 / 255 - 0.196) / 0.454)]
    ]
    more = chunk(b"PLTE", bytes([100] * 9)), chunk(b"tRNS", bytes([0, 128, 255]))
    found = load_map(write(tmp_path, raw_png(3, 1, 8, 3, b"\x00\x00\x01\x02", *more), "scale")).data
    assert (found[0, 0], found[0, 1] > 0, found[0, 2] > 0) == (-1, True, True)


@pytest.mark.parametrize("depth", [1, 4, 8])
def test_bitmaps_with_a_palette(tmp_path, depth):
    palette = bytes([10, 10, 10, 0] + [250, 250, 250, 0] * (2**depth - 1))
    row = {1: b"\x50", 4: b"\x01\x01", 8: b"\x00\x01\x00\x01"}[depth].ljust(4, b"\0")
    start = 54 + len(palette)
    header = b"BM" + struct.pack("<IIIIiiHHIIiiII", 0, 0, start, 40, 4, -1, 1, depth, 0, 0, 0, 0, 0, 0)
    assert load_map(write(tmp_path, header + palette + row)).data.tolist() == [[100, 0, 100, 0]]


HUGE = struct.pack(">IIBBBBB", 30_000, 6_000, 8, 6, 0, 0, 0)
SOUND = png(GREY)


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (b"", "PGM, PNG or BMP"),
        (b"P7 3 3", "PGM, PNG or BMP"),
        (b"GIF89a", "PGM, PNG or BMP"),
        (b"P5", "width"),
        (b"P5 3", "width"),
        (b"P5 3 -3 255\n", "height"),
        (b"P5 3 3 0\n" + bytes(9), "maxval"),
        (b"P5 3 3 65536\n" + bytes(18), "maxval"),
        (b"P5 0 3 255\n", "pixels"),
        (b"P5 99999999999 3 255\n", "width"),
        (b"P5 99999 99999 255\n", "pixels"),
        (b"P5 3 3 255\n" + bytes(8), "complete"),
        (b"P5 3 3 256\n" + bytes(17), "complete"),
        (b"P5 3 1 100\n" + bytes([0, 100, 101]), "its maxval, not of 101"),
        (b"P2 3 1 255\n1 2", "complete"),
        (b"P2 3 1 255\n1 2      ", "complete"),
        (b"P2 3 1 255\n1 2 -3", "digits"),
        (b"P2 3 1 255\n1 2 99999999999999999999999", "maxval"),
        (b"P2 3 1 255\n1 2 x", "digits"),
        (b"P1 3 1\n1 0 2", "maxval"),
        (b"P5 " + b"#\n" * 100_000, "width"),
        (b"BM", "BMP"),
        (bmp(GREY)[:-1], "complete"),
        (SOUND[:-13], "complete"),
        (SOUND[:40], "PNG"),
        (SOUND[:60] + bytes([SOUND[60] ^ 1]) + SOUND[61:], "check sum|sound"),
        (SOUND[:8] + chunk(b"IHDR", HUGE) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b""), "complete"),
        (raw_png(9, 13, 8, 0, bytes(10 * 12)), "complete"),
        (raw_png(9, 13, 8, 0, b"\x07" + bytes(10 * 13 - 1)), "decoded"),
        (raw_png(9, 13, 3, 0, bytes(10 * 13)), "standard"),
        (raw_png(9, 13, 8, 3, bytes(10 * 13)), "palette"),
        (raw_png(9, 13, 8, 0, bytes(200), interlaced=2), "standard"),
        (raw_png(9, 13, 8, 0, bytes(200), chunk(b"acTL", bytes(8))), "animated"),
    ],
)
def test_a_broken_image_is_refused_at_once(tmp_path, image, expected):
    path = write(tmp_path, image)
    started = time.process_time()
    with pytest.raises(MapFileError, match=expected) as caught:
        load_map(path)
    assert caught.value.field == "image"
    assert time.process_time() - started < 1.0


def test_an_interlaced_png(tmp_path):
    # Of 2 x 2 pixels, the first pass has one, the sixth one and the last one row of two.
    image = raw_png(2, 2, 8, 0, bytes([0, 10, 0, 20, 0, 30, 40]), interlaced=1)
    assert load_map(write(tmp_path, image, "raw")).data.tolist() == [[30, 40], [10, 20]]


_PEAK = """
import re, sys
from pathlib import Path
from hitchhike_ros.mapping.map_file import load_map
def peak(): return int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text()).group(1)) * 1024
base = peak()
cells = load_map(sys.argv[1]).data.size
print((peak() - base) / cells)
"""


@pytest.mark.parametrize("kind", ["grey.png", "colour.png", "alpha.png", "plain.pgm", "deep.pgm", "colour.bmp"])
def test_a_map_takes_no_more_than_4_bytes_a_cell_and_a_few_mb(tmp_path, kind):
    pixels = np.full((2000, 2000), 205, np.uint8)
    pixels[300:1700, 300:1700] = 254
    image = {
        "grey.png": lambda: png(pixels),
        "colour.png": lambda: png(np.repeat(pixels[:, :, None], 3, axis=2)),
        "alpha.png": lambda: png(np.repeat(pixels[:, :, None], 4, axis=2)),
        "plain.pgm": lambda: b"P2 2000 2000 255\n" + (b"254 " * 4_000_000),
        "deep.pgm": lambda: b"P5 2000 2000 65535\n" + (pixels.astype(">u2") * 257).tobytes(),
        "colour.bmp": lambda: bmp(np.repeat(pixels[:, :, None], 3, axis=2)),
    }[kind]()
    path = write(tmp_path, image)
    found = subprocess.run(
        [sys.executable, "-c", _PEAK, str(path)], check=True, capture_output=True, text=True, timeout=60
    )
    assert float(found.stdout) < 4.0 + 4e6 / pixels.size
