"""Grid maps and scenarios of the Moving AI benchmarks (Sturtevant, IEEE TCIAIG 4(2), 2012).

The files count rows from the top; grids here count them from the bottom, so that a map looks the same in both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hitchhike_ros.core.errors import MapFileError
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, OccupancyGrid

# Swamp and water (S, W) have rules of their own about who may enter them from where, which a grid cannot keep.
_VALUES = {".": FREE, "G": FREE, "@": OCCUPIED, "O": OCCUPIED, "T": OCCUPIED}


@dataclass(frozen=True)
class SearchProblem:
    """A problem on a map: cells as (row, column) of the grid, and the optimal length in cells as the file rounds it.

    A step costs 1 or √2, and a diagonal one needs both cells beside it free.
    """

    map: str
    start: tuple[int, int]
    goal: tuple[int, int]
    length: float


def load_moving_ai_map(path: Path | str, resolution: float = 1.0) -> OccupancyGrid:
    """The grid of a ``.map`` file of type octile; the files do not say how large a cell is, in m.

    Raises:
        MapFileError: names the file, the field or line, its value and what was expected.
    """
    lines = _lines(path)
    header = dict(zip(("type", "height", "width", "map"), (line.split() for line in lines), strict=False))
    for name, words in header.items():
        if len(words) != (1 if name == "map" else 2) or words[0] != name:
            expected = f"the header of a Moving AI map: type, height, width, map; here {name}"
            raise MapFileError(path, name, " ".join(words), expected)
    if len(header) < 4:
        raise MapFileError(path, "", f"{len(lines)} lines", "the header of a Moving AI map")
    if header["type"][1] != "octile":
        raise MapFileError(path, "type", header["type"][1], "octile")
    height, width = (_size(path, name, header[name][1]) for name in ("height", "width"))
    rows = lines[4:]
    if len(rows) != height:
        raise MapFileError(path, "map", f"{len(rows)} rows", f"as many as height says ({height})")
    for number, row in enumerate(rows, start=5):
        if len(row) != width:
            raise MapFileError(path, f"line {number}", f"{len(row)} cells", f"as many as width says ({width})")
        for cell in row:
            if cell not in _VALUES:
                raise MapFileError(path, f"line {number}", cell, f"cells of {' '.join(_VALUES)} only")
    data = np.array([[_VALUES[cell] for cell in row] for row in rows], dtype=np.int8)
    return OccupancyGrid(np.flipud(data), resolution)


def load_problems(path: Path | str) -> list[SearchProblem]:
    """The problems of a ``.scen`` file, version 1.

    Raises:
        MapFileError: names the file, the line, its value and what was expected.
    """
    lines = _lines(path)
    if not lines or lines[0].split() not in (["version", "1"], ["version", "1.0"]):
        raise MapFileError(path, "line 1", lines[0] if lines else "", "version 1")
    return [_scenario(path, f"line {number}", line) for number, line in enumerate(lines[1:], start=2) if line.strip()]


def _scenario(path: Path | str, field: str, line: str) -> SearchProblem:
    expected = "bucket, map, width, height, start x, start y, goal x, goal y, optimal length"
    try:
        _bucket, name, *numbers, optimal = line.split()
        width, height, start_x, start_y, goal_x, goal_y = (int(number) for number in numbers)
        length = float(optimal)
    except ValueError as exc:
        raise MapFileError(path, field, line, expected) from exc
    for x, y in ((start_x, start_y), (goal_x, goal_y)):
        if not (0 <= x < width and 0 <= y < height):
            raise MapFileError(path, field, f"{x} {y}", f"a cell of a map of {width} x {height}")
    if not 0 <= length < math.inf:
        raise MapFileError(path, field, length, "a length")
    return SearchProblem(name, (height - 1 - start_y, start_x), (height - 1 - goal_y, goal_x), length)


def _lines(path: Path | str) -> list[str]:
    try:
        text = Path(path).read_text(encoding="ascii")
    except OSError as exc:
        raise MapFileError(path, "", exc.strerror, "a readable file") from exc
    except UnicodeDecodeError as exc:
        raise MapFileError(path, "", f"byte {exc.start} is no ASCII", "a text file of Moving AI") from exc
    return text.rstrip().splitlines()


def _size(path: Path | str, name: str, value: str) -> int:
    if not value.isdecimal() or int(value) == 0:
        raise MapFileError(path, name, value, "a whole number above 0")
    return int(value)
