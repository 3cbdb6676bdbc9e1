"""Paths that drivers announce: which can be planned with, and all rides that they offer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from numbers import Integral, Real

import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import BoolArray, FloatArray, NonNegative, Positive
from hitchhike_ros.core.errors import ItineraryInputError

_FARTHEST_M = 1e6  # beyond the largest map: sums of squares of whatever is nearer stay exact enough
# Of a segment's length: a site so near a node is at it, or rounding would say which way the driver goes on from there.
_SHARE_DECIMALS = 9

IndexArray = npt.NDArray[np.int64]


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
    farthest = float(np.abs(path).max())
    require(farthest < _FARTHEST_M, "path", farthest, f"coordinates below {_FARTHEST_M:.0e} m")
    places, speed = driver.free_places, driver.safe_speed_mps
    require(isinstance(places, Integral) and places >= 1, "free_places", places, "a free place")
    known = isinstance(speed, Real) and math.isfinite(speed)
    require(known and speed > 0, "safe_speed_mps", speed, "a finite speed > 0")
    if times[0] < now:
        here = [np.interp(now, times, path[:, axis]) for axis in (0, 1)]
        ahead = times > now
        path, times = np.vstack([here, path[ahead]]), np.concatenate([[now], times[ahead]])
    return AnnouncedDriver(driver.id, path, times, places, speed)


def possible_rides(
    drivers: Sequence[AnnouncedDriver], sites: FloatArray, start: FloatArray, goal: FloatArray, rules: RideRules
) -> Rides:
    """All rides longer than ``min_ride_m`` over the paths of ``drivers`` as :func:`usable_drivers` gives them.

    One may board and leave at ``sites`` (S, 2); where the rules allow it, leave at the nodes of the driver's path and
    the goal, board at the start and at nodes of any path. A path passes a point where it comes nearest to it, within
    ``site_tolerance_m``; one that comes back passes it again. Sites (S, 3) have a heading, and one boards there only
    with a driver that goes on within 90° of it, unless one may board anywhere.
    """
    # One chain of all paths: a knot on it is the index of a node, with a fraction between two.
    nodes = np.concatenate([np.empty((0, 2)), *(driver.path for driver in drivers)])
    whose = np.repeat(np.arange(len(drivers)), [len(driver.path) for driver in drivers])
    place, knot, may_board, may_leave = _stops(nodes, whose, sites, start, goal, rules)
    its_driver = whose[knot.astype(np.int64)]
    arc, time, hurried, ridden = (_between(clock, knot) for clock in _clocks(drivers, rules))
    begins, ends = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for first, last in pairwise(np.searchsorted(its_driver, np.arange(len(drivers) + 1)).tolist()):
        board = first + np.flatnonzero(may_board[first:last])
        leave = first + np.flatnonzero(may_leave[first:last])
        i, j = np.nonzero(arc[leave] - arc[board, None] > rules.min_ride_m)
        begins.append(board[i])
        ends.append(leave[j])
    begin, end = np.concatenate(begins), np.concatenate(ends)
    new = np.diff(begin, prepend=-1) > 0
    boardings = begin[new]
    points, number = _distinct(place)
    return Rides(
        points=points,
        driver=its_driver[boardings],
        at=number[boardings],
        time=time[boardings],
        earliest=hurried[boardings],
        boarding=np.cumsum(new) - 1,
        to=number[end],
        metres=arc[end] - arc[begin],
        duration=rules.couple_s + (ridden[end] - ridden[begin]) + rules.decouple_s,
    )


def _stops(
    nodes: FloatArray, whose: IndexArray, sites: FloatArray, start: FloatArray, goal: FloatArray, rules: RideRules
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Where rides may begin or end, along the chain: points (K, 2), knots, whether one may board, and leave, (K,)."""
    groups = (  # points of whichever path passes them, whether one may board there, whether one may leave there
        (sites[:, :2], True, True),
        (start[None], rules.board_anywhere, False),
        (goal[None], False, rules.leave_anywhere),
        (nodes[: len(nodes) if rules.board_anywhere else 0], True, rules.leave_anywhere),
    )
    places, number = _distinct(np.concatenate([points for points, *_ in groups]))
    boards, leaves = np.zeros((2, len(places)), dtype=bool)
    bounds = np.cumsum([len(points) for points, *_ in groups])
    for (_, board, leave), its in zip(groups, np.split(number, bounds[:-1]), strict=True):
        boards[its] |= board
        leaves[its] |= leave
    place, knot = _passed(nodes, whose[:-1] == whose[1:], places, rules.site_tolerance_m)
    points, may_board, may_leave = places[place], boards[place], leaves[place]
    if sites.shape[1] == 3 and not rules.board_anywhere:
        headings = np.zeros(len(places))
        headings[number[: len(sites)]] = sites[:, 2]
        may_board = may_board & _goes_on(nodes, knot, headings[place])
    if rules.leave_anywhere and not rules.board_anywhere:  # then a node is its own driver's alone
        points, knot = np.concatenate([points, nodes]), np.concatenate([knot, np.arange(len(nodes))])
        may_board = np.concatenate([may_board, np.zeros(len(nodes), dtype=bool)])
        may_leave = np.concatenate([may_leave, np.ones(len(nodes), dtype=bool)])
    order = np.argsort(knot, kind="stable")
    return points[order], knot[order], may_board[order], may_leave[order]


def _goes_on(nodes: FloatArray, knot: FloatArray, heading: FloatArray) -> BoolArray:
    """Whether the chain of ``nodes`` (N, 2) goes on from knots (K,) within 90° of the headings (K,)."""
    along = np.diff(nodes, axis=0, append=nodes[-1:])[knot.astype(np.int64)]
    return np.asarray(along[:, 0] * np.cos(heading) + along[:, 1] * np.sin(heading) > 0.0)


def _distinct(points: FloatArray) -> tuple[FloatArray, IndexArray]:
    """The different ones of ``points`` (K, 2), and the index (K,) of each point among them."""
    different, number = np.unique(points, axis=0, return_inverse=True)
    return different, number.reshape(-1)


def _between(values: FloatArray, knot: FloatArray) -> FloatArray:
    """Values of nodes (N,) at knots (K,)."""
    return np.interp(knot, np.arange(len(values)), values) if len(values) else np.empty(0)


def _clocks(drivers: Sequence[AnnouncedDriver], rules: RideRules) -> Iterator[FloatArray]:
    """At every node of the chain: metres, time announced, time if the driver hurries, time that a pair needs, (N,)."""
    columns: list[tuple[FloatArray, ...]] = [(np.empty(0),) * 4]
    for driver in drivers:
        lengths = np.hypot(*np.diff(driver.path, axis=0).T)
        steps = np.diff(driver.times)
        # A driver that stands at a place does so for a reason of its own: it does not hurry there.
        hurried = np.where(lengths > 0, np.minimum(steps, lengths / driver.safe_speed_mps), steps)
        coupled = np.maximum(steps, lengths / rules.ride_speed_mps)
        sums = np.zeros((3, len(driver.path)))
        np.cumsum([lengths, hurried, coupled], axis=1, out=sums[:, 1:])
        columns.append((sums[0], driver.times, driver.times[0] + sums[1], sums[2]))
    return map(np.concatenate, zip(*columns, strict=True))


def _passed(
    nodes: FloatArray, joined: BoolArray, places: FloatArray, tolerance_m: float
) -> tuple[IndexArray, FloatArray]:
    """Which of ``places`` (P, 2) the chain passes, and where on it, both (K,).

    The chain is ``nodes`` (N, 2); ``joined`` (N - 1,) says between which there is a segment.
    """
    if len(nodes) < 2:
        return np.empty(0, np.int64), np.empty(0)
    begin, along = nodes[:-1].T[:, None], np.diff(nodes, axis=0).T[:, None]  # (2, 1, segments)
    square = (along**2).sum(axis=0)
    offset = places.T[:, :, None] - begin  # (2, P, segments)
    fraction = (offset[0] * along[0] + offset[1] * along[1]) / np.where(square > 0, square, 1.0)
    fraction = np.round(np.clip(fraction, 0.0, 1.0), _SHARE_DECIMALS)
    offset -= fraction * along
    near = joined & (np.hypot(offset[0], offset[1]) <= tolerance_m)
    # Nearest within a segment; at a node that one segment comes nearer to and the next one leaves; at either end.
    first, last = np.append(True, ~joined[:-1]), np.append(~joined[1:], True)
    leaves_next = np.hstack([fraction[:, 1:] == 0, np.ones((len(places), 1), dtype=bool)]) | last
    nearest = np.where(fraction == 1, leaves_next, (fraction > 0) | first)
    place, segment = np.nonzero(near & nearest)
    return place, segment + fraction[place, segment]


def _numbers(robot: str, field: str, values: object) -> FloatArray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as exc:
        raise ItineraryInputError(robot, field, values, "numbers") from exc
