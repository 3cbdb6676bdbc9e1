"""Map files of map_server: a YAML beside a PGM, PNG or BMP image."""

from __future__ import annotations

import math
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
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

Mode = Literal["trinary", "scale", "raw"]

# What map_saver writes: grey values and thresholds that the reader takes for free, occupied and unknown.
PIXEL_FREE, PIXEL_OCCUPIED, PIXEL_UNKNOWN = 254, 0, 205
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196


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
    image = _read_image(path, description.image)
    data = _values(image, description)
    x, y, yaw = description.origin
    return OccupancyGrid(np.flipud(data), description.resolution, Pose2D(x, y, yaw))


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
    content = read_yaml(path, MapFileError)
    known = {f.name for f in fields(_MapYaml)}
    for name in known - {"mode"}:
        if name not in content:
            raise MapFileError(path, name, None, "a value: every map_server YAML has this field")
    if isinstance(content["negate"], bool):
        content["negate"] = int(content["negate"])
    description = convert({key: content[key] for key in known & set(content)}, _MapYaml, path, error=MapFileError)
    if not math.isfinite(description.resolution):
        raise MapFileError(path, "resolution", description.resolution, "a finite number of metres per pixel")
    if not all(math.isfinite(value) for value in description.origin):
        raise MapFileError(path, "origin", list(description.origin), "finite [x, y, yaw]")
    if not description.free_thresh < description.occupied_thresh:
        expected = f"less than occupied_thresh ({description.occupied_thresh})"
        raise MapFileError(path, "free_thresh", description.free_thresh, expected)
    return description


def _read_image(path: Path, name: str) -> npt.NDArray[np.float64]:
    """The image's pixels, (H, W, channels) in 0–255, top row first."""
    file = path.parent / name
    if not file.is_file():
        raise MapFileError(path, "image", name, f"an image file; {file} is not one")
    try:
        pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    except cv2.error as exc:
        raise MapFileError(path, "image", name, f"a PGM, PNG or BMP image ({exc.err})") from exc
    if pixels is None:
        raise MapFileError(path, "image", name, "a PGM, PNG or BMP image that can be read")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise MapFileError(path, "image", name, f"an image of 8 or 16 bits a channel, not of {pixels.dtype}")
    return np.atleast_3d(pixels) * (255.0 / np.iinfo(pixels.dtype.name).max)


def _values(pixels: npt.NDArray[np.float64], description: _MapYaml) -> npt.NDArray[np.int8]:
    """Cell values (H, W) of pixels (H, W, channels), by the rules of map_server's image loader."""
    channels = pixels.shape[2]
    has_alpha = channels in (2, 4)
    # map_server's trinary mode averages alpha as if it were a colour; maps that rely on it must read the same.
    colours = pixels if description.mode == "trinary" or not has_alpha else pixels[:, :, :-1]
    grey = colours.mean(axis=2)
    if description.negate:
        grey = 255.0 - grey
    if description.mode == "raw":
        return np.where(grey > OCCUPIED, UNKNOWN, grey).astype(np.int8)
    occupancy = (255.0 - grey) / 255.0
    occupied, free = occupancy > description.occupied_thresh, occupancy < description.free_thresh
    between = np.full(grey.shape, UNKNOWN, dtype=np.float64)
    if description.mode == "scale":
        span = description.occupied_thresh - description.free_thresh
        opaque = pixels[:, :, -1] > 0 if has_alpha else np.ones(grey.shape, dtype=bool)
        between = np.where(opaque, 1.0 + 98.0 * (occupancy - description.free_thresh) / span, UNKNOWN)
    return np.select([occupied, free], [OCCUPIED, FREE], between).astype(np.int8)
