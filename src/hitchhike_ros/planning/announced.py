"""Paths that drivers announce: which can be planned with, and all rides that they offer."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray, NonNegative, Positive
from hitchhike_ros.errors import ItineraryInputError

IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AnnouncedDriver:
    """A driver's plan: ``path`` (N, 2) in m in ``map``, ``times`` (N,) in s at which it is there, N >= 2.

    Between its points it keeps its speed. Towards a boarding point it may hurry up to ``safe_speed_mps`` (P18 §4).
    """

    id: str
    path: FloatArray
    times: FloatArray
    free_places: int = 1
    safe_speed_mps: float = 0.6


@dataclass(frozen=True)
class RideRules:
    """When and where a ride can be had. Values without a source are chosen."""

    min_ride_m: NonNegative = 20.0  # T_dhh: a ride is longer (P18 §5)
    max_wait_s: NonNegative = 60.0  # T_hwait, of whoever is first; the driver waits no longer either
    couple_s: NonNegative = 15.0  # P18 Table 2
    decouple_s: NonNegative = 12.0  # P18 Table 2
    ride_speed_mps: Positive = 0.5  # a pair goes no faster
    board_anywhere: bool = False  # at any node of the driver's path, not at the sites alone (P18 §5)
    leave_anywhere: bool = True  # as P17 §3.1
    site_tolerance_m: NonNegative = 0.5  # a path so near passes the site
    max_age_s: NonNegative = 3.0  # a path that begins longer ago is not the driver's present plan


@dataclass(frozen=True, eq=False)
class Rides:
    """Every ride that can be had, as columns; points (P, 2) in ``map`` are numbered by their row in ``points``.

    A boarding (B of them) is a driver at a boarding point: ``driver``, ``at`` (point), ``time`` announced and
    ``earliest`` if the driver hurries, all (B,). A ride (R of them) is ``boarding``, ``to`` (point), its ``metres`` and
    ``duration`` in s with coupling and decoupling, all (R,).
    Rides are in the order of their boardings, and every boarding has one.
    """

    points: FloatArray
    driver: IndexArray
    at: IndexArray
    time: FloatArray
    earliest: FloatArray
    boarding: IndexArray
    to: IndexArray
    metres: FloatArray
    duration: FloatArray


def usable_drivers(
    drivers: Iterable[AnnouncedDriver], now: float, rules: RideRules
) -> tuple[tuple[AnnouncedDriver, ...], tuple[ItineraryInputError, ...]]:
    """The drivers that can be planned with, and for each of the others the reason why not."""
    usable: list[AnnouncedDriver] = []
    refused: list[ItineraryInputError] = []
    known: set[str] = set()
    for driver in drivers:
        try:
            if driver.id in known:
                raise ItineraryInputError(driver.id, "id", driver.id, "an id that no other driver has")
            usable.append(checked(driver, now, rules.max_age_s))
            known.add(driver.id)
        except ItineraryInputError as exc:
            refused.append(exc)
    return tuple(usable), tuple(refused)


def checked(driver: AnnouncedDriver, now: float, max_age_s: float) -> AnnouncedDriver:
    """The driver's plan from ``now`` on.

    Raises:
        ItineraryInputError: names the driver and the field that is wrong.
    """

    def require(holds: bool, field: str, value: object, expected: str) -> None:
        if not holds:
            raise ItineraryInputError(driver.id, field, value, expected)

    path, times = (_numbers(driver.id, name, getattr(driver, name)) for name in ("path", "times"))
    require(
        path.ndim == 2 and path.shape[1:] == (2,) and len(path) > 1, "path", path.shape, "two points or more (N, 2)"
    )
    require(times.shape == (len(path),), "times", times.shape, f"one time for each of the {len(path)} points")
    for name, values in (("path", path), ("times", times)):
        bad = values[~np.isfinite(values)]
        require(not len(bad), name, float(bad[0]) if len(bad) else None, "finite numbers")
    steps = np.diff(times)
    require(bool((steps > 0).all()), "times", float(steps.min()), "steps > 0 s")
    require(
        times[0] >= now - max_age_s, "times", float(times[0]), f"a path that begins at {now - max_age_s} s or later"
    )
    require(times[-1] > now, "times", float(times[-1]), f"a path that ends after now, {now} s")
    require(driver.free_places >= 1, "free_places", driver.free_places, "a free place")
    speed = driver.safe_speed_mps
    require(math.isfinite(speed) and speed > 0, "safe_speed_mps", speed, "a finite speed > 0")
    if times[0] < now:
        here = [np.interp(now, times, path[:, axis]) for axis in (0, 1)]
        ahead = times > now
        path, times = np.vstack([here, path[ahead]]), np.concatenate([[now], times[ahead]])
    return AnnouncedDriver(driver.id, path, times, driver.free_places, speed)


def possible_rides(
    drivers: tuple[AnnouncedDriver, ...], sites: FloatArray, start: FloatArray, goal: FloatArray, rules: RideRules
) -> Rides:
    """All rides longer than ``min_ride_m`` over the paths of ``drivers`` as :func:`usable_drivers` gives them.

    One may board and leave at ``sites`` (S, 2); where the rules allow it, leave at the driver's own nodes and the goal,
    board at the start and at nodes of any path. A path passes a point where it is nearest to it and within
    ``site_tolerance_m``; one that comes back passes it again.
    """
    empty = np.empty((0, 2))
    nodes = np.concatenate([empty, *(driver.path for driver in drivers)])
    common = (  # points, whether one may board there, whether one may leave there
        (sites, True, True),
        (nodes if rules.board_anywhere else empty, True, rules.leave_anywhere),
        (start[None], rules.board_anywhere, False),
        (goal[None], False, rules.leave_anywhere),
    )
    its_own = rules.leave_anywhere and not rules.board_anywhere
    columns, places = [], []
    boardings = passages = 0
    for k, driver in enumerate(drivers):
        groups = (*common, (driver.path if its_own else empty, False, True))
        place = np.concatenate([group[0] for group in groups])
        may_board = np.concatenate([np.full(len(points), board) for points, board, _ in groups])
        may_leave = np.concatenate([np.full(len(points), leave) for points, _, leave in groups])
        which, knot = _passed(driver, place, rules.site_tolerance_m)
        places.append(place[which])
        at, time, earliest, boarding, to, metres, duration = _rides_of(
            driver, knot, may_board[which], may_leave[which], rules
        )
        whose = np.full(len(at), k)
        columns.append((whose, at + passages, time, earliest, boarding + boardings, to + passages, metres, duration))
        passages, boardings = passages + len(which), boardings + len(at)
    points, number = np.unique(np.concatenate([empty, *places]), axis=0, return_inverse=True)
    none = (*[np.empty(0, np.int64)] * 2, *[np.empty(0)] * 2, *[np.empty(0, np.int64)] * 2, *[np.empty(0)] * 2)
    whose, at, time, earliest, boarding, to, metres, duration = map(np.concatenate, zip(none, *columns, strict=True))
    number = number.reshape(-1)
    return Rides(points, whose, number[at], time, earliest, boarding, number[to], metres, duration)


def _rides_of(
    driver: AnnouncedDriver, knot: FloatArray, may_board: BoolArray, may_leave: BoolArray, rules: RideRules
) -> tuple[IndexArray, FloatArray, FloatArray, IndexArray, IndexArray, FloatArray, FloatArray]:
    """One driver's columns of :class:`Rides`, points and boardings counted among its passages and its boardings.

    A passage (K of them) is at ``knot`` (K,): the index of a node of the path, with a fraction between two.
    """
    lengths = np.linalg.norm(np.diff(driver.path, axis=0), axis=1)
    steps = np.diff(driver.times)
    # A driver that stands at a place does so for a reason of its own: it does not hurry there.
    hurried = np.where(lengths > 0, np.minimum(steps, lengths / driver.safe_speed_mps), steps)
    coupled = np.maximum(steps, lengths / rules.ride_speed_mps)
    indices = np.arange(len(driver.path))
    time = np.interp(knot, indices, driver.times)
    arc, earliest, ridden = (
        np.interp(knot, indices, np.concatenate([[0.0], np.cumsum(each)])) for each in (lengths, hurried, coupled)
    )
    board, leave = np.flatnonzero(may_board), np.flatnonzero(may_leave)
    metres = arc[leave] - arc[board, None]
    long_enough = metres > rules.min_ride_m
    offered = long_enough.any(axis=1)
    i, j = np.nonzero(long_enough)
    begin, end = board[offered], leave[j]
    boarding = (np.cumsum(offered) - 1)[i]
    duration = rules.couple_s + (ridden[end] - ridden[board[i]]) + rules.decouple_s
    return begin, time[begin], driver.times[0] + earliest[begin], boarding, end, metres[i, j], duration


def _passed(driver: AnnouncedDriver, places: FloatArray, tolerance_m: float) -> tuple[IndexArray, FloatArray]:
    """Which of ``places`` (P, 2) the path passes, and where: node index with a fraction; both (K,)."""
    begin, along = driver.path[:-1], np.diff(driver.path, axis=0)
    square = (along**2).sum(axis=1)
    offset = places[:, None] - begin  # (P, segments, 2)
    fraction = np.divide((offset * along).sum(axis=2), square, out=np.zeros(offset.shape[:2]), where=square > 0)
    fraction = np.clip(fraction, 0.0, 1.0)
    distance = np.linalg.norm(offset - fraction[..., None] * along, axis=2)
    edge = np.full((len(places), 1), np.inf)
    before, after = np.hstack([edge, distance[:, :-1]]), np.hstack([distance[:, 1:], edge])
    place, segment = np.nonzero((distance <= tolerance_m) & (distance < before) & (distance <= after))
    return place, segment + fraction[place, segment]


def _numbers(robot: str, field: str, values: object) -> FloatArray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as exc:
        raise ItineraryInputError(robot, field, values, "numbers") from exc
