"""Itineraries: the optimum, the papers' rides as special cases, and announcements that cannot be planned with."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from hitchhike_ros.core.errors import ItineraryInputError, UnreachableError
from hitchhike_ros.experiments.bench import itineraries as bench_itineraries
from hitchhike_ros.experiments.bench.itineraries import along_corridors, building_fleet, small_fleet
from hitchhike_ros.experiments.bench.itinerary_reference import cheapest
from hitchhike_ros.planning.announced import AnnouncedDriver, RideRules, possible_rides, usable_drivers
from hitchhike_ros.planning.itinerary import ItineraryCosts, ItineraryParameters, ItineraryRequest, plan_itinerary
from hitchhike_ros.planning.overlap import common_path

RULES = RideRules()
ANYWHERE = ItineraryParameters(RideRules(board_anywhere=True))
SEEDS = st.integers(0, 10**9)


def nodes(*corners: tuple[int, int]) -> np.ndarray:
    """The nodes of a grid path, 1 m apart, through corners that are joined by straight lines along the axes."""
    path = [corners[0]]
    for x, y in corners[1:]:
        while path[-1] != (x, y):
            path.append((path[-1][0] + int(np.sign(x - path[-1][0])), path[-1][1] + int(np.sign(y - path[-1][1]))))
    return np.array(path, dtype=float)


def driver(name: str, path: np.ndarray, speed: float = 0.5, begin: float = 0.0, **others) -> AnnouncedDriver:
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    times = begin + np.concatenate([[0.0], np.cumsum(lengths / speed)])
    return AnnouncedDriver(name, path, times, **{"safe_speed_mps": speed, **others})


def request(start: tuple[float, float], goal: tuple[float, float], *sites: tuple[float, float]) -> ItineraryRequest:
    return ItineraryRequest(start, goal, 0.5, np.array(sites).reshape(-1, 2), 0.0)


def kinds(plan) -> list[str]:
    return [leg.kind for leg in plan.legs]


def common_nodes(path: np.ndarray, other: np.ndarray) -> list[tuple[float, float]]:
    """The nodes that two paths share, in the order of the first."""
    there = {tuple(node) for node in other}
    return [tuple(node) for node in path if tuple(node) in there]


# The papers' rides


def test_full_ride_of_p17():
    """P17 §3.1: the driver comes to the hitchhiker at its hitchhiking point; the goal is on the driver's path."""
    ahead = driver("d", nodes((-10, 0), (40, 0)))
    plan = plan_itinerary(request((0, 0), (29, 0), (0, 0)), [ahead])
    assert kinds(plan) == ["wait", "ride"]
    wait, ride = plan.legs
    assert wait.end_s == pytest.approx(20.0)  # 10 m at 0.5 m/s
    assert (ride.driver, ride.start, ride.end, ride.metres) == ("d", (0, 0), (29, 0), pytest.approx(29.0))
    assert plan.arrival_s == pytest.approx(20 + RULES.couple_s + 29 / 0.5 + RULES.decouple_s)


@pytest.mark.parametrize("speed", [0.4, 0.6])
@pytest.mark.parametrize(("length", "worth_s"), [(20, 28.0), (32, 60.0)])
def test_a_ride_is_worth_the_wait_that_its_costs_say(speed: float, length: int, worth_s: float):
    rules = RideRules(min_ride_m=10.0, max_wait_s=100.0, ride_speed_mps=speed)
    asks = replace(request((0, 0), (length, 0), (0, 0)), solo_speed_mps=speed)
    for wait_s, rides in ((worth_s - 0.5, 1), (worth_s + 1.0, 0)):
        comes = driver("d", nodes((0, 0), (length, 0)), speed=speed, begin=wait_s)
        plan = plan_itinerary(asks, [comes], parameters=ItineraryParameters(replace(rules, max_age_s=math.inf)))
        assert len(plan.rides) == rides


def test_decoupling_point_is_the_farthest_common_node():
    """P17 §3.1: the driver turns off before the goal is reached."""
    its_path, own_path = nodes((0, 0), (40, 0), (40, -30)), nodes((0, 0), (40, 0), (40, 10))
    plan = plan_itinerary(request((0, 0), (40, 10), (0, 0)), [driver("d", its_path)], along_corridors)
    assert kinds(plan) == ["ride", "solo"]
    assert plan.rides[0].end == common_nodes(own_path, its_path)[-1] == (40, 0)
    assert plan.solo_m == pytest.approx(10)


@pytest.mark.parametrize("parameters", [ANYWHERE, ItineraryParameters()])
def test_partial_ride_boards_at_h(parameters):
    """P18 §5 with the lengths of §8.3.2: 28.8 m alone to h, the nearest node of Q_d ∩ Q_h, and a ride of 35.6 m."""
    h, goal = (28.8, 0.0), (64.4, 0.0)
    own_path = np.vstack([[0.0, 0.0], h, goal])
    its_path = np.vstack([[28.8, 20.0], h, goal])
    sites = () if parameters is ANYWHERE else (h, (40.0, 0.0))
    plan = plan_itinerary(request((0, 0), goal, *sites), [driver("d", its_path)], along_corridors, parameters)
    assert kinds(plan) == ["solo", "ride"]
    assert plan.solo_m == pytest.approx(28.8)
    ride = plan.rides[0]
    assert ride.start == h
    assert ride.metres == pytest.approx(35.6)
    assert ride.driver_wait_s == pytest.approx((28.8 - 20.0) / 0.5)  # it is there first
    shared = common_path(own_path, its_path, tolerance_m=0.3)
    assert ride.start == pytest.approx((shared.nearest.x, shared.nearest.y), abs=0.6)
    assert ride.end == pytest.approx((shared.farthest.x, shared.farthest.y), abs=1e-9)


def test_two_drivers_with_a_common_goal():
    """P18 Fig. 4a: h1 is the start, h2 where the second driver's path joins, and the second driver waits there."""
    first = driver("d1", nodes((0, 0), (29, 0), (29, -20)))
    second = driver("d2", nodes((29, 20), (29, 0), (65, 0)), begin=20.0)
    plan = plan_itinerary(request((0, 0), (65, 0)), [second, first], along_corridors, ANYWHERE)
    assert kinds(plan) == ["ride", "ride"]
    one, two = plan.rides
    assert (one.driver, one.start, one.end) == ("d1", (0, 0), (29, 0))
    assert (two.driver, two.start, two.end) == ("d2", (29, 0), (65, 0))
    at_h2 = RULES.couple_s + 29 / 0.5 + RULES.decouple_s
    assert two.begin_s == pytest.approx(at_h2)
    assert two.driver_wait_s == pytest.approx(at_h2 - (20 + 20 / 0.5))  # 25 s; the paper's second driver waited 21 s


def test_two_drivers_with_other_goals_change_at_h2_and_part_at_h3():
    """P18 Fig. 4b: h2 = nearest node of Q_d1 ∩ Q_d2, h3 = farthest node of Q_h ∩ Q_d2, then alone to the goal."""
    own_path = nodes((0, 0), (40, 0), (40, 30), (50, 30))
    first_path, second_path = nodes((0, 0), (60, 0)), nodes((30, 5), (30, 0), (40, 0), (40, 50))
    drivers = [driver("d1", first_path, speed=0.4), driver("d2", second_path, speed=0.5, begin=60.0)]
    plan = plan_itinerary(request((0, 0), (50, 30)), drivers, along_corridors, ANYWHERE)
    assert kinds(plan) == ["ride", "ride", "solo"]
    h1, h2, h3 = (0, 0), common_nodes(first_path, second_path)[0], common_nodes(own_path, second_path)[-1]
    assert (h2, h3) == ((30, 0), (40, 30))
    assert [(ride.start, ride.end) for ride in plan.rides] == [(h1, h2), (h2, h3)]
    assert all(ride.metres > RULES.min_ride_m for ride in plan.rides)


def test_three_drivers_one_after_the_other():
    drivers = [driver(f"d{k}", nodes((30 * k, 0), (30 * k + 30, 0)), begin=85.0 * k) for k in range(3)]
    plan = plan_itinerary(request((0, 0), (90, 0)), drivers, parameters=ANYWHERE)
    assert kinds(plan) == ["ride"] * 3
    assert plan.solo_m == 0


# Rules


def test_a_ride_is_longer_than_the_minimum():
    asked, costs = request((0, 0), (20, 0), (0, 0)), ItineraryCosts(solo_per_m=100.0)
    for min_ride_m, rides in ((20.0, 0), (19.9, 1)):
        parameters = ItineraryParameters(RideRules(min_ride_m=min_ride_m), costs)
        plan = plan_itinerary(asked, [driver("d", np.array([[0.0, 0.0], [20.0, 0.0]]))], parameters=parameters)
        assert len(plan.rides) == rides


@pytest.mark.parametrize(("begin", "rides"), [(-1.0, 1), (60.0, 1), (60.1, 0)])
def test_the_hitchhiker_waits_no_longer_than_allowed(begin, rides):
    late = driver("d", nodes((0, 0), (60, 0)), begin=begin)
    usable, refused = usable_drivers([late], 0.0, RULES)
    plan = plan_itinerary(request((0, 0), (60, 0), (0, 0), (1, 0)), usable)
    assert not refused
    assert len(plan.rides) == rides


@pytest.mark.parametrize(("metres", "rides"), [(30, 1), (31, 0)])
def test_a_driver_waits_no_longer_than_allowed(metres, rides):
    plan = plan_itinerary(request((-metres, 0), (60, 0), (0, 0)), [driver("d", nodes((0, 0), (60, 0)))])
    assert len(plan.rides) == rides


def test_a_driver_hurries_to_the_boarding_point_within_its_safe_speed():
    """P18 §8.1.3: twice the speed, half the wait."""
    waits = []
    for safe_speed in (0.5, 1.0):
        coming = driver("d", nodes((-20, 0), (40, 0)), safe_speed_mps=safe_speed)
        plan = plan_itinerary(request((0, 0), (40, 0), (0, 0)), [coming])
        waits.append(plan.wait_s)
        assert plan.rides[0].end_s - plan.rides[0].begin_s == pytest.approx(27 + 40 / 0.5)
    assert waits == pytest.approx([40.0, 20.0])


def test_boarding_is_at_sites_unless_anywhere_is_allowed():
    asked, passing = request((0, 0), (60, 0)), driver("d", nodes((0, 0), (60, 0)))
    assert kinds(plan_itinerary(asked, [passing])) == ["solo"]
    assert kinds(plan_itinerary(asked, [passing], parameters=ANYWHERE)) == ["ride"]


def test_leaving_is_at_sites_where_that_is_the_rule():
    asked, passing = request((0, 0), (60, 0), (0, 0), (50, 0)), driver("d", nodes((0, 0), (60, 0)))
    plan = plan_itinerary(asked, [passing], parameters=ItineraryParameters(RideRules(leave_anywhere=False)))
    assert (kinds(plan), plan.rides[0].end) == (["ride", "solo"], (50, 0))


def test_an_earlier_but_longer_wait_does_not_hide_a_later_itinerary():
    """Alone one is too early for the second driver; with the slow first driver one is not."""
    first = driver("slow", nodes((0, 0), (30, 0)), speed=0.2)
    second = driver("next", nodes((30, 0), (90, 0)), begin=170.0)
    plan = plan_itinerary(request((0, 0), (90, 0), (0, 0), (30, 0)), [first, second])
    assert [ride.driver for ride in plan.rides] == ["slow", "next"]


def test_a_cheaper_label_at_the_same_point_does_not_hide_a_later_one():
    """Boarded at once, the first driver leaves one waiting too long for the next; made to wait, it does not."""
    first = driver("first", np.array([[0.0, 0.0], [10.0, 0.0], [40.0, 0.0]]))
    second = driver("second", nodes((40, 0), (140, 0)), begin=180.0)
    asked = replace(request((0, 0), (140, 0), (0, 0), (10, 0), (40, 0)), solo_speed_mps=0.2)
    plan = plan_itinerary(asked, [first, second])
    assert [(ride.driver, ride.start) for ride in plan.rides] == [("first", (10, 0)), ("second", (40, 0))]


def test_a_driver_that_gave_a_ride_is_late_and_gives_no_other():
    """Alone it would be round its loop at 330 s, with a rider it is much later."""
    loop = driver("d", nodes((0, 0), (100, 0), (100, 100), (130, 100), (130, 0), (330, 0)), speed=1.0)
    parameters = ItineraryParameters(RideRules(max_wait_s=1000.0), ItineraryCosts(wait_per_s=0.0))
    asked = request((0, 0), (330, 0), (0, 0), (100, 0), (130, 0))
    plan = plan_itinerary(asked, [loop], along_corridors, parameters)
    assert plan.cost == pytest.approx(cheapest(asked, [loop], along_corridors, parameters))
    assert kinds(plan) == ["ride"]


def test_labels_of_equal_times_differ_in_whom_they_can_still_ride_with():
    """Both drivers bring one to the second site at the same time; only with the other can one take the first then."""
    back = driver("back", np.array([[0, -10], [0, 0], [30, 0], [30, 40], [30, 0], [90, 0]], dtype=float), speed=1.0)
    other = driver("other", np.array([[0.0, 0.0], [30.0, 0.0]]), speed=1.0)
    asked = request((-5, 0), (90, 0), (0, 0), (30, 0))
    plan = plan_itinerary(asked, [back, other], along_corridors)
    assert [ride.driver for ride in plan.rides] == ["other", "back"]


def test_a_path_passes_a_site_once_each_time_it_comes_by():
    site, corners = np.array([[10.0, 0.3]]), ((0, 0), (40, 0), (0, 0), (40, 0))
    for path in (np.array(corners, dtype=float), nodes(*corners)):
        rides = possible_rides([driver("d", path)], site, np.zeros(2), np.array([99.0, 0.0]), RULES)
        assert rides.time == pytest.approx([20.0, 140.0, 180.0])
        assert rides.points[rides.at] == pytest.approx(np.repeat(site, 3, axis=0))


@pytest.mark.parametrize("beside_m", [-1e-12, 0.0, 1e-12])
def test_a_site_at_a_corner_is_one_where_the_driver_goes_on_as_after_the_corner(beside_m: float):
    """A corner that a sum of cells gives differs from the site in the file by rounding."""
    path = np.array([[24.0, 12.0], [0.0, 24.0], [12.0, 48.0]])
    site = np.array([[0.0, 24.0 + beside_m, 0.0]])
    rides = possible_rides([driver("d", path)], site, np.array([24.0, 0.0]), np.array([24.0, 60.0]), RULES)
    assert rides.points[rides.at] == pytest.approx(site[:, :2])
    assert rides.metres == pytest.approx([math.hypot(12, 24)])


def test_a_driver_that_stands_somewhere_does_not_hurry_from_there():
    path, times = np.array([[-20.0, 0.0], [-10.0, 0.0], [-10.0, 0.0], [40.0, 0.0]]), np.array([0.0, 20.0, 30.0, 130.0])
    coming = AnnouncedDriver("d", path, times, safe_speed_mps=1.0)
    plan = plan_itinerary(request((0, 0), (40, 0), (0, 0)), [coming])
    assert plan.wait_s == pytest.approx(10 + 10 + 10)


def test_a_way_that_only_a_driver_knows():
    def walled(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        apart = (a[:, None, 0] < 15) != (b[None, :, 0] < 15)
        return np.where(apart, np.inf, cdist(a, b))

    asked = request((0, 0), (30, 3), (0, 0))
    plan = plan_itinerary(asked, [driver("d", nodes((0, 0), (30, 0)))], walled)
    assert kinds(plan) == ["ride", "solo"]
    with pytest.raises(UnreachableError):
        plan_itinerary(asked, [], walled)


# The optimum


@given(SEEDS)
@example(758680826)  # boards at a site with a heading, at a corner of the driver's path
@settings(max_examples=100)
def test_no_itinerary_is_cheaper(seed):
    asked, drivers, parameters = small_fleet(seed)
    plan = plan_itinerary(asked, drivers[:5], parameters=parameters)
    assert plan.optimal
    assert plan.cost == pytest.approx(cheapest(asked, drivers[:5], cdist, parameters), abs=1e-6)


@given(SEEDS, st.booleans())
@settings(max_examples=60)
def test_legs_join_keep_the_rules_and_add_up_to_the_cost(seed, large):
    if large:
        asked, drivers = building_fleet(np.random.default_rng(seed), 15)
        parameters, metric = ANYWHERE, "cityblock"
    else:
        asked, drivers, parameters = small_fleet(seed)
        metric = "euclidean"
    plan = plan_itinerary(asked, drivers, lambda a, b: cdist(a, b, metric), parameters)
    rules, costs = parameters.rules, parameters.costs
    place, clock, cost = asked.start, asked.now, 0.0
    for leg in plan.legs:
        assert (leg.start, leg.begin_s) == (place, pytest.approx(clock))
        assert leg.end_s >= leg.begin_s
        if leg.kind == "solo":
            assert leg.metres == pytest.approx(cdist([leg.start], [leg.end], metric)[0, 0])
            assert leg.end_s - leg.begin_s == pytest.approx(leg.metres / asked.solo_speed_mps)
            cost += costs.solo_per_m * leg.metres
        elif leg.kind == "wait":
            assert leg.end_s - leg.begin_s <= rules.max_wait_s + 1e-9
            cost += costs.wait_per_s * (leg.end_s - leg.begin_s)
        else:
            assert leg.metres > rules.min_ride_m
            assert leg.metres >= math.dist(leg.start, leg.end) - 2 * rules.site_tolerance_m
            assert leg.end_s - leg.begin_s >= leg.metres / rules.ride_speed_mps + rules.couple_s
            assert 0 <= leg.driver_wait_s <= rules.max_wait_s + 1e-9
            cost += costs.driver_wait_per_s * leg.driver_wait_s + costs.change
        place, clock = leg.end, leg.end_s
    assert (place, clock) == (asked.goal, pytest.approx(plan.arrival_s))
    assert plan.cost == pytest.approx(cost + costs.arrival_per_s * (plan.arrival_s - asked.now), abs=1e-6)
    assert len({ride.driver for ride in plan.rides}) == len(plan.rides)


@given(SEEDS)
@settings(max_examples=30)
def test_one_more_driver_never_costs_more(seed):
    random = np.random.default_rng(seed)
    asked, drivers = building_fleet(random, 12)
    some = plan_itinerary(asked, drivers[:-1], along_corridors)
    assert plan_itinerary(asked, drivers, along_corridors).cost <= some.cost + 1e-9
    assert some.cost <= plan_itinerary(asked, [], along_corridors).cost


def test_a_search_that_is_cut_short_says_so():
    asked, drivers = building_fleet(np.random.default_rng(0), 40)
    whole, cut = (
        plan_itinerary(asked, drivers, along_corridors, ItineraryParameters(max_labels=labels)) for labels in (5000, 1)
    )
    assert (whole.optimal, cut.optimal) == (True, False)
    assert whole.cost <= cut.cost <= plan_itinerary(asked, [], along_corridors).cost


def test_the_benchmark_counts_what_is_not_optimal(monkeypatch):
    found = bench_itineraries._optimal(0, 5, lambda *_: None)
    assert [(found[0].value, found[0].ok), (found[1].ok)] == [(5, True), True]
    monkeypatch.setattr(bench_itineraries, "cheapest", lambda *_: 0.0)
    found = bench_itineraries._optimal(0, 5, lambda *_: None)
    assert [(found[0].value, found[0].ok), (found[1].ok)] == [(0, False), False]


# Bad input

GOOD = driver("good", nodes((0, 0), (40, 0)))
BAD = {
    "path": [
        np.array([[0.0, 0.0]]),
        np.zeros((41, 3)),
        np.full((41, 2), np.nan),
        np.full((41, 2), 1e308),
        [[0.0, 0.0], [1.0]],
        None,
        "path",
    ],
    "times": [
        GOOD.times[:-1],
        GOOD.times[::-1],
        np.zeros(41),
        GOOD.times - 3.1,
        GOOD.times - 1000.0,
        np.where(GOOD.times == 8, np.nan, GOOD.times),
        np.where(GOOD.times == 80, np.inf, GOOD.times),
    ],
    "free_places": [0, -1, None, math.nan],
    "safe_speed_mps": [0.0, -1.0, math.nan, math.inf, "fast"],
}


@pytest.mark.parametrize(("field", "value"), [(field, value) for field, values in BAD.items() for value in values])
def test_a_bad_driver_is_refused_by_name_and_spoils_nothing(field, value):
    bad = replace(GOOD, id="bad", **{field: value})
    usable, refused = usable_drivers([bad, GOOD], 0.0, RULES)
    assert [kept.id for kept in usable] == ["good"]
    assert [(error.robot, error.field) for error in refused] == [("bad", field)]
    assert str(refused[0]).startswith(f"bad: {field} is ")


def test_an_id_used_twice_is_refused_the_second_time():
    usable, refused = usable_drivers([GOOD, replace(GOOD, free_places=2)], 0.0, RULES)
    assert [kept.free_places for kept in usable] == [1]
    assert [(error.robot, error.field) for error in refused] == [("good", "id")]


def test_what_a_driver_has_passed_is_left_out():
    (kept,), refused = usable_drivers([GOOD], 3.0, RULES)
    assert not refused
    assert (tuple(kept.path[0]), kept.times[0]) == ((1.5, 0.0), 3.0)
    assert kept.path[1:].tolist() == nodes((2, 0), (40, 0)).tolist()
    assert kept.times[1] == pytest.approx(4.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"start": (math.nan, 0.0)},
        {"goal": (0.0, math.inf)},
        {"goal": (0.0,)},
        {"solo_speed_mps": 0.0},
        {"solo_speed_mps": math.nan},
        {"now": math.nan},
        {"sites": np.array([[0.0, math.nan]])},
    ],
)
def test_a_senseless_request_is_refused_by_field(changes):
    with pytest.raises(ItineraryInputError) as caught:
        plan_itinerary(replace(request((0, 0), (1, 0)), **changes), [GOOD])
    assert (caught.value.robot, [caught.value.field]) == ("hitchhiker", list(changes))


@pytest.mark.parametrize(
    "wrong", [lambda a, b: -cdist(a, b), lambda a, b: cdist(a, b) * np.nan, lambda a, b: cdist(b, a)]
)
def test_senseless_distances_are_refused(wrong):
    with pytest.raises(ItineraryInputError, match="solo_metres"):
        plan_itinerary(request((0, 0), (60, 0), (0, 0)), [GOOD], wrong)
