"""The best way to a goal by driving alone, waiting and riding with any number of drivers.

Full rides, partial rides (P18 §5) and rides with several drivers (P18 §6) are one problem: a sequence of rides, each
with another driver, joined by stretches driven alone. The robot that is first at a boarding point waits for a bounded
time; a driver may hurry or dawdle on its way there, so as to arrive when the hitchhiker does. The papers' points follow
from the costs: h and h2 are the nearest common nodes, and h3 is the farthest, where only metres driven alone count.

The search is best first over labels (point, time, cost, drivers ridden with) where a ride ends. What is still to come
is bounded from below by the best itinerary that needs no wait. As waiting is bounded, an earlier label does not replace
a later one that costs more; labels are compared at equal times only. The search is therefore slow when many points lie
side by side, as where one may board anywhere and paths share a corridor but no node. ``max_labels`` bounds it.

A plan holds for what was announced. When a driver is late, gone or refuses, plan again with the drivers that are left.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import msgspec
import numpy as np
from scipy.spatial.distance import cdist

from hitchhike_ros.core.datatypes import FloatArray, NonNegative
from hitchhike_ros.core.errors import ItineraryInputError, UnreachableError
from hitchhike_ros.planning.announced import AnnouncedDriver, IndexArray, RideRules, Rides, possible_rides

Point = tuple[float, float]

# Metres (A, B) to drive alone from points (A, 2) to points (B, 2) in ``map``, inf where there is no way. scipy's cdist
# measures straight lines.
SoloMetres = Callable[[FloatArray, FloatArray], FloatArray]

_EQUAL = 1e-9  # costs that differ by less are equal


@dataclass(frozen=True)
class ItineraryCosts:
    """What an itinerary costs, in seconds of a later arrival. All chosen, so that the papers' rides pay.

    Where a pair is as fast as one alone, a ride of 20 m is worth a wait of 28 s, and one of 32 m a wait of 60 s.
    """

    arrival_per_s: NonNegative = 1.0
    solo_per_m: NonNegative = 4.0
    wait_per_s: NonNegative = 0.5  # of the hitchhiker, beside the later arrival
    driver_wait_per_s: NonNegative = 1.0
    change: NonNegative = 10.0  # of driver; the first ride counts as one


@dataclass(frozen=True)
class ItineraryParameters:
    """Rules and costs, and how many labels are looked at before the best itinerary so far is taken (chosen)."""

    rules: RideRules = field(default_factory=RideRules)
    costs: ItineraryCosts = field(default_factory=ItineraryCosts)
    max_labels: Annotated[int, msgspec.Meta(ge=1)] = 5000


@dataclass(frozen=True, eq=False)
class ItineraryRequest:
    """The hitchhiker: ``start`` and ``goal`` in ``map``, its speed alone, the boarding ``sites``, the time ``now``.

    Sites are points (S, 2), or poses (S, 3) where only drivers that go that way stop.
    """

    start: Point
    goal: Point
    solo_speed_mps: float
    sites: FloatArray
    now: float


@dataclass(frozen=True)
class ItineraryLeg:
    """One part of an itinerary from ``start`` at ``begin_s`` to ``end`` at ``end_s``.

    A ride begins with coupling and ends with decoupling; before it, its driver waits ``driver_wait_s``.
    """

    kind: Literal["solo", "wait", "ride"]
    start: Point
    end: Point
    begin_s: float
    end_s: float
    metres: float = 0.0
    driver: str | None = None
    driver_wait_s: float = 0.0


@dataclass(frozen=True)
class Itinerary:
    """Legs in order. ``optimal`` is False when ``max_labels`` ended the search: a better one may exist."""

    legs: tuple[ItineraryLeg, ...]
    cost: float
    arrival_s: float
    optimal: bool = True

    @property
    def rides(self) -> tuple[ItineraryLeg, ...]:
        return tuple(leg for leg in self.legs if leg.kind == "ride")

    @property
    def solo_m(self) -> float:
        return sum(leg.metres for leg in self.legs if leg.kind == "solo")

    @property
    def wait_s(self) -> float:
        return sum(leg.end_s - leg.begin_s for leg in self.legs if leg.kind == "wait")


@dataclass(frozen=True)
class _Label:
    """The hitchhiker at the end of ``ride`` (-1: at its start), at ``time``, after ``cost``."""

    cost: float
    time: float
    ride: int = -1
    used: int = 0  # bit k: has ridden with driver k, whose times are no longer those announced
    parent: _Label | None = None


def plan_itinerary(
    request: ItineraryRequest,
    drivers: Sequence[AnnouncedDriver],
    solo_metres: SoloMetres = cdist,
    parameters: ItineraryParameters | None = None,
) -> Itinerary:
    """The cheapest itinerary; driving alone all the way is one.

    Args:
        request: who asks for it.
        drivers: those that :func:`hitchhike_ros.planning.announced.usable_drivers` leaves.
        solo_metres: distances of driving alone.
        parameters: rules and costs.

    Raises:
        ItineraryInputError: the request, or a distance, is senseless.
        UnreachableError: neither alone nor with a ride is there a way.
    """
    parameters = parameters or ItineraryParameters()
    sites = _check(request)
    start, goal = np.array(request.start, dtype=float), np.array(request.goal, dtype=float)
    rides = possible_rides(drivers, sites, start, goal, parameters.rules)
    search = _Search(request, rides, solo_metres, parameters)
    best, optimal = search.run()
    if best is None:
        raise UnreachableError(f"no way from {request.start} to {request.goal}, alone or with a ride")
    return search.itinerary(best, [driver.id for driver in drivers], optimal)


class _Search:
    """One search: distances and bounds as arrays, then labels from a heap."""

    def __init__(
        self, request: ItineraryRequest, rides: Rides, solo_metres: SoloMetres, parameters: ItineraryParameters
    ) -> None:
        self.request, self.rides = request, rides
        self.rules, self.costs, self.max_labels = parameters.rules, parameters.costs, parameters.max_labels
        ends = np.array([request.start, request.goal], dtype=float)
        # Rows: points where a ride ends, then the start. Columns: points where one begins, then the goal.
        leaves, self.row = _numbered(rides.to, len(rides.points))
        boards, self.column = _numbered(rides.at, len(rides.points))
        sources, targets = np.vstack([rides.points[leaves], ends[:1]]), np.vstack([rides.points[boards], ends[1:]])
        self.metres = np.asarray(solo_metres(sources, targets), dtype=float)
        if self.metres.shape != (len(sources), len(targets)) or not (self.metres >= 0).all():
            raise ItineraryInputError(
                "hitchhiker", "solo_metres", self.metres, "distances >= 0 of every pair of points"
            )
        per_metre = self.costs.solo_per_m + self.costs.arrival_per_s / request.solo_speed_mps
        self.solo_cost = np.where(np.isfinite(self.metres), per_metre * self.metres, np.inf)
        self.ride_cost = self.costs.arrival_per_s * rides.duration + self.costs.change
        # Rides first[b] to first[b + 1] begin with boarding b.
        self.first = np.searchsorted(rides.boarding, np.arange(len(rides.at) + 1)).tolist()
        # Of each ride from its boarding on, and the least of each boarding: cost if no other follows, and a bound.
        self.ride_end = self.ride_cost + self.solo_cost[self.row, -1]
        self.ride_to_go = self.ride_cost + self._to_go()[self.row]
        self.least_end, self.least_to_go = self._least(self.ride_end), self._least(self.ride_to_go)

    def run(self) -> tuple[_Label | None, bool]:
        """The label whose way alone to the goal ends the best itinerary, and whether none can be better."""
        best, bound = None, math.inf
        serial = 0  # labels of equal bounds come in the order they were found
        heap = [(0.0, serial, _Label(0.0, self.request.now))]
        # Drivers ridden with on the way to a point and time. Labels of one point come in the order of their costs.
        known: dict[tuple[int, float], list[int]] = {}
        looked_at = 0
        while heap and heap[0][0] < bound - _EQUAL:
            if looked_at == self.max_labels:
                return best, False
            looked_at += 1
            label = heapq.heappop(heap)[2]
            row = self._row(label)
            alike = known.setdefault((row, round(label.time, 9)), [])
            if any(not used & ~label.used for used in alike):
                continue
            alike.append(label.used)
            if label.cost + self.solo_cost[row, -1] < bound - _EQUAL:
                best, bound = label, float(label.cost + self.solo_cost[row, -1])
            cost, time = self._board(label, row)
            if not len(cost):
                continue
            ends = cost + self.least_end
            least = int(ends.argmin())
            if ends[least] < bound - _EQUAL:
                ride = self.first[least] + int(self.ride_end[self.first[least] : self.first[least + 1]].argmin())
                best, bound = self._ride(label, ride, cost, time), float(ends[least])
            for boarding in np.flatnonzero(cost + self.least_to_go < bound - _EQUAL).tolist():
                its = slice(self.first[boarding], self.first[boarding + 1])
                estimate = cost[boarding] + self.ride_to_go[its]
                worth = np.flatnonzero(estimate < bound - _EQUAL)
                for k, value in zip(worth.tolist(), estimate[worth].tolist(), strict=True):
                    serial += 1
                    heapq.heappush(heap, (value, serial, self._ride(label, its.start + k, cost, time)))
        return best, True

    def itinerary(self, last: _Label, drivers: Sequence[str], optimal: bool) -> Itinerary:
        """The legs that lead to ``last`` and from there alone to the goal."""
        labels = [last]
        while (parent := labels[-1].parent) is not None:
            labels.append(parent)
        legs: list[ItineraryLeg] = []
        here = self.request.start
        for before, after in zip(labels[::-1], labels[-2::-1], strict=False):
            boarding = int(self.rides.boarding[after.ride])
            there = self._point(self.rides.at[boarding])
            metres = float(self.metres[self._row(before), self.column[boarding]])
            arrives = before.time + metres / self.request.solo_speed_mps
            begins = max(arrives, float(self.rides.earliest[boarding]))
            late = max(0.0, begins - float(self.rides.time[boarding]))
            legs.append(ItineraryLeg("solo", here, there, before.time, arrives, metres))
            legs.append(ItineraryLeg("wait", there, there, arrives, begins))
            here = self._point(self.rides.to[after.ride])
            driver = drivers[self.rides.driver[boarding]]
            legs.append(
                ItineraryLeg(
                    "ride", there, here, begins, after.time, float(self.rides.metres[after.ride]), driver, late
                )
            )
        metres = float(self.metres[self._row(last), -1])
        arrival = last.time + metres / self.request.solo_speed_mps
        legs.append(ItineraryLeg("solo", here, self.request.goal, last.time, arrival, metres))
        cost = last.cost + float(self.solo_cost[self._row(last), -1])
        kept = tuple(leg for leg in legs if leg.metres > 0 or leg.end_s > leg.begin_s)
        return Itinerary(kept, cost, arrival, optimal)

    def _to_go(self) -> FloatArray:
        """Lower bound of the cost from each row's point to the goal: the best sequence of rides if nobody waits."""
        to_go = self.solo_cost[:, -1].copy()
        if not len(self.rides.to):
            return to_go
        while True:
            from_boarding = self._least(self.ride_cost + to_go[self.row])
            from_board = np.full(self.solo_cost.shape[1] - 1, np.inf)
            np.minimum.at(from_board, self.column, from_boarding)
            better = np.minimum(to_go, (self.solo_cost[:, :-1] + from_board).min(axis=1))
            if (better >= to_go - _EQUAL).all():
                return better
            to_go = better

    def _least(self, of_rides: FloatArray) -> FloatArray:
        """The least value (B,) of the rides (R,) of each boarding."""
        return np.minimum.reduceat(of_rides, self.first[:-1]) if len(of_rides) else of_rides

    def _board(self, label: _Label, row: int) -> tuple[FloatArray, FloatArray]:
        """Cost so far and time (B,) of each boarding that may come next, the cost inf where it may not."""
        rides, costs = self.rides, self.costs
        metres, solo_cost = self.metres[row, self.column], self.solo_cost[row, self.column]
        arrival = label.time + metres / self.request.solo_speed_mps
        time = np.maximum(arrival, rides.earliest)
        wait = np.maximum(0.0, rides.earliest - arrival)
        driver_wait = np.maximum(0.0, arrival - rides.time)
        cost = label.cost + solo_cost + (costs.arrival_per_s + costs.wait_per_s) * wait
        cost += costs.driver_wait_per_s * driver_wait
        limit = self.rules.max_wait_s
        unused = np.array([not label.used >> k & 1 for k in range(int(rides.driver.max(initial=-1)) + 1)], dtype=bool)
        possible = (wait <= limit) & (driver_wait <= limit) & unused[rides.driver]
        return np.where(possible, cost, np.inf), time

    def _ride(self, label: _Label, ride: int, cost: FloatArray, time: FloatArray) -> _Label:
        boarding = int(self.rides.boarding[ride])
        ends = float(time[boarding]) + float(self.rides.duration[ride])
        spent = float(cost[boarding] + self.ride_cost[ride])
        return _Label(spent, ends, ride, label.used | 1 << int(self.rides.driver[boarding]), label)

    def _row(self, label: _Label) -> int:
        return int(self.row[label.ride]) if label.ride >= 0 else len(self.metres) - 1

    def _point(self, number: int) -> Point:
        x, y = self.rides.points[number]
        return float(x), float(y)


def _numbered(values: IndexArray, below: int) -> tuple[IndexArray, IndexArray]:
    """The different ones of ``values`` (K,) in order, and the index (K,) of each value among them."""
    occurs = np.zeros(below, dtype=bool)
    occurs[values] = True
    return np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[values]


def _check(request: ItineraryRequest) -> FloatArray:
    """The sites (S, 2) of a request that can be planned."""
    speed = request.solo_speed_mps
    if not (math.isfinite(speed) and speed > 0):
        raise ItineraryInputError("hitchhiker", "solo_speed_mps", speed, "a finite speed > 0")
    if not math.isfinite(request.now):
        raise ItineraryInputError("hitchhiker", "now", request.now, "a finite time")
    for name in ("start", "goal"):
        point = getattr(request, name)
        if len(point) != 2 or not all(map(math.isfinite, point)):
            raise ItineraryInputError("hitchhiker", name, point, "two finite coordinates")
    sites = np.asarray(request.sites, dtype=float)
    sites = sites if sites.size else np.empty((0, 2))
    if sites.ndim != 2 or sites.shape[1] not in (2, 3):
        raise ItineraryInputError("hitchhiker", "sites", sites.shape, "points (S, 2) or poses (S, 3)")
    if not np.isfinite(sites).all():
        raise ItineraryInputError("hitchhiker", "sites", sites.tolist(), "finite coordinates")
    return sites
