"""The simulated world against its own geometry: driving, laser, contacts, boxes, repeatability."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hitchhike_ros.core.datatypes import LaserScan, Pose2D, Twist2D
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.geometry import distance, pose_from_matrix, transform_points
from hitchhike_ros.core.robot_model import mount
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.simulation.physics.laser import LaserParameters, measure
from hitchhike_ros.simulation.physics.world import World
from hitchhike_ros.simulation.world_file import Box
from simulated_room import PACKAGE, TINY, make_world, robot

MODELS = ("p3dx", "turtlebot")


def drive(world: World, twist: Twist2D, duration_s: float) -> None:
    """As a node does: a command each 0.1 s."""
    for _ in range(round(duration_s * 10)):
        for body in world.robots.values():
            body.command(twist, world.now)
        world.run(0.1)


def beam(scan: LaserScan, bearing: float) -> float:
    return float(scan.ranges[round((bearing - scan.angle_min) / scan.angle_increment)])


@pytest.mark.parametrize("model", MODELS)
def test_robots_drive_what_they_are_told(model: str, tmp_path: Path) -> None:
    with make_world(tmp_path, {"r": robot(model, 0.6, 2.0)}) as world:
        body = world.robots["r"]
        drive(world, Twist2D(0.5, 0.0), 1.0)
        start, twist = body.ground_truth()
        assert twist.v == pytest.approx(0.5, rel=0.02)
        drive(world, Twist2D(0.5, 0.0), 4.0)
        end, _ = body.ground_truth()
        assert end.x - start.x == pytest.approx(2.0, rel=0.02)
        assert (end.y, end.theta) == pytest.approx((2.0, 0.0), abs=0.01)
        drive(world, Twist2D(0.0, 1.0), 1.0)
        before = body.ground_truth()[0]
        drive(world, Twist2D(0.0, 1.0), 1.5)
        after, twist = body.ground_truth()
        assert after.theta - before.theta == pytest.approx(1.5, rel=0.02)
        assert twist.omega == pytest.approx(1.0, rel=0.02)
        assert distance(before, after) < 0.005
        assert not world.contacts()
        odometry = body.odometry()
        assert odometry.stamp == pytest.approx(world.now)
        drift = math.hypot(odometry.pose.x - (after.x - 0.6), odometry.pose.y - (after.y - 2.0))
        assert 1e-4 < drift < 0.15


@pytest.mark.parametrize("model", MODELS)
def test_wheels_turn_about_their_joints(model: str, tmp_path: Path) -> None:
    joints = {joint.get("name"): joint for joint in ElementTree.parse(PACKAGE / "urdf" / f"{model}.urdf").iter("joint")}
    with make_world(tmp_path, {"r": robot(model, 2.0, 2.0, 0.7)}) as world:
        body = world.robots["r"]
        for twist, turned in ((Twist2D(), False), (Twist2D(0.3, 0.8), True)):
            drive(world, twist, 1.3)
            mounts, angles = body.wheel_mounts(), body.wheel_angles()
            assert sorted(mounts) == ["wheel_left", "wheel_right"]
            assert (min(np.abs(angles)) > 1.0) == turned
            assert (abs(angles[1] - angles[0]) > 1.0) == turned
            for side, angle in zip(("left", "right"), angles, strict=True):
                joint = joints[f"wheel_{side}_joint"]
                origin, axis = joint.find("origin"), joint.find("axis")
                assert origin is not None
                assert axis is not None
                assert (origin.get("rpy"), axis.get("xyz")) == (None, "0 1 0")
                expected = np.eye(4)
                expected[:3, :3] = Rotation.from_euler("y", angle).as_matrix()
                expected[:3, 3] = [float(value) for value in origin.get("xyz", "").split()]
                assert mounts[f"wheel_{side}"] == pytest.approx(expected, abs=1e-6)


def test_a_robot_that_hears_nothing_stops(tmp_path: Path) -> None:
    with make_world(tmp_path, {"r": robot("p3dx", 1.0, 2.0), "s": robot("turtlebot", 1.0, 1.0)}) as world:
        for body in world.robots.values():
            body.command(Twist2D(0.4, 0.0), world.now)
        world.run(0.45)
        assert all(body.ground_truth()[1].v > 0.35 for body in world.robots.values())
        for _ in range(10):  # the watchdog of one robot does not hear the other
            world.robots["r"].command(Twist2D(0.4, 0.0), world.now)
            world.run(0.1)
        assert world.robots["r"].ground_truth()[1].v == pytest.approx(0.4, rel=0.02)
        assert world.robots["s"].ground_truth()[1].v == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("model", MODELS)
def test_the_laser_measures_the_room(model: str, tmp_path: Path) -> None:
    with make_world(tmp_path, {"r": robot(model, 3.0, 1.0)}) as world:
        scan = world.robots["r"].scan()
        ahead = mount(PACKAGE / "urdf" / f"{model}.urdf", "laser")[0, 3]
        angles = scan.angles()
        assert (scan.ranges.size, scan.range_max) == (769, 8.0)
        assert (angles[0], angles[-1]) == pytest.approx((-0.75 * math.pi, 0.75 * math.pi))
        with np.errstate(divide="ignore"):
            to_x = np.where(np.cos(angles) > 0, 3.0 - ahead, 3.0 + ahead) / np.abs(np.cos(angles))
            to_y = np.where(np.sin(angles) > 0, 3.0, 1.0) / np.abs(np.sin(angles))
        true = np.minimum(to_x, to_y)
        error = scan.ranges - true
        assert np.all(np.abs(error) <= np.maximum(0.03, 0.03 * true) + 0.005)  # the data sheet's bound, for every beam
        assert abs(np.mean(error / true)) < 0.002
        assert 0.5 < np.std(error) / np.mean(np.maximum(0.01, 0.01 * true)) < 1.5


@pytest.mark.parametrize("model", MODELS)
def test_nothing_in_reach_is_plus_infinity(model: str, tmp_path: Path) -> None:
    """In an open field no beam returns; above all none from the robot itself."""
    with make_world(tmp_path, {"r": robot(model, 3.0, 2.0)}, wall=0.0) as world:
        drive(world, Twist2D(0.4, 0.5), 1.0)
        assert np.all(world.robots["r"].scan().ranges == np.inf)


def test_readings_are_rep_117() -> None:
    params = LaserParameters()
    true = np.array([0.001, 0.5, 7.0, 8.5, np.inf])
    readings = measure(np.tile(true, (200, 1)), params, np.random.default_rng(0))
    assert np.isneginf(readings[:, 0]).mean() > 0.9
    assert np.all(np.abs(readings[:, 1] - 0.5) <= 0.03)
    assert np.all(np.abs(readings[:, 2] - 7.0) <= 0.21)
    assert np.all(np.isposinf(readings[:, 3:]))


def test_lasers_see_boxes_and_robots(tmp_path: Path) -> None:
    robots = {"a": robot("p3dx", 1.0, 2.0), "b": robot("turtlebot", 3.0, 2.0)}
    boxes = [{"id": "low", "x": 4.0, "y": 1.5, "w": 0.2, "b": 1.0, "height_m": 0.3}]
    with make_world(tmp_path, robots, boxes=boxes) as world:
        a, b = (body.scan() for body in world.robots.values())
        assert beam(a, 0.0) == pytest.approx(3.0 - 0.14 - 1.17, abs=0.1)  # the computer on the other's lowest plate
        assert beam(b, 0.0) == pytest.approx(4.0 - 3.12, abs=0.05)
        world.remove_box("low")
        assert beam(world.robots["b"].scan(), 0.0) == pytest.approx(6.0 - 3.12, rel=0.03)


def test_driving_into_things_is_a_contact(tmp_path: Path) -> None:
    robots = {"a": robot("p3dx", 0.8, 3.0, math.pi), "b": robot("turtlebot", 3.0, 1.0), "c": robot("p3dx", 5.0, 1.0)}
    boxes = [{"id": "obs1", "x": 3.5, "y": 0.8, "w": 0.2, "b": 0.4, "height_m": 0.3}]
    with make_world(tmp_path, robots, boxes=boxes) as world:
        world.run(0.5)
        assert not world.contacts()
        drive(world, Twist2D(0.4, 0.0), 2.5)
        a, b, c = (world.robots[name].contacts() for name in "abc")
        assert [(contact.robot, contact.other) for contact in a + b + c] == [
            ("a", "walls"),
            ("b", "obs1"),
            ("c", "walls"),
        ]
        assert a[0].x == pytest.approx(0.0, abs=0.02)  # the wall is where the map says
        assert b[0].x == pytest.approx(3.5, abs=0.02)
        assert world.robots["a"].ground_truth()[0].x == pytest.approx(0.21, abs=0.02)
        world.reset()
        world.run(0.5)
        assert not world.contacts()


def test_robots_touch_each_other(tmp_path: Path) -> None:
    robots = {"a": robot("p3dx", 1.0, 2.0), "b": robot("turtlebot", 1.8, 2.0, math.pi)}
    with make_world(tmp_path, robots) as world:
        drive(world, Twist2D(0.3, 0.0), 1.5)
        assert {(contact.robot, contact.other) for contact in world.contacts()} == {("a", "b"), ("b", "a")}


def noisy_run(folder: Path, seed: int, scans_of_other: int) -> tuple[np.ndarray, Pose2D]:
    robots = {"a": robot("p3dx", 1.0, 2.0), "b": robot("turtlebot", 1.0, 1.0)}
    with make_world(folder, robots, seed) as world:
        drive(world, Twist2D(0.3, 0.2), 0.5)
        for _ in range(scans_of_other):
            world.robots["b"].scan()
        return world.robots["a"].scan().ranges, world.robots["a"].odometry().pose


def test_a_seed_decides_all_noise_of_each_sensor(tmp_path: Path) -> None:
    first, again, other = noisy_run(tmp_path, 7, 0), noisy_run(tmp_path, 7, 3), noisy_run(tmp_path, 8, 0)
    assert np.array_equal(first[0], again[0])
    assert first[1] == again[1]
    assert not np.array_equal(first[0], other[0])
    assert first[1] != other[1]


def test_worlds_do_not_meet(tmp_path: Path) -> None:
    (tmp_path / "small").mkdir()
    with (
        make_world(tmp_path, {"r": robot("p3dx", 1.0, 2.0)}) as one,
        make_world(tmp_path / "small", {"r": robot("p3dx", 1.0, 2.0)}, size=(3.0, 4.0)) as two,
    ):
        drive(one, Twist2D(0.3, 0.0), 0.5)
        assert (one.now, two.now) == (0.5, 0.0)
        assert two.robots["r"].ground_truth()[0].x == pytest.approx(1.0, abs=1e-3)
        assert beam(two.robots["r"].scan(), 0.0) == pytest.approx(3.0 - 1.17, abs=0.06)


def test_boxes_come_and_go(tmp_path: Path) -> None:
    with make_world(tmp_path, {"r": robot("p3dx", 1.0, 2.0)}) as world:
        world.add_box(Box("new", 3.0, 1.5, 0.2, 1.0, 0.3))
        assert beam(world.robots["r"].scan(), 0.0) == pytest.approx(3.0 - 1.17, rel=0.03)
        assert [box.id for box in world.boxes] == ["new"]
        for bad in (
            Box("new", 5.0, 1.0, 0.2, 0.2),
            Box("flat", 5.0, 1.0, 0.0, 0.2),
            Box("on_robot", 0.9, 1.9, 0.3, 0.3),
        ):
            with pytest.raises(WorldFileError):
                world.add_box(bad)
        with pytest.raises(WorldFileError, match="one of new"):
            world.remove_box("old")
        world.reset()  # as in the world file, which has none
        assert not world.boxes


def test_a_start_must_be_free_and_a_model_exist(tmp_path: Path) -> None:
    for x, y in ((-0.1, 2.0), (90.0, 2.0), (2.1, 2.1)):
        boxes = [{"id": "b", "x": 2.0, "y": 2.0, "w": 0.2, "b": 0.2}]
        with pytest.raises(WorldFileError, match=r"robots.r.start.*a free place"):
            make_world(tmp_path, {"r": robot("p3dx", x, y)}, boxes=boxes)
    with pytest.raises(WorldFileError, match=r"robots.r.model is 'nosuch', expected .*urdf/nosuch.urdf"):
        make_world(tmp_path, {"r": robot("nosuch", 1.0, 1.0)})


def test_the_world_of_the_paper_is_its_map_and_its_boxes(tmp_path: Path) -> None:
    """P17 Exp. 1: corridor 23 m x 2.23 m, boxes of Table 1 at 0.04 m a pixel."""
    with World(PACKAGE / "maps" / "p17_exp1.world.yaml", package=PACKAGE, params=TINY) as world:
        grid = load_map(PACKAGE / "maps" / "p17_exp1.yaml")
        middle = grid.data[grid.world_to_cell([[0.0, 5.72]])[0, 0]]
        free = np.flatnonzero(middle == 0) * grid.resolution
        assert free.min() == pytest.approx(1.0)
        assert free.max() >= 24.0
        across = np.flatnonzero(grid.data[:, grid.world_to_cell([[12.0, 0.0]])[0, 1]] == 0) * grid.resolution
        assert across.max() + grid.resolution - across.min() == pytest.approx(2.24)
        pixels = [[round(v / 0.04) for v in (box.x, box.y, box.w, box.b)] for box in world.boxes]
        assert pixels == [[231, 152, 7, 4], [308, 129, 10, 11], [376, 150, 11, 7]]
        world.run(0.5)
        assert not world.contacts()


def test_any_map_is_a_world(tmp_path: Path, shared_data: Path) -> None:
    """The Willow Garage map: walls stand where the map has occupied cells, with whatever threshold its file names."""
    image = shared_data / "maps" / "willow-2010-02-18-0.10.pgm"
    text = (
        f"image: {image}\nresolution: 0.1\norigin: [0, 0, 0.3]\nnegate: 0\noccupied_thresh: 0.2\nfree_thresh: 0.196\n"
    )
    (tmp_path / "willow.yaml").write_text(text)
    grid = load_map(tmp_path / "willow.yaml")
    walls = grid.cell_to_world(np.argwhere(grid.occupied))
    (x, y), theta = grid.cell_to_world([[500, 157]])[0], 0.5
    with make_world(tmp_path, {"r": robot("p3dx", float(x), float(y), theta)}, map="willow.yaml") as world:
        scan = world.robots["r"].scan()
        T_world_laser = pose_from_matrix(world.robots["r"].T_world("laser"))
        seen, angles = scan.ranges[scan.valid()], scan.angles()[scan.valid()]
        hits = transform_points(T_world_laser, np.column_stack([np.cos(angles), np.sin(angles)]) * seen[:, None])
        off = [np.min(np.hypot(*(walls - hit).T)) for hit in hits]
        assert len(hits) > 300
        assert np.all(off < 0.1 * math.sqrt(0.5) + np.maximum(0.03, 0.03 * seen))
