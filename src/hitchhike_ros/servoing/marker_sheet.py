"""A marker on a sheet of paper, true to size, with what is needed to mount it and to check the print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hitchhike_ros.core.errors import VisionError

PAPERS_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
_MM_PER_INCH = 25.4
_EDGE_MM = 8.0  # what printers leave white
_BELOW_MM = 34.0  # for text and ruler
_RULER_MM = 100.0


@dataclass(frozen=True, eq=False)
class Sheet:
    """A marker to print.

    ``cells`` (N, N): true is white, top row first; a tag with its black edge, or the modules of a QR code.
    ``size_m`` is their width. Around them ``quiet`` white cells are cut out with them where the paper is large enough,
    and at least one.
    """

    cells: npt.NDArray[np.bool_]
    quiet: int
    size_m: float
    title: str
    paper: str = "A4"


def write_sheet(sheet: Sheet, path: Path, dpi: int = 300) -> tuple[Path, Path]:
    """``path`` with the suffixes .pdf (vectors) and .png (pixels that know their size).

    Raises:
        VisionError: unknown paper, or the marker does not fit on it.
        OSError: a file cannot be written.
    """
    if sheet.paper not in PAPERS_MM:
        raise VisionError(f"paper is {sheet.paper!r}, expected one of {', '.join(PAPERS_MM)}")
    width, height = PAPERS_MM[sheet.paper]
    n = len(sheet.cells)
    room = min(width, height - _BELOW_MM)
    largest = min(room - 2 * _EDGE_MM, room * n / (n + 2))
    side = 1e3 * sheet.size_m
    if not 0.0 < side <= largest:
        expected = f"more than 0 and, on {sheet.paper}, at most {largest / 1e3:.3f} m"
        raise VisionError(f"marker size is {sheet.size_m} m, expected {expected}")
    figure = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    axes.set_axis_off()
    quiet = min(sheet.quiet * side / n, 0.5 * (room - side))
    left, bottom = 0.5 * (width - side), 0.5 * (height + _BELOW_MM - side)
    _draw_cells(axes, sheet, left, bottom, side / n)
    cut = Rectangle((left - quiet, bottom - quiet), side + 2 * quiet, side + 2 * quiet)
    cut.set(fill=False, edgecolor="0.7", linewidth=0.4)
    axes.add_patch(cut)
    _draw_notes(axes, sheet, 0.5 * width, bottom - quiet)
    pdf, png = path.with_suffix(".pdf"), path.with_suffix(".png")
    FigureCanvasPdf(figure).print_pdf(pdf)  # type: ignore[no-untyped-call]
    figure.set_dpi(dpi)
    FigureCanvasAgg(figure).print_png(png, metadata={"Title": sheet.title}, pil_kwargs={"dpi": (dpi, dpi)})  # type: ignore[no-untyped-call]
    return pdf, png


def _draw_cells(axes: Axes, sheet: Sheet, left: float, bottom: float, cell: float) -> None:
    """Black cells as one rectangle a run, which leaves no hairlines within a row."""
    n = len(sheet.cells)
    for row in range(n):
        edges = np.flatnonzero(np.diff(np.pad(~sheet.cells[row], 1).astype(np.int8)))
        for first, last in edges.reshape(-1, 2):
            # Rows overlap by a hair, or some viewers show white lines between them.
            below = 0.02 if row + 1 < n and not sheet.cells[row + 1, first:last].any() else 0.0
            place = (left + first * cell, bottom + (n - 1 - row - below) * cell)
            axes.add_patch(
                Rectangle(place, (last - first) * cell, (1.0 + below) * cell, facecolor="black", linewidth=0)
            )


def _draw_notes(axes: Axes, sheet: Sheet, middle: float, bottom: float) -> None:
    axes.text(middle, bottom - 4.0, f"{sheet.title}, {1e3 * sheet.size_m:.1f} mm", ha="center", va="top", fontsize=11)
    text = "this side down · cut along the grey line · print at 100 %, then measure: the ruler must be 100 mm long"
    axes.text(middle, bottom - 10.5, text, ha="center", va="top", fontsize=7.5, color="0.3")
    start, y = middle - 0.5 * _RULER_MM, bottom - 22.0
    axes.plot([start, start + _RULER_MM], [y, y], color="black", linewidth=0.5, solid_capstyle="butt")
    for mm in range(0, round(_RULER_MM) + 1, 5):
        length = 4.0 if mm % 10 == 0 else 2.5
        axes.plot([start + mm] * 2, [y, y + length], color="black", linewidth=0.4, solid_capstyle="butt")
        if mm % 10 == 0:
            axes.text(start + mm, y - 1.0, str(mm), ha="center", va="top", fontsize=6)
    axes.text(start + _RULER_MM + 4.0, y - 1.0, "mm", ha="left", va="top", fontsize=6)
