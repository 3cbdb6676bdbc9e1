"""The cheapest itinerary's cost by trying everything: slow, and obviously right. For tests and the benchmark alone.

It shares rules and costs with :mod:`hitchhike_ros.planning.itinerary`, but none of its code: plain numbers, and no
order or bound that leaves an itinerary out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from hitchhike_ros.planning.announced import AnnouncedDriver, RideRules
from hitchhike_ros.planning.itinerary import ItineraryParameters, ItineraryRequest, Point, SoloMetres

# A driver at a point of its path: the point, metres along the path, time announced, time if it hurries, time that a
# pair needs to there from the path's beginning, whether one may board, whether one may leave.
_Stop = tuple[Point, float, float, float, float, bool, bool]


def cheapest(
    request: ItineraryRequest,
    drivers: Sequence[AnnouncedDriver],
    solo_metres: SoloMetres,
    parameters: ItineraryParameters,
) -> float:
    """Cost of the best itinerary, inf where there is none; arguments as of ``plan_itinerary``."""
    rules, costs = parameters.rules, parameters.costs
    stops = [list(_stops(driver, drivers, request, rules)) for driver in drivers]
    known: dict[tuple[Point, Point], float] = {}

    def metres(a: Point, b: Point) -> float:
        if (a, b) not in known:
            known[a, b] = float(solo_metres(np.array([a]), np.array([b]))[0, 0])
        return known[a, b]

    def best(here: Point, now: float, left: frozenset[int]) -> float:
        """Cost of everything from ``here`` at ``now`` on with the drivers that are left."""
        alone = metres(here, request.goal)
        cheapest = alone * costs.solo_per_m + alone / request.solo_speed_mps * costs.arrival_per_s
        for k in left:
            for at, its_arc, time, earliest, began, may_board, _ in stops[k]:
                arrival = now + metres(here, at) / request.solo_speed_mps
                boards = max(arrival, earliest)
                wait, driver_wait = boards - arrival, max(0.0, boards - time)
                if not may_board or max(wait, driver_wait) > rules.max_wait_s or math.isinf(arrival):
                    continue
                for to, arc, _, _, ends, _, may_leave in stops[k]:
                    if not may_leave or not arc - its_arc > rules.min_ride_m:
                        continue
                    after = boards + rules.couple_s + (ends - began) + rules.decouple_s
                    cost = (
                        costs.solo_per_m * metres(here, at)
                        + costs.wait_per_s * wait
                        + costs.driver_wait_per_s * driver_wait
                        + costs.change
                        + costs.arrival_per_s * (after - now)
                    )
                    cheapest = min(cheapest, cost + best(to, after, left - {k}))
        return cheapest

    return best(request.start, request.now, frozenset(range(len(drivers))))


def _stops(
    driver: AnnouncedDriver, drivers: Sequence[AnnouncedDriver], request: ItineraryRequest, rules: RideRules
) -> Iterator[_Stop]:
    points = [(request.start, rules.board_anywhere, False), (request.goal, False, rules.leave_anywhere)]
    sites = np.asarray(request.sites, dtype=float)
    for x, y, *heading in sites.tolist() if sites.size else []:
        for segment, share in _passages(driver, (x, y), rules.site_tolerance_m):
            boards = rules.board_anywhere or not heading or _goes_on(driver, segment + (share == 1), heading[0])
            yield _stop(driver, (x, y), segment, share, boards, True, rules)
    if rules.board_anywhere:
        points += [((x, y), True, rules.leave_anywhere) for each in drivers for x, y in each.path.tolist()]
    else:
        for node, (x, y) in enumerate(driver.path.tolist()):
            segment = max(node - 1, 0)
            yield _stop(driver, (x, y), segment, node - segment, False, rules.leave_anywhere, rules)
    for point, may_board, may_leave in points:
        for segment, share in _passages(driver, point, rules.site_tolerance_m):
            yield _stop(driver, point, segment, share, may_board, may_leave, rules)


def _stop(
    driver: AnnouncedDriver,
    point: Point,
    segment: int,
    share: float,
    may_board: bool,
    may_leave: bool,
    rules: RideRules,
) -> _Stop:
    """The stop at ``share`` of a segment of the path."""
    path, times = driver.path.tolist(), driver.times.tolist()
    arc, time, earliest, ridden = 0.0, times[0], times[0], 0.0
    for i in range(segment + 1):
        part = share if i == segment else 1.0
        length, duration = math.dist(path[i], path[i + 1]), times[i + 1] - times[i]
        arc += part * length
        time += part * duration
        earliest += part * (min(duration, length / driver.safe_speed_mps) if length > 0 else duration)
        ridden += part * max(duration, length / rules.ride_speed_mps)
    return point, arc, time, earliest, ridden, may_board, may_leave


def _goes_on(driver: AnnouncedDriver, segment: int, heading: float) -> bool:
    path = driver.path.tolist()
    if segment + 1 >= len(path):
        return False
    (x1, y1), (x2, y2) = path[segment : segment + 2]
    return (x2 - x1) * math.cos(heading) + (y2 - y1) * math.sin(heading) > 0.0


def _passages(driver: AnnouncedDriver, point: Point, tolerance_m: float) -> Iterator[tuple[int, float]]:
    """Segment and share of every passage of the path by the point: where it comes nearest, if that is near enough."""
    nearest = []
    for a, b in pairwise(driver.path.tolist()):
        length = math.dist(a, b)
        share = 0.0
        if length > 0:
            share = ((point[0] - a[0]) * (b[0] - a[0]) + (point[1] - a[1]) * (b[1] - a[1])) / length**2
            share = round(min(1.0, max(0.0, share)), 9)  # a point at a node but for rounding is at the node
        nearest.append((math.dist(point, (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))), share))
    for i, (distance, share) in enumerate(nearest):
        comes_nearer_after = i + 1 < len(nearest) and nearest[i + 1][1] > 0
        within = 0 < share < 1
        at_begin = share == 0 and i == 0
        at_end = share == 1 and not comes_nearer_after
        if distance <= tolerance_m and (within or at_begin or at_end):
            yield i, share
