"""A part of an image is found where it has gone, and another one is not taken for it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchhike_ros.servoing.lens import GrayImage
from hitchhike_ros.servoing.patch_shift import patch_shift

SIZE = (640, 480)


def scene(side: float, shift: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> tuple[GrayImage, np.ndarray]:
    """A square of random cells in front of a wall, and its corners (4, 2) px without the shift."""
    rng = np.random.default_rng(seed)
    wall = cv2.GaussianBlur(rng.uniform(90.0, 160.0, SIZE[::-1]), (0, 0), 3.0)
    cells = np.full((10, 10), 230.0)
    cells[1:9, 1:9] = 20.0
    cells[2:8, 2:8] = rng.choice([20.0, 230.0], (6, 6))
    corner = np.array([300.0, 200.0])
    scale = side / 8.0
    to_image = np.array([[scale, 0.0, corner[0] + shift[0] - scale], [0.0, scale, corner[1] + shift[1] - scale]])
    to_image[:, 2] += 0.5 * (scale - 1.0)
    image = cv2.warpAffine(
        cells, to_image, SIZE, wall.copy(), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_TRANSPARENT
    )
    square = corner + side * np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    return cv2.GaussianBlur(image, (0, 0), 0.7).astype(np.uint8), square


@settings(max_examples=60)
@given(st.floats(24.0, 160.0), st.floats(-22.0, 22.0), st.floats(-22.0, 22.0))
def test_the_shift_is_found_to_where_lines_can_be_sought(side: float, dx: float, dy: float) -> None:
    before, corners = scene(side)
    now, _ = scene(side, (dx, dy))
    shift = patch_shift(before, now, corners)
    assert shift is not None
    assert shift == pytest.approx([dx, dy], abs=max(1.0, 0.025 * side))


def test_another_picture_and_one_that_is_gone_are_not_found() -> None:
    before, corners = scene(80.0)
    other, _ = scene(80.0, seed=3)
    wall, _ = scene(80.0, (400.0, 0.0))
    assert patch_shift(before, 255 - other, corners) is None
    assert patch_shift(before, wall, corners) is None


def test_a_part_at_the_rim_is_compared_as_far_as_it_is_in_the_image() -> None:
    before, corners = scene(80.0, (-280.0, 0.0))
    now, _ = scene(80.0, (-288.0, 5.0))
    assert patch_shift(before, now, corners - (280.0, 0.0)) == pytest.approx([-8.0, 5.0], abs=2.0)
    assert patch_shift(before, now, corners - (900.0, 0.0)) is None
