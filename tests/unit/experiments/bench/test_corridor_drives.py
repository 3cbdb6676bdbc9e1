"""The drives of the benchmarks: what is drawn leaves a way, and what is found is compared with what is there."""

from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Obstacle
from hitchhike_ros.core.geometry import distance_to_box
from hitchhike_ros.experiments.bench.corridor_drives import MODELS, compare_boxes, draw_world
from hitchhike_ros.simulation.people import RADIUS_M
from hitchhike_ros.simulation.world_file import load_world
from simulated_room import PACKAGE

BASE = load_world(PACKAGE / "maps" / "p17_exp1.world.yaml")


def test_every_seed_leaves_a_lane_and_nobody_walks_through_a_box() -> None:
    for seed in range(100):
        world = draw_world(BASE, seed)
        assert list(world.robots) == [MODELS[seed % 2]]
        assert (len(world.boxes), len(world.people)) == (3, 2)
        for box in world.boxes:
            assert max(box.y - 4.60, 6.84 - box.y - box.b) > 1.0
            for person in world.people:
                for a, b in pairwise(person.path):
                    assert all(distance_to_box(x, y, box) > RADIUS_M for x, y in np.linspace(a, b, 20))
        for person in world.people:
            ys = [y for _, y in person.path]
            assert min(ys) < 5.72 < max(ys)
    assert draw_world(BASE, 7) == draw_world(BASE, 7) != draw_world(BASE, 9)


def test_found_boxes_are_compared_with_the_nearest_and_others_are_phantoms() -> None:
    true = [Obstacle("a", 1.0, 1.0, 0.4, 0.2), Obstacle("b", 5.0, 1.0, 0.2, 0.2)]
    near, person = Obstacle("obs1", 1.03, 1.0, 0.4, 0.15), Obstacle("obs2", 3.0, 1.0, 0.3, 0.3)
    found, phantoms, place, size = compare_boxes([near, person], true)
    assert (found, phantoms) == (1, (person,))
    assert (place, size) == pytest.approx((0.03, 0.05))
    again = Obstacle("obs3", 1.1, 1.05, 0.2, 0.1)
    assert compare_boxes([near, again], true)[1] == (again,)


def test_a_process_of_its_own_can_load_what_a_drive_needs() -> None:
    """In catkin's devel space too, where the compiled modules are not beside the others."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        assert pool.submit(draw_world, BASE, 3).result(timeout=120.0) == draw_world(BASE, 3)
