"""Robots and their modules in one process."""

from pathlib import Path

from hitchhike_ros.simulation.composed import ComposedRide
from simulated_room import PACKAGE, make_world, robot


def test_robots_of_one_model_tell_each_its_own_marker(tmp_path: Path) -> None:
    robots = {"one": robot("p3dx", 1.0, 1.0, marker=0), "two": robot("p3dx", 3.0, 1.0, marker=2)}
    with make_world(tmp_path, robots) as world:
        ride = ComposedRide(world, PACKAGE)
        assert {name: its.params.marker_id for name, its in ride.robots.items()} == {"one": 0, "two": 2}
