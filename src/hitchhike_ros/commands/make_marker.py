"""usage: rosrun hitchhike_ros make_marker (--id N | --qr MESSAGE) [OPTIONS]

Writes a marker to print, true to size: NAME.pdf and NAME.png, with id, size and a ruler to check the print.
Needs no ROS master.

  --id N           number of an AprilTag: 0 and 1 for the robots' plates, 10 and up for walls
  --qr MESSAGE     a QR code with this text instead
  --family FAMILY  of the tag: 16h5, 25h9, 36h10 or 36h11 (36h11)
  --size M         width of the outer black square, or of the QR code's modules, in m (0.16)
  --paper PAPER    A4, A3, A2, letter or tabloid (A4)
  --dpi N          pixels per inch of the PNG (300)
  --output NAME    files to write, without suffix (tag36h11_0, qr)
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.errors import HitchhikeError, VisionError
from hitchhike_ros.servoing.marker_sheet import Sheet, write_sheet
from hitchhike_ros.servoing.tag_cells import QUIET_CELLS, tag_cells

_QR_QUIET = 4  # ISO/IEC 18004


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros make_marker``."""
    parser = argparse.ArgumentParser("make_marker", usage=str(__doc__).removeprefix("usage: "))
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--id", type=int)
    what.add_argument("--qr")
    parser.add_argument("--family", default="36h11")
    parser.add_argument("--size", type=float, default=0.16)
    parser.add_argument("--paper", default="A4")
    parser.add_argument("--dpi", type=int, choices=range(50, 1201), metavar="50..1200", default=300)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    try:
        if arguments.qr is None:
            cells, quiet = tag_cells(arguments.family, arguments.id), QUIET_CELLS
            cells = cells[quiet:-quiet, quiet:-quiet]
            title, name = f"AprilTag {arguments.family} id {arguments.id}", f"tag{arguments.family}_{arguments.id}"
        else:
            cells, quiet = qr_cells(arguments.qr), _QR_QUIET
            title, name = f"QR code “{arguments.qr}”", "qr"
        sheet = Sheet(cells, quiet, arguments.size, title, arguments.paper)
        output = arguments.output or Path(name)
        files = write_sheet(sheet, output.with_name(output.name + ".pdf"), arguments.dpi)
    except HitchhikeError as exc:
        sys.exit(f"make_marker: {exc}")
    except OSError as exc:
        sys.exit(f"make_marker: {exc.filename}: {exc.strerror}")
    print(*files, sep="\n")


def qr_cells(message: str) -> npt.NDArray[np.bool_]:
    """Modules (N, N) of a QR code; true is white.

    Raises:
        VisionError: the message is empty or too long.
    """
    try:
        code = cv2.QRCodeEncoder.create().encode(message) if message else None
    except cv2.error as exc:
        raise VisionError(f"QR message of {len(message)} characters: {exc.err}") from exc
    if code is None or code.size == 0:
        raise VisionError("QR message is empty, expected some characters")
    rows, columns = np.flatnonzero((code == 0).any(axis=1)), np.flatnonzero((code == 0).any(axis=0))
    return np.asarray(code[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] > 0)
