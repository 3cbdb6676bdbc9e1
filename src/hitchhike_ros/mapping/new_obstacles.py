"""New static boxes: what the laser sees where the static map has nothing.

End points far from every wall of the map are counted in cells. What was hit often enough, long enough and from places
far enough apart stands there; people and driving robots leave their cells before. A cluster of such cells becomes a
box, and from then on the beams around it say where its sides are (:mod:`hitchhike_ros.mapping.box_fit`). A box that
beams pass through is gone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.datatypes import FloatArray, LaserScan, NonNegative, Obstacle, Pose2D, PoseEstimate, Positive
from hitchhike_ros.mapping.beams import Beams, beams_in_map
from hitchhike_ros.mapping.box_fit import View, sweep, view_rows
from hitchhike_ros.mapping.grid import UNKNOWN, OccupancyGrid, distance_to
from hitchhike_ros.mapping.hit_evidence import CellKeys, HitEvidence
from hitchhike_ros.mapping.laser import LaserNoise

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class NewObstaclesParameters:
    """Parameters of :class:`NewObstacleMapper` (section ``new_obstacles``); all chosen."""

    laser: LaserNoise = field(default_factory=LaserNoise)
    max_range_m: Positive = 4.0  # farther returns are too vague
    wall_clearance_m: Positive = 0.12  # from a wall of the map, beyond the noise of the return
    clearance_sigmas: NonNegative = 2.0
    robot_clearance_m: NonNegative = 0.15  # around other robots
    min_scans: Positive = 8.0  # hits of a cell before it counts
    min_age_s: Positive = 4.0  # longer than a person stops on the way
    min_baseline_m: NonNegative = 0.3
    max_count: Positive = 30.0  # hits that a cell keeps
    pass_weight: Positive = 2.0  # hits that one beam through a cell takes away
    join_m: Positive = 0.12  # cells nearer than this belong to one box
    min_cells: int = 2
    view_spacing_m: Positive = 0.1  # the robot moves this far between two views of a box
    view_margin_m: Positive = 0.25  # around a box, within which beams tell about it
    max_views: int = 40
    beams_per_view: int = 40
    gone_scans: int = 8  # scans that look through a box before it is gone
    hysteresis_m: Positive = 0.01  # smaller changes are not told
    max_position_sigma_m: Positive = 0.15  # of the pose; a robot that does not know where it is maps nothing
    max_heading_sigma_rad: Positive = 0.06


@dataclass(eq=False)
class _Box:
    """A box under observation: ``bounds`` (4,) least x, y, greatest x, y in ``map``."""

    id: str
    bounds: FloatArray
    handed_over: bool = False
    views: list[View] = field(default_factory=list)
    unsettled: bool = True
    passed_scans: int = 0

    def obstacle(self) -> Obstacle:
        x, y, x2, y2 = (float(v) for v in self.bounds)
        return Obstacle(self.id, round(x, 4), round(y, 4), round(x2 - x, 4), round(y2 - y, 4))


class NewObstacleMapper:
    """Boxes that stand where the static map is free.

    Args:
        grid: the static map.
        params: see :class:`NewObstaclesParameters`.
    """

    def __init__(self, grid: OccupancyGrid, params: NewObstaclesParameters) -> None:
        self._grid, self._params = grid, params
        self._wall_distance = distance_to(grid.occupied, grid.resolution).ravel()
        self._known = np.not_equal(grid.data, UNKNOWN).ravel()
        self._evidence = HitEvidence(params.max_count)
        self._boxes: list[_Box] = []
        self._obstacles: tuple[Obstacle, ...] = ()
        self._discovered = 0

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The boxes known now, oldest first, in ``map``; the same tuple while nothing changed beyond noise."""
        return self._obstacles

    def add(self, obstacles: Iterable[Obstacle]) -> None:
        """Boxes handed over by a driver: kept with the extents that it measured until beams pass through them.

        A box where one is known already takes its place and its id; an id taken by a box elsewhere is replaced.
        """
        for obstacle in obstacles:
            bounds = np.array([obstacle.x, obstacle.y, obstacle.x + obstacle.w, obstacle.y + obstacle.b])
            same = [box for box in self._boxes if _overlap(box.bounds, bounds, 0.0)]
            if same:
                same[0].bounds, same[0].handed_over, same[0].passed_scans = bounds, True, 0
                self._boxes = [box for box in self._boxes if box not in same[1:]]
            else:
                taken = any(box.id == obstacle.id for box in self._boxes)
                name = self._next_id() if taken else obstacle.id
                self._boxes.append(_Box(name, bounds, handed_over=True))
        self._publish()

    def update(
        self,
        scan: LaserScan,
        estimate: PoseEstimate,
        T_base_laser: Pose2D,
        others: Iterable[tuple[Pose2D, float]] = (),
    ) -> None:
        """Take in one scan.

        Args:
            scan: in the laser's frame.
            estimate: pose of ``base_footprint`` in ``map`` when the scan was taken.
            T_base_laser: the laser on the robot.
            others: known robots as pose in ``map`` and radius in m; returns from them are left out.

        Raises:
            SensorDataError: the scan is empty, has senseless angles or NaN ranges.
        """
        params = self._params
        beams, indices = beams_in_map(scan, estimate, T_base_laser, params.laser)
        if not self._pose_is_known(estimate):
            return
        beams, indices = _without_robots(beams, indices, others, params.robot_clearance_m)
        keys = self._cells(beams)
        novel = self._novel(beams, keys)
        self._evidence.add(np.unique(keys[novel]), scan.stamp, beams.origin)
        self._forget_passed(scan, estimate, T_base_laser, beams, indices)
        self._observe_boxes(beams, keys)
        self._discover(beams, keys)
        self._settle_one()
        self._publish()

    def _pose_is_known(self, estimate: PoseEstimate) -> bool:
        variances = np.diag(estimate.covariance)
        position, heading = self._params.max_position_sigma_m, self._params.max_heading_sigma_rad
        return bool(variances[:2].max() <= position**2 and variances[2] <= heading**2)

    def _cells(self, beams: Beams) -> CellKeys:
        """Cell (N,) of each end point as row * width + column, -1 where it is not on the map."""
        cells = np.full(beams.ranges.size, -1, dtype=np.int64)
        hit = np.flatnonzero(np.isfinite(beams.ranges))
        found = self._grid.world_to_cell(beams.points()[hit])
        inside = self._grid.in_bounds(found)
        cells[hit[inside]] = found[inside] @ np.array([self._grid.width, 1])
        return cells

    def _novel(self, beams: Beams, keys: CellKeys) -> BoolArray:
        """Mask (N,) of the end points that no wall of the map explains."""
        params = self._params
        clearance = params.wall_clearance_m + params.clearance_sigmas * beams.sigma
        near = (beams.ranges <= params.max_range_m) & (keys >= 0)
        return near & self._known[keys] & (self._wall_distance[keys] - self._grid.resolution / 2 > clearance)

    def _forget_passed(
        self,
        scan: LaserScan,
        estimate: PoseEstimate,
        T_base_laser: Pose2D,
        beams: Beams,
        indices: npt.NDArray[np.int64],
    ) -> None:
        """Weaken the cells that beams pass through: all three beams around a cell's centre end well behind it."""
        keys = self._evidence.keys
        if not keys.size:
            return
        centres = self._grid.cell_to_world(np.column_stack(np.divmod(keys, self._grid.width)))
        offset = centres - beams.origin
        distance = np.hypot(offset[:, 0], offset[:, 1])
        heading = estimate.pose.theta + T_base_laser.theta + scan.angle_min
        bearing = (np.arctan2(offset[:, 1], offset[:, 0]) - heading) % (2.0 * np.pi)
        beam = np.rint(bearing / scan.angle_increment).astype(np.int64)
        seen = np.zeros(scan.ranges.size + 2)
        seen[indices + 1] = beams.ranges
        clear = np.minimum(np.minimum(seen[:-2], seen[1:-1]), seen[2:])
        on_scan = beam < clear.size
        margin = self._grid.resolution + 3.0 * self._params.laser.sigma(distance)
        passed = on_scan & (clear[np.where(on_scan, beam, 0)] > distance + margin)
        self._evidence.weaken(passed, self._params.pass_weight)

    def _observe_boxes(self, beams: Beams, keys: CellKeys) -> None:
        """Drop boxes that beams pass through, and take a view of the others when the robot has moved."""
        gone = []
        for box in self._boxes:
            distance = _distance(beams.origin, box.bounds)
            if distance > self._params.max_range_m:
                continue
            box.passed_scans = _passed_scans(box, beams)
            if box.passed_scans >= self._params.gone_scans:
                gone.append(box)
            elif not box.handed_over:
                self._take_view(box, beams, keys, distance)
        self._boxes = [box for box in self._boxes if box not in gone]
        if gone:
            self._evidence.keep(~self._cells_near(self._evidence.keys, gone))

    def _take_view(self, box: _Box, beams: Beams, keys: CellKeys, distance: float) -> None:
        """Remember what the beams tell about a box."""
        params = self._params
        if box.views and np.hypot(*(box.views[-1].position - beams.origin)) < params.view_spacing_m:
            return
        margin = params.view_margin_m
        enter, leave = beams.crossing(_grown(box.bounds, margin))
        telling = (enter <= leave) & (leave > 0.0) & (beams.ranges > enter)
        inside = telling & (beams.ranges < leave)
        for other in self._boxes:
            if other is not box and inside.any():
                telling &= ~(inside & _within(beams.points(), _grown(other.bounds, margin / 4)))
        chosen = np.flatnonzero(telling)
        chosen = chosen[:: max(1, -(-chosen.size // params.beams_per_view))]
        if not chosen.size:
            return
        wall = np.maximum(self._wall_distance[keys[chosen]] - self._grid.resolution / 2, 0.0)
        elsewhere = np.where(inside[chosen] & (keys[chosen] >= 0), wall, 0.0)
        rows = view_rows(
            beams.origin,
            beams.directions[chosen],
            np.minimum(beams.ranges[chosen], 100.0),
            beams.sigma[chosen],
            elsewhere,
        )
        box.views.append(View(beams.origin, rows, distance))
        if len(box.views) > params.max_views:
            box.views.remove(max(box.views, key=lambda view: view.distance))
        box.unsettled = True

    def _discover(self, beams: Beams, keys: CellKeys) -> None:
        """Make boxes of the clusters of standing cells that belong to none yet."""
        params = self._params
        standing = self._evidence.standing(params.min_scans, params.min_age_s, params.min_baseline_m)
        standing = standing[~self._cells_near(standing, self._boxes)]
        if standing.size < params.min_cells:
            return
        for cluster in self._clusters(standing):
            if cluster.shape[0] >= params.min_cells:
                centres = self._grid.cell_to_world(cluster)
                half = self._grid.resolution / 2
                bounds = np.concatenate([centres.min(axis=0) - half, centres.max(axis=0) + half])
                box = _Box(self._next_id(), bounds)
                self._boxes.append(box)
                self._take_view(box, beams, keys, _distance(beams.origin, bounds))

    def _clusters(self, keys: CellKeys) -> list[npt.NDArray[np.int64]]:
        """Groups of cells, (n, 2) each as (row, column), whose gaps are smaller than ``join_m``."""
        cells = np.column_stack(np.divmod(keys, self._grid.width))
        reach = int(np.ceil(self._params.join_m / self._grid.resolution / 2))
        local = cells - cells.min(axis=0) + reach
        image = np.zeros(local.max(axis=0) + reach + 1, dtype=np.uint8)
        image[tuple(local.T)] = 1
        _, labels = cv2.connectedComponents(cv2.dilate(image, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)))
        label = labels[tuple(local.T)]
        return [cells[label == value] for value in np.unique(label)]

    def _cells_near(self, keys: CellKeys, boxes: Iterable[_Box]) -> BoolArray:
        """Mask (K,) of the cells within the margin of a box."""
        centres = self._grid.cell_to_world(np.column_stack(np.divmod(keys, self._grid.width)))
        near = np.zeros(keys.size, dtype=bool)
        for box in boxes:
            near |= _within(centres, _grown(box.bounds, self._params.view_margin_m))
        return near

    def _settle_one(self) -> None:
        """Fit the box that waits longest to its views, and merge it with a box that it grew into."""
        box = next((box for box in self._boxes if box.unsettled and box.views), None)
        if box is None:
            return
        fitted = sweep(box.bounds, np.hstack([view.rows for view in box.views]))
        box.unsettled = bool(np.abs(fitted - box.bounds).max() > 1e-6)
        box.bounds = fitted
        self._boxes.remove(box)
        into = next((other for other in self._boxes if _overlap(other.bounds, fitted, 0.0)), None)
        if into is None:
            self._boxes.append(box)
        elif not into.handed_over:
            into.bounds = np.concatenate([np.minimum(into.bounds, fitted)[:2], np.maximum(into.bounds, fitted)[2:]])
            into.views = sorted(into.views + box.views, key=lambda view: view.distance)[: self._params.max_views]
            into.unsettled = True

    def _next_id(self) -> str:
        taken = {box.id for box in self._boxes}
        self._discovered += 1
        while f"obs{self._discovered}" in taken:
            self._discovered += 1
        return f"obs{self._discovered}"

    def _publish(self) -> None:
        """Tell the boxes as they are now, when one came, went, or moved beyond the hysteresis."""
        now = {box.id: box.obstacle() for box in self._boxes}
        told = {obstacle.id: obstacle for obstacle in self._obstacles}
        fresh = [i for i in now if i not in told]
        kept = [i for i in told if i in now]
        limit = self._params.hysteresis_m
        if fresh or len(kept) < len(told) or any(_change(now[i], told[i]) > limit for i in kept):
            self._obstacles = tuple(now[i] for i in kept + fresh)


def _without_robots(
    beams: Beams, indices: npt.NDArray[np.int64], others: Iterable[tuple[Pose2D, float]], clearance_m: float
) -> tuple[Beams, npt.NDArray[np.int64]]:
    """The beams that do not end on another robot, and their indices."""
    kept = np.ones(beams.ranges.size, dtype=bool)
    points = beams.points()
    for pose, radius in others:
        kept &= ~(np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y) < radius + clearance_m)
    if kept.all():
        return beams, indices
    reduced = replace(beams, directions=beams.directions[kept], ranges=beams.ranges[kept], sigma=beams.sigma[kept])
    return reduced, indices[kept]


def _passed_scans(box: _Box, beams: Beams) -> int:
    """How many scans in a row have looked through a box, with this one."""
    size = box.bounds[2:] - box.bounds[:2]
    inset = np.minimum(0.05, 0.3 * size)
    enter, leave = beams.crossing(box.bounds + np.concatenate([inset, -inset]))
    through = (enter <= leave) & (enter > 0.0)
    margin = 0.05 + 3.0 * beams.sigma
    passed = int((through & (beams.ranges > leave + margin)).sum())
    stopped = int((through & (beams.ranges <= leave + margin) & (beams.ranges >= enter - margin)).sum())
    if passed >= 3 and passed > 4 * stopped:
        return box.passed_scans + 1
    return 0 if stopped else box.passed_scans


def _grown(bounds: FloatArray, margin: float) -> FloatArray:
    """Bounds (4,) with ``margin`` in m on every side."""
    return bounds + np.array([-margin, -margin, margin, margin])


def _within(points: FloatArray, bounds: FloatArray) -> BoolArray:
    """Mask (N,) of the points (N, 2) inside bounds (4,)."""
    return ((points >= bounds[:2]) & (points <= bounds[2:])).all(axis=1)


def _overlap(a: FloatArray, b: FloatArray, gap: float) -> bool:
    """Whether two boxes (4,) are nearer than ``gap`` along both axes."""
    return bool((a[:2] < b[2:] + gap).all() and (b[:2] < a[2:] + gap).all())


def _distance(point: FloatArray, bounds: FloatArray) -> float:
    """Distance in m from a point (2,) to a box (4,)."""
    return float(np.hypot(*np.maximum(np.maximum(bounds[:2] - point, point - bounds[2:]), 0.0)))


def _change(a: Obstacle, b: Obstacle) -> float:
    """Greatest difference in m of two boxes' sides."""
    return max(abs(a.x - b.x), abs(a.y - b.y), abs(a.x + a.w - b.x - b.w), abs(a.y + a.b - b.y - b.b))
