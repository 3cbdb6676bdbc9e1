"""New static obstacles: what the laser sees again and again where the map is free (P17 §3, Table 1).

Each beam that ends away from the walls marks a small cell, and each beam that passes through a marked cell wears the
mark off, so what moves leaves nothing behind. Cells that were seen for a while and from places apart make a box.
Space that no beam went through may belong to the box. This joins the sides of a box and extends it to a wall.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, NonNegative, Obstacle, Pose2D, PoseEstimate, Positive
from hitchhike_ros.core.geometry import compose, distance, transform_points
from hitchhike_ros.mapping.grid import FREE, OccupancyGrid, distance_to
from hitchhike_ros.mapping.laser import LaserNoise, check_scan, end_points, passed_through
from hitchhike_ros.mapping.seen_through import SeenThrough

_STRIDE = 1 << 32  # cell (column, row) has the key column * _STRIDE + row
_HALF = 1 << 31


@dataclass(frozen=True)
class MappingParameters:
    """Section ``mapping`` of a robot's parameter file (all values are chosen)."""

    laser: LaserNoise = field(default_factory=LaserNoise)
    cell_m: Positive = 0.02
    max_range_m: Positive = 5.0  # far enough to see a box for min_age_s when passing it at 1 m/s
    wall_margin_m: Positive = 0.12  # an end point nearer than this to a wall of the map is that wall
    robot_margin_m: NonNegative = 0.15  # margin around a known robot, as its pose and the ranges have errors
    margin_sigmas: NonNegative = 2.5  # of the range, beside the margin
    reference_sigma_m: Positive = 0.015  # a beam with this noise or less counts fully
    max_score: Positive = 10.0  # so many beams through a cell remove it, however long it was marked
    min_scans: int = 8
    min_age_s: Positive = 3.6  # longer than a person who stops for three seconds covers a cell
    came_age_s: Positive = 20.0  # where it was empty before: what comes is taken for a person for so long
    passing_s: NonNegative = 1.2  # longer than somebody who walks at 0.5 m/s covers a cell
    min_view_gap_m: Positive = 0.5
    min_cells: int = 4  # cells that fulfil all three conditions
    merge_gap_m: Positive = 0.05
    join_gap_m: NonNegative = 0.10  # a gap between two boxes that are one, unless a beam went through it
    free_range_m: Positive = 3.0  # as far as beams tell of free space to the width of a gap
    free_margin_m: NonNegative = 0.06  # from a box's sides, where noise of range and pose leave doubts
    hysteresis_m: NonNegative = 0.021  # smallest change of a side; one cell is noise
    trim: NonNegative = 0.02  # share of the evidence beyond each side of a box
    max_pose_sigma_m: Positive = 0.15  # a pose that is known less well is not mapped with
    max_heading_sigma_rad: Positive = 0.07


@dataclass(eq=False)
class _Cells:
    """The marked cells, sorted by their keys; one row of every array a cell."""

    keys: npt.NDArray[np.int64]
    score: FloatArray  # evidence for minus evidence against, at most max_score
    scans: FloatArray
    first_stamp: FloatArray
    last_stamp: FloatArray
    # Time of the last beam that went through: whoever comes where somebody has just left does not stand there for long.
    since_stamp: FloatArray
    since_view: FloatArray  # (K, 2), where the robot was then
    apart: npt.NDArray[np.bool_]  # seen since then from places far enough apart
    came: npt.NDArray[np.bool_]  # the place had been seen empty before

    @classmethod
    def fresh(
        cls,
        keys: npt.NDArray[np.int64],
        score: FloatArray,
        stamp: float,
        view: FloatArray,
        came: npt.NDArray[np.bool_] | None = None,
    ) -> _Cells:
        n = len(keys)
        stamps, views, no = np.full(n, stamp), np.tile(view, (n, 1)), np.zeros(n, dtype=bool)
        came = no.copy() if came is None else came
        return cls(keys, score, np.ones(n), stamps, stamps.copy(), stamps.copy(), views, no, came)

    def select(self, chosen: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> _Cells:
        return _Cells(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def joined(self, other: _Cells) -> _Cells:
        both = [np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.__dataclass_fields__]
        order = np.argsort(both[0], kind="stable")
        return _Cells(*(array[order] for array in both))

    def find(self, keys: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Row of each key and whether it is there."""
        at = np.minimum(np.searchsorted(self.keys, keys), max(len(self.keys) - 1, 0))
        return at, (self.keys[at] == keys) if len(self.keys) else np.zeros(len(keys), dtype=bool)


class NewObstacleMapper:
    """Finds, refines and removes axis-aligned boxes that a static map does not have."""

    def __init__(self, grid: OccupancyGrid, parameters: MappingParameters) -> None:
        self._grid, self._parameters = grid, parameters
        # From a wall's face, which is half a cell before the centres of its cells.
        self._to_wall = distance_to(grid.occupied, grid.resolution)
        self._to_wall -= np.float32(grid.resolution / 2)
        self._free = np.equal(grid.data, FREE)
        self._cells = _Cells.fresh(np.zeros(0, dtype=np.int64), np.zeros(0), 0.0, np.zeros(2))
        p = parameters
        self._seen_through = SeenThrough(grid, p.laser, p.free_range_m, 2.0 * p.cell_m)
        self._boxes: tuple[Obstacle, ...] = ()
        self._given: dict[str, Obstacle] = {}  # handed over, and not seen by this robot yet
        self._names = 0

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The boxes in ``map``, in the order in which they were found; a box keeps its id while it is refined.

        The same tuple until a box comes, goes or changes by more than noise.
        """
        return self._boxes

    def update(
        self,
        scan: LaserScan,
        pose_estimate: PoseEstimate,
        T_base_laser: Pose2D,
        ignore: Sequence[tuple[Pose2D, float]] = (),
    ) -> bool:
        """Take in a scan.

        Args:
            scan: the scan.
            pose_estimate: the robot's pose when the scan was taken.
            T_base_laser: the laser's mount.
            ignore: places (pose in ``map``, radius in m) of other robots, which are no obstacles.

        Returns:
            Whether the scan was used; not so when the pose is too uncertain to map by.

        Raises:
            SensorDataError: the scan is senseless; nothing has changed then.
        """
        check_scan(scan)
        p, covariance = self._parameters, pose_estimate.covariance
        if covariance[0, 0] + covariance[1, 1] > p.max_pose_sigma_m**2 or covariance[2, 2] > p.max_heading_sigma_rad**2:
            return False
        pose = pose_estimate.pose
        T_map_laser = compose(pose, T_base_laser)
        view = np.array([pose.x, pose.y])
        self._wear_off(scan, T_map_laser, view)
        ends = end_points(scan, T_base_laser, p.max_range_m)
        points, sigma = transform_points(pose, ends.points), p.laser.sigma(ends.ranges)
        self._seen_through.look(scan, T_map_laser, points)
        new = self._away_from_walls(points, sigma, ignore)
        self._mark(points[new], sigma[new], scan.stamp, view)
        self._cells = self._cells.select(self._cells.score > 0.0)
        self._find_boxes()
        return True

    def add(self, obstacles: Iterable[Obstacle]) -> None:
        """Take over boxes from another robot, as often as they come. A box that this robot has seen itself stays."""
        for theirs in obstacles:
            known = [mine for mine in self._boxes if _touch(mine, theirs, self._parameters.join_gap_m)]
            if any(mine.id not in self._given for mine in known):
                continue
            for mine in known:
                self._drop(mine)
            name = known[0].id if known else theirs.id
            if name in {mine.id for mine in self._boxes}:
                name = self._new_name()
            box = Obstacle(name, theirs.x, theirs.y, theirs.w, theirs.b)
            self._given[name] = box
            self._boxes = (*self._boxes, box)
            keys = self._inside(box)
            cells = _Cells.fresh(keys, np.full(len(keys), self._parameters.max_score / 2), 0.0, np.zeros(2))
            cells.scans[:] = 0.0  # not of its own
            self._cells = self._cells.select(~np.isin(self._cells.keys, keys)).joined(cells)

    def _wear_off(self, scan: LaserScan, T_map_laser: Pose2D, view: FloatArray) -> None:
        """Take evidence and age from the marked cells that a beam passed through."""
        p = self._parameters
        centres = self._centres(self._cells.keys)
        passed, range_m = passed_through(scan, T_map_laser, centres, p.laser, 2.0 * p.cell_m)
        passed &= range_m < p.max_range_m
        cells = self._cells
        cells.score[passed] -= self._weight(p.laser.sigma(range_m[passed]))
        cells.since_stamp[passed], cells.since_view[passed], cells.apart[passed] = scan.stamp, view, False

    def _away_from_walls(
        self, points: FloatArray, sigma: FloatArray, ignore: Sequence[tuple[Pose2D, float]]
    ) -> npt.NDArray[np.bool_]:
        """Mask (N,) of the points (N, 2) that lie in free space of the map, and on no known robot."""
        p = self._parameters
        cells = self._grid.world_to_cell(points)
        away = self._grid.in_bounds(cells)
        rows, columns = np.where(away[:, None], cells, 0).T
        away &= self._free[rows, columns] & (self._to_wall[rows, columns] > p.wall_margin_m + p.margin_sigmas * sigma)
        for robot, radius_m in ignore:
            away &= np.hypot(points[:, 0] - robot.x, points[:, 1] - robot.y) > radius_m + p.robot_margin_m
        return away

    def _mark(self, points: FloatArray, sigma: FloatArray, stamp: float, view: FloatArray) -> None:
        """Give evidence to the cells in which end points (N, 2) lie: once a scan, by the best point of each cell."""
        keys, first = np.unique(self._keys(points), return_inverse=True)
        weight = np.zeros(len(keys))
        np.maximum.at(weight, first, self._weight(sigma))
        at, known = self._cells.find(keys)
        cells, rows = self._cells, at[known]
        cells.score[rows] = np.minimum(cells.score[rows] + weight[known], self._parameters.max_score)
        fresh = cells.scans[rows] == 0
        for stamps in (cells.first_stamp, cells.since_stamp):
            stamps[rows[fresh]] = stamp
        cells.since_view[rows[fresh]] = view
        cells.scans[rows] += 1
        cells.last_stamp[rows] = stamp
        moved_m = np.hypot(*(cells.since_view[rows] - view).T)
        cells.apart[rows] |= moved_m >= self._parameters.min_view_gap_m
        came = self._seen_through.ever(self._centres(keys[~known]))
        self._cells = cells.joined(_Cells.fresh(keys[~known], weight[~known], stamp, view, came))

    def _find_boxes(self) -> None:
        p = self._parameters
        # A person who walks past a box is no part of it.
        passing = self._cells.last_stamp - self._cells.first_stamp < p.passing_s
        cells = self._cells.select(~passing | (self._cells.scans == 0))
        centres = self._centres(cells.keys)
        age_s = cells.last_stamp - cells.since_stamp
        sure = (cells.scans >= p.min_scans) & (age_s >= np.where(cells.came, p.came_age_s, p.min_age_s)) & cells.apart
        boxes: dict[str, Obstacle] = {}
        for group, box in self._joined(cells, centres):
            own = bool(sure[group].sum() >= p.min_cells)
            known = [old for old in self._boxes if old.id not in boxes and _touch(old, box, 0.0)]
            known.sort(key=lambda old: distance(_centre(old), _centre(box)))
            if not own and (not known or len(group) < p.min_cells):
                continue
            given = next((old for old in known if old.id in self._given), None)
            if given is not None and not own:
                boxes[given.id] = given
                continue
            name = known[0].id if known else self._new_name()
            mine = bool(known) and known[0].id not in self._given
            steady = mine and _change(known[0], box) <= p.hysteresis_m
            boxes[name] = known[0] if steady else Obstacle(name, box.x, box.y, box.w, box.b)
        self._given = {name: box for name, box in self._given.items() if boxes.get(name) is box}
        order = {box.id: k for k, box in enumerate(self._boxes)}
        found = tuple(sorted(boxes.values(), key=lambda box: order.get(box.id, len(order))))
        self._boxes = self._boxes if found == self._boxes else found

    def _joined(self, cells: _Cells, centres: FloatArray) -> list[tuple[npt.NDArray[np.int64], Obstacle]]:
        """Rows and box of the cells of each thing, the largest first.

        The laser sees pieces of one thing: a side now, a side later, and never what stands behind. Clusters close
        together are pieces of one box unless a beam went through that box since they appeared.
        """
        p = self._parameters
        done: list[tuple[npt.NDArray[np.int64], Obstacle]] = []
        waiting = sorted(self._clusters(centres), key=len)
        while waiting:
            group = waiting.pop()
            box = self._box(centres[group], cells.score[group])
            for k, (other, its) in enumerate(done):
                if not _touch(box, its, p.join_gap_m):
                    continue
                both = np.concatenate([other, group])
                union = self._box(centres[both], cells.score[both])
                since = max(cells.first_stamp[piece].min() for piece in (other, group))
                if not self._seen_through.crosses(union, p.free_margin_m, since):
                    del done[k]
                    waiting.append(both)
                    break
            else:
                done.append((group, box))
        things = [(group, self._up_to_walls(box, float(cells.first_stamp[group].min()))) for group, box in done]
        return sorted(things, key=lambda thing: len(thing[0]), reverse=True)

    def _up_to_walls(self, box: Obstacle, since: float) -> Obstacle:
        """A box with the sides that stand at a wall moved there: its last bit counted as the wall's end points."""
        p = self._parameters
        cut_m = p.wall_margin_m + p.margin_sigmas * float(p.laser.sigma(np.array(p.free_range_m)))
        corners = np.array([[box.x, box.y], [box.x + box.w, box.y + box.b]])
        for axis, end in itertools.product((0, 1), (0, 1)):
            out = (2 * end - 1) * np.eye(2)[axis]
            to_wall = self._to_wall_along(corners, axis, end, out)
            if not 0.0 < to_wall <= cut_m:
                continue
            moved, gap = corners.copy(), corners.copy()
            moved[end] += to_wall * out
            gap[end], gap[1 - end, axis] = moved[end], corners[end, axis]
            if not self._seen_through.crosses(_between(gap), p.free_margin_m, since):
                corners = moved
        return _between(corners)

    def _to_wall_along(self, corners: FloatArray, axis: int, end: int, out: FloatArray) -> float:
        """Distance in m of the wall that runs all along one side of a box, in the direction ``out``; inf without."""
        shares = np.linspace(0.1, 0.9, 9)[:, None]
        points = corners[0] + shares * (corners[1] - corners[0])
        points[:, axis] = corners[end, axis]
        cells = self._grid.world_to_cell(points)
        if not self._grid.in_bounds(cells).all():
            return math.inf
        faces = self._grid.cell_to_world(cells) + self._to_wall[tuple(cells.T)][:, None] * out
        behind = self._grid.world_to_cell(faces + self._grid.resolution / 2 * out)
        if not (self._grid.in_bounds(behind).all() and (self._to_wall[tuple(behind.T)] < 0.0).all()):
            return math.inf
        return float(np.median((faces - points) @ out))

    def _clusters(self, centres: FloatArray) -> list[npt.NDArray[np.int64]]:
        """Rows of the cells (K, 2) of each cluster; clusters are further apart than ``merge_gap_m``."""
        if not len(centres):
            return []
        coarse = np.floor(centres / self._parameters.merge_gap_m).astype(np.int64)
        coarse -= coarse.min(axis=0)
        image = np.zeros(coarse.max(axis=0) + 1, dtype=np.uint8)
        image[tuple(coarse.T)] = 1
        _, labels = cv2.connectedComponents(image, connectivity=8)
        number = labels[tuple(coarse.T)]
        order = np.argsort(number, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)

    def _box(self, centres: FloatArray, score: FloatArray) -> Obstacle:
        """The extent of the evidence, without its outermost shares, as a box without a name."""
        trim, sides = self._parameters.trim, []
        for values in centres.T:
            order = np.argsort(values)
            share = np.cumsum(score[order])
            low, high = np.searchsorted(share, [trim * share[-1], (1.0 - trim) * share[-1]])
            # Centres, not edges, of the cells: noise leaves marks on both sides of a face.
            sides.append((float(values[order[low]]), float(values[order[min(high, len(order) - 1)]])))
        return _between(np.array(sides).T)

    def _weight(self, sigma: FloatArray) -> FloatArray:
        return np.minimum(1.0, (self._parameters.reference_sigma_m / sigma) ** 2)

    def _keys(self, points: FloatArray) -> npt.NDArray[np.int64]:
        cells = np.floor(points / self._parameters.cell_m).astype(np.int64)
        keys: npt.NDArray[np.int64] = cells[:, 0] * _STRIDE + cells[:, 1] + _HALF
        return keys

    def _centres(self, keys: npt.NDArray[np.int64]) -> FloatArray:
        column, row = np.divmod(keys, _STRIDE)
        return (np.column_stack([column, row - _HALF]) + 0.5) * self._parameters.cell_m

    def _inside(self, box: Obstacle) -> npt.NDArray[np.int64]:
        """Keys of the cells whose centres lie in a box, sorted; at least one."""
        cell = self._parameters.cell_m
        x = np.arange(box.x + cell / 2, box.x + box.w, cell) if box.w > cell else np.array([box.x + box.w / 2])
        y = np.arange(box.y + cell / 2, box.y + box.b, cell) if box.b > cell else np.array([box.y + box.b / 2])
        return np.unique(self._keys(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)))

    def _drop(self, box: Obstacle) -> None:
        self._boxes = tuple(other for other in self._boxes if other is not box)
        self._given.pop(box.id, None)
        self._cells = self._cells.select(~np.isin(self._cells.keys, self._inside(box)))

    def _new_name(self) -> str:
        taken = {box.id for box in self._boxes}
        while True:
            self._names += 1
            if f"obs{self._names}" not in taken:
                return f"obs{self._names}"


def _centre(box: Obstacle) -> Pose2D:
    return Pose2D(box.x + box.w / 2, box.y + box.b / 2)


def _between(corners: FloatArray) -> Obstacle:
    """A box without a name, from its corners (2, 2); to a tenth of a millimetre, as messages are for people too."""
    return Obstacle("", *np.round([*corners[0], *(corners[1] - corners[0])], 4).tolist())


def _touch(a: Obstacle, b: Obstacle, gap_m: float) -> bool:
    """Whether two boxes overlap or are no further apart than the gap."""
    return max(a.x, b.x) <= min(a.x + a.w, b.x + b.w) + gap_m and max(a.y, b.y) <= min(a.y + a.b, b.y + b.b) + gap_m


def _change(a: Obstacle, b: Obstacle) -> float:
    """By how much in m the side that differs most differs."""
    return max(abs(a.x - b.x), abs(a.y - b.y), abs(a.x + a.w - b.x - b.w), abs(a.y + a.b - b.y - b.b))
