"""The grid simulator: events in order, drives that take as long as they must, rides by the real machines, faults."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import HitchhikingPoint, Obstacle, Pose2D
from hitchhike_ros.core.errors import GoalBlockedError, OutsideMapError, UnreachableError
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.events import Send, Tick
from hitchhike_ros.protocol.messages import Decouple, Message, Terminate
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.simulation.grid.body import Body
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.paths import GridPaths, corners
from hitchhike_ros.simulation.grid.robot import Errand
from hitchhike_ros.simulation.grid.world import GridWorld
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters

BOX = Obstacle("box", 30.0, 9.0, 1.0, 3.0)
GOAL, FARTHER = Pose2D(60.0, 10.0), Pose2D(66.0, 10.0)
WAITING = Pose2D(6.8, 10.0)


def hall() -> OccupancyGrid:
    """75 m by 15 m at 4 cells a metre; a wall at y = 5 m with one door at x = 35 m to 37.5 m."""
    data = np.zeros((60, 300), np.int8)
    data[[0, 20, -1]] = data[:, [0, -1]] = 100
    data[20, 140:150] = 0
    return OccupancyGrid(data.astype(np.int8), 0.25)


def world(boxes: tuple[Obstacle, ...] = (BOX,), seed: int = 0, json_messages: bool = True, **network: Any) -> GridWorld:
    point = HitchhikingPoint("west", ((4.0, 7.0), (12.0, 7.0), (12.0, 13.0), (4.0, 13.0)), Pose2D(8.0, 10.0), WAITING)
    radio = NetworkModel(NetworkParameters(**{"delay_s": 0.05, "seed": seed, **network}))
    return GridWorld(
        hall(), Sites((), (point,)), radio, GridWorldParameters(seed=seed, json_messages=json_messages), boxes
    )


def parameters(marker: int, **params: Any) -> HitchhikingParameters:
    return HitchhikingParameters(**{"marker_id": marker, "max_wait_s": 30.0, **params})


def pair(seed: int = 0, **network: Any) -> GridWorld:
    """A hitchhiker that waits at the point, and a driver that comes by."""
    w = world(seed=seed, **network)
    w.add_robot("rider", WAITING, parameters(1, profile=40.0), [Errand(GOAL)], clock_offset_s=3.5)
    w.add_robot("driver", Pose2D(2.0, 10.0), parameters(2, profile=80.0, may_ride=False), [Errand(FARTHER, 5.0)])
    return w


def test_a_solo_drive_arrives_when_its_path_says() -> None:
    w = world(boxes=())
    params = parameters(1, may_ride=False, cruise_speed_mps=0.7)
    robot = w.add_robot("solo", Pose2D(2.0, 2.0, 1.0), params, [Errand(Pose2D(60.0, 12.0, 2.0), at_s=4.0)])
    path = w.paths.plan((2.0, 2.0), (60.0, 12.0))
    metres = np.hypot(*np.diff(path, axis=0).T).sum()
    assert w.run(500.0, w.idle)
    (trip,) = robot.trips
    assert (trip.reached, trip.began_s) == (True, 4.0)
    assert trip.ended_s is not None
    assert trip.ended_s - 4.0 == pytest.approx(metres / 0.7, abs=0.02)
    assert trip.driven_m == pytest.approx(metres)
    assert w.pose("solo") == Pose2D(60.0, 12.0, 2.0)


def test_a_robot_that_drives_alone_needs_few_events() -> None:
    w = world(boxes=())
    params = parameters(1, may_ride=False, beacon_period_s=10.0)
    w.add_robot("solo", Pose2D(2.0, 10.0), params, [Errand(GOAL)])
    w.run(500.0, w.idle)
    assert w.now > 90.0
    assert w.events < 20


def test_events_come_in_the_order_of_time() -> None:
    w = pair(jitter_s=0.5, seed=1)
    times = []
    w.observers.append(lambda now, _name, _event, _effects: times.append(now))
    acted = []
    for time in (7.0, 3.0, 7.0, 5.0):
        w.at(time, lambda time=time: acted.append((time, w.now)))
    w.run(60.0)
    assert times == sorted(times)
    assert len(times) > 200
    assert acted == [(3.0, 3.0), (5.0, 5.0), (7.0, 7.0), (7.0, 7.0)]
    assert w.now == 60.0


def test_a_ride_with_its_handover() -> None:
    w = pair()
    assert w.run(300.0, w.idle)
    rider, driver = w.robots["rider"], w.robots["driver"]
    assert all(trip.reached for robot in (rider, driver) for trip in robot.trips)
    (award,) = driver.awards
    assert award.ride_m == pytest.approx(60.0 - 8.0, abs=0.5)  # as told
    assert award.ride_m - 0.2 <= rider.ridden_m <= award.ride_m + 2.0  # and a little more round the box
    assert rider.trips[0].ridden_m > 50.0
    assert set(rider.known) == {"box"}  # which it heard of from its driver
    assert rider.state_s["riding"] > rider.ridden_m / rider.params.ride_speed_mps
    assert distance(w.pose("rider"), GOAL) < 0.1


def test_a_rider_stays_behind_its_driver_on_the_trail() -> None:
    w = pair()
    gaps, off = [], []

    def watch(_now: float, name: str, event: object, _effects: object) -> None:
        rider, driver = w.robots["rider"], w.robots["driver"]
        if name == "rider" and isinstance(event, Tick) and rider.status.state == "riding":
            gaps.append(rider.agent.hitchhiker.gap_m() or math.nan)
            trail = min(
                math.dist((rider.body.x, rider.body.y), driver.body.point(s))
                for s in driver.body.odometer_m - np.arange(0.0, 2.5, 0.02)
            )
            off.append(trail)

    w.observers.append(watch)
    w.run(300.0, w.idle)
    assert len(gaps) > 100
    assert np.nanmax(gaps) < 1.0
    assert np.nanmin(gaps) > 0.6
    assert not np.isnan(gaps).any()
    assert max(off[10:]) < 0.05  # after the straight way to where the driver was


def test_the_same_seed_is_the_same_run() -> None:
    def run(seed: int) -> list[str]:
        w = pair(seed, loss=0.2, jitter_s=0.3, duplication=0.1)
        w.run(40.0)
        return list(w.trace())

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_messages_as_text_and_as_objects_make_the_same_run() -> None:
    def history(text: bool) -> list[tuple[float, str, str]]:
        w = pair(json_messages=text)
        w.run(300.0, w.idle)
        return w.robots["rider"].history + w.robots["driver"].history

    assert history(True) == history(False)


def test_a_robot_that_runs_is_not_restarted_nor_one_that_is_down_crashed_again() -> None:
    w = pair()
    w.run(1.0)
    agent = w.robots["driver"].agent
    w.restart("driver")
    assert w.robots["driver"].agent is agent
    told: list[object] = []
    w.observers.append(lambda _now, name, event, _effects: told.append(event) if name == "driver" else None)
    w.crash("driver")
    w.crash("driver")
    assert told == ["crash"]


def test_a_robot_that_crashes_says_nothing_and_goes_on_after_its_restart() -> None:
    w = pair()
    said: list[tuple[float, object]] = []

    def listen(now: float, name: str, event: object, effects: Any) -> None:
        if name == "driver":
            said.extend((now, e.message) for e in effects if isinstance(e, Send))
            if isinstance(event, str):
                said.append((now, event))

    w.observers.append(listen)
    w.at(50.0, lambda: w.crash("driver"))
    w.at(70.0, lambda: w.restart("driver"))
    w.run(50.0)
    assert w.robots["rider"].status.state == "riding"
    place = w.pose("driver")
    w.run(69.0)
    assert w.pose("driver") == place
    assert w.run(500.0, w.idle)
    assert [said for said in said if 50.0 <= said[0] < 70.0] == [(50.0, "crash")]
    assert (70.0, "restart") in said
    assert all(trip.reached for robot in w.robots.values() for trip in robot.trips)
    assert w.robots["rider"].trips[0].ridden_m < 40.0
    assert not any(isinstance(message, Decouple) for _, message in said)


def test_the_trace_is_bounded_and_says_what_happened() -> None:
    w = pair()
    w.run(300.0, w.idle)
    lines = list(w.trace())
    assert len(lines) == w.params.trace_events
    assert any("Goal reached" in line for line in lines)
    assert any("driver" in line and "send status" in line for line in lines)


def test_who_cannot_hear_gets_nothing() -> None:
    w = pair(range_m=3.0)
    heard: list[float] = []

    def listen(_now: float, name: str, event: object, _effects: object) -> None:
        if name == "rider" and isinstance(event, Message):
            heard.append(abs(w.pose("driver").x - w.pose("rider").x))

    w.observers.append(listen)
    w.run(300.0, w.idle)
    assert heard
    assert max(heard) < 3.2  # it has gone on a little when the message comes


def test_a_goal_that_cannot_be_reached_is_given_up_with_the_reason() -> None:
    w = world()
    robot = w.add_robot("solo", Pose2D(2.0, 2.0), parameters(1), [Errand(Pose2D(70.0, 5.1))])
    w.run(100.0, w.idle)
    assert not robot.trips[0].reached
    assert "too near to an obstacle" in robot.trips[0].reason.detail


@pytest.mark.parametrize(("goal", "reached"), [(Pose2D(2.05, 2.0), True), (Pose2D(70.0, 5.1), False)])
def test_the_end_of_a_goal_is_noticed_at_once_though_beacons_are_rare(goal: Pose2D, reached: bool) -> None:
    w = world()
    robot = w.add_robot("solo", Pose2D(2.0, 2.0), parameters(1, beacon_period_s=500.0), [Errand(goal, at_s=1.0)])
    assert w.run(100.0, w.idle)
    (trip,) = robot.trips
    assert trip.reached is reached
    assert trip.ended_s is not None
    assert trip.ended_s - 1.0 <= (0.1 if reached else robot.params.planner_patience_s + 1.0)


def test_a_robot_that_waits_at_its_place_is_not_ticked_all_the_time() -> None:
    w = pair()
    w.robots["driver"].errands.clear()
    w.run(100.0)
    assert w.robots["rider"].state_s["requesting"] > 20.0
    assert w.events < 100.0 * 4 * 4


@pytest.mark.parametrize(
    ("periods", "riding_s", "driving_s"),
    [({}, 0.3, 0.1), ({"look_period_s": 0.4, "riding_look_period_s": 0.5}, 0.5, 0.4)],
)
def test_on_a_ride_robots_are_ticked_when_their_agents_look(
    periods: dict[str, float], riding_s: float, driving_s: float
) -> None:
    w = world()
    rider = w.add_robot("rider", WAITING, parameters(1, profile=40.0, **periods), [Errand(GOAL)])
    trip = [Errand(FARTHER, 5.0)]
    driver = w.add_robot("driver", Pose2D(2.0, 10.0), parameters(2, profile=80.0, may_ride=False, **periods), trip)
    ticks: dict[str, list[float]] = {"rider": [], "driver": []}

    def note(now: float, name: str, event: object, _effects: object) -> None:
        if isinstance(event, Tick) and (rider.status.state, driver.status.state) == ("riding", "driving"):
            ticks[name].append(now)

    w.observers.append(note)
    assert w.run(300.0, w.idle)
    for times, period_s in ((ticks["rider"], riding_s), (ticks["driver"], driving_s)):
        apart = np.diff(times)
        assert apart.max() == pytest.approx(period_s)
        assert np.median(apart) == pytest.approx(period_s)


def test_a_robot_that_stands_alone_repeats_its_last_words_in_time_and_is_not_ticked_otherwise() -> None:
    w = world()
    quiet = {"beacon_period_s": 30.0, "robot_timeout_s": 60.0}
    rider = w.add_robot("rider", WAITING, parameters(1, profile=40.0, **quiet), [Errand(GOAL)])
    trip = [Errand(FARTHER, 5.0)]
    w.add_robot("driver", Pose2D(2.0, 10.0), parameters(2, profile=80.0, may_ride=False, **quiet), trip)
    w.run(100.0, lambda: rider.status.state == "riding")
    w.crash("driver")
    w.give_goal("rider", None)
    assert w.run(w.now + 10.0, lambda: rider.status.state == "idle")
    ticks, words = [], []

    def note(now: float, _name: str, event: object, effects: object) -> None:
        assert isinstance(event, Tick)
        assert isinstance(effects, list)
        ticks.append(now)
        words.extend(now for e in effects if isinstance(e, Send) and isinstance(e.message, Terminate))

    w.observers.append(note)
    w.run(w.now + 8.0)
    assert len(words) >= 5
    assert np.diff(words) == pytest.approx(rider.params.repeat_period_s)
    assert len(ticks) <= len(words) + 2


def test_the_same_name_or_marker_twice_is_refused() -> None:
    w = pair()
    with pytest.raises(ValueError, match="driver is there already"):
        w.add_robot("driver", Pose2D(2.0, 2.0), parameters(7))
    with pytest.raises(ValueError, match="driver has marker 2"):
        w.add_robot("other", Pose2D(2.0, 2.0), parameters(2))


# Paths.


def test_a_path_costs_what_the_paper_says() -> None:
    paths = GridPaths(hall(), 0.25)
    path = paths.plan((2.125, 10.125), (4.125, 11.125))
    assert np.hypot(*np.diff(path, axis=0).T).sum() / 0.25 == pytest.approx(4 + 4 * math.sqrt(2.0))
    assert (path[0], path[-1]) == (pytest.approx((2.125, 10.125)), pytest.approx((4.125, 11.125)))
    assert np.hypot(*np.diff(corners(path), axis=0).T).sum() == pytest.approx(1.0 + math.sqrt(2.0))


def test_paths_to_one_goal_share_their_ends() -> None:
    paths = GridPaths(hall(), 0.25)
    a, b = (paths.plan(start, (60.0, 3.0)) for start in ((2.0, 10.0), (20.0, 13.0)))
    shared = {tuple(p) for p in a.tolist()} & {tuple(p) for p in b.tolist()}
    assert len(shared) > 80


def test_a_known_box_is_driven_around() -> None:
    paths = GridPaths(hall(), 0.25, (BOX,))
    free, around = (paths.plan((20.0, 10.0), (40.0, 10.0), known) for known in ((), ("box",)))
    clear = [
        min(math.dist(p, (min(max(p[0], 30.0), 31.0), min(max(p[1], 9.0), 12.0))) for p in path.tolist())
        for path in (free, around)
    ]
    assert clear[0] == 0.0
    assert clear[1] >= 0.25


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ((80.0, 10.0), OutsideMapError),
        ((math.nan, 10.0), OutsideMapError),
        ((60.0, 5.1), GoalBlockedError),
        ((60.0, 3.0), UnreachableError),
    ],
)
def test_why_there_is_no_path(goal: tuple[float, float], error: type[Exception]) -> None:
    data = hall().data.copy()
    data[20] = 100
    with pytest.raises(error):
        GridPaths(OccupancyGrid(data, 0.25), 0.25).plan((2.0, 10.0), goal)


def test_a_robot_too_near_to_a_wall_finds_its_way_out() -> None:
    path = GridPaths(hall(), 0.5).plan((2.0, 5.3), (10.0, 10.0))
    assert tuple(path[0]) == (2.0, 5.3)
    assert (path[1:, 1] > 5.7).all()


def test_line_of_sight() -> None:
    paths = GridPaths(hall(), 0.25, (BOX,))
    assert paths.sees((2.0, 10.0), (6.0, 11.0))
    assert paths.sees((36.0, 8.0), (36.5, 3.0))  # through the door
    assert not paths.sees((33.0, 8.0), (33.5, 3.0))
    assert not paths.sees((29.0, 10.0), (32.0, 10.0))  # the box
    assert not paths.sees((2.0, 10.0), (-1.0, 10.0))
    assert paths.sees_box((28.0, 10.0), BOX)
    assert not paths.sees_box((30.0, 4.0), BOX)


# Bodies.


def test_a_body_looks_along_its_path_and_rounds_corners() -> None:
    body = Body(Pose2D(0.0, 0.0, 1.0), 10.0)
    body.drive(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]]), 0.5, 3.0)
    assert body.arrives == pytest.approx(18.0)
    headings = []
    for time in np.arange(10.0, 18.0, 0.1):
        body.advance(float(time))
        headings.append(body.theta)
    assert headings[5] == pytest.approx(0.0, abs=1e-9)
    assert headings[-1] == pytest.approx(math.pi / 2)
    assert np.abs(np.diff(headings)).max() < 0.2
    body.advance(20.0)
    assert body.pose == Pose2D(2.0, 2.0, 3.0)
    assert (body.speed_mps, body.odometer_m) == (0.0, 4.0)


def test_a_follower_stops_where_it_has_lost_sight() -> None:
    leader, rider = Body(Pose2D(2.0, 0.0), 0.0), Body(Pose2D(0.0, 0.0), 0.0)
    rider.follow(leader, 1.2, 0.65)
    rider.look(True)
    leader.drive(np.array([[2.0, 0.0], [12.0, 0.0]]), 0.5, None)
    rider.advance(4.0)
    assert rider.x == pytest.approx(2.6)  # still catching up
    rider.advance(8.0)
    assert (rider.x, rider.speed_mps) == (pytest.approx(6.0 - 1.2), 0.5)
    rider.look(False)
    rider.advance(20.0)
    assert (rider.x, rider.speed_mps) == (pytest.approx(4.8), 0.0)
    rider.look(True)
    rider.advance(40.0)
    assert rider.x == pytest.approx(12.0 - 1.2)
    assert rider.speed_mps == 0.0
