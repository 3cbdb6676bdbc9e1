"""AprilTags of the simulated world, as meshes: a renderer without textures shows them too."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import Marker
from hitchhike_ros.servoing.tag_cells import QUIET_CELLS, tag_cells


def write_tag(marker: Marker, folder: Path, board_m: float = 0.0) -> tuple[Path, Path]:
    """Two meshes (OBJ) in the marker's frame (x outward normal, z up): the black cells and the white ones.

    ``board_m`` is the thickness of the board it is printed on: the EGL renderer's depth has 16 bits, so what lies
    closer than some millimetres behind the tag would shine through it.

    Raises:
        VisionError: as :func:`tag_cells`.
    """
    cells = tag_cells(marker.family, marker.id)
    n = len(cells)
    # Who looks along -x with z up has +y to the right: rows go down z, columns go up y. All cells share one lattice of
    # vertices, which leaves no cracks between them.
    edges = (np.arange(n + 1) - n / 2.0) * marker.size_m / (n - 2 * QUIET_CELLS)
    lattice = [f"v {board_m} {y:.6f} {-z:.6f}" for z in edges for y in edges]
    paths = []
    for colour, mask in (("black", ~cells), ("white", cells)):
        faces = []
        for row, column in np.argwhere(mask):
            a = row * (n + 1) + column + 1  # top left, counted from 1
            a, b, c, d = (f"{i}//1" for i in (a, a + n + 1, a + n + 2, a + 1))  # counter-clockwise from outside
            faces += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
        path = folder / f"tag_{marker.family}_{marker.id}_{colour}.obj"
        path.write_text("\n".join([*lattice, "vn 1 0 0", *faces]) + "\n", encoding="ascii")
        paths.append(path)
    return paths[0], paths[1]
