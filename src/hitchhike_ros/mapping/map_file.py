"""Map files of map_server: a YAML beside a PGM, PNG or BMP image."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from hitchhike_ros.core.datatypes import Pose2D, Positive, UnitInterval
from hitchhike_ros.core.errors import MapFileError
from hitchhike_ros.core.parameters import convert, read_yaml
from hitchhike_ros.core.yaml_text import parse_yaml_text
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from hitchhike_ros.mapping.map_image import ImageError, MapImage, read_image

Mode = Literal["trinary", "scale", "raw"]

# What map_saver writes: grey values and thresholds that the reader takes for free, occupied and unknown.
PIXEL_FREE, PIXEL_OCCUPIED, PIXEL_UNKNOWN = 254, 0, 205
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196

_BAND = 1 << 18


@dataclass(frozen=True)
class _MapYaml:
    """The fields of a map_server YAML; others are ignored, as map_server does."""

    image: str
    resolution: Positive
    origin: tuple[float, float, float]
    negate: Literal[0, 1]
    occupied_thresh: UnitInterval
    free_thresh: UnitInterval
    mode: Mode = "trinary"


def load_map(path: Path | str) -> OccupancyGrid:
    """The grid of a map_server YAML file.

    Trinary: dark pixels are occupied, light ones free, others unknown. Scale: those between the thresholds get 1–99,
    transparent ones unknown. Raw: the pixel is the value, above 100 unknown. ``negate`` swaps light and dark.
    A relative image path starts at the YAML's folder.

    Raises:
        MapFileError: names the file, the field, its value and what was expected.
    """
    path = Path(path)
    description = _read_description(path)
    data = _cells(_read_image(path, description.image), description)
    x, y, yaw = description.origin
    return OccupancyGrid(data, description.resolution, Pose2D(x, y, yaw))


def save_map(grid: OccupancyGrid, path: Path | str) -> None:
    """Write ``path`` (YAML) and a PGM of the same stem beside it; :func:`load_map` reads back the same grid.

    A grid of free, occupied and unknown cells is written as map_saver does; one with values between in raw mode.

    Raises:
        MapFileError: the files cannot be written.
    """
    path = Path(path)
    trinary = bool(np.isin(grid.data, (FREE, OCCUPIED, UNKNOWN)).all())
    if trinary:
        table = {FREE: PIXEL_FREE, OCCUPIED: PIXEL_OCCUPIED, UNKNOWN: PIXEL_UNKNOWN}
        pixels = np.select([grid.data == value for value in table], list(table.values())).astype(np.uint8)
    else:
        pixels = np.where(grid.data < 0, 255, grid.data).astype(np.uint8)
    image = path.with_suffix(".pgm")
    header = f"P5\n# CREATOR: hitchhike_ros {grid.resolution:.3f} m/pix\n{grid.width} {grid.height}\n255\n"
    origin = ", ".join(repr(float(value)) for value in (grid.origin.x, grid.origin.y, grid.origin.theta))
    lines = [
        yaml.safe_dump({"image": image.name}, allow_unicode=True, width=math.inf).strip(),  # quoted where it has to be
        f"resolution: {float(grid.resolution)!r}",
        f"origin: [{origin}]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESH}",
        f"free_thresh: {FREE_THRESH}",
        *([] if trinary else ["mode: raw"]),
    ]
    try:
        image.write_bytes(header.encode() + np.flipud(pixels).tobytes())
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as exc:
        raise MapFileError(exc.filename, "", exc.strerror, "a file that can be written") from exc


def trinary(grid: OccupancyGrid, free_percent: int = 25, occupied_percent: int = 65) -> OccupancyGrid:
    """``grid`` with free, occupied and unknown cells only, told apart as map_saver does; the defaults are its own.

    Cells up to ``free_percent`` are free, from ``occupied_percent`` on occupied, all others unknown.
    """
    free = (grid.data >= 0) & (grid.data <= free_percent)
    data = np.select([free, grid.data >= occupied_percent], [FREE, OCCUPIED], UNKNOWN).astype(np.int8)
    return replace(grid, data=data)


def _read_description(path: Path) -> _MapYaml:
    content = read_yaml(path, MapFileError, parse_yaml_text)
    values: dict[str, object] = {"mode": "trinary"}
    for name in (f.name for f in fields(_MapYaml)):
        if name in content:
            values[name] = _NUMBERS[name](content[name]) if name in _NUMBERS else content[name]
        elif name != "mode":
            raise MapFileError(path, name, None, "a value: every map_server YAML has this field")
    description = convert(values, _MapYaml, path, error=MapFileError)
    if not math.isfinite(description.resolution):
        raise MapFileError(path, "resolution", description.resolution, "a finite number of metres per pixel")
    if not all(math.isfinite(value) for value in description.origin):
        raise MapFileError(path, "origin", list(description.origin), "finite [x, y, yaw]")
    if not description.free_thresh <= description.occupied_thresh:
        expected = f"at most occupied_thresh ({description.occupied_thresh})"
        raise MapFileError(path, "free_thresh", description.free_thresh, expected)
    return description


def _float(text: object) -> object:
    """The number that yaml-cpp reads in a scalar: always decimal, 010 is 10. What is none stays as it is."""
    if isinstance(text, str):
        if _FLOAT.fullmatch(text):
            return float(text)
        match = _NOT_FINITE.fullmatch(text)
        if match:
            return float(match.group(1) + match.group(2))
    return text


def _origin(value: object) -> object:
    """[x, y, yaw]; map_server ignores what stands behind them."""
    return [_float(item) for item in value[:3]] if isinstance(value, list) else value


def _negate(text: object) -> object:
    """As yaml-cpp reads an int: with the prefixes of C. ``true`` and ``false`` are taken too, as nav2 writes them."""
    match = _INT.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return {"true": 1, "false": 0}.get(text.lower(), text) if isinstance(text, str) else text
    digits = match.group(2)
    base = 16 if digits[:2].lower() == "0x" else 8 if digits[0] == "0" else 10
    return int(match.group(1) + digits, base)


_FLOAT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\s*", re.ASCII)
_NOT_FINITE = re.compile(r"([-+]?)\.(inf|Inf|INF|nan|NaN|NAN)")
_INT = re.compile(r"([-+]?)(0[xX][0-9a-fA-F]{1,7}|0[0-7]{0,10}|[1-9][0-9]{0,8})\s*", re.ASCII)
_NUMBERS: dict[str, Callable[[object], object]] = {
    "resolution": _float,
    "origin": _origin,
    "negate": _negate,
    "occupied_thresh": _float,
    "free_thresh": _float,
}


def _read_image(path: Path, name: str) -> MapImage:
    file = path.parent / name
    if not os.path.isfile(file):  # Path.is_file raises where a name is too long
        raise MapFileError(path, "image", name, f"an image file; {file} is not one")
    try:
        return read_image(file)
    except ImageError as exc:
        raise MapFileError(path, "image", name, str(exc)) from exc
    except OSError as exc:
        raise MapFileError(path, "image", name, f"a file that can be read ({exc.strerror})") from exc


def _cells(image: MapImage, description: _MapYaml) -> npt.NDArray[np.int8]:
    """Cell values (H, W), lowest row first, by the rules of map_server's image loader.

    They take the place of the pixels in the image's buffer, so that a map needs no memory beyond that.
    """
    channels, buffer, cells = image.channels, image.buffer, image.height * image.width
    # map_server's trinary mode averages alpha as if it were a colour; maps that rely on it must read the same.
    colours = 3 if channels == 4 and description.mode != "trinary" else channels
    opaque, transparent = (_value_of_sum(colours, description, is_opaque) for is_opaque in (True, False))
    for first in range(0, cells, _BAND):
        last = min(cells, first + _BAND)
        pixels = buffer[first * channels : last * channels].reshape(-1, channels)
        sums = pixels[:, 0] if channels == 1 else pixels[:, :colours].sum(axis=1, dtype=np.uint16)
        values = opaque[sums]
        if description.mode == "scale" and channels > 1:
            # map_server takes the last byte of a pixel for alpha, also where it is a colour.
            values = np.where(pixels[:, image.sdl_last] > 0, values, transparent[sums])
        buffer[first:last] = values.view(np.uint8)
    del pixels, sums
    buffer.resize(cells, refcheck=False)  # gives the rest of the memory back; no other view of it is left
    buffer.shape = (image.height, image.width)
    cv2.flip(buffer, 0, buffer)
    buffer.setflags(write=False)
    return buffer.view(np.int8)


def _value_of_sum(colours: int, description: _MapYaml, is_opaque: bool) -> npt.NDArray[np.int8]:
    """Cell values by the sum of so many colours, 0 to 255 each."""
    grey = np.arange(255 * colours + 1) / colours
    if description.negate:
        grey = 255.0 - grey
    if description.mode == "raw":
        return np.where(grey.astype(int) > OCCUPIED, UNKNOWN, grey).astype(np.int8)
    occupancy = (255.0 - grey) / 255.0
    between = np.full(grey.shape, UNKNOWN, dtype=np.float64)
    if description.mode == "scale" and is_opaque:
        span = max(description.occupied_thresh - description.free_thresh, 1e-9)
        between = np.clip(1.0 + 98.0 * (occupancy - description.free_thresh) / span, 1.0, 99.0)
    occupied, free = occupancy > description.occupied_thresh, occupancy < description.free_thresh
    return np.select([occupied, free], [OCCUPIED, FREE], between).astype(np.int8)
