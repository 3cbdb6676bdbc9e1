"""Who rides with whom in a network (P18 §4 to §6): what a driver can offer, and which offer a hitchhiker takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, HitchhikingPoint, Pose2D
from hitchhike_ros.core.errors import ItineraryInputError, PlanningError, UnreachableError
from hitchhike_ros.core.geometry import compose, distance, path_length
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.announced import AnnouncedDriver, RideRules, usable_drivers
from hitchhike_ros.planning.itinerary import (
    Itinerary,
    ItineraryLeg,
    ItineraryParameters,
    ItineraryRequest,
    SoloMetres,
    plan_itinerary,
)
from hitchhike_ros.planning.overlap import common_path
from hitchhike_ros.protocol.announcement import OwnPath, announced_driver
from hitchhike_ros.protocol.messages import Accept, Request
from hitchhike_ros.protocol.parameters import HitchhikingParameters, Policy

Planner = Callable[[Pose2D, Pose2D], FloatArray]

# How far the hitchhiker stands behind the driver where there is no hitchhiking point, beyond the gap (chosen).
_ROOM_M = 0.4
# Who passes a hitchhiking point by so much goes there (chosen: half the width of a wide corridor).
_SITE_M = 1.5
# Two ways through one corridor are no farther apart than it is wide: who boards changes the lane.
_LANES_M = 2.0 * _SITE_M
# A place so near to a corner is at it (chosen).
_CORNER_M = 0.1
# So far beside its path a place is on it: a hitchhiking point, or where one stands there.
_TOLERANCE_M = _SITE_M + _ROOM_M


@dataclass(frozen=True)
class Meeting:
    """A ride that was chosen: with whom, from which point (the driver aligns, the hitchhiker waits), and to where.

    ``in_s``: when the hitchhiker is there; ``begins_in_s`` and ``ends_in_s``: of the ride; ``more``: another one may
    follow.
    """

    driver: str
    point: HitchhikingPoint
    leave: tuple[float, float]
    ride_m: float
    in_s: float
    begins_in_s: float
    ends_in_s: float
    more: bool


def solo_metres(planner: Planner) -> SoloMetres:
    """Distances by planning every way; one search per target serves all starts, as D* Lite repairs it."""

    def metres(sources: FloatArray, targets: FloatArray) -> FloatArray:
        found = np.full((len(sources), len(targets)), np.inf)
        for j, target in enumerate(targets.tolist()):
            for i, source in enumerate(sources.tolist()):
                try:
                    found[i, j] = path_length(planner(Pose2D(*source), Pose2D(*target)))
                except PlanningError:
                    continue  # no way, which the infinite distance says
        return found

    return metres


@dataclass(frozen=True, eq=False)
class Stretch:
    """The part of a driver's path that a ride follows: what is told of it, ridden and paid for. Its length is fixed.

    It is between the arc lengths ``begin_m`` and ``end_m`` of ``line``, the driver's path.
    """

    line: Polyline
    begin_m: float
    end_m: float

    @property
    def length_m(self) -> float:
        return self.end_m - self.begin_m

    @property
    def end(self) -> Pose2D:
        """Where the driver stops, looking along its path."""
        return self.line.pose(self.end_m)


def way_of(request: Request, planner: Planner) -> FloatArray:
    """The way (N, 2) of the hitchhiker to its goal, Q_h: as it says, or by ``planner`` where it does not.

    Raises:
        PlanningError: it says none, and none is found.
    """
    if len(request.path) > 1:
        way, goal = Polyline(request.path), request.goal
        begins = way.project(request.x, request.y)[1] <= _SITE_M
        if begins and math.dist(request.path[-1], (goal.x, goal.y)) <= _SITE_M:
            return np.array(request.path)
    return planner(request.pose, request.goal)  # nor is a path believed that leads elsewhere


def shared_stretch(
    path: OwnPath,
    way: FloatArray,
    sites: Sites,
    params: HitchhikingParameters,
    board_m: float | None = None,
) -> Stretch | None:
    """What a driver can offer to a robot with the given ``way`` (N, 2): from the first place ahead to the last on both.

    None where both ways share less than T_dhh from there on (P18 Algorithm 2). One boards at any of those places, or at
    the hitchhiking points that the path passes; where somebody else boards already, there: ``board_m`` along the path.
    """
    if board_m is not None:
        return shared_from(path, board_m, way, params)
    if params.board_anywhere:
        return shared_from(path, path.come_m, way, params)
    places = _places(sites)
    arcs, away = path.line.project_all(places[:, :2])
    ahead = [
        float(arcs[k])
        for k in np.flatnonzero((away <= _SITE_M) & (arcs >= path.come_m - _SITE_M)).tolist()
        if _leads(path.line, arcs[k], places[k, 2])
    ]
    return shared_from(path, max(min(ahead), path.come_m), way, params) if ahead else None


def shared_from(path: OwnPath, first_m: float, way: FloatArray, params: HitchhikingParameters) -> Stretch | None:
    """From the first place ahead of ``first_m`` to the last that ``way`` (N, 2) passes too; as :func:`common_path`.

    None where they share less than T_dhh. Two plans may take any two lanes of a corridor. Where they run in one lane at
    last, they part where they leave it.
    """
    # The plan is longer than the line to which it is simplified.
    plan_from_m, _ = Polyline(path.plan).project(*path.line.point(first_m))
    lane_m = params.overlap_tolerance_m
    shared = common_path(path.plan, way, max(_LANES_M, lane_m), from_a_m=plan_from_m)
    if shared.nearest is None or shared.farthest is None:
        return None
    beyond_m, last = 0.0, shared.farthest
    in_lane = common_path(path.plan, way, lane_m, from_a_m=max(plan_from_m, shared.end_a_m - 2.0 * _LANES_M))
    if in_lane.farthest is not None and in_lane.end_a_m >= shared.end_a_m - _LANES_M:
        beyond_m, last = shared.end_a_m - in_lane.end_a_m, in_lane.farthest
    if shared.length_m - beyond_m < params.min_ride_m:
        return None
    begin_m, _ = path.line.project(shared.nearest.x, shared.nearest.y, first_m)
    end_m, _ = path.line.project(last.x, last.y, begin_m)
    return Stretch(path.line, begin_m, end_m)


def choose(
    start: Pose2D,
    goal: Pose2D,
    ready_in_s: float,
    offers: Mapping[str, tuple[Accept, float]],
    now: float,
    sites: Sites,
    params: HitchhikingParameters,
    metres: SoloMetres,
) -> Meeting | None:
    """The ride to take of the ``offers`` (by robot: the offer, and when it came), None where driving alone is better.

    The best itinerary of all offers where ``arrival`` decides; else the best that is with the driver of the best
    profile, or with the nearest, as long as that is better than driving alone.
    """
    announced = [announced_driver(k, a.path, at, 1, a.safe_speed_mps) for k, (a, at) in offers.items() if a.path]
    usable, _ = usable_drivers(announced, now, _rules(params))
    if not usable:
        return None
    request = ItineraryRequest(
        (start.x, start.y), (goal.x, goal.y), params.cruise_speed_mps, _places(sites), now + ready_in_s
    )
    settings = ItineraryParameters(_rules(params))

    def plan(drivers: tuple[AnnouncedDriver, ...]) -> Itinerary | None:
        try:
            return plan_itinerary(request, drivers, metres, settings)
        except UnreachableError:
            return None  # navigation will find out, and say why

    best = plan(usable)
    if best is None or not best.rides:
        return None  # nor with one of them alone
    if params.own_policy != "arrival" and len(usable) > 1:
        preferred = _preferred(usable, start, offers, params.own_policy, metres)
        best = next(filter(None, (_with(driver, best, plan) for driver in preferred)), best)
    return _meeting(best, offers, sites, params, now)


def agreed_stretch(
    driver: OwnPath, aligning: Pose2D, waiting: Pose2D, leave: tuple[float, float], ride_m: float = 0.0
) -> Stretch:
    """The ride along the driver's path from ``aligning`` to ``leave``.

    A path may pass either place more than once. Of the places ahead those count that are as far apart as the
    hitchhiker says, ``ride_m`` from where it waits; where it does not say, the first.

    Raises:
        ItineraryInputError: either is not on the path ahead, or the path goes another way there; it names which.
    """
    begins = [
        arc
        for arc in driver.line.passes(aligning.x, aligning.y, _TOLERANCE_M, driver.come_m)
        if _leads(driver.line, arc, aligning.theta)
    ]
    if not begins:
        raise ItineraryInputError("driver", "aligning", aligning, "a place on its path, heading along it")
    rides = [(begin, end) for begin in begins for end in driver.line.passes(*leave, _TOLERANCE_M, begin)]
    if not rides:
        raise ItineraryInputError("driver", "leave", leave, "a place on its path")
    begin_m, end_m = rides[0]
    if ride_m > 0.0:
        told_m = ride_m - distance(waiting, aligning)
        begin_m, end_m = min(rides, key=lambda ride: abs(ride[1] - ride[0] - told_m))
    return Stretch(driver.line, begin_m, end_m)


def _leads(line: Polyline, arc: float, theta: float) -> bool:
    """Whether a path comes by or goes on, at a corner either will do, within 90° of a heading."""
    return any(math.cos(line.pose(s).theta - theta) > 1e-6 for s in (arc - _CORNER_M, arc + _CORNER_M))


def _with(
    driver: AnnouncedDriver, best: Itinerary, plan: Callable[[tuple[AnnouncedDriver, ...]], Itinerary | None]
) -> Itinerary | None:
    """An itinerary that rides with ``driver``."""
    itinerary = best if any(leg.driver == driver.id for leg in best.rides) else plan((driver,))
    return itinerary if itinerary is not None and itinerary.rides else None


def _preferred(
    drivers: tuple[AnnouncedDriver, ...],
    start: Pose2D,
    offers: Mapping[str, tuple[Accept, float]],
    policy: Policy,
    metres: SoloMetres,
) -> list[AnnouncedDriver]:
    """The best first; among equals of profile the nearest."""
    here = np.array([[start.x, start.y]])
    away = metres(np.array([driver.path[0] for driver in drivers]), here)[:, 0]
    keys = [(-offers[d.id][0].profile if policy == "profile" else 0.0, m) for d, m in zip(drivers, away, strict=True)]
    return [drivers[k] for k in sorted(range(len(drivers)), key=keys.__getitem__)]


def _rules(params: HitchhikingParameters) -> RideRules:
    return RideRules(
        min_ride_m=params.min_ride_m,
        max_wait_s=params.patience_s,
        couple_s=params.couple_s,
        decouple_s=params.decouple_s,
        ride_speed_mps=params.ride_speed_mps,
        board_anywhere=params.board_anywhere,
        site_tolerance_m=_SITE_M,
        max_age_s=math.inf,  # what is too old has not been kept
    )


def _places(sites: Sites) -> FloatArray:
    """Where hitchhikers wait, (S, 3)."""
    poses = [point.waiting_pose for point in sites.hitchhiking_points]
    return np.array([(p.x, p.y, p.theta) for p in poses]).reshape(-1, 3)


def _meeting(
    itinerary: Itinerary,
    offers: Mapping[str, tuple[Accept, float]],
    sites: Sites,
    params: HitchhikingParameters,
    now: float,
) -> Meeting:
    ride = itinerary.rides[0]
    assert ride.driver is not None
    first = itinerary.legs[0]
    there = first.end_s if first.kind == "solo" else first.begin_s
    return Meeting(
        ride.driver,
        _point(ride, offers[ride.driver][0], sites, params),
        ride.end,
        ride.metres,
        max(0.0, there - now),
        max(0.0, ride.begin_s - now),
        max(0.0, ride.end_s - now),
        len(itinerary.rides) > 1,
    )


def _point(ride: ItineraryLeg, offer: Accept, sites: Sites, params: HitchhikingParameters) -> HitchhikingPoint:
    """The hitchhiking point where the ride begins, or places for both on the driver's path."""
    x, y = ride.start
    known = next((p for p in sites.hitchhiking_points if distance(p.waiting_pose, Pose2D(x, y)) < 0.01), None)
    if known is not None:
        return known
    path = OwnPath(np.array(offer.path)[:, :2]).line
    arc, _ = path.project(x, y)
    apart = params.gap_m - offer.marker_pose.x + _ROOM_M
    waiting = path.pose(arc)
    if arc + apart > path.end_m:
        return HitchhikingPoint("", (), compose(waiting, Pose2D(apart)), waiting)
    return HitchhikingPoint("", (), path.pose(arc + apart), waiting)
