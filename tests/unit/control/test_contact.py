"""Which obstacle touches the footprint, in words."""

from __future__ import annotations

import numpy as np

from flat_world import P3DX, TURTLEBOT
from hitchhike_ros.control.clearance import Footprint
from hitchhike_ros.control.contact import Contact

TOUCHED = "an obstacle touches the footprint"


def test_the_deepest_point_is_named_with_bearing_range_and_source() -> None:
    points = np.array([[3.0, 0.0], [0.0, 0.1], [-0.05, 0.0], [0.16, 0.0]])
    for at, words in ((2, "at 180°, 0.05 m"), (1, "at 90°, 0.10 m"), (3, "at 0°, 0.16 m")):
        contact = Contact(Footprint(TURTLEBOT))
        assert contact.describe(points, [("scan", 4)]) == f"{TOUCHED} {words} from its middle (scan)"
        points[at] = 3.0, 3.0


def test_the_source_is_that_of_the_point() -> None:
    sources = [("scan", 1), ("earlier scans", 0), ("the place that another robot tells", 2), ("other", 1)]
    for deepest, source in enumerate(("scan", *["the place that another robot tells"] * 2, "other")):
        points = np.full((4, 2), 2.0)
        points[deepest] = 0.1, -0.1
        said = Contact(Footprint(P3DX)).describe(points, sources)
        assert said == f"{TOUCHED} at -45°, 0.14 m from its middle ({source})"


def test_of_one_obstacle_it_says_one_thing() -> None:
    """The reason is told whenever it changes, and a scan is noisy."""
    contact, said = Contact(Footprint(TURTLEBOT)), set()
    for noise in np.random.default_rng(0).normal(0.0, 0.01, (50, 2)):
        said.add(contact.describe(np.array([[-0.15, 0.0]]) + noise, [("scan", 1)]))
    assert len(said) == 1
    assert (
        contact.describe(np.array([[0.0, 0.15]]), [("scan", 1)]) == f"{TOUCHED} at 90°, 0.15 m from its middle (scan)"
    )
    contact.clear()
    assert contact.describe(np.array([[0.02, 0.14]]), [("scan", 1)]).startswith(f"{TOUCHED} at 82°")
