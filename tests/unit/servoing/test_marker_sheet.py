"""Printed markers: true to size, and read by the detectors that robots use."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from hitchhike_ros.commands.make_marker import qr_cells
from hitchhike_ros.core.errors import VisionError
from hitchhike_ros.servoing.marker_sheet import PAPERS_MM, Sheet, write_sheet
from hitchhike_ros.servoing.tag_cells import QUIET_CELLS, tag_cells

DPI = 150


def tag_sheet(family: str, tag_id: int, size_m: float, paper: str = "A4") -> Sheet:
    cells = tag_cells(family, tag_id)[QUIET_CELLS:-QUIET_CELLS, QUIET_CELLS:-QUIET_CELLS]
    return Sheet(cells, QUIET_CELLS, size_m, f"AprilTag {family} id {tag_id}", paper)


def mm(pixels: float) -> float:
    return pixels / DPI * 25.4


@pytest.mark.parametrize(("family", "tag_id", "size_m"), [("36h11", 0, 0.16), ("25h9", 3, 0.08), ("16h5", 29, 0.05)])
def test_a_printed_tag_is_found_at_its_size(tmp_path: Path, family: str, tag_id: int, size_m: float) -> None:
    _, png = write_sheet(tag_sheet(family, tag_id, size_m), tmp_path / "tag", DPI)
    image = cv2.imread(str(png), cv2.IMREAD_GRAYSCALE)
    assert [mm(side) for side in image.shape[::-1]] == pytest.approx(PAPERS_MM["A4"], abs=0.2)
    dictionaries = {
        "36h11": cv2.aruco.DICT_APRILTAG_36h11,
        "25h9": cv2.aruco.DICT_APRILTAG_25h9,
        "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    }
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionaries[family]))
    corners, ids, _ = detector.detectMarkers(image)
    assert ids is not None
    assert ids.ravel().tolist() == [tag_id]
    sides = np.linalg.norm(np.diff(corners[0][0], axis=0, append=corners[0][0][:1]), axis=1)
    assert [mm(side) for side in sides] == pytest.approx([1e3 * size_m] * 4, abs=0.5)


def test_the_pdf_is_a_page_of_that_paper(tmp_path: Path) -> None:
    pdf, _ = write_sheet(tag_sheet("36h11", 0, 0.16, "A3"), tmp_path / "tag", DPI)
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", pdf.read_bytes())
    assert box is not None
    points = [float(value) for value in box.groups()]
    assert [value / 72.0 * 25.4 for value in points] == pytest.approx(PAPERS_MM["A3"], abs=0.1)


@pytest.mark.parametrize("message", ["p3dx", "robot p3dx of the second floor"])
def test_a_printed_qr_code_says_its_message(tmp_path: Path, message: str) -> None:
    _, png = write_sheet(Sheet(qr_cells(message), 4, 0.12, "QR"), tmp_path / "qr", DPI)
    said, _, _ = cv2.QRCodeDetector().detectAndDecode(cv2.imread(str(png), cv2.IMREAD_GRAYSCALE))
    assert said == message


@pytest.mark.parametrize(
    ("size_m", "paper", "expected"),
    [(0.2, "A4", "at most 0.168 m"), (0.0, "A4", "more than 0"), (float("nan"), "A4", "nan"), (0.1, "A9", "A9")],
)
def test_what_cannot_be_printed_is_refused(tmp_path: Path, size_m: float, paper: str, expected: str) -> None:
    with pytest.raises(VisionError, match=expected):
        write_sheet(tag_sheet("36h11", 0, size_m, paper), tmp_path / "tag", DPI)


def test_an_empty_qr_message_is_refused() -> None:
    with pytest.raises(VisionError, match="empty"):
        qr_cells("")
