"""Who rides with whom in a network (P18 §4 to §6): what a driver can offer, and which offer a hitchhiker takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, HitchhikingPoint, Pose2D
from hitchhike_ros.core.errors import ItineraryInputError, PlanningError, UnreachableError
from hitchhike_ros.core.geometry import compose, distance, path_length
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
from hitchhike_ros.protocol.announcement import OwnPath, announced_driver
from hitchhike_ros.protocol.messages import Accept
from hitchhike_ros.protocol.parameters import HitchhikingParameters, Policy

Planner = Callable[[Pose2D, Pose2D], FloatArray]

# How far the hitchhiker stands behind the driver where there is no hitchhiking point, beyond the gap (chosen).
_ROOM_M = 0.4
# Who passes a hitchhiking point by so much goes there (chosen: half the width of a wide corridor).
_SITE_M = 1.5
# A ride takes its rider nearer to its goal by this much of its length, as the crow flies (chosen: it is a quarter on
# the first side of an L whose second is twice as long, and a third in P18 Experiment 3).
_LEAST_PROGRESS = 0.2


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


class Boardings:
    """Where one may board along a path, and what rides can be had there: the quick answer to a question from afar."""

    def __init__(self, path: OwnPath, sites: Sites, params: HitchhikingParameters) -> None:
        self._path, self._params = path, params
        self._nodes, self._arcs = path.nodes()
        if params.board_anywhere:
            self._at = self._arcs
            return
        places = _places(sites)
        arcs, away = path.line.project_all(places[:, :2])
        passed = [(arcs[k], places[k, 2]) for k in np.flatnonzero(away <= _SITE_M).tolist()]
        self._at = np.array([arc for arc, theta in passed if math.cos(path.line.pose(arc).theta - theta) > 0.0])

    def serve(self, goal: Pose2D) -> bool:
        """Whether a ride longer than T_dhh, from where the robot is on, takes one nearer to ``goal``."""
        begin = self._at[self._at >= self._path.come_m - _SITE_M]
        if not len(begin):
            return False
        to_go = np.hypot(self._nodes[:, 0] - goal.x, self._nodes[:, 1] - goal.y)
        metres = self._arcs - begin[:, None]
        nearer = np.interp(begin, self._arcs, to_go)[:, None] - to_go
        return bool(((metres > self._params.min_ride_m) & (nearer > _LEAST_PROGRESS * metres)).any())


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


def stretch(driver: OwnPath, aligning: Pose2D, leave: tuple[float, float]) -> tuple[float, float]:
    """Where along the driver's path a ride from ``aligning`` to ``leave`` begins and ends, in m.

    Raises:
        ItineraryInputError: either is not on the path ahead, or the path goes another way there; it names which.
    """
    tolerance = _SITE_M + _ROOM_M
    begin_m, away = driver.line.project(aligning.x, aligning.y, driver.come_m)
    if away > tolerance or math.cos(driver.line.pose(begin_m).theta - aligning.theta) <= 0.0:
        raise ItineraryInputError("driver", "aligning", aligning, "a place on its path, heading along it")
    end_m, away = driver.line.project(*leave, begin_m)
    if away > tolerance:
        raise ItineraryInputError("driver", "leave", leave, "a place on its path")
    return begin_m, end_m


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
