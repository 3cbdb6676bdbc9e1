"""True boxes and those of a map are paired."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Obstacle
from hitchhike_ros.experiments.scoring.boxes import match_boxes


def test_boxes_pair_by_nearest_centre_and_each_only_once() -> None:
    true = [Obstacle("a", 0.0, 0.0, 0.4, 0.4), Obstacle("b", 0.5, 0.0, 0.4, 0.4), Obstacle("c", 5.0, 0.0, 1.0, 1.0)]
    found = [Obstacle("x", 0.3, 0.0, 0.4, 0.5), Obstacle("y", -0.4, 0.0, 0.4, 0.4)]
    matches = match_boxes(true, found)
    assert [m.found.id if m.found else None for m in matches] == ["y", "x", None]
    assert matches[1].place_m == pytest.approx(np.hypot(0.2, 0.05))
    assert matches[1].size_m == pytest.approx(0.1)
