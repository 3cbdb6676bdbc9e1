"""Rides that are arranged from afar (P18 §4 to §6): real agents in the grid simulator, three corridors.

y = 64  |            |            hitchhiking points: "west" on the long corridor, eastward; "south" before the
        |            |            crossing, northward; "north" on the right one behind the crossing, northward
y = 30  +---west-----+----- x = 70
                     |
y =  2               south
      x = 10        x = 45
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import HitchhikingPoint, Obstacle, Pose2D
from hitchhike_ros.core.geometry import compose, distance
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.events import Send
from hitchhike_ros.protocol.matching import shared_stretch
from hitchhike_ros.protocol.messages import Accept, Beacon, Lock, Message, Request
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.robot import Errand, GridRobot
from hitchhike_ros.simulation.grid.world import GridWorld
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters

_RESOLUTION = 0.25
_FREE = ((2.0, 28.5, 70.0, 31.5), (8.5, 28.5, 11.5, 66.0), (43.5, 2.0, 46.5, 66.0))
EAST, NORTH, SOUTH = 0.0, math.pi / 2, -math.pi / 2
WEST_POINT = Pose2D(12.0, 30.0, EAST)


def _grid() -> OccupancyGrid:
    data = np.full((272, 300), 100, dtype=np.int8)
    for x0, y0, x1, y1 in _FREE:
        rows, columns = (slice(int(a / _RESOLUTION), int(b / _RESOLUTION)) for a, b in ((y0, y1), (x0, x1)))
        data[rows, columns] = 0
    return OccupancyGrid(data, _RESOLUTION)


def _point(name: str, waiting: Pose2D) -> HitchhikingPoint:
    x, y = waiting.x, waiting.y
    area = ((x - 3, y - 3), (x + 3, y - 3), (x + 3, y + 3), (x - 3, y + 3))
    return HitchhikingPoint(name, area, compose(waiting, Pose2D(1.2)), waiting)


GRID = _grid()
SITES = Sites((), (_point("west", WEST_POINT), _point("north", Pose2D(45.0, 34.0, NORTH))))


class Fleet:
    """Robots by name, and what becomes of them."""

    def __init__(self, sites: Sites = SITES, boxes: tuple[Obstacle, ...] = (), **network: Any) -> None:
        params = GridWorldParameters(position_sigma_m=0.0, heading_sigma_rad=0.0)
        self.world = GridWorld(GRID, sites, NetworkModel(NetworkParameters(**network)), params, boxes)
        self.heard: list[tuple[float, str, Message]] = []
        self.world.observers.append(self._note)

    def _note(self, now: float, robot: str, event: object, _effects: object) -> None:
        if isinstance(event, Message) and not isinstance(event, Beacon):
            self.heard.append((now, robot, event))

    def add(self, name: str, start: Pose2D, goal: Pose2D, at_s: float = 3.0, **hitchhiking: Any) -> GridRobot:
        params = HitchhikingParameters(**{"mode": "network", "marker_id": len(self.world.robots), **hitchhiking})
        return self.world.add_robot(name, start, params, [Errand(goal, at_s)])

    def driver(self, name: str, start: Pose2D, goal: Pose2D, at_s: float = 0.0, **hitchhiking: Any) -> GridRobot:
        return self.add(name, start, goal, at_s, **{"may_ride": False, "profile": 80.0, **hitchhiking})

    def run(self, until: Callable[[], bool] | None = None, limit_s: float = 600.0) -> Fleet:
        stopped = self.world.run(limit_s, until or self.world.idle)
        assert stopped, [robot.status for robot in self.world.robots.values()]
        if until is None:
            for robot in self.world.robots.values():
                for trip in robot.trips:
                    assert trip.reached, (robot.name, robot.history)
                    # Who comes to a goal that another robot has stands before it, in line where there are several.
                    away_m = 3.0 if trip.reason.reason is Reason.GOAL_TAKEN else 0.15
                    assert distance(robot.body.pose, trip.goal) < away_m
        return self


def _states(robot: GridRobot) -> list[str]:
    return [state for _, state, _ in robot.history]


def _since(robot: GridRobot, state: str) -> float:
    return next(time for time, name, _ in robot.history if name == state)


def _waited(robot: GridRobot) -> float:
    """From the question to the moment when the ride begins, or when it leaves alone."""
    leaves = next((time for time, name, _ in robot.history if name in ("coupling", "navigating")), math.inf)
    return leaves - _since(robot, "requesting")


FAR_DRIVER = Pose2D(10.0, 55.0, SOUTH), Pose2D(69.0, 30.0, EAST)
EAST_END = Pose2D(62.0, 29.4, EAST)


def test_a_ride_that_is_arranged_from_afar() -> None:
    fleet = Fleet(boxes=(Obstacle("box", 30.0, 29.0, 0.5, 0.5),))
    driver, rider = fleet.driver("driver", *FAR_DRIVER), fleet.add("rider", WEST_POINT, EAST_END)
    fleet.run()
    assert _states(rider)[1:] == [
        *("requesting", "locking", "awaiting_aligned", "coupling", "riding", "settling", "relocalizing"),
        *("navigating", "idle"),
    ]
    assert _states(driver)[1:] == ["navigating", "aligning", "aligned", "driving", "decoupling", "navigating", "idle"]
    (award,) = driver.awards
    assert award.ride_m == pytest.approx(62.0 - 13.2, abs=1.5)
    assert rider.trips[0].ridden_m == pytest.approx(award.ride_m, abs=0.5)
    assert set(rider.known) == {"box"}  # which it has never seen


@pytest.mark.parametrize("factor", [1.0, 1.5, 2.0, 3.0])
def test_a_driver_hurries_to_a_hitchhiker_that_waits_and_never_with_one(factor: float) -> None:
    """P18 §8.1.3: the wait is inversely proportional to its speed."""
    fleet = Fleet()
    driver = fleet.driver("driver", *FAR_DRIVER, cruise_speed_mps=0.5, safe_speed_mps=0.5 * factor)
    rider = fleet.add("rider", WEST_POINT, EAST_END)
    speeds: dict[str, set[float]] = {}

    def note(*_: object) -> None:
        speeds.setdefault(driver.status.state, set()).add(round(driver.status.speed_limit_mps or 0.0, 3))

    fleet.world.observers.append(note)
    fleet.run()
    way_m = 55.0 - 30.0 + 2.0 - 0.5 * 3.25  # and what it has driven when it is asked
    assert _waited(rider) == pytest.approx(way_m / (0.5 * factor), rel=0.1)
    assert max(speeds["aligning"]) == pytest.approx(0.5 * factor)
    assert speeds["driving"] == speeds["decoupling"] == {driver.params.ride_speed_mps}
    assert speeds["navigating"] == {0.5}


@pytest.mark.parametrize(
    ("policy", "priority", "chosen"),
    [("profile", 10, "far"), ("profile", 12, "near"), ("proximity", 10, "near"), ("arrival", 10, "near")],
)
def test_the_best_driver_is_chosen_by_policy_and_the_others_are_told(policy: str, priority: int, chosen: str) -> None:
    """Priority above the usual chooses the nearest (P18 §4)."""
    fleet = Fleet()
    for name, profile, y in (("near", 60.0, 40.0), ("middle", 70.0, 48.0), ("far", 90.0, 56.0)):
        fleet.driver(name, Pose2D(10.0, y, SOUTH), FAR_DRIVER[1], profile=profile)
    rider = fleet.add("rider", WEST_POINT, EAST_END, policy=policy, priority=priority)
    fleet.run(lambda: rider.status.state == "riding")
    assert rider.status.ride is not None
    assert rider.status.ride.driver == chosen
    cancelled = {robot for _, robot, m in fleet.heard if m.type == "request_cancel"}
    assert cancelled == {"near", "middle", "far"} - {chosen}
    accepted = {m.robot_id for _, _, m in fleet.heard if isinstance(m, Accept)}
    assert accepted == {"near", "middle", "far"}


def test_drivers_that_have_set_out_at_the_same_moment_are_heard_all() -> None:
    """Their beacons have not offered a place yet; the nearest is the first to answer."""
    fleet = Fleet(delay_s=0.1, jitter_s=0.3)
    for name, profile, y in (("near", 60.0, 40.0), ("middle", 70.0, 48.0), ("far", 90.0, 56.0)):
        fleet.driver(name, Pose2D(10.0, y, SOUTH), FAR_DRIVER[1], profile=profile, at_s=3.0)
    rider = fleet.add("rider", WEST_POINT, EAST_END)
    fleet.run(lambda: rider.status.state == "awaiting_aligned")
    assert rider.status.ride is not None
    assert rider.status.ride.driver == "far"


@pytest.mark.parametrize(
    ("params", "asked", "reason"),
    [
        ({"priority": 17}, {}, "High priority"),
        ({"may_drive": False}, {}, "Does not drive others"),
        ({"profile": 30.0}, {}, "Profile mismatch"),
        ({}, {"min_ride_m": 45.0}, "Path too short"),
        ({}, {"goal": Pose2D(10.0, 64.0, NORTH)}, "Path too short"),
    ],
)
def test_a_denial_comes_from_afar_and_the_hitchhiker_leaves_at_once(
    params: dict[str, Any], asked: dict[str, Any], reason: str
) -> None:
    fleet = Fleet()
    settings = {"min_ride_m": asked.pop("min_ride_m", 20.0)} if "min_ride_m" in asked else {}
    fleet.driver("driver", Pose2D(10.0, 55.0, SOUTH), asked.pop("goal", Pose2D(50.0, 30.0)), **{**params, **settings})
    rider = fleet.add("rider", WEST_POINT, EAST_END, profile=50.0)
    fleet.run()
    assert _waited(rider) < 1.0
    assert reason in next(why for _, state, why in rider.history if state == "navigating")


def test_where_nobody_is_a_hitchhiker_leaves_when_it_has_listened_for_a_while() -> None:
    rider = (fleet := Fleet()).add("rider", WEST_POINT, EAST_END)
    fleet.run()
    assert _waited(rider) == pytest.approx(rider.params.offer_window_s, abs=0.3)


@pytest.mark.parametrize("delay_s", [0.0, 1.0, 2.0])
def test_the_delay_of_the_network_is_what_a_denial_costs(delay_s: float) -> None:
    fleet = Fleet(delay_s=delay_s)
    fleet.driver("driver", *FAR_DRIVER, priority=17)
    rider = fleet.add("rider", WEST_POINT, EAST_END, at_s=6.0, offer_window_s=10.0, robot_timeout_s=8.0)
    fleet.run()
    # A driver in a hurry announces no place, so only its answer counts: there and back.
    assert _waited(rider) == pytest.approx(2.0 * delay_s + 0.25, abs=0.5)


def test_a_partial_ride() -> None:
    """P18 §5: alone to the nearest hitchhiking point on the driver's way, where the driver waits."""
    fleet = Fleet()
    driver = fleet.driver("driver", Pose2D(45.0, 8.0, NORTH), Pose2D(45.0, 65.0, NORTH))
    rider = fleet.add("rider", Pose2D(25.0, 30.0, EAST), Pose2D(44.5, 64.0, NORTH))
    fleet.run()
    assert rider.trips[0].ridden_m == pytest.approx(64.0 - 35.2, abs=1.5)
    assert rider.trips[0].driven_m - rider.trips[0].ridden_m == pytest.approx(24.0, abs=4.0)
    assert _since(driver, "driving") - _since(rider, "coupling") < 2.0


def test_two_drivers_each_longer_than_t_dhh_and_the_second_waits() -> None:
    """P18 §6: it is booked while the first ride is on."""
    fleet = Fleet()
    first = fleet.driver("first", Pose2D(10.0, 45.0, SOUTH), Pose2D(60.0, 30.0, EAST))
    second = fleet.driver("second", Pose2D(45.0, 8.0, NORTH), Pose2D(45.0, 65.0, NORTH), cruise_speed_mps=0.4)
    rider = fleet.add("rider", WEST_POINT, Pose2D(44.5, 64.0, NORTH))
    fleet.run()
    rides = [driver.awards[0].ride_m for driver in (first, second)]
    assert [len(driver.awards) for driver in (first, second)] == [1, 1]
    assert min(rides) > 20.0
    assert _since(second, "aligning") < next(t for t, s, _ in first.history if s == "decoupling")
    waited = next(t for t, s, _ in second.history if s == "driving") - _since(second, "aligned")
    assert 5.0 < waited < 60.0
    assert _states(rider).count("requesting") == 1  # the robot itself never stood and asked again
    assert rider.trips[0].ridden_m == pytest.approx(sum(rides), abs=1.0)


def test_a_second_driver_that_is_gone_leaves_the_rider_to_itself() -> None:
    fleet = Fleet()
    fleet.driver("first", Pose2D(10.0, 45.0, SOUTH), Pose2D(60.0, 30.0, EAST))
    second = fleet.driver("second", Pose2D(45.0, 3.0, NORTH), Pose2D(45.0, 65.0, NORTH), cruise_speed_mps=0.4)
    rider = fleet.add("rider", WEST_POINT, Pose2D(44.5, 64.0, NORTH))
    fleet.run(lambda: second.status.state == "aligned")
    fleet.world.crash("second")
    fleet.run(lambda: rider.idle)
    assert rider.trips[0].reached
    assert rider.trips[0].ridden_m > 20.0


def test_roles_are_reversed_where_the_one_that_asks_has_the_better_profile() -> None:
    fleet = Fleet()
    low = fleet.add("low", Pose2D(10.0, 55.0, SOUTH), Pose2D(69.0, 30.0), at_s=0.0, profile=30.0)
    high = fleet.add("high", Pose2D(9.0, 30.0, EAST), Pose2D(60.0, 30.0), at_s=8.0, profile=90.0)
    fleet.run()
    assert high.awards[0].hitchhiker == "low"
    assert high.awards[0].ride_m == pytest.approx(60.0 - 13.2, abs=1.5)
    assert low.trips[0].ridden_m > 40.0
    assert high.trips[0].ridden_m == 0.0


def test_roles_stay_where_nobody_wants_them_reversed() -> None:
    fleet = Fleet()
    low = fleet.add("low", Pose2D(10.0, 55.0, SOUTH), Pose2D(69.0, 30.0), 0.0, profile=30.0, role_reversal=False)
    high = fleet.add("high", Pose2D(9.0, 30.0, EAST), Pose2D(60.0, 30.0), at_s=8.0, profile=90.0)
    fleet.run()
    assert low.trips[0].ridden_m == high.trips[0].ridden_m == 0.0


# Convoys.


def _convoy(goals: tuple[float, float, float] = (62.0, 62.0, 62.0), places: int = 3) -> tuple[Fleet, list[GridRobot]]:
    fleet = Fleet()
    fleet.driver("driver", *FAR_DRIVER, places=places)
    riders = [
        fleet.add(f"rider{k}", Pose2D(12.0 - 1.2 * k, 30.0, EAST), Pose2D(goal, 29.4, EAST), 3.0 + 0.5 * k)
        for k, goal in enumerate(goals)
    ]
    return fleet, riders


def test_a_convoy_where_each_follows_the_one_ahead_and_all_arrive() -> None:
    fleet, riders = _convoy()
    driver = fleet.world.robots["driver"]
    fleet.run(lambda: driver.status.state == "driving")
    assert driver.status.convoy == ("rider0", "rider1", "rider2")
    followed = [robot.status.servo.marker_id for robot in riders if robot.status.servo is not None]
    assert followed == [0, 1, 2]
    fleet.run(lambda: driver.body.pose.x > 40.0)
    xs = [robot.body.pose.x for robot in (driver, *riders)]
    assert all(0.9 < ahead - behind < 1.6 for ahead, behind in pairwise(xs))
    fleet.run()
    assert sorted(award.hitchhiker for award in driver.awards) == ["rider0", "rider1", "rider2"]
    for robot in riders:
        assert robot.trips[0].ridden_m > 45.0


@pytest.mark.parametrize("goals", [(40.0, 62.0, 62.0), (62.0, 40.0, 62.0), (62.0, 62.0, 40.0)])
def test_anyone_leaves_at_its_own_point_and_those_behind_close_up(goals: tuple[float, float, float]) -> None:
    fleet, riders = _convoy(goals)
    driver = fleet.world.robots["driver"]
    fleet.run(lambda: len(driver.awards) == 1)
    leaver = riders[goals.index(40.0)]
    assert driver.awards[0].hitchhiker == leaver.name
    fleet.run(lambda: driver.status.state == "driving")
    followed = [r.status.servo.marker_id for r in riders if r is not leaver and r.status.servo is not None]
    first, _ = (r for r in riders if r is not leaver)
    assert followed == [0, first.params.marker_id]
    fleet.run()
    for robot, goal in zip(riders, goals, strict=True):
        assert robot.trips[0].ridden_m == pytest.approx(goal - 13.2, abs=2.5)
    assert len({award.hitchhiker for award in driver.awards}) == 3


def test_one_that_leaves_a_convoy_knows_the_driver_and_the_robot_ahead_each_where_it_is() -> None:
    """The driver's messages tell a rider of the robot ahead of it, which is the driver for the first one alone."""
    fleet, riders = _convoy((62.0, 40.0, 62.0))
    driver, leaver = fleet.world.robots["driver"], riders[1]
    fleet.run(lambda: leaver.status.state == "relocalizing")
    known = sorted(leaver.agent.status(fleet.world.now).robots, key=lambda robot: robot.x)
    poses = riders[0].body.pose, driver.body.pose
    assert [(robot.x, robot.y) for robot in known] == [pytest.approx((pose.x, pose.y), abs=0.1) for pose in poses]
    assert [robot.radius_m for robot in known] == [0.4, 0.2]  # the rider ahead has not said what it is


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_one_lost_follower_does_not_lose_the_rest(lost: int) -> None:
    fleet, riders = _convoy()
    driver = fleet.world.robots["driver"]
    fleet.run(lambda: driver.body.pose.x > 25.0)
    fleet.world.crash(riders[lost].name)
    rest = [robot for robot in riders if robot is not riders[lost]]
    fleet.run(lambda: driver.idle and all(robot.idle for robot in rest))
    assert all(robot.trips[0].reached for robot in rest)
    assert {award.hitchhiker for award in driver.awards} >= {robot.name for robot in rest}


def test_a_full_convoy_takes_no_more() -> None:
    fleet, riders = _convoy(places=2)
    fleet.run()
    assert [robot.trips[0].ridden_m > 40.0 for robot in riders] == [True, True, False]


@pytest.mark.parametrize("first", [0, 1, 2])
def test_who_stands_in_front_rides_in_front_whoever_asks_first(first: int) -> None:
    fleet = Fleet()
    driver = fleet.driver("driver", *FAR_DRIVER, places=3)
    for k in range(3):
        at_s = 3.0 if k == first else 3.5
        fleet.add(f"rider{k}", Pose2D(12.0 - 1.2 * k, 30.0, EAST), Pose2D(62.0, 29.4, EAST), at_s)
    fleet.run(lambda: driver.status.state == "driving")
    assert driver.status.convoy == ("rider0", "rider1", "rider2")


def test_places_are_given_once() -> None:
    fleet, _ = _convoy()
    fleet.run()
    places = {(m.to, m.place) for _, _, m in fleet.heard if m.type == "ack" and getattr(m, "of", "") == "lock"}
    assert places == {("rider0", 1), ("rider1", 2), ("rider2", 3)}


# Bad luck and bad input.


@pytest.mark.parametrize("seed", range(3))
def test_rides_on_a_network_that_loses_doubles_and_delays(seed: int) -> None:
    fleet = Fleet(loss=0.3, duplication=0.2, delay_s=0.1, jitter_s=0.3, reordering=0.1, reorder_delay_s=0.5, seed=seed)
    fleet.driver("driver", *FAR_DRIVER, places=2)
    for k in range(2):
        fleet.add(f"rider{k}", Pose2D(12.0 - 1.2 * k, 30.0, EAST), EAST_END, 3.0 + 0.5 * k)
    fleet.run()


@pytest.mark.parametrize(
    ("change", "ignored"),
    [
        ({"ride_id": "another"}, 1),
        ({"path": ((1e7, 0.0, 0.0), (2e7, 0.0, 1.0))}, 0),
        ({"path": ((30.0, 30.0, 0.0), (69.0, 30.0, 60.0))}, 0),
        ({"path": ()}, 0),
    ],
    ids=["unknown ride", "off the map", "has passed", "no path"],
)
def test_an_offer_that_is_none_is_not_taken(change: dict[str, Any], ignored: int) -> None:
    fleet = Fleet()
    rider = fleet.add("rider", WEST_POINT, EAST_END)
    fleet.run(lambda: rider.status.state == "requesting")
    hitchhiker, now = rider.agent.hitchhiker, fleet.world.now
    fields: dict[str, Any] = {
        "robot_id": "nobody",
        "to": "rider",
        "ride_id": hitchhiker.ride_id,
        "x": 10.0,
        "y": 40.0,
        "theta": SOUTH,
        "profile": 90.0,
        "ride_m": 50.0,
        "decouple_point": (69.0, 30.0),
        "marker_id": 9,
        "marker_size_m": 0.16,
        "marker_pose": Pose2D(-0.2, 0.0, math.pi),
        "path": ((10.0, 40.0, 0.0), (10.0, 30.0, 20.0), (69.0, 30.0, 140.0)),
    }
    before = hitchhiker.ignored
    rider.agent.step(Accept(**{**fields, **change}), now)
    assert hitchhiker.ignored - before == ignored
    fleet.run(lambda: rider.status.state != "requesting")
    assert rider.status.state == "navigating"
    assert rider.status.reason in ("Driving alone is better", "Driver not found")


def test_a_driver_denies_a_lock_whose_meeting_is_not_on_its_way() -> None:
    fleet = Fleet()
    driver = fleet.driver("driver", *FAR_DRIVER)
    fleet.run(lambda: fleet.world.now > 1.0)
    common: dict[str, Any] = {"robot_id": "rider", "to": "driver", "ride_id": "r"}
    ask = Request(**common, x=12.0, y=30.0, theta=0.0, goal=EAST_END, profile=10.0)
    now = fleet.world.now

    def answer(message: Message) -> Any:
        (sent,) = (effect.message for effect in driver.agent.step(message, now) if isinstance(effect, Send))
        return sent

    assert isinstance(answer(ask), Accept)
    places = {"aligning": Pose2D(13.2, 30.0), "waiting": WEST_POINT, "leave": (60.0, 30.0)}
    for change, reason in (
        ({"aligning": Pose2D(13.2, 40.0)}, "Invalid HH place"),
        ({"aligning": Pose2D(13.2, 30.0, math.pi)}, "Invalid HH place"),
        ({"leave": (45.0, 60.0)}, "Invalid HH place"),
        ({"leave": (20.0, 30.0)}, "Path too short"),
        ({"leave": None}, "No such offer"),
        ({"aligning": None}, "No such offer"),
    ):
        denial = answer(Lock(**common, **{**places, **change}))
        assert getattr(denial, "reason", None) == reason, change
    assert driver.agent.driver.refused == 6
    assert answer(Lock(**common, **places)).type == "ack"


@pytest.mark.parametrize(
    ("goal", "able"),
    [
        (Pose2D(60.0, 30.0), True),
        (Pose2D(45.0, 64.0, NORTH), True),  # round a corner, P18 Experiment 3: 28.8 m and then 37.4 m
        (Pose2D(8.0, 30.0), False),
        (Pose2D(10.0, 64.0, NORTH), False),
    ],
)
def test_who_can_drive_one_towards_its_goal(goal: Pose2D, able: bool) -> None:
    path = OwnPath(np.array([(10.0, 30.0), (42.0, 30.0)]))
    way = GridWorld(GRID, SITES).paths.plan((12.0, 30.0), (goal.x, goal.y))
    assert (shared_stretch(path, way, SITES, HitchhikingParameters(mode="network")) is not None) is able


def test_a_driver_that_says_it_is_late_is_not_waited_for() -> None:
    fleet = Fleet()
    driver = fleet.driver("driver", *FAR_DRIVER)
    rider = fleet.add("rider", WEST_POINT, EAST_END, max_wait_s=30.0)
    fleet.run(lambda: rider.status.state == "awaiting_aligned")
    assert rider.status.ride is not None
    facts = driver.agent.driver.facts
    facts.boarding = replace(facts.boarding, at_m=facts.boarding.at_m + 100.0)  # as if it had come to a way round
    fleet.run(lambda: rider.status.state != "awaiting_aligned", limit_s=fleet.world.now + 5.0)
    assert (rider.status.state, rider.status.reason) == ("requesting", "Driver is late")
    fleet.run(lambda: driver.status.role == "none")
