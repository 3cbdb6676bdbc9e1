"""The worlds that ship: the papers' numbers, and room for the robots where they start, couple and arrive."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Marker, Pose2D
from hitchhike_ros.core.geometry import between, compose, path_length, pose_from_matrix, wrap_angle
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.robot_model import RobotLimits, mount
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.planning.costmap import build_costmap, label_regions
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.planning.overlap import Overlap, common_path
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.simulation.physics.camera import CameraParameters
from hitchhike_ros.simulation.world_file import WorldFile, load_world
from simulated_room import PACKAGE

WORLDS = tuple(sorted(path.name.removesuffix(".world.yaml") for path in (PACKAGE / "maps").glob("*.world.yaml")))
# The paper's ride from the first hitchhiking point to where the paths of p3dx and turtlebot part, in m.
RIDES = {"p17_exp1": 20.4, "p17_exp2": 28.82, "p18_building": 28.8}
TWO_PERCENT = 0.02
# P17 Table 1: x, y, width, breadth in cells of 0.04 m.
PAPER_BOXES = {
    "p17_exp1": ((231, 152, 7, 4), (308, 129, 10, 11), (376, 150, 11, 7)),
    "p17_exp2": (
        (394, 685, 11, 11), (493, 650, 14, 11), (632, 698, 10, 12),
        (795, 646, 21, 10), (931, 682, 17, 11), (1075, 654, 15, 10),
    ),
}  # fmt: skip
# P18 Experiments 2 and 3 in the building.
PARTIAL_START = Pose2D(11.65, 10.0, 0.0)
FAR_GOAL, SECOND_DRIVER_GOAL = Pose2D(40.0, 47.4, math.pi / 2), Pose2D(40.0, 50.0, math.pi / 2)
LEAST_WAY_M = 0.7
# A marker is found this near, and this far from the camera's axis, with some room to its picture's edge.
MARKER_RANGE_M, MARKER_BEARING_RAD = 4.0, math.radians(CameraParameters().horizontal_fov_deg / 2 - 3)
SETTINGS = HitchhikingParameters()


@cache
def world(name: str) -> WorldFile:
    return load_world(PACKAGE / "maps" / f"{name}.world.yaml")


@cache
def grid(name: str) -> OccupancyGrid:
    return load_map(world(name).map)


@cache
def planner(model: str) -> GlobalPlanner:
    config = PACKAGE / "config" / f"{model}.yaml"
    params = load_parameters(GlobalPlannerParameters, "global_planner", config)
    return GlobalPlanner(params, load_parameters(RobotLimits, "robot", config))


def clearance(name: str, model: str, pose: Pose2D) -> float:
    """Room beyond what the robot's inflation takes in m; negative where no path may lead."""
    costmap = planner(model).costmap(grid(name))
    return float(costmap.clearance[tuple(grid(name).world_to_cell([pose.x, pose.y])[0])]) - costmap.lethal_m


def shared(plan: OccupancyGrid, driver: tuple[Pose2D, Pose2D], hitchhiker: tuple[Pose2D, Pose2D]) -> Overlap:
    """The driver's search for a common stretch: both paths by its own planner."""
    paths = (planner("p3dx").plan(plan, *ends) for ends in (driver, hitchhiker))
    return common_path(*paths, SETTINGS.overlap_tolerance_m)


def goal(name: str, robot: str) -> Pose2D:
    pose = world(name).robots[robot].goal
    assert pose is not None
    return pose


def cell(name: str, x: float, y: float) -> int:
    return int(grid(name).data[tuple(grid(name).world_to_cell([x, y])[0])])


def test_every_experiment_has_its_world():
    assert set(WORLDS) >= set(RIDES)


@pytest.mark.parametrize("name", WORLDS)
def test_robots_have_room_at_start_and_goal_and_a_way_between(name):
    for robot in world(name).robots.values():
        assert clearance(name, robot.model, robot.start) >= 0.0
        if robot.goal is not None:
            assert clearance(name, robot.model, robot.goal) >= 0.0
            planner(robot.model).plan(grid(name), robot.start, robot.goal)


@pytest.mark.parametrize("name", WORLDS)
def test_robots_of_one_world_have_each_their_own_marker(name):
    robots = world(name).robots.values()
    ids = [robot.marker for robot in robots] + [marker.id for marker in world(name).sites.markers]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("name", WORLDS)
def test_boxes_stand_on_free_floor_and_leave_a_way(name):
    boxes, plan = world(name).boxes, grid(name)
    empty = replace(plan, data=np.zeros_like(plan.data))
    covered = np.array([empty.with_obstacles([box]).occupied for box in boxes]).reshape(-1, *plan.data.shape)
    assert np.all(plan.data[covered.any(axis=0)] == FREE)
    assert covered.sum(axis=0).max() <= 1  # no two overlap
    filled = plan.with_obstacles(boxes)
    limits = load_parameters(RobotLimits, "robot", PACKAGE / "config" / "p3dx.yaml")
    wide = build_costmap(filled, limits, GlobalPlannerParameters()).clearance >= LEAST_WAY_M / 2
    regions = label_regions(np.where(wide, np.float32(1), np.float32(np.inf)))
    poses = [pose for robot in world(name).robots.values() for pose in (robot.start, robot.goal) if pose is not None]
    found = {int(regions[tuple(filled.world_to_cell([pose.x, pose.y])[0])]) for pose in poses}
    assert len(found) == 1
    assert found != {0}


@pytest.mark.parametrize("name", sorted(PAPER_BOXES))
def test_boxes_are_the_papers(name):
    boxes = [(box.x, box.y, box.w, box.b) for box in world(name).boxes]
    assert np.array(boxes) == pytest.approx(0.04 * np.array(PAPER_BOXES[name]))


def test_the_second_corridor_is_the_papers():
    """30 m x 2.92 m between lobby and passage, and door recesses and pilasters leave the walls between them."""
    plan = grid("p17_exp2")
    middle = np.arange(14.06, 44.04, 0.04)
    widths = [np.sum(plan.data[:, column] == FREE) for _, column in plan.world_to_cell([(x, 27.0) for x in middle])]
    assert float(np.median(widths)) * plan.resolution == pytest.approx(2.92)
    inside = [cell("p17_exp2", x, 25.66) != FREE for x in (14.02, 14.06, 44.02, 44.06)]
    assert inside == [False, True, True, False]


@pytest.mark.parametrize("name", [name for name in WORLDS if world(name).sites.hitchhiking_points])
def test_both_robots_have_room_to_couple_at_the_ordered_distance(name):
    marker, camera = (
        pose_from_matrix(mount(PACKAGE / "urdf" / f"{model}.urdf", link))
        for model, link in (("p3dx", "marker"), ("turtlebot", "camera"))
    )
    for point in world(name).sites.hitchhiking_points:
        assert clearance(name, "p3dx", point.aligning_pose) >= 0.0
        assert clearance(name, "turtlebot", point.waiting_pose) >= 0.0
        seen = between(compose(point.waiting_pose, camera), compose(point.aligning_pose, marker))
        assert (seen.x, seen.y) == pytest.approx((SETTINGS.gap_m, 0.0), abs=SETTINGS.gap_tolerance_m)
        assert abs(wrap_angle(seen.theta)) == pytest.approx(math.pi)


@pytest.mark.parametrize("name", [name for name in WORLDS if world(name).sites.markers])
def test_markers_hang_on_walls_and_are_seen_by_the_driver_that_aligns(name):
    sites = world(name).sites
    camera = pose_from_matrix(mount(PACKAGE / "urdf" / "p3dx.urdf", "camera"))
    for marker in sites.markers:
        x, y = marker.x, marker.y
        c, s = math.cos(marker.yaw), math.sin(marker.yaw)
        for side in (-marker.size_m / 2, marker.size_m / 2):
            assert cell(name, x - 0.02 * c - side * s, y - 0.02 * s + side * c) == OCCUPIED
            assert cell(name, x + 0.02 * c - side * s, y + 0.02 * s + side * c) == FREE
    for point in sites.hitchhiking_points:
        wanted = None if point.marker is None else sites.marker(point.marker)
        if wanted is not None:
            eye = compose(point.aligning_pose, camera)
            seen = between(eye, Pose2D(wanted.x, wanted.y, wanted.yaw))
            assert math.hypot(seen.x, seen.y) <= MARKER_RANGE_M
            assert abs(math.atan2(seen.y, seen.x)) <= MARKER_BEARING_RAD
            assert in_sight(name, eye, wanted)


def in_sight(name: str, eye: Pose2D, marker: Marker) -> bool:
    line = np.linspace((eye.x, eye.y), (marker.x, marker.y), 200)[:-2]
    return bool(np.all(grid(name).data[tuple(grid(name).world_to_cell(line).T)] == FREE))


@pytest.mark.parametrize("name", sorted(RIDES))
def test_the_ride_is_as_long_as_the_papers(name):
    """When it is offered, and when it is driven around boxes that nobody knew then."""
    start = world(name).sites.hitchhiking_points[0].aligning_pose
    hitchhiker = (world(name).robots["turtlebot"].start, goal(name, "turtlebot"))
    ride = shared(grid(name), (start, goal(name, "p3dx")), hitchhiker)
    assert ride.start_a_m == 0.0
    assert ride.length_m == pytest.approx(RIDES[name], rel=TWO_PERCENT)
    assert ride.farthest is not None
    driven = planner("p3dx").plan(grid(name).with_obstacles(world(name).boxes), start, ride.farthest)
    assert path_length(driven) == pytest.approx(RIDES[name], rel=TWO_PERCENT)


def test_the_building_holds_a_partial_ride():
    """P18 Experiment 2: 28.8 m alone, then 35.6 m with a driver that does not pass the hitchhiker's start."""
    name = "p18_building"
    driver, hitchhiker = (world(name).robots["p3dx2"].start, SECOND_DRIVER_GOAL), (PARTIAL_START, FAR_GOAL)
    crossing = next(point for point in world(name).sites.hitchhiking_points if point.name == "crossing")
    ride = shared(grid(name), driver, hitchhiker)
    assert ride.start_b_m == pytest.approx(28.8, rel=TWO_PERCENT)
    assert ride.length_m == pytest.approx(35.6, rel=TWO_PERCENT)
    at_the_crossing = shared(grid(name), (crossing.aligning_pose, driver[1]), (crossing.waiting_pose, FAR_GOAL))
    assert at_the_crossing.length_m == pytest.approx(35.6, rel=TWO_PERCENT)
    alone = planner("turtlebot").plan(grid(name), PARTIAL_START, crossing.waiting_pose)
    assert path_length(alone) == pytest.approx(28.8, rel=TWO_PERCENT)


def test_the_building_holds_a_ride_with_two_drivers():
    """P18 Experiment 3: 28.8 m with the first; the second's 35.6 m are those of the partial ride."""
    name = "p18_building"
    west = world(name).sites.hitchhiking_points[0]
    ride = shared(grid(name), (west.aligning_pose, goal(name, "p3dx")), (west.waiting_pose, FAR_GOAL))
    assert ride.length_m == pytest.approx(28.8, rel=TWO_PERCENT)
    assert ride.farthest is not None
    assert world(name).sites.hitchhiking_point_at(ride.farthest.x, ride.farthest.y).name == "crossing"


def test_the_first_driver_comes_from_where_twice_the_speed_saves_ten_seconds():
    """P18 §8.3.1: 20 s at 0.5 m/s, 10 s at 1 m/s."""
    robots, west = world("p18_building").robots, world("p18_building").sites.hitchhiking_points[0]
    path = planner("p3dx").plan(grid("p18_building"), robots["p3dx"].start, west.aligning_pose)
    assert path_length(path) == pytest.approx(10.0, rel=TWO_PERCENT)
