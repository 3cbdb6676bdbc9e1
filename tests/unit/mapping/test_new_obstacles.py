"""New boxes against the map: found where they are, refined, removed; people and robots are no boxes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import LaserNoise
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.mapping.new_obstacles import MappingParameters, NewObstacleMapper
from laser_world import LASER, boxes_of, drive, take_scan, walls_of
from repository import ROOT

MAP = ROOT / "maps" / "p17_exp1.yaml"
# P17 Table 1, Exp. 1.
BOXES = (
    Obstacle("obs1", 9.24, 6.08, 0.28, 0.16),
    Obstacle("obs2", 12.32, 5.16, 0.40, 0.44),
    Obstacle("obs3", 15.04, 6.00, 0.44, 0.28),
)
PAST_ALL = [(7.0, 5.65), (9.4, 5.42), (11.0, 5.7), (12.5, 6.15), (14.0, 5.7), (15.2, 5.35), (17.5, 5.6)]
PAST_FIRST = [(7.0, 5.65), (9.4, 5.42), (11.5, 5.6)]
GOOD = np.diag([0.01, 0.01, 0.002]) ** 2


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    return load_map(MAP)


def person(x: float, y: float) -> Obstacle:
    return Obstacle("person", x - 0.15, y - 0.15, 0.3, 0.3)


def ride(
    grid: OccupancyGrid,
    route: list[tuple[float, float]],
    things: Callable[[float], Iterable[Obstacle]],
    mapper: NewObstacleMapper | None = None,
    seed: int = 0,
    ratio: float = 0.01,
    pose_sigma: float = 0.0,
    heading_sigma: float | None = None,
    ignore: Callable[[float], list[tuple[Pose2D, float]]] = lambda _: [],
) -> NewObstacleMapper:
    """Drive at 0.5 m/s among things that may change with time."""
    rng, walls = np.random.default_rng(seed), walls_of(grid)
    mapper = mapper or NewObstacleMapper(grid, MappingParameters(laser=LaserNoise(ratio, ratio)))
    error = np.zeros(3)
    sigmas = [pose_sigma, pose_sigma, 0.2 * pose_sigma if heading_sigma is None else heading_sigma]
    for truth, odometry in drive(route, 0.5, rng):
        t = odometry.stamp
        scan = take_scan(truth, np.vstack([walls, boxes_of(things(t))]), rng, t, beams=513, ratio=ratio)
        error = 0.95 * error + 0.31 * rng.normal(0.0, 1.0, 3) * sigmas
        pose = Pose2D(truth.x + error[0], truth.y + error[1], truth.theta + error[2])
        assert mapper.update(scan, PoseEstimate(t, pose, GOOD), LASER, ignore(t))
    return mapper


def worst(found: Iterable[Obstacle], true: Iterable[Obstacle]) -> float:
    """Largest error in place and size of the boxes, which must be as many and match one to one."""
    pairs = list(zip(sorted(found, key=lambda o: o.x), sorted(true, key=lambda o: o.x), strict=True))
    return max(max(abs(f.x - t.x), abs(f.y - t.y), abs(f.w - t.w), abs(f.b - t.b)) for f, t in pairs)


@pytest.mark.parametrize(("ratio", "pose_sigma", "bound"), [(0.01, 0.0, 0.04), (0.015, 0.02, 0.10)])
def test_the_papers_boxes_are_found_in_passing(grid, ratio, pose_sigma, bound):
    mapper = ride(grid, PAST_ALL, lambda _: BOXES, seed=1, ratio=ratio, pose_sigma=pose_sigma)
    assert worst(mapper.obstacles, BOXES) < bound
    assert [box.id for box in mapper.obstacles] == ["obs1", "obs2", "obs3"]


def test_boxes_keep_their_ids_while_they_are_refined(grid):
    seen: dict[str, list[Obstacle]] = {}
    mapper = NewObstacleMapper(grid, MappingParameters())
    walls, rng = walls_of(grid), np.random.default_rng(2)
    for truth, odometry in drive(PAST_ALL, 0.5, rng):
        scan = take_scan(truth, np.vstack([walls, boxes_of(BOXES)]), rng, odometry.stamp, beams=513)
        mapper.update(scan, PoseEstimate(odometry.stamp, truth, GOOD), LASER)
        for box in mapper.obstacles:
            seen.setdefault(box.id, []).append(box)
    assert sorted(seen) == ["obs1", "obs2", "obs3"]
    assert seen["obs3"][0].w < seen["obs3"][-1].w  # its far side comes into view in passing
    assert all(abs(box.x - BOXES[2].x) < 0.5 for box in seen["obs3"])


@pytest.mark.parametrize(
    "walk",
    [
        lambda t: person(10.0, 4.8 + 0.5 * t),  # across, in front of the robot
        lambda t: person(14.0 - 0.8 * t, 6.2),  # towards it and past it
        lambda t: person(8.0 + 0.5 * t, 6.2),  # beside it, as fast as the robot
        lambda t: person(8.5 + 0.3 * t, 6.3),  # overtaken
    ],
)
def test_people_who_walk_leave_nothing(grid, walk):
    mapper = ride(grid, [(7.0, 5.5), (12.5, 5.5)], lambda t: [walk(t)] if t < 8.0 else [])
    assert mapper.obstacles == ()


def test_who_walks_close_by_a_box_does_not_stretch_it(grid):
    """Not even while he does: what the robot saw last is what it keeps."""
    mapper, sizes = NewObstacleMapper(grid, MappingParameters(laser=LaserNoise(0.01, 0.01))), set()

    def things(t: float) -> list[Obstacle]:
        sizes.update((box.w, box.b) for box in mapper.obstacles)
        return [BOXES[0], person(13.0 - 0.6 * t, 5.85)]

    ride(grid, PAST_FIRST, things, mapper)
    assert sizes
    assert max(w for w, _ in sizes) < BOXES[0].w + 0.05
    assert max(b for _, b in sizes) < BOXES[0].b + 0.05


@pytest.mark.parametrize("arrival", [0.0, 2.0, 5.0])
def test_who_stops_for_three_seconds_is_never_a_box(grid, arrival):
    mapper, told = NewObstacleMapper(grid, MappingParameters()), set()

    def things(t: float) -> list[Obstacle]:
        told.update(mapper.obstacles)
        return [person(10.5 + max(arrival - t, 0.0) - max(t - arrival - 3.0, 0.0), 6.3)]

    ride(grid, [(7.0, 5.5), (12.5, 5.5)], things, mapper, pose_sigma=0.01)
    assert not told


def test_two_who_stop_at_one_place_one_after_the_other_are_no_box(grid):
    """Each for less than a box has to stand there, and for a moment the place is empty."""
    mapper, told = NewObstacleMapper(grid, MappingParameters()), set()

    def things(t: float) -> list[Obstacle]:
        told.update(mapper.obstacles)
        return [person(11.0, 6.2)] if 1.0 < t < 4.0 or 4.3 < t < 7.3 else []

    ride(grid, [(7.0, 5.5), (12.5, 5.5)], things, mapper)
    assert not told


@pytest.mark.parametrize("seed", [0, 1])
def test_walls_frames_and_pillars_are_no_boxes_though_the_pose_is_off(grid, seed):
    """By 3 cm and more than a degree, while the filter believes in 1 cm."""
    mapper, told = NewObstacleMapper(grid, MappingParameters()), set()

    def things(_: float) -> list[Obstacle]:
        told.update(mapper.obstacles)
        return []

    lobby_and_corridor = [(2.2, 1.8), (3.0, 3.5), (3.0, 5.2), (4.5, 5.7), (9.0, 5.7), (14.0, 5.7)]
    ride(grid, lobby_and_corridor, things, mapper, seed=seed, pose_sigma=0.03, heading_sigma=0.02)
    assert not told


def test_pieces_of_a_box_that_are_seen_at_different_times_are_one_box(grid):
    """Its far side is seen for less than a second in passing, and later its lower part, past somebody."""
    rng, walls = np.random.default_rng(0), walls_of(grid)
    mapper = NewObstacleMapper(grid, MappingParameters())
    screen = Obstacle("person", 13.30, 5.60, 0.05, 0.35)
    passing = [(0.1 * k, Pose2D(10.0 + 0.06 * k, 5.9, 0.0), []) for k in range(52)]
    looking_back = [(10.0 + 0.1 * k, Pose2D(14.6 - 0.02 * k, 6.1, math.pi), [screen]) for k in range(10)]
    for t, pose, others in passing + looking_back:
        scan = take_scan(pose, np.vstack([walls, boxes_of([BOXES[1], *others])]), rng, t, beams=513)
        mapper.update(scan, PoseEstimate(t, pose, GOOD), LASER)
    assert worst(mapper.obstacles, BOXES[1:2]) < 0.05


BESIDE = [(7.5, 5.65), (9.0, 5.8), (12.0, 5.8)]


@pytest.mark.parametrize("gap_m", [0.0, 0.06, 0.20])
def test_a_box_at_a_wall_reaches_the_wall_and_one_before_it_does_not(grid, gap_m):
    """The corridor's wall is at y = 4.60, and nearer to it than 12 cm an end point counts as the wall's."""
    box = Obstacle("box", 10.0, 4.60 + gap_m, 0.4, 0.4)
    (found,) = ride(grid, BESIDE, lambda _: [box], pose_sigma=0.01).obstacles
    assert found.y == pytest.approx(4.60 if gap_m < 0.1 else box.y, abs=0.06)
    assert found.y + found.b == pytest.approx(box.y + box.b, abs=0.04)


@pytest.mark.parametrize("gap_m", [0.10, 0.16])
def test_boxes_with_a_gap_that_was_seen_through_are_two(grid, gap_m):
    boxes = (Obstacle("a", 10.0, 5.0, 0.4, 0.3), Obstacle("b", 10.4 + gap_m, 5.0, 0.3, 0.3))
    first, second = sorted(ride(grid, BESIDE, lambda _: boxes, pose_sigma=0.01).obstacles, key=lambda box: box.x)
    assert worst([first], boxes[:1]) < 0.06
    # How deep the second is, the first hides.
    assert (second.x, second.w) == pytest.approx((boxes[1].x, 0.3), abs=0.05)
    assert second.y + second.b == pytest.approx(5.3, abs=0.04)


def test_noise_is_not_told(grid):
    """Driving up to the boxes and past them changes each a few times; between that it is the same tuple."""
    mapper = NewObstacleMapper(grid, MappingParameters())
    versions: list[tuple[Obstacle, ...]] = []

    def things(_: float) -> tuple[Obstacle, ...]:
        if not versions or mapper.obstacles is not versions[-1]:
            versions.append(mapper.obstacles)
        return BOXES

    ride(grid, PAST_ALL, things, mapper, pose_sigma=0.01)
    assert 3 < len(versions) < 40
    assert all(before != after for before, after in itertools.pairwise(versions))


def test_boxes_are_found_at_a_metre_a_second_too(grid):
    walls, rng = np.vstack([walls_of(grid), boxes_of(BOXES)]), np.random.default_rng(4)
    mapper = NewObstacleMapper(grid, MappingParameters())
    for truth, odometry in drive([(4.0, 5.6), *PAST_ALL], 1.0, rng):
        scan = take_scan(truth, walls, rng, odometry.stamp, beams=513)
        mapper.update(scan, PoseEstimate(odometry.stamp, truth, GOOD), LASER)
    assert worst(mapper.obstacles, BOXES) < 0.08


def test_who_stood_still_for_long_is_removed_when_gone(grid):
    stood: list[int] = []
    mapper = NewObstacleMapper(grid, MappingParameters())

    def things(t: float) -> list[Obstacle]:
        stood.append(len(mapper.obstacles))
        return [person(11.0, 6.2)] if t < 6.0 else []

    ride(grid, [(7.0, 5.5), (12.5, 5.5)], things, mapper)
    assert max(stood) == 1
    assert mapper.obstacles == ()


def test_who_comes_and_stands_until_the_robot_has_passed_is_no_box(grid):
    """Nobody sees afterwards that the place is empty again."""

    def things(t: float) -> list[Obstacle]:
        return [person(11.0 + max(3.0 - t, 0.0), 6.2)]

    assert ride(grid, [(8.0, 5.5), (14.0, 5.5)], things, pose_sigma=0.01).obstacles == ()


def test_who_comes_and_stays_is_a_box_in_the_end(grid):
    def things(t: float) -> list[Obstacle]:
        return [person(11.0, 6.2)] if t > 2.0 else []

    there_and_back = [(8.0, 5.5), (10.0, 5.5)] + 6 * [(9.0, 5.5), (10.0, 5.5)] + [(13.0, 5.5)]
    assert len(ride(grid, there_and_back, things).obstacles) == 1


def test_a_box_that_was_taken_away_goes(grid):
    mapper = ride(grid, PAST_FIRST, lambda _: BOXES[:1])
    assert len(mapper.obstacles) == 1
    ride(grid, PAST_FIRST, lambda _: [], mapper)
    assert mapper.obstacles == ()


def test_a_robot_that_stands_maps_nothing(grid):
    mapper, walls, rng = NewObstacleMapper(grid, MappingParameters()), walls_of(grid), np.random.default_rng(0)
    rectangles, pose = np.vstack([walls, boxes_of(BOXES)]), Pose2D(8.0, 5.6, 0.0)
    for k in range(60):
        mapper.update(take_scan(pose, rectangles, rng, 0.1 * k, beams=513), PoseEstimate(0.1 * k, pose, GOOD), LASER)
    assert mapper.obstacles == ()


def test_a_known_robot_is_no_box(grid):
    partner = Obstacle("robot", 9.5, 6.1, 0.35, 0.35)
    assert len(ride(grid, PAST_FIRST, lambda _: [partner]).obstacles) == 1
    known = [(Pose2D(9.68, 6.28), 0.35)]
    assert ride(grid, PAST_FIRST, lambda _: [partner], ignore=lambda _: known).obstacles == ()


def test_handed_over_boxes_are_kept_as_given_until_seen(grid):
    mapper = NewObstacleMapper(grid, MappingParameters())
    mapper.add(BOXES)
    mapper.add(BOXES)
    assert mapper.obstacles == BOXES
    better = replace(BOXES[1], x=12.35, w=0.37)
    mapper.add([better])
    assert set(mapper.obstacles) == {BOXES[0], better, BOXES[2]}
    ride(grid, [(3.0, 5.6), (4.0, 5.6)], lambda _: BOXES, mapper)  # too far to see them
    assert set(mapper.obstacles) == {BOXES[0], better, BOXES[2]}


def test_handed_over_boxes_are_refined_and_removed_by_own_eyes(grid):
    mapper = NewObstacleMapper(grid, MappingParameters())
    mapper.add([replace(BOXES[0], id="a", x=9.30, y=6.12), replace(BOXES[1], id="gone", x=10.5)])
    ride(grid, PAST_FIRST, lambda _: BOXES[:1], mapper)
    assert worst(mapper.obstacles, BOXES[:1]) < 0.06
    assert mapper.obstacles[0].id == "a"
    mapper.add([replace(BOXES[0], x=9.40)])  # its own eyes are better
    assert worst(mapper.obstacles, BOXES[:1]) < 0.06


def test_names_do_not_clash(grid):
    mapper = ride(grid, PAST_FIRST, lambda _: BOXES[:1])
    mapper.add([replace(BOXES[2], id="obs1")])
    assert [box.id for box in mapper.obstacles] == ["obs1", "obs2"]


def test_nothing_is_mapped_by_a_bad_pose_or_a_bad_scan(grid):
    mapper = NewObstacleMapper(grid, MappingParameters())
    scan = take_scan(Pose2D(8.0, 5.6, 0.0), boxes_of(BOXES))
    assert not mapper.update(scan, PoseEstimate(0.0, Pose2D(8.0, 5.6, 0.0), np.diag([0.1, 0.1, 0.001])), LASER)
    assert not mapper.update(scan, PoseEstimate(0.0, Pose2D(8.0, 5.6, 0.0), np.diag([1e-4, 1e-4, 0.1])), LASER)
    with pytest.raises(SensorDataError, match="NaN"):
        mapper.update(replace(scan, ranges=np.full(769, math.nan)), PoseEstimate(0.0, Pose2D(), GOOD), LASER)
