"""AprilTags as pictures, and as textured plates of the simulated world."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pybullet as p

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


def tag_image(family: str, tag_id: int, pixels_per_cell: int = 24) -> tuple[npt.NDArray[np.uint8], float]:
    """An upright tag with its white border, (N, N) grey, and the ratio of the picture's side to the black square's.

    Raises:
        VisionError: unknown family, or the family has no such id.
    """
    if family not in DICTIONARIES:
        raise VisionError(f"tag family is {family!r}, expected one of {', '.join(DICTIONARIES)}")
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
    if not 0 <= tag_id < len(dictionary.bytesList):
        raise VisionError(f"tag id is {tag_id}, expected 0 to {len(dictionary.bytesList) - 1} in family {family}")
    cells = dictionary.markerSize + 2
    tag = dictionary.generateImageMarker(tag_id, cells * pixels_per_cell)
    picture = np.pad(tag, QUIET_CELLS * pixels_per_cell, constant_values=255).astype(np.uint8)
    return picture, 1.0 + 2.0 * QUIET_CELLS / cells


def write_tag(marker: Marker, folder: Path, board_m: float = 0.0) -> tuple[Path, Path]:
    """A mesh (OBJ) in the marker's frame (x outward normal, z up) and its picture (PNG), seen from outside only.

    ``board_m`` is the thickness of the board it is printed on: the EGL renderer's depth has 16 bits, so what lies
    closer than some millimetres behind the picture would shine through it.

    Raises:
        VisionError: as :func:`tag_image`.
    """
    picture, ratio = tag_image(marker.family, marker.id)
    half = ratio * marker.size_m / 2.0
    stem = f"tag_{marker.family}_{marker.id}"
    image, mesh = folder / f"{stem}.png", folder / f"{stem}.obj"
    cv2.imwrite(str(image), picture)
    # Who looks along -x with z up has +y to the right: there the picture's right edge (u = 1) belongs.
    corners = ((-half, -half, 0, 0), (half, -half, 1, 0), (half, half, 1, 1), (-half, half, 0, 1))
    lines = [f"v {board_m} {y} {z}" for y, z, _, _ in corners]
    lines += [f"vt {u} {v}" for _, _, u, v in corners]
    lines += ["vn 1 0 0", "f 1/1/1 2/2/1 3/3/1", "f 1/1/1 3/3/1 4/4/1"]
    mesh.write_text("\n".join(lines) + "\n", encoding="ascii")
    return mesh, image


def paste(client: int, body: int, link: int, image: Path) -> None:
    """Put the picture of :func:`write_tag` on its mesh, the visual shape of a body's link."""
    texture = p.loadTexture(str(image), physicsClientId=client)
    matte = [0.0, 0.0, 0.0]
    p.changeVisualShape(
        body, link, textureUniqueId=texture, rgbaColor=[1.0] * 4, specularColor=matte, physicsClientId=client
    )
