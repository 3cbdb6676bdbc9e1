"""What two ways share, whatever their shape (P18 Algorithm 2), and the one stretch that is told, ridden and paid.

Real agents in the grid simulator, in buildings of corridors that are 3 m wide and in open halls. Every hitchhiker and
driver go about the same way; rides along it are judged from afar, and at a hitchhiking point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import HitchhikingPoint, Pose2D
from hitchhike_ros.core.geometry import compose, path_length
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.overlap import common_path
from hitchhike_ros.protocol.announcement import OwnPath, asked_path
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.matching import agreed_stretch, shared_stretch, way_of
from hitchhike_ros.protocol.messages import Accept, Ack, Deny, Lock, Message, Request
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.robot import Errand, GridRobot
from hitchhike_ros.simulation.grid.world import GridWorld

_RESOLUTION = 0.25
Rectangle = tuple[float, float, float, float]
WEST, NORTH = math.pi, math.pi / 2

# Corridors 3 m wide: (x0, y0, x1, y1) of free rectangles.
U: tuple[Rectangle, ...] = ((2, 2, 34, 5), (31, 2, 34, 13), (2, 10, 34, 13))
S: tuple[Rectangle, ...] = ((2, 2, 34, 5), (31, 2, 34, 13), (2, 10, 34, 13), (2, 10, 5, 21), (2, 18, 34, 21))
LOOP: tuple[Rectangle, ...] = ((2, 2, 42, 5), (39, 2, 42, 24), (2, 21, 42, 24), (2, 2, 5, 24))
HALL: tuple[Rectangle, ...] = ((2, 2, 72, 42),)


def _world(free: Sequence[Rectangle], points: Sequence[Pose2D] = ()) -> GridWorld:
    width, height = (max(rectangle[k] for rectangle in free) + 2 for k in (2, 3))
    data = np.full((int(height / _RESOLUTION), int(width / _RESOLUTION)), 100, dtype=np.int8)
    for x0, y0, x1, y1 in free:
        rows, columns = (slice(int(a / _RESOLUTION), int(b / _RESOLUTION)) for a, b in ((y0, y1), (x0, x1)))
        data[rows, columns] = 0
    sites = [HitchhikingPoint(f"point{k}", _area(p), compose(p, Pose2D(1.2)), p) for k, p in enumerate(points)]
    params = GridWorldParameters(position_sigma_m=0.0, heading_sigma_rad=0.0)
    return GridWorld(OccupancyGrid(data, _RESOLUTION), Sites((), tuple(sites)), params=params)


def _area(pose: Pose2D) -> tuple[tuple[float, float], ...]:
    x, y = pose.x, pose.y
    return (x - 3, y - 3), (x + 3, y - 3), (x + 3, y + 3), (x - 3, y + 3)


class Pair:
    """A driver and a hitchhiker, the messages between them, and what became of the ride."""

    def __init__(
        self,
        world: GridWorld,
        driver: tuple[Pose2D, Pose2D],
        rider: tuple[Pose2D, Pose2D],
        at_s: float = 1.0,
        **hitchhiking: Any,
    ) -> None:
        self.world, self.heard = world, list[Message]()
        shared = {"mode": "network", "max_wait_s": 120.0, **hitchhiking}
        self.driver = self._add("driver", driver, 0.0, {**shared, "may_ride": False, "profile": 80.0, "marker_id": 0})
        self.rider = self._add("rider", rider, at_s, {**shared, "marker_id": 1})
        self.told_m: float | None = None
        self.body_m = self._before_m = 0.0
        world.observers.append(self._note)
        assert world.run(900.0, world.idle), [robot.status for robot in world.robots.values()]
        for robot in world.robots.values():
            assert robot.trips[0].reached, robot.history

    def _add(self, name: str, way: tuple[Pose2D, Pose2D], at_s: float, params: dict[str, Any]) -> GridRobot:
        return self.world.add_robot(name, way[0], HitchhikingParameters(**params), [Errand(way[1], at_s)])

    def _note(self, now: float, robot: str, event: object, _effects: object) -> None:
        if isinstance(event, Accept | Ack | Deny | Lock):
            self.heard.append(event)
        if robot == "rider" and self.rider.status.state == "riding" and self.rider.status.ride is not None:
            self.told_m = self.rider.status.ride.ride_m
        if robot == "driver" and self.driver.status.state in ("driving", "decoupling"):
            self.driver.body.advance(now)
            self._before_m = self._before_m or self.driver.body.odometer_m
            self.body_m = self.driver.body.odometer_m - self._before_m

    @property
    def offers(self) -> list[Accept]:
        return [message for message in self.heard if isinstance(message, Accept)]

    @property
    def denials(self) -> set[str]:
        return {message.reason for message in self.heard if isinstance(message, Deny)}

    def assert_ridden_as_told(self, least_m: float) -> None:
        """Told at the lock, ridden by the bodies and paid for: one length."""
        (award,) = self.driver.awards
        assert self.told_m is not None
        assert self.told_m >= least_m
        assert award.ride_m == pytest.approx(self.told_m, abs=1e-6)
        assert award.points == pytest.approx(self.driver.params.award_rate * self.told_m)
        assert self.body_m == pytest.approx(self.told_m, abs=1.0, rel=0.04)
        assert self.rider.trips[0].ridden_m == pytest.approx(self.told_m, abs=1.5, rel=0.04)


# From start to goal behind the driver; the driver starts behind the hitchhiker and goes a little farther.
CORRIDORS = {
    "u": (U, (Pose2D(3, 3.5), Pose2D(2.6, 11.5, WEST)), (Pose2D(6, 3.5), Pose2D(6, 11.5, WEST)), 54.0),
    "s": (S, (Pose2D(3, 3.5), Pose2D(33, 19.5)), (Pose2D(6, 3.5), Pose2D(30, 19.5)), 85.0),
    "loop": (LOOP, (Pose2D(3, 3.5), Pose2D(40.5, 18, NORTH)), (Pose2D(6, 3.5), Pose2D(40.5, 14, NORTH)), 40.0),
}


@pytest.mark.parametrize("board_anywhere", [True, False])
@pytest.mark.parametrize("shape", CORRIDORS)
def test_a_common_way_is_ridden_whatever_its_shape(shape: str, board_anywhere: bool) -> None:
    free, driver, rider, least_m = CORRIDORS[shape]
    pair = Pair(_world(free, [rider[0]]), driver, rider, board_anywhere=board_anywhere)
    pair.assert_ridden_as_told(least_m)
    assert pair.offers[0].ride_m == pytest.approx(pair.told_m, abs=3.0)


@pytest.mark.parametrize("shape", CORRIDORS)
def test_at_a_hitchhiking_point_the_same_is_offered(shape: str) -> None:
    free, (_, goal), rider, least_m = CORRIDORS[shape]
    aligned = compose(rider[0], Pose2D(1.2))
    pair = Pair(_world(free, [rider[0]]), (aligned, goal), rider, at_s=0.1, mode="local")
    pair.assert_ridden_as_told(least_m)
    assert pair.offers[0].ride_m == pytest.approx(pair.told_m, abs=1e-6)


@pytest.mark.parametrize("board_anywhere", [True, False])
def test_the_other_way_round_a_loop_is_another_way(board_anywhere: bool) -> None:
    driver, rider = (Pose2D(4, 3.5), Pose2D(40.5, 12, NORTH)), (Pose2D(6, 3.5), Pose2D(14, 22.5))
    pair = Pair(_world(LOOP, [rider[0]]), driver, rider, board_anywhere=board_anywhere)
    assert (pair.offers, pair.denials) == ([], {"Path too short"})


@pytest.mark.parametrize(("beside_m", "serves"), [(0.2, True), (12.0, False)])
def test_parallel_ways_in_a_hall(beside_m: float, serves: bool) -> None:
    driver, rider = (Pose2D(4, 20), Pose2D(69, 20)), (Pose2D(8, 20 + beside_m), Pose2D(66, 20 + beside_m))
    pair = Pair(_world(HALL), driver, rider, board_anywhere=True)
    if serves:
        pair.assert_ridden_as_told(50.0)
    else:
        assert (pair.offers, pair.denials) == ([], {"Path too short"})


def test_against_the_way_nothing_is_shared() -> None:
    driver, rider = (Pose2D(69, 20, WEST), Pose2D(4, 20, WEST)), (Pose2D(8, 20), Pose2D(66, 20))
    pair = Pair(_world(HALL), driver, rider, board_anywhere=True)
    assert (pair.offers, pair.denials) == ([], {"Path too short"})


U_WAY = np.array([(6.0, 3.5), (32.5, 3.5), (32.5, 11.5), (6.0, 11.5)])
ELSEWHERE = ((3.0, 11.5), (2.5, 11.5))


def _asks(path: tuple[tuple[float, float], ...]) -> Request:
    return Request(robot_id="rider", x=6.0, y=3.5, theta=0.0, goal=Pose2D(6.0, 11.5), profile=1.0, path=path)


@pytest.mark.parametrize(
    "told", [(), (ELSEWHERE[0],), ELSEWHERE, ((6.0, 3.5), (30.0, 3.5)), ((1e300, 0.0), (6.0, 11.5))]
)
def test_a_request_without_a_path_to_its_goal_is_judged_by_a_plan_of_the_drivers_own(
    told: tuple[tuple[float, float], ...],
) -> None:
    planned: list[tuple[Pose2D, Pose2D]] = []

    def planner(start: Pose2D, goal: Pose2D) -> np.ndarray:
        planned.append((start, goal))
        return U_WAY

    way = way_of(_asks(told), planner)
    assert planned == [(Pose2D(6.0, 3.5), Pose2D(6.0, 11.5))]
    assert way.tolist() == U_WAY.tolist()
    told_path = asked_path(U_WAY)
    assert way_of(_asks(told_path), planner).tolist() == U_WAY.tolist()
    assert len(planned) == 1, "a path that is told is not planned again"


def test_an_older_robot_is_driven_through_a_u_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HitchhikerMachine, "_asked_path", lambda *_: ())
    free, driver, rider, least_m = CORRIDORS["u"]
    Pair(_world(free, [rider[0]]), driver, rider).assert_ridden_as_told(least_m)


@pytest.mark.parametrize(("goal_x", "offered"), [(22.0, False), (32.0, True)])
def test_t_dhh_is_held_against_what_is_shared_ahead_of_the_boarding_point(goal_x: float, offered: bool) -> None:
    path = OwnPath(_line((2, 3.5), (40, 3.5)))
    path.come_m = 3.0
    sites = Sites((), (HitchhikingPoint("p", _area(Pose2D(10, 3.5)), Pose2D(11.2, 3.5), Pose2D(10, 3.5)),))
    stretch = shared_stretch(path, _line((2, 4.5), (goal_x, 4.5)), sites, HitchhikingParameters(mode="network"))
    assert (stretch is not None) is offered
    if stretch is not None:
        assert (stretch.begin_m, stretch.end_m) == pytest.approx((8.0, goal_x - 2.0), abs=0.4)


def test_a_lock_names_the_pass_of_a_place_that_is_passed_twice() -> None:
    """Along a loop and on along its beginning: the same place is left after 10 m or after 40 m."""
    path = OwnPath(_line((0, 0), (20, 0), (20, 5), (-5, 5), (-5, 0.5), (30, 0.5)))
    begin, waiting = Pose2D(2.2, 0.0), Pose2D(1.0, 0.0)
    for leave, told_m, length_m in (((12.0, 0.2), 11.0, 9.8), ((12.0, 0.2), 69.5, 68.3), ((12.0, 0.2), 0.0, 9.8)):
        stretch = agreed_stretch(path, begin, waiting, leave, told_m)
        assert stretch.length_m == pytest.approx(length_m, abs=1.5)


def _line(*corners: tuple[float, float]) -> np.ndarray:
    line = Polyline(corners)
    return line.at(np.linspace(0.0, line.end_m, max(2, int(line.end_m / 0.1))))


def test_paths_that_meet_twice_share_both_stretches() -> None:
    """12 m, a way round a block on either side of it, 14 m: the ride goes from the first to the last of it."""
    one = _line((0, 0), (12, 0), (12, 6), (20, 6), (20, 0), (34, 0))
    other = _line((0, 0), (12, 0), (12, -6), (20, -6), (20, 0), (34, 0))
    shared = common_path(one, other, 0.3)
    assert shared.length_m == pytest.approx(26.0, abs=1.5)
    assert (shared.start_a_m, shared.end_a_m) == pytest.approx((0.0, path_length(one)), abs=0.5)


def test_paths_that_meet_in_another_order_share_the_longer_stretch() -> None:
    one = _line((0, 0), (12, 0), (12, 6), (-6, 6), (-6, 12), (9, 12))
    other = _line((-6, 12), (9, 12), (9, 20), (-20, 20), (-20, 0), (12, 0))
    shared = common_path(one, other, 0.3)
    assert shared.length_m == pytest.approx(15.0, abs=0.5)
    assert shared.nearest is not None
    assert (shared.nearest.x, shared.nearest.y) == pytest.approx((-6.0, 12.0), abs=0.5)


@pytest.mark.parametrize("points", [2, 50, 64, 65, 400, 3000])
def test_a_path_is_asked_with_in_few_points_that_keep_to_it(points: int) -> None:
    angle = np.linspace(0.0, 3.0, points)
    plan = np.column_stack([20.0 * angle, 3.0 * np.sin(7.0 * angle)])
    asked = asked_path(plan)
    assert 2 <= len(asked) <= 64
    assert np.array([asked[0], asked[-1]]) == pytest.approx(plan[[0, -1]], abs=1e-3)
    _, away = Polyline(asked).project_all(plan)
    assert away.max() <= 0.1
