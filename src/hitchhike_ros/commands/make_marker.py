"""Writes a marker to print, true to size: NAME.pdf and NAME.png, with id, size and a ruler to check the print.

It is an AprilTag (--id) or a QR code (--qr). Needs no ROS master.
"""

from __future__ import annotations

from pathlib import Path

import click
import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.commands.command_line import SETTINGS, help_of, run
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.servoing.marker_sheet import PAPERS_MM, Sheet, write_sheet
from hitchhike_ros.servoing.tag_cells import DICTIONARIES, QUIET_CELLS, tag_cells

_QR_QUIET = 4  # ISO/IEC 18004


@click.command("make_marker", help=help_of(__doc__), context_settings=SETTINGS)
@click.option(
    "--id",
    "tag_id",
    metavar="N",
    type=click.IntRange(min=0),
    help="Number of an AprilTag: 0 and 1 for the rear markers of robots, 10 and up for walls.",
)
@click.option("--qr", metavar="MESSAGE", help="A QR code with this text instead.")
@click.option("--family", type=click.Choice(list(DICTIONARIES)), default="36h11", show_default=True, help="Of the tag.")
@click.option(
    "--size",
    metavar="M",
    type=float,
    default=0.16,
    show_default=True,
    help="Width of the outer black square, or of the QR code's modules, in m.",
)
@click.option("--paper", type=click.Choice(list(PAPERS_MM)), default="A4", show_default=True)
@click.option(
    "--dpi",
    metavar="50..1200",
    type=click.IntRange(50, 1200),
    default=300,
    show_default=True,
    help="Pixels per inch of the PNG.",
)
@click.option(
    "--output",
    metavar="NAME",
    type=click.Path(path_type=Path),
    help="Files to write, without suffix.  [default: tag36h11_0, qr]",
)
def command(
    tag_id: int | None, qr: str | None, family: str, size: float, paper: str, dpi: int, output: Path | None
) -> None:
    """Draw one marker."""
    if (tag_id is None) == (qr is None):
        raise click.UsageError("expected either --id or --qr")
    if tag_id is not None:
        cells, quiet = tag_cells(family, tag_id), QUIET_CELLS
        cells = cells[quiet:-quiet, quiet:-quiet]
        title, name = f"AprilTag {family} id {tag_id}", f"tag{family}_{tag_id}"
    else:
        cells, quiet = qr_cells(qr or ""), _QR_QUIET
        title, name = f"QR code “{qr}”", "qr"
    output = output or Path(name)
    try:
        files = write_sheet(Sheet(cells, quiet, size, title, paper), output.with_name(output.name + ".pdf"), dpi)
    except OSError as exc:
        raise click.FileError(str(exc.filename), exc.strerror) from exc
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


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros make_marker``."""
    run(command)
