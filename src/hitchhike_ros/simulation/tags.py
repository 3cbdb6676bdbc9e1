"""AprilTags of the simulated world, as meshes: a renderer without textures shows them too."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import Marker
from hitchhike_ros.errors import VisionError

DICTIONARIES = {
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
# White cells around the black edge: one is enough for detectors, two leave room for a blurred edge (chosen).
QUIET_CELLS = 2


def tag_cells(family: str, tag_id: int) -> npt.NDArray[np.bool_]:
    """The cells (N, N) of an upright tag with its white border, top row first; true is white.

    Raises:
        VisionError: unknown family, or the family has no such id.
    """
    if family not in DICTIONARIES:
        raise VisionError(f"tag family is {family!r}, expected one of {', '.join(DICTIONARIES)}")
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
    if not 0 <= tag_id < len(dictionary.bytesList):
        raise VisionError(f"tag id is {tag_id}, expected 0 to {len(dictionary.bytesList) - 1} in family {family}")
    tag = dictionary.generateImageMarker(tag_id, dictionary.markerSize + 2) > 0
    return np.pad(tag, QUIET_CELLS, constant_values=True)


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
