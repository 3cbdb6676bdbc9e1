"""Curves over time as SVG for the HTML report: drawn by matplotlib, in the colours of the page.

The axes are as wide as the picture and the labels of values stand to its left, outside, so that a time is at the same
place as in the bars above. Each picture is there twice, for wide pages and for narrow ones.
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hitchhike_ros.core.datatypes import FloatArray

SVG = "http://www.w3.org/2000/svg"


@dataclass(frozen=True)
class Series:
    """Values (N,) at the times (N,) in s; NaN where there is none. ``index`` is the number of the robot."""

    label: str
    index: int
    stamps: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class Size:
    """Of a picture, in the pixels of a page that shows it as it is; ``foot`` is for the labels of times."""

    width: float
    height: float
    foot: float
    font: float


SIZES = {"wide": Size(900.0, 190.0, 20.0, 10.0), "narrow": Size(430.0, 170.0, 20.0, 11.0)}

# Colours that matplotlib draws in, and what the page has in their place.
_TEXT, _GRID, _ZERO = "#0000f0", "#0000f1", "#0000f2"
_PAGE = {_TEXT: "var(--dim)", _GRID: "var(--line)", _ZERO: "var(--dim)"}
ROBOT_COLOURS = 6
_NUMBERS = {"d", "x", "y", "transform"}


def round_values(low: float, high: float, most: int) -> list[float]:
    """At most about ``most`` round numbers from ``low`` to ``high``: 1, 2 or 5 times a power of ten apart."""
    found = MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [float(value) for value in found if low <= value <= high]


def curves_svg(series: Sequence[Series], window: tuple[float, float], size: Size, title: str) -> Markup:
    """The series over ``window``, with zero among the values, as an element of a page."""
    style = {"svg.fonttype": "none", "font.size": size.font, "path.simplify_threshold": 0.5}
    with mpl.rc_context(style):
        figure = Figure(figsize=(size.width / 72.0, size.height / 72.0))
        axes = figure.add_axes((0.0, size.foot / size.height, 1.0, 1.0 - size.foot / size.height))
        axes.axhline(0.0, color=_ZERO, linewidth=1.0)
        for one in series:
            axes.plot(one.stamps, one.values, color=_robot_colour(one.index), linewidth=1.5, gid=one.label)
        axes.set_xlim(*window)
        axes.margins(y=0.05)
        axes.xaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 5, 10]))
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        axes.tick_params(length=0.0, colors=_TEXT)
        axes.grid(color=_GRID, linewidth=1.0)
        axes.set_axisbelow(True)
        for background in (figure.patch, axes.patch, axes.spines[:]):
            background.set_visible(False)
        file = io.StringIO()
        FigureCanvasSVG(figure).print_svg(file, metadata={"Date": None, "Creator": None})
    return _for_a_page(file.getvalue(), title, {one.label for one in series})


def _robot_colour(index: int) -> str:
    return f"#0000a{index % ROBOT_COLOURS}"


def _for_a_page(text: str, title: str, labels: Collection[str]) -> Markup:
    """matplotlib's SVG without what several on one page would share, and with the page's font and colours.

    Curves keep their ``labels`` as what is shown when they are pointed at.
    """
    ElementTree.register_namespace("", SVG)
    root = ElementTree.fromstring(text)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in (f"{{{SVG}}}defs", f"{{{SVG}}}metadata", f"{{{SVG}}}use"):
                parent.remove(child)
        parent.attrib.pop("clip-path", None)
        for name in _NUMBERS & parent.attrib.keys():
            parent.set(name, re.sub(r"(\.\d)\d+", r"\1", parent.get(name, "")))  # tenths of a pixel do
        name = parent.attrib.pop("id", "")
        if name in labels:
            ElementTree.SubElement(parent, f"{{{SVG}}}title").text = name
    for name in ("width", "height", "version"):
        root.attrib.pop(name)
    root.set("role", "img")
    root.set("aria-label", title)
    page = ElementTree.tostring(root, encoding="unicode")
    for colour, ours in _PAGE.items():
        page = page.replace(colour, ours)
    page = re.sub(r"#0000a(\d)", r"var(--r\1)", page)
    return Markup(re.sub(r"font: ([\d.]+px) [^;\"]*", r"font: \1 system-ui, sans-serif", page))
