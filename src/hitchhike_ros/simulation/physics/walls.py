"""Walls of the simulated world: the occupied cells of any map, extruded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.mapping.grid import OccupancyGrid

# Four sides and the top of a prism whose corners are 0–3 below and 4–7 above, counter-clockwise from outside.
_FACES = ((0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7))

_MOST_PRISMS = 5000  # of 20 vertices each


def merge_cells(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Disjoint rectangles (N, 4) as (row, column, end row, end column) that cover the mask (H, W), ends exclusive.

    Greedy: runs within a row, grown upwards while the next row has the same run.
    """
    padded = np.zeros(mask.shape[1] + 2, dtype=np.int8)
    open_runs: dict[tuple[int, int], int] = {}
    rectangles = []
    for row in range(len(mask) + 1):  # one empty row behind the last ends every rectangle
        padded[1:-1] = mask[row] if row < len(mask) else 0
        edges = np.diff(padded)
        runs = set(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))
        for run in [run for run in open_runs if run not in runs]:
            rectangles.append((open_runs.pop(run), run[0], row, run[1]))
        for run in runs:
            open_runs.setdefault(run, row)
    return np.array(sorted(rectangles), dtype=np.int64).reshape(-1, 4)


def wall_meshes(grid: OccupancyGrid, height_m: float) -> Iterator[tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]]:
    """As :func:`wall_mesh`, in parts that pybullet takes: it has a limit of 131,072 vertices for each."""
    rectangles = merge_cells(grid.occupied)
    for first in range(0, len(rectangles), _MOST_PRISMS):
        yield wall_mesh(grid, height_m, rectangles[first : first + _MOST_PRISMS])


def wall_mesh(
    grid: OccupancyGrid, height_m: float, rectangles: npt.NDArray[np.int64] | None = None
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Rectangles of cells, by default all that are occupied, as prisms from the floor to ``height_m``.

    Returns:
        Vertices (V, 3) in ``map``, their normals (V, 3) and triangles (T, 3). Vertices are not shared between faces, so
        that edges look sharp. Empty without occupied cells.
    """
    rectangles = merge_cells(grid.occupied) if rectangles is None else rectangles
    if not len(rectangles):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    r0, c0, r1, c1 = rectangles.T
    # cell_to_world gives centres: an edge lies half a cell before.
    corners = np.stack(
        [grid.cell_to_world(np.column_stack(rc) - 0.5) for rc in ((r0, c0), (r0, c1), (r1, c1), (r1, c0))]
    )
    floor = np.dstack([corners, np.zeros(corners.shape[:2])])
    prism = np.concatenate([floor, floor + [0.0, 0.0, height_m]])  # (8, N, 3)
    quads = np.concatenate([prism[list(face)].swapaxes(0, 1) for face in _FACES])  # (5 N, 4, 3)
    normals = np.cross(quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    first = 4 * np.arange(len(quads))[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return quads.reshape(-1, 3), np.repeat(normals, 4, axis=0), triangles


def write_obj(file: Path, vertices: FloatArray, normals: FloatArray, triangles: npt.NDArray[np.int64]) -> None:
    """A mesh as :func:`wall_mesh` returns it, as a Wavefront OBJ file."""
    # One format string a list: big maps have a hundred thousand lines.
    parts = (
        ("v %.4f %.4f %.4f\n", vertices),
        ("vn %.4f %.4f %.4f\n", normals),
        ("f %d//%d %d//%d %d//%d\n", np.repeat(triangles + 1, 2, axis=1)),
    )
    file.write_text("".join(line * len(rows) % tuple(rows.ravel().tolist()) for line, rows in parts), encoding="ascii")
