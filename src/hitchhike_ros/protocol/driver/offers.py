"""What a driver offers to whom, for how long that holds, or why it does not: P17 Algorithm 1, P18 Algorithm 2."""

from __future__ import annotations

import math
from dataclasses import replace

from hitchhike_ros.core.datatypes import HitchhikingPoint, Pose2D
from hitchhike_ros.core.errors import HitchhikeError, ItineraryInputError, PlanningError
from hitchhike_ros.core.geometry import between, compose, distance, point_in_polygon
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.driver.convoy import LEAVE_TOGETHER_M, Offer
from hitchhike_ros.protocol.driver.facts import ENGAGED, WITH_RIDER, DriverFacts
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.matching import Stretch, agreed_stretch, shared_from, way_of
from hitchhike_ros.protocol.messages import Lock, Request, Waypoint
from hitchhike_ros.protocol.parameters import TIME_CRITICAL_PRIORITY
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.reasons import Reason

# Where exactly a ride ends does not matter, but a driver that turned for the last centimetres would lose its rider.
RIDE_TOLERANCE_M = 0.25
# A hitchhiker may stand so far ahead of its waiting place (chosen): it sees nothing behind itself and does not go back.
_AHEAD_M = 0.5
# Of a hitchhiker's camera from its base, at most (chosen).
_CAMERA_M = 0.2
# A robot that joins boards within this of where the first rider does (chosen).
_JOIN_M = 0.5
_NOWHERE = HitchhikingPoint("", (), Pose2D(), Pose2D())  # before a hitchhiker has said where


class Refusal(HitchhikeError):
    """A ride is not offered, or an offer does not hold."""

    def __init__(self, reason: Reason) -> None:
        self.reason = reason
        super().__init__(str(reason))


def verdict(f: DriverFacts) -> Offer | Refusal:
    """What comes of the request or lock that is being taken: worked out once, however many guards ask."""
    if f.judged is None or f.judged[0] is not f.event or f.judged[1] != f.now:
        found: Offer | Refusal
        try:
            found = here(f, f.event) if isinstance(f.event, Request) else locked(f, f.event)
        except Refusal as no:
            found = no
        f.judged = f.event, f.now, found
    offer = f.judged[2]
    assert isinstance(offer, Offer | Refusal)
    return offer


def answer(f: DriverFacts, request: Request) -> tuple[Offer, tuple[Waypoint, ...]]:
    """The offer to one that asks, beside what it already has on its way, and the way where it is asked from afar.

    Raises:
        Refusal: no ride is offered.
    """
    if f.params.mode == "network":
        return from_afar(f, request)
    if f.state in ENGAGED:
        return to_join(f, request), ()
    offer = verdict(f)
    if isinstance(offer, Refusal):
        raise offer
    return offer, ()


def here(f: DriverFacts, request: Request) -> Offer:
    """To the hitchhiker at the same hitchhiking point, in the order of P17 Algorithm 1.

    Raises:
        Refusal: no ride is offered.
    """
    _check_willing(f, request)
    point = None if f.estimate is None else _point_around(f.sites, f.estimate.pose, request.pose)
    if point is None:
        raise Refusal(Reason.INVALID_PLACE)
    try:
        apart_m = f.params.gap_m - f.rear_marker.marker_pose.x + _CAMERA_M
        point = _aligned_with(request.pose, point, apart_m)
        path = _boarded_path(f, point)
        way = way_of(request, f.planner)
    except PlanningError as exc:
        raise Refusal(Reason.PATH_TOO_SHORT) from exc
    shared = shared_from(path, path.come_m, way, f.params)
    if shared is None:
        raise Refusal(Reason.PATH_TOO_SHORT)
    _check_profile(f, request)
    # The ride begins where both stand, although their ways may meet a little farther on.
    return Offer(request.robot_id, request.ride_id, point, replace(shared, begin_m=path.come_m))


def from_afar(f: DriverFacts, request: Request) -> tuple[Offer, tuple[Waypoint, ...]]:
    """To a hitchhiker anywhere: the way of every driver that is able, with its times (P18 Algorithm 2).

    Raises:
        Refusal: no ride is offered.
    """
    _check_willing(f, request)
    if not f.free_places:
        raise Refusal(Reason.PATH_TOO_SHORT if f.state.phase is Phase.ALONE else Reason.ALREADY_DRIVING)
    assert f.route is not None
    board_m = f.riders[0].offer.stretch.begin_m if f.riders else None
    stretch = f.route.shared_with(request, f.estimate, f.state is DriverState.NAVIGATING, board_m)
    if stretch is None:
        raise Refusal(Reason.PATH_TOO_SHORT)
    _check_profile(f, request)
    waypoints = f.announced()
    if not waypoints:
        raise Refusal(Reason.PATH_TOO_SHORT)
    return Offer(request.robot_id, request.ride_id, _NOWHERE, stretch), waypoints


def to_join(f: DriverFacts, request: Request) -> Offer:
    """To another hitchhiker at the hitchhiking point where a driver is about to take one along.

    Raises:
        Refusal: no ride is offered.
    """
    if not f.free_places:
        raise Refusal(Reason.ALREADY_DRIVING)
    return here(f, request)


def locked(f: DriverFacts, lock: Lock) -> Offer:
    """The ride that a hitchhiker takes with ``lock``, which was promised to it.

    Raises:
        Refusal: the promise does not hold, or the ride is not as it was promised.
    """
    if f.state in WITH_RIDER:
        raise Refusal(Reason.ALREADY_DRIVING)
    if f.state is DriverState.NAVIGATING:
        return _met(f, lock)
    if f.state not in (DriverState.ALIGNING, DriverState.ALIGNED):
        raise Refusal(Reason.NOT_OFFERED)
    if not f.free_places:
        raise Refusal(Reason.ALREADY_DRIVING)
    # One that joins boards where the first rider does.
    offer = _met(f, lock) if f.params.mode == "network" else _promised(f, lock)
    point = f.riders[0].offer.point
    if distance(offer.point.aligning_pose, point.aligning_pose) > _JOIN_M:
        raise Refusal(Reason.INVALID_PLACE)
    return replace(offer, point=point, stretch=_together(f, offer.stretch))


def _together(f: DriverFacts, stretch: Stretch) -> Stretch:
    """A joiner's ride: it begins with the first rider's, and ends with another's that ends nearly there."""
    rides = [rider.offer.stretch for rider in f.riders]
    ends = (ride.end_m for ride in rides if abs(ride.end_m - stretch.end_m) <= LEAVE_TOGETHER_M)
    return Stretch(rides[0].line, rides[0].begin_m, min(ends, default=stretch.end_m))


def _boarded_path(f: DriverFacts, point: HitchhikingPoint) -> OwnPath:
    """The driver's way from the hitchhiking point, which is the first rider's where there is one already.

    Raises:
        PlanningError: there is no way.
    """
    assert f.route is not None
    if not f.riders:
        return OwnPath(f.planner(point.aligning_pose, f.route.goal))
    stretch = f.riders[0].offer.stretch
    path = OwnPath(stretch.line.points)
    path.come_m = stretch.begin_m
    return path


def promise(f: DriverFacts, offer: Offer) -> None:
    """The offer holds until the hitchhiker has heard all others; it binds nobody."""
    f.promised = {key: (until, known) for key, (until, known) in f.promised.items() if until >= f.now}
    holds_s = 2.0 * f.params.offer_window_s + f.params.confirm_timeout_s
    f.promised[offer.hitchhiker, offer.ride_id] = f.now + holds_s, offer


def _promised(f: DriverFacts, lock: Lock) -> Offer:
    until, offer = f.promised.get((lock.robot_id, lock.ride_id), (-math.inf, None))
    if offer is None or until < f.now:
        raise Refusal(Reason.NOT_OFFERED)
    return offer


def _met(f: DriverFacts, lock: Lock) -> Offer:
    """The ride from where a hitchhiker that was answered from afar wants to be met (P18 §4)."""
    _promised(f, lock)
    if lock.aligning is None or lock.waiting is None or lock.leave is None:
        raise Refusal(Reason.NOT_OFFERED)
    path = f.own_path()
    if path is None:
        raise Refusal(Reason.PATH_TOO_SHORT)
    try:
        stretch = agreed_stretch(path, lock.aligning, lock.waiting, lock.leave, lock.ride_m)
    except ItineraryInputError as exc:
        raise Refusal(Reason.INVALID_PLACE) from exc
    if stretch.length_m < f.params.min_ride_m - RIDE_TOLERANCE_M:
        raise Refusal(Reason.PATH_TOO_SHORT)
    waiting = lock.waiting
    known = (p for p in f.sites.hitchhiking_points if distance(p.waiting_pose, waiting) < RIDE_TOLERANCE_M)
    point = next(known, HitchhikingPoint("", (), lock.aligning, waiting))
    return Offer(lock.robot_id, lock.ride_id, point, stretch)


def _check_willing(f: DriverFacts, request: Request) -> None:
    if not f.params.may_drive:
        raise Refusal(Reason.NO_DRIVER)
    if f.route is None:
        raise Refusal(Reason.DRIVES_NOWHERE)
    if max(f.params.priority, request.priority) >= TIME_CRITICAL_PRIORITY:
        raise Refusal(Reason.HIGH_PRIORITY)


def _check_profile(f: DriverFacts, request: Request) -> None:
    if request.profile > f.params.profile:
        raise Refusal(Reason.PROFILE_MISMATCH)


def _point_around(sites: Sites, own: Pose2D, other: Pose2D) -> HitchhikingPoint | None:
    """The hitchhiking point in whose area both robots are, the nearest to the driver first."""
    for point in sorted(sites.hitchhiking_points, key=lambda p: distance(own, p.aligning_pose)):
        if all(point_in_polygon(pose.x, pose.y, point.area) for pose in (own, other)):
            return point
    return None


def _aligned_with(hitchhiker: Pose2D, point: HitchhikingPoint, apart_m: float) -> HitchhikingPoint:
    """The point, aligned at farther on where a hitchhiker ahead of its place would stand nearer than ``apart_m``."""
    ahead_m = between(point.waiting_pose, hitchhiker).x
    missing_m = apart_m - between(point.waiting_pose, point.aligning_pose).x + ahead_m
    farther_m = min(max(min(ahead_m, missing_m), 0.0), _AHEAD_M)
    return replace(point, aligning_pose=compose(point.aligning_pose, Pose2D(farther_m)))
