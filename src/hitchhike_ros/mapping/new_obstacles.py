"""New static boxes: what the laser sees where the static map is free (P17 §3, Table 1).

Ends of beams far from every wall of the map are counted in cells. What is hit often, for long and from places apart
stands there; people and driving robots leave their cells before. A cluster of cells becomes a box, and from then on the
beams around it say where its sides are (:mod:`hitchhike_ros.mapping.box_fit`). A box that beams pass through is gone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray, LaserScan, NonNegative, Obstacle, Pose2D, PoseEstimate, Positive
from hitchhike_ros.mapping.beams import Beams, beams_in_map
from hitchhike_ros.mapping.box_fit import View, sweep, take_view
from hitchhike_ros.mapping.grid import UNKNOWN, OccupancyGrid, distance_to
from hitchhike_ros.mapping.hit_evidence import CellKeys, HitEvidence
from hitchhike_ros.mapping.laser import LaserNoise

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class MappingParameters:
    """Section ``mapping`` of a robot's parameter file (all values are chosen)."""

    laser: LaserNoise = field(default_factory=LaserNoise)
    max_range_m: Positive = 5.0  # farther returns are too vague
    wall_clearance_m: Positive = 0.12  # nearer to a wall of the map, an end is that wall
    clearance_sigmas: NonNegative = 2.0  # beside it, of the end
    robot_clearance_m: NonNegative = 0.15  # around other robots
    watched_scans: Positive = 5.0  # hits of a cell before the beams around it are remembered
    watched_age_s: NonNegative = 0.8
    min_scans: Positive = 8.0  # hits of a cell before it is known to stand
    min_age_s: NonNegative = 4.0  # longer than people stop on their way
    min_baseline_m: NonNegative = 0.3  # between the places from which it was seen
    max_count: Positive = 30.0  # hits that a cell remembers
    pass_weight: Positive = 2.0  # hits that a scan takes away when it looks through a cell
    min_cells: Annotated[int, msgspec.Meta(ge=1)] = 2
    join_m: Positive = 0.12  # what is nearer belongs to one box
    margin_m: Positive = 0.25  # around a box, within which beams tell about it
    view_spacing_m: Positive = 0.1  # way of the robot between two views of a box
    max_views: Annotated[int, msgspec.Meta(ge=1)] = 32  # of a box; the nearest are kept
    min_views: Annotated[int, msgspec.Meta(ge=1)] = 5  # before it is told, so that its parts find together
    max_view_beams: Annotated[int, msgspec.Meta(ge=1)] = 32
    check_m: Positive = 2.0  # from nearer, the own views of a box that was handed over count
    gone_scans: Annotated[int, msgspec.Meta(ge=1)] = 8  # that look through a box before it is gone
    hysteresis_m: NonNegative = 0.015  # smaller changes of a side are not told
    max_position_sigma_m: Positive = 0.15  # a robot that does not know where it is maps nothing
    max_heading_sigma_rad: Positive = 0.07


@dataclass(eq=False)
class _Box:
    """A box under observation: ``bounds`` (4,) least x, y, greatest x, y in ``map``.

    It has an id once it is known to stand. ``given`` (4,) are its bounds as another robot has measured them.
    """

    bounds: FloatArray
    id: str = ""
    given: FloatArray | None = None
    views: list[View] = field(default_factory=list)
    looked_from: FloatArray | None = None  # (2,) in ``map``, of the newest view
    settled: bool = True
    fitted_at: float = -np.inf
    looked_through: int = 0

    def obstacle(self) -> Obstacle:
        x, y, x2, y2 = (float(v) for v in self.bounds)
        return Obstacle(self.id, round(x, 4), round(y, 4), round(x2 - x, 4), round(y2 - y, 4))


class NewObstacleMapper:
    """Finds, refines and removes axis-aligned boxes that a static map does not have."""

    def __init__(self, grid: OccupancyGrid, parameters: MappingParameters) -> None:
        self._grid, self._parameters = grid, parameters
        # From a wall's face, which is half a cell before the centres of its cells.
        self._to_wall = (distance_to(grid.occupied, grid.resolution) - grid.resolution / 2).ravel()
        self._unknown = np.equal(grid.data, UNKNOWN).ravel()
        self._evidence = HitEvidence(parameters.max_count)
        self._boxes: list[_Box] = []
        self._obstacles: tuple[Obstacle, ...] = ()
        self._names = 0

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The boxes in ``map``, in the order in which they were found; the same tuple until one changes beyond noise.

        A box keeps its id while it is refined.
        """
        return self._obstacles

    def add(self, obstacles: Iterable[Obstacle]) -> None:
        """Take over boxes from another robot, as often as they come: a box that this robot has seen itself stays.

        They keep the sides that the other robot measured where no near beam of this one tells otherwise, and their ids
        unless these are taken.
        """
        for theirs in obstacles:
            bounds = np.array([theirs.x, theirs.y, theirs.x + theirs.w, theirs.y + theirs.b])
            same = [box for box in self._boxes if _near(box.bounds, bounds, self._parameters.join_m)]
            if any(box.id and box.views for box in same):
                continue
            self._boxes = [box for box in self._boxes if box not in same]
            name = next((box.id for box in same if box.id), theirs.id)
            taken = {box.id for box in self._boxes}
            self._boxes.append(_Box(bounds, self._new_name() if name in taken else name, given=bounds))
        self._tell()

    def update(
        self,
        scan: LaserScan,
        estimate: PoseEstimate,
        T_base_laser: Pose2D,
        others: Iterable[tuple[Pose2D, float]] = (),
    ) -> bool:
        """Take in a scan.

        Args:
            scan: the scan.
            estimate: the robot's pose when the scan was taken.
            T_base_laser: the laser's mount.
            others: places (pose in ``map``, radius in m) of other robots, which are no obstacles.

        Returns:
            Whether the scan was used; not so when the pose is too uncertain to map by.

        Raises:
            SensorDataError: the scan is senseless; nothing has changed then.
        """
        beams = beams_in_map(scan, estimate, T_base_laser, self._parameters.laser)
        if not self._knows_place(estimate):
            return False
        beams = beams.select(~self._on_robots(beams.ends, others))
        cells = self._cells(beams)
        self._evidence.add(np.unique(cells[self._new(beams, cells)]), scan.stamp, beams.origin)
        self._wear_off(beams)
        self._remove_gone(beams)
        self._watch()
        self._confirm()
        self._look(beams, cells)
        self._settle(scan.stamp)
        self._tell()
        return True

    def _knows_place(self, estimate: PoseEstimate) -> bool:
        p, variance = self._parameters, np.diag(estimate.covariance)
        return bool(variance[:2].max() <= p.max_position_sigma_m**2 and variance[2] <= p.max_heading_sigma_rad**2)

    def _on_robots(self, ends: FloatArray, others: Iterable[tuple[Pose2D, float]]) -> BoolArray:
        """Mask (N,) of the ends (N, 2) that lie on another robot."""
        on = np.zeros(len(ends), dtype=bool)
        for robot, radius_m in others:
            reach = radius_m + self._parameters.robot_clearance_m
            on |= np.hypot(ends[:, 0] - robot.x, ends[:, 1] - robot.y) <= reach
        return on

    def _cells(self, beams: Beams) -> CellKeys:
        """Cell (N,) of each near end as row * width + column; -1 of others, and where there is no map."""
        keys = np.full(beams.ranges.size, -1, dtype=np.int64)
        near = np.flatnonzero(beams.ranges <= self._parameters.max_range_m)
        cells = self._grid.world_to_cell(beams.ends[near])
        inside = self._grid.in_bounds(cells)
        keys[near[inside]] = cells[inside] @ np.array([self._grid.width, 1])
        return keys

    def _new(self, beams: Beams, cells: CellKeys) -> BoolArray:
        """Mask (N,) of the ends that lie in free space of the map."""
        p = self._parameters
        clearance = p.wall_clearance_m + p.clearance_sigmas * np.hypot(beams.range_sigma, beams.pose_sigma)
        return (cells >= 0) & ~self._unknown[cells] & (self._to_wall[cells] > clearance)

    def _wear_off(self, beams: Beams) -> None:
        """Take evidence from the cells that beams pass through."""
        offset = self._centres(self._evidence.keys) - beams.origin
        range_m = np.hypot(offset[:, 0], offset[:, 1])
        behind = range_m + self._grid.resolution + 3.0 * self._parameters.laser.sigma(range_m)
        clear = beams.clear_range(np.arctan2(offset[:, 1], offset[:, 0])) > behind
        self._evidence.weaken(clear & (range_m <= self._parameters.max_range_m), self._parameters.pass_weight)

    def _remove_gone(self, beams: Beams) -> None:
        """Remove the boxes that scan after scan looks through, with their evidence."""
        for box in self._boxes:
            if _distance(beams.origin, box.bounds) <= self._parameters.max_range_m:
                box.looked_through = _looked_through(box, beams)
        gone = [box for box in self._boxes if box.looked_through >= self._parameters.gone_scans]
        if gone:
            self._boxes = [box for box in self._boxes if box not in gone]
            self._evidence.keep(~self._around(self._evidence.keys, gone, self._parameters.join_m))

    def _watch(self) -> None:
        """Watch new clusters of cells: those apart from every box, and what stands but no box has grown to."""
        p = self._parameters
        early = self._evidence.standing(p.watched_scans, p.watched_age_s, 0.0)
        early = early[~self._around(early, self._boxes, p.margin_m)]
        left = self._evidence.standing(p.min_scans, p.min_age_s, p.min_baseline_m)
        left = left[~self._around(left, self._boxes, p.join_m)]
        for cluster in self._clusters(np.union1d(early, left)):
            if len(cluster) >= p.min_cells:
                centres, half = self._centres(cluster), self._grid.resolution / 2
                self._boxes.append(_Box(np.concatenate([centres.min(axis=0) - half, centres.max(axis=0) + half])))

    def _confirm(self) -> None:
        """Name the watched boxes that are known to stand."""
        p = self._parameters
        if all(box.id for box in self._boxes):
            return
        standing = self._evidence.standing(p.min_scans, p.min_age_s, p.min_baseline_m)
        for box in self._boxes:
            stands = len(box.views) >= p.min_views and self._around(standing, [box], p.join_m).sum() >= p.min_cells
            if stands and not box.id:
                box.id = self._new_name()

    def _look(self, beams: Beams, cells: CellKeys) -> None:
        """Remember what the beams tell about the boxes near by, when the robot has moved since it last did."""
        p = self._parameters
        for box in self._boxes:
            distance = _distance(beams.origin, box.bounds)
            moved = box.looked_from is None or np.hypot(*(box.looked_from - beams.origin)) >= p.view_spacing_m
            if moved and distance <= (p.max_range_m if box.given is None else p.check_m):
                self._add_view(box, distance, beams, cells)

    def _add_view(self, box: _Box, distance: float, beams: Beams, cells: CellKeys) -> None:
        p = self._parameters
        enter, leave = beams.crossing(_grown(box.bounds, p.margin_m))
        telling = (enter <= leave) & (leave > 0.0) & (beams.ranges > enter)
        inside = beams.ranges < leave
        for other in self._boxes:
            if other is not box and _near(other.bounds, box.bounds, 2 * p.margin_m):
                telling &= ~(inside & _within(beams.ends, _grown(other.bounds, p.join_m / 2)))
        chosen = np.flatnonzero(telling)
        if not chosen.size:
            return
        chosen = chosen[:: -(-chosen.size // p.max_view_beams)]
        # The map is as coarse as its cells.
        to_wall = np.maximum(self._to_wall[cells[chosen]] - self._grid.resolution, 0.0)
        elsewhere = np.where(inside[chosen] & (cells[chosen] >= 0), to_wall, 0.0)
        box.views.append(take_view(beams, chosen, distance, elsewhere))
        if len(box.views) > p.max_views:
            box.views.remove(max(box.views, key=lambda view: view.distance))
        box.looked_from, box.settled = beams.origin, False

    def _settle(self, now: float) -> None:
        """Fit one box a scan, in turn, and unite it with a box that it has come near to."""
        waiting = [box for box in self._boxes if not box.settled]
        if not waiting:
            return
        box = min(waiting, key=lambda box: box.fitted_at)
        before, box.bounds, box.fitted_at = box.bounds, sweep(box.bounds, box.views, box.given), now
        box.settled = bool((box.bounds == before).all())
        near = [other for other in self._boxes if _near(other.bounds, box.bounds, self._parameters.join_m)]
        if len(near) > 1:
            self._unite(near[0], near[1])

    def _unite(self, older: _Box, younger: _Box) -> None:
        """Keep one of two boxes, around both and with the views of both; a box that was handed over keeps its sides."""
        kept, other = (younger, older) if younger.id and not older.id else (older, younger)
        if kept.given is None:
            kept.bounds = np.append(
                np.minimum(kept.bounds, other.bounds)[:2], np.maximum(kept.bounds, other.bounds)[2:]
            )
            views = sorted(kept.views + other.views, key=lambda view: view.distance)
            kept.views, kept.settled = views[: self._parameters.max_views], False
        self._boxes.remove(other)

    def _tell(self) -> None:
        """Tell the boxes as they are now when one came, went, or changed by more than noise."""
        now = {box.id: box.obstacle() for box in self._boxes if box.id}
        told = {box.id: box for box in self._obstacles}
        kept = [name for name in told if name in now]
        fresh = [name for name in now if name not in told]
        changed = any(_change(now[name], told[name]) > self._parameters.hysteresis_m for name in kept)
        if fresh or changed or len(kept) < len(told):
            self._obstacles = tuple(now[name] for name in kept + fresh)

    def _new_name(self) -> str:
        taken = {box.id for box in self._boxes}
        while True:
            self._names += 1
            if f"obs{self._names}" not in taken:
                return f"obs{self._names}"

    def _centres(self, cells: CellKeys) -> FloatArray:
        """Centres (K, 2) in ``map`` of cells (K,)."""
        return self._grid.cell_to_world(np.column_stack(np.divmod(cells, self._grid.width)))

    def _around(self, cells: CellKeys, boxes: Iterable[_Box], margin: float) -> BoolArray:
        """Mask (K,) of the cells (K,) on the boxes or up to ``margin`` in m beside them."""
        near, centres = np.zeros(cells.size, dtype=bool), self._centres(cells)
        for box in boxes:
            near |= _within(centres, _grown(box.bounds, margin))
        return near

    def _clusters(self, cells: CellKeys) -> list[CellKeys]:
        """The cells (K,) in groups whose gaps are wider than ``join_m``."""
        if not cells.size:
            return []
        places = np.column_stack(np.divmod(cells, self._grid.width))
        reach = int(np.ceil(self._parameters.join_m / self._grid.resolution / 2))
        local = places - places.min(axis=0) + reach
        image = np.zeros(local.max(axis=0) + reach + 1, dtype=np.uint8)
        image[tuple(local.T)] = 1
        _, labels = cv2.connectedComponents(cv2.dilate(image, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)))
        label = labels[tuple(local.T)]
        return [cells[label == number] for number in np.unique(label)]


def _looked_through(box: _Box, beams: Beams) -> int:
    """How many scans more have looked through a box than were stopped by it, of late and with this one."""
    size = box.bounds[2:] - box.bounds[:2]
    # Only the inner part of the box, or a little more than nothing, is sure not to be missed.
    inset = np.minimum(0.05, np.minimum(0.3 * size, 0.5 * size - 0.01))
    enter, leave = beams.crossing(box.bounds + np.append(inset, -inset))
    across = (enter <= leave) & (enter > 0.0)
    margin = 0.05 + 3.0 * np.hypot(beams.range_sigma, beams.pose_sigma)
    passed = across & (beams.ranges > leave + margin)
    stopped = across & ~passed & (beams.ranges >= enter - margin)
    if passed.sum() >= 3 and passed.sum() > 4 * stopped.sum():
        return box.looked_through + 1
    return max(box.looked_through - int(stopped.any()), 0)


def _grown(bounds: FloatArray, margin: float) -> FloatArray:
    """Bounds (4,) with ``margin`` in m more on every side."""
    return bounds + np.array([-margin, -margin, margin, margin])


def _within(points: FloatArray, bounds: FloatArray) -> BoolArray:
    """Mask (N,) of the points (N, 2) inside bounds (4,)."""
    return ((points >= bounds[:2]) & (points <= bounds[2:])).all(axis=1)


def _near(a: FloatArray, b: FloatArray, gap: float) -> bool:
    """Whether two boxes (4,) are no more than ``gap`` in m apart along both axes."""
    return bool((a[:2] <= b[2:] + gap).all() and (b[:2] <= a[2:] + gap).all())


def _distance(place: FloatArray, bounds: FloatArray) -> float:
    """Distance in m from a place (2,) to a box (4,)."""
    return float(np.hypot(*np.maximum(np.maximum(bounds[:2] - place, place - bounds[2:]), 0.0)))


def _change(a: Obstacle, b: Obstacle) -> float:
    """By how much in m the side that moved most has moved."""
    return max(abs(a.x - b.x), abs(a.y - b.y), abs(a.x + a.w - b.x - b.w), abs(a.y + a.b - b.y - b.b))
