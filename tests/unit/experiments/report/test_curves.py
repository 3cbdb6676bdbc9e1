"""Curves as SVG: round values beside them, the page's colours, and nothing that several pictures would share."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from hitchhike_ros.experiments.report.curves import SIZES, SVG, Series, curves_svg, round_values

TIMES = np.linspace(0.0, 90.0, 500)
SINE = Series("rider & <driver>", 1, TIMES, 0.05 * np.sin(TIMES))
BROKEN = Series("another", 7, TIMES, np.where(np.abs(TIMES - 45.0) < 5.0, np.nan, 0.02))


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.0, 10.0, [0, 2, 4, 6, 8, 10]), (-0.03, 0.07, [-0.02, 0, 0.02, 0.04, 0.06]), (3.0, 90.0, [20, 40, 60, 80])],
)
def test_values_are_round_and_within_their_bounds(low: float, high: float, expected: list[float]) -> None:
    assert round_values(low, high, 5) == pytest.approx(expected)


@pytest.fixture(params=SIZES)
def picture(request: pytest.FixtureRequest) -> ElementTree.Element:
    return ElementTree.fromstring(curves_svg([SINE, BROKEN], (0.0, 90.0), SIZES[request.param], "Error & more"))


def test_curves_have_the_colours_of_their_robots_and_their_labels(picture: ElementTree.Element) -> None:
    found = {}
    for group in picture.iter(f"{{{SVG}}}g"):
        title, path = group.find(f"{{{SVG}}}title"), group.find(f"{{{SVG}}}path")
        if title is not None and path is not None:
            found[title.text] = path.get("style", ""), path.get("d", "")
    assert found.keys() == {"rider & <driver>", "another"}
    assert "stroke: var(--r1)" in found["rider & <driver>"][0] and "stroke: var(--r1)" in found["another"][0]
    assert [d.count("M") for _, d in found.values()] == [1, 2]  # the pen is lifted where there is no value


def test_values_stand_outside_to_the_left_and_times_below(picture: ElementTree.Element) -> None:
    _, _, width, height = (float(v) for v in picture.get("viewBox", "").split())
    texts = [(t.text or "", float(t.get("x", "")), float(t.get("y", ""))) for t in picture.iter(f"{{{SVG}}}text")]
    assert [text for text, x, _ in texts if x < 0.0] == ["−0.05", "0.00", "0.05"]
    times = {text: x for text, x, _ in texts if x >= 0.0}
    assert times["40"] == pytest.approx(40.0 / 90.0 * width, abs=0.5)
    assert all(y <= height for _, _, y in texts)


def test_nothing_is_shared_with_another_picture_of_the_page(picture: ElementTree.Element) -> None:
    text = ElementTree.tostring(picture, encoding="unicode")
    assert not re.search(r"#0000|DejaVu|id=|clip-path|<defs|xlink|width=\"", text)
    assert picture.get("aria-label") == "Error & more"


def test_a_picture_is_the_same_each_time() -> None:
    assert len({curves_svg([SINE], (0.0, 90.0), SIZES["wide"], "") for _ in range(2)}) == 1
