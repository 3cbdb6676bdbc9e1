"""People of the simulated world: where they walk, whom they stop for, and what a robot sees and touches of them."""

import math
from pathlib import Path

import pytest

from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.simulation.people import RADIUS_M, Person, Walker
from hitchhike_ros.simulation.world_file import load_world
from simulated_room import make_world, robot, write_world

CORNER = Person("anna", ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0)), speed_mps=0.5, start_s=1.0)


def test_they_walk_there_and_back_from_their_time_on() -> None:
    walker = Walker(CORNER)
    places = {}
    for k in range(150):
        places[k] = walker.pose
        walker.step(0.1 * k, 0.1, ())
    assert places[10] == Pose2D(0.0, 0.0, 0.0)
    for k, (x, y) in {30: (1.0, 0.0), 60: (2.0, 0.5), 80: (2.0, 0.5), 130: (0.0, 0.0), 140: (0.5, 0.0)}.items():
        assert (places[k].x, places[k].y) == pytest.approx((x, y), abs=1e-6)


def test_they_stop_for_a_robot_in_front_and_for_no_other() -> None:
    robots = {
        "front": Pose2D(0.7, 0.2),
        "side": Pose2D(0.1, 0.6),
        "far": Pose2D(0.9, 0.0),
        "beside": Pose2D(0.3, 0.7),
        "behind": Pose2D(-0.1, 0.5),
    }
    moved = {name: Walker(CORNER).step(2.0, 0.1, [pose]) for name, pose in robots.items()}
    assert moved == {"front": False, "side": False, "far": True, "beside": True, "behind": True}


def test_they_turn_back_when_a_robot_stays_in_front() -> None:
    walker = Walker(CORNER)
    for _ in range(10):
        walker.step(2.0, 0.1, [])
    places = []
    for _ in range(20):
        walker.step(2.0, 0.1, [Pose2D(1.0, 0.0)])
        places.append(walker.pose)
    assert [place.x for place in places[:10]] == pytest.approx([0.5] * 10)
    assert math.cos(places[11].theta) == -1.0
    assert places[-1].x < 0.2


def test_the_laser_sees_them_and_they_push_nobody(tmp_path: Path) -> None:
    people = [{"id": "bob", "path": [[3.0, 0.5], [3.0, 3.5]], "speed_mps": 1.0}]
    with make_world(tmp_path, {"r": robot("turtlebot", 1.0, 2.0)}, people=people) as world:
        world.run(1.5)
        scan = world.robots["r"].scan()
        ahead = scan.ranges[len(scan.ranges) // 2]
        assert ahead == pytest.approx(3.0 - RADIUS_M - 1.0 - 0.12, abs=0.06)
        assert world.contacts() == ()
        world.reset()
        assert world.people[0].walker.pose.y == pytest.approx(0.5)


def test_somebody_who_meets_a_robot_stops_before_it_and_whoever_is_pushed_into_it_does_not_push(tmp_path: Path) -> None:
    people = [{"id": "bob", "path": [[1.0, 0.5], [1.0, 3.5]]}, {"id": "eve", "path": [[0.9, 2.1], [5.0, 2.1]]}]
    with make_world(tmp_path, {"r": robot("turtlebot", 1.0, 2.0)}, people=people) as world:
        before, _ = world.robots["r"].ground_truth()
        world.run(2.0)
        after, _ = world.robots["r"].ground_truth()
        assert 2.0 - world.people[0].walker.pose.y >= 0.79
        assert [(c.robot, c.other) for c in world.contacts()] == [("r", "eve")]
        assert distance(before, after) < 0.01


def test_a_robot_that_drives_into_somebody_has_a_contact(tmp_path: Path) -> None:
    people = [{"id": "bob", "path": [[2.0, 2.0], [2.0, 3.0]], "start_s": 100}]
    with make_world(tmp_path, {"r": robot("turtlebot", 1.0, 2.0)}, people=people) as world:
        for _ in range(20):
            world.robots["r"].command(Twist2D(0.5), world.now)
            world.run(0.1)
        assert [(c.robot, c.other) for c in world.contacts()] == [("r", "bob")]


@pytest.mark.parametrize(
    ("people", "field"),
    [
        ([{"id": "a", "path": [[1, 1]]}], "people[0].path"),
        ([{"id": "a", "path": [[1, 1], [1, 1]]}], "people[0].path"),
        ([{"id": "a", "path": [[1, 1], [2, 1]], "speed_mps": 0}], "people[0].speed_mps"),
        ([{"id": "a", "path": [[1, 1], [2, float("nan")]]}], "people[0].path"),
        ([{"id": "a", "path": [[1, 1], [2, 1]]}] * 2, "people[1].id"),
        ([{"id": "r", "path": [[1, 1], [2, 1]]}], "people[0].id"),
        ({"a": 1}, "people"),
    ],
)
def test_bad_people_are_refused_by_name(people: object, field: str, tmp_path: Path) -> None:
    path = write_world(tmp_path, {"r": robot("turtlebot", 1.0, 2.0)}, people=people)
    with pytest.raises(WorldFileError) as caught:
        load_world(path)
    assert caught.value.field.startswith(field)


def test_one_who_is_hurried_walks_there_once_and_waits_for_no_robot() -> None:
    walker = Walker(Person("eve", ((0.0, 0.0), (1.0, 0.0)), 1.0, hurried=True))
    for i in range(200):
        walker.step(0.01 * i, 0.01, [Pose2D(0.5, 0.0)])
    assert walker.pose.x == 1.0
