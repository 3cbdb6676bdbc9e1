"""Localizes the robot in its map and keeps that map up to date (modules LZN and MAP of P17 Fig. 8)."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from hitchhike_ros.core.datatypes import (
    FloatArray,
    LaserScan,
    NonNegative,
    Obstacle,
    Odometry,
    Pose2D,
    PoseEstimate,
    Positive,
    UnitInterval,
)
from hitchhike_ros.core.errors import HitchhikeError, SensorDataError, StaleInputError
from hitchhike_ros.core.geometry import compose, inverse
from hitchhike_ros.core.robot_model import LaserMount
from hitchhike_ros.localization.ekf import check_gaussian
from hitchhike_ros.localization.localizer import Localizer, LocalizerParameters
from hitchhike_ros.localization.methods import Method, make_localizer
from hitchhike_ros.localization.particle_localizer import ParticleLocalizer
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.laser import ScanParameters, check_scan
from hitchhike_ros.mapping.new_obstacles import MappingParameters, NewObstacleMapper
from hitchhike_ros.modules.inputs import FoundObstacles, HandedOverObstacles, InitialPose
from hitchhike_ros.modules.module import Health, Level, Order, Orders, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.protocol.observations import Observations
from hitchhike_ros.protocol.status import Status

# A robot stands when it is slower than this, in m/s and rad/s (chosen).
_STANDS = 1e-3
_BAD: dict[type, str] = {
    Odometry: "bad_odometry",
    LaserScan: "bad_scans",
    Observations: "bad_observations",
    InitialPose: "bad_initialpose",
    HandedOverObstacles: "bad_new_obstacles",
}
# What is taken while localization is off too.
_ALWAYS = frozenset({InitialPose, HandedOverObstacles})


@dataclass(frozen=True)
class SlamParameters:
    """Section ``slam``; all values are chosen."""

    scan_timeout_s: Positive = 0.3
    """Without a scan for longer than this, the module says so,"""
    watch_period_s: Positive = 0.1
    """and says it anew so often."""
    min_explained: UnitInterval = 0.5
    """A scan of which less than this share lies on walls of the map contradicts the pose (where the pose is right it is
    above 0.9 in the simulated corridor, with the pose 1.6 or 3 m off below 0.5). Nothing is mapped from it."""
    min_returns: UnitInterval = 0.3
    """So does a scan that cannot be laid on the map at all, if this share of its beams has a return; with fewer it
    shows too little."""
    contradicted_s: Positive = 2.0
    """Scans that contradict the pose for so long are an error."""
    map_period_s: Positive = 1.0
    """The map is large and boxes grow with every scan: changes are told no more often."""
    transform_tolerance_s: NonNegative = 0.1
    """``T_map_odom`` is told for each scan, and holds for so long after it was taken, as of amcl: a pose of the moment
    of a scan can be looked up as soon as the next scan is there, also while the robot stands."""
    repeat_period_s: Positive = 0.5
    """While localization is off, the last ``T_map_odom`` is told so often,"""
    repeat_holds_s: Positive = 1.0
    """and holds for so long: whoever looks on sees the robot go on by its wheels."""
    rest_scan_period_s: Positive = 2.35
    """Of a robot that stands, has no goal and knows its pose, a scan that was taken sooner than this after the last one
    that was worked on is left out: what appears beside it goes into its map so much later."""
    rest_pose_period_s: Positive = 0.75
    """Meanwhile its pose is told so often: nobody waits longer than a second for one."""


@dataclass(frozen=True, kw_only=True)
class SlamOutputs(Outputs):
    """What scans, or other inputs, give.

    ``T_map_odom`` has the time until which it holds; ``particles`` (N, 3) are those of ``pose``. ``odom_frame`` is what
    the newest odometry calls its frame.
    """

    pose: PoseEstimate | None = None
    T_map_odom: tuple[float, Pose2D] | None = None
    odom_frame: str = ""
    particles: FloatArray | None = None
    grid: OccupancyGrid | None = None
    boxes: FoundObstacles | None = None


class Slam:
    """Steps a localizer and a mapper with what has arrived, in the order in which it came."""

    name: ClassVar[str] = "slam"
    inputs: ClassVar[frozenset[type]] = frozenset(_BAD)
    patient: ClassVar[frozenset[type]] = frozenset({Odometry, Observations})  # a filter takes them at its own time

    def __init__(
        self,
        params: SlamParameters,
        localizer: Localizer,
        mapper: NewObstacleMapper,
        grid: OccupancyGrid,
        T_base_laser: Pose2D,
        *,
        alone: bool = False,
        scan_params: ScanParameters | None = None,
        upside_down: bool = False,
    ) -> None:
        """A module that is off until the status says otherwise; ``alone`` it is on, whatever the status.

        Args:
            params: periods and timeouts.
            localizer: has no estimate yet.
            mapper: of the same grid.
            grid: the original map.
            T_base_laser: the laser's mount, as if it stood upright.
            alone: whether it works without a status.
            scan_params: which scans are used.
            upside_down: whether the laser is.
        """
        self._upside_down = upside_down
        self._scan_params = scan_params or ScanParameters()
        self._bad_share = 0.0  # of the newest scan's beams
        self._params, self._localizer, self._mapper = params, localizer, mapper
        self._grid, self._T_base_laser, self._alone = grid, T_base_laser, alone
        self._orders = Orders(Status(0.0, "") if alone else None)
        self._arrived: deque[object] = deque()
        self._asked = True  # whether the next step is to be taken at once
        self._on = False
        self._known: PoseEstimate | None = None  # where localization starts when it is switched on
        self._pose_problem = ""  # of the newest initial pose, while there is no other
        self._odometry_problem = ""
        self._stands = False
        self._settled = False  # whether a scan of the robot as it stands gave a pose
        self._worked_at = self._told_at = -math.inf  # stamps of scans
        self._contradicted_since = math.inf  # by all scans that were worked on
        self._scanned_at = self._watched_at = self._repeated_at = self._stepped_at = -math.inf
        self._T_map_odom: Pose2D | None = None
        self._odom_frame = ""  # as the driver of the base calls it
        self._mapped: tuple[Obstacle, ...] | None = None  # the boxes that were told last,
        self._mapped_at = -math.inf  # and when
        self._counters: Counter[str] = Counter()
        self._health = Health(Level.OK, "off")

    @classmethod
    def build(cls, files: RobotFiles, *, method: Method = "ekf", alone: bool = False) -> Slam:
        """The module of the robot that ``files`` describe.

        Args:
            files: the sections ``slam``, ``localization`` and ``mapping``, the laser's mount, the markers and the map.
            method: how to localize, :data:`.localization.methods.Method`.
            alone: whether it works without a status.

        Raises:
            ParameterError: a parameter is of no use.
            HitchhikeError: a file cannot be used, or there is no map.
        """
        params = files.load(SlamParameters, "slam")
        localization = files.load(LocalizerParameters, "localization")
        mapping = files.load(MappingParameters, "mapping")
        markers, laser = files.sites.markers, LaserMount.of(files.mount("laser"))
        grid = files.grid  # last, as it may have to be awaited
        localizer = make_localizer(method, grid, markers, localization, laser.pose)
        scan_params = files.load(ScanParameters, "scan")
        mapper = NewObstacleMapper(grid, mapping)
        return cls(
            params,
            localizer,
            mapper,
            grid,
            laser.pose,
            alone=alone,
            scan_params=scan_params,
            upside_down=laser.upside_down,
        )

    # What arrives.

    def listens(self) -> frozenset[type]:
        """While localization is off, only to what is told of pose and map."""
        status = self._orders.newest()
        on = status is not None and status.modules.LZN
        return self.inputs if on else _ALWAYS

    def sense(self, x: object, now: float) -> None:
        """Store an input; all but odometry and markers make a step due."""
        what = x.what if isinstance(x, Refused) else type(x)
        if what in self.listens():
            self._arrived.append(x)
            self._asked = self._asked or what not in self.patient

    def order(self, order: Order, now: float) -> None:
        """The status says whether localization and mapping are on, whether there is a goal, and where others are."""
        if isinstance(order, Status):
            self._orders.put(order, now)
            self._arrived.append(order)
            self._asked = True

    # What is asked.

    @property
    def can_globalize(self) -> bool:
        """Whether the method can look for the robot everywhere."""
        return isinstance(self._localizer, ParticleLocalizer)

    def globalize(self) -> None:
        """Forget where the robot is: it may be anywhere.

        Raises:
            HitchhikeError: localization is off, or its method cannot do that.
        """
        if not (self._on and isinstance(self._localizer, ParticleLocalizer)):
            raise HitchhikeError("localization is off" if self.can_globalize else "the method has no particles")
        self._settled = False
        self._localizer.globalize()

    # What comes of it.

    def next_due(self, now: float) -> float:
        """At once for what has arrived; on, when scans stay away; off, when ``T_map_odom`` is to be told again."""
        if self._asked or now < self._stepped_at:
            return now
        if self._on:
            return self._silent_from()
        return math.inf if self._T_map_odom is None else self._repeated_at + self._params.repeat_period_s

    def step(self, now: float) -> SlamOutputs:
        """Take all that has arrived, in turn."""
        if now < self._stepped_at:  # time has jumped back
            self._contradicted_since = now if math.isfinite(self._contradicted_since) else math.inf
            self._scanned_at, self._watched_at, self._repeated_at, self._mapped_at = (
                min(at, now) for at in (self._scanned_at, self._watched_at, self._repeated_at, self._mapped_at)
            )
        arrived, self._arrived, self._asked, self._stepped_at = self._arrived, deque(), False, now
        said: dict[str, Any] = {}
        if self._alone:
            self._switch(on=True, now=now)
        if self._mapped is None:
            self._tell_map(now, said)
        for x in arrived:
            self._take(x, now, said)
        if self._on and now >= self._silent_from():
            self._watched_at, self._settled = now, False
            self._say(Level.ERROR, f"no scan for {now - self._scanned_at:.1f} s")
        elif not self._on and self._T_map_odom and now >= self._repeated_at + self._params.repeat_period_s:
            self._repeated_at = now
            said["T_map_odom"] = (now + self._params.repeat_holds_s, self._T_map_odom)
        beams = {"bad_beam_share": round(self._bad_share, 3)} if self._on and self._bad_share else {}
        health = replace(self._health, counters={**self._health.counters, **self._counters, **beams})
        return SlamOutputs(health=health, odom_frame=self._odom_frame, **said)

    def _silent_from(self) -> float:
        """When the next is to be said of scans that do not come."""
        p = self._params
        return max(self._scanned_at + p.scan_timeout_s, self._watched_at + p.watch_period_s)

    def _take(self, x: object, now: float, said: dict[str, Any]) -> None:
        match x:
            case Status():
                self._switch(on=x.modules.LZN, now=now)
            case InitialPose():
                self._start_from(x.estimate)
            case HandedOverObstacles():
                self._mapper.add(x.obstacles)
                if self._mapper.obstacles != self._mapped:
                    self._tell_map(now, said)
            case Odometry() if self._on:
                self._move(x)
            case Observations() if self._on:
                self._see(x)
            case LaserScan() if self._on:
                self._scanned_at, said["answered"], self._bad_share = now, x.stamp, x.bad_share()
                self._work_on(x.mirrored() if self._upside_down else x, now, said)
                if self._T_map_odom is not None:
                    said["T_map_odom"] = x.stamp + self._params.transform_tolerance_s, self._T_map_odom
            case Refused() if self._on or x.what in _ALWAYS:
                if x.what is LaserScan:
                    self._scanned_at, said["answered"] = now, x.stamp
                self._refuse(x.what, x.reason)

    def _refuse(self, what: type, reason: str) -> None:
        self._counters[_BAD[what]] += 1
        if what is Odometry:
            # Where the robot went meanwhile is not known: no scan is worked on before usable odometry comes.
            self._odometry_problem, self._settled = reason, False
        elif what is LaserScan:
            self._settled = False
            self._say(Level.ERROR, reason)
        elif what is InitialPose:
            self._pose_problem = reason
            self._say(Level.WARN, f"initialpose refused: {reason}")

    # Where it starts.

    def _switch(self, *, on: bool, now: float) -> None:
        if on == self._on:
            return
        self._on = on
        if not on:
            if self._localizer.initialised:
                self._known = self._localizer.estimate
            self._repeated_at = -math.inf  # what was told with the last scan holds no longer
            self._say(Level.OK, "off")
            return
        self._bad_share = 0.0
        # Odometry from before the pause says nothing about the way since: the filter starts anew.
        self._localizer.restart()
        self._odometry_problem, self._stands, self._settled = "", False, False
        self._scanned_at, self._contradicted_since = now, math.inf
        self._say(Level.OK, "waiting for scans")
        if self._known is not None:
            self._localizer.initialise(self._known)
            self._known = None

    def _start_from(self, estimate: PoseEstimate) -> None:
        """Take up a pose that is known otherwise; what is none is refused before it gets into a filter."""
        try:
            check_gaussian(estimate.pose, estimate.covariance)
        except ValueError as exc:
            self._refuse(InitialPose, str(exc))
            return
        self._pose_problem, self._settled = "", False
        if self._on:
            self._localizer.initialise(estimate)
        else:
            self._known = estimate
            self._say(Level.OK, "off")

    # Localizing.

    def _move(self, odometry: Odometry) -> None:
        try:
            self._localizer.predict(odometry)
        except SensorDataError as exc:
            self._refuse(Odometry, str(exc))
            return
        self._odometry_problem, self._odom_frame = "", odometry.frame_id
        twist = self._localizer.twist
        self._stands = max(abs(twist.v), abs(twist.omega)) <= _STANDS
        self._settled = self._settled and self._stands

    def _see(self, observations: Observations) -> None:
        if not self._localizer.initialised:
            return
        try:
            self._localizer.update_markers(observations.markers)
        except SensorDataError as exc:
            self._refuse(Observations, str(exc))

    def _work_on(self, scan: LaserScan, now: float, said: dict[str, Any]) -> None:
        """Localize and map by a scan, or leave it out."""
        try:
            if self._odometry_problem:
                raise SensorDataError(self._odometry_problem)
            if not self._localizer.initialised:
                why = f": the one that was told is refused: {self._pose_problem}" if self._pose_problem else ""
                self._say(Level.WARN, f"no initial pose yet{why}")
                return
            if self._may_leave_out(scan.stamp, now):
                if scan.stamp - self._told_at >= self._params.rest_pose_period_s:
                    self._tell_pose(self._localizer.estimate_at(scan.stamp), said)
                return
            check_scan(scan, self._scan_params.max_bad_share)
            used = self._localizer.update_scan(scan)
            estimate = self._localizer.estimate_at(scan.stamp)
            self._tell_pose(estimate, said)
            contradicts = self._contradicts(scan, used=used)
            self._contradicted_since = min(self._contradicted_since, now) if contradicts else math.inf
            self._settled, self._worked_at = self._stands and not contradicts, scan.stamp
            if not contradicts:
                self._map(scan, estimate, now, said)
        except SensorDataError as exc:
            self._refuse(LaserScan, str(exc))
            return
        self._say_how(now, used=used)

    def _contradicts(self, scan: LaserScan, *, used: bool) -> bool:
        """Whether a scan shows walls where the map has none, seen from the pose."""
        p, explained = self._params, self._localizer.explained
        if used:
            return explained is not None and explained < p.min_explained
        return bool(np.isfinite(scan.ranges).mean() >= p.min_returns)

    def _may_leave_out(self, stamp: float, now: float) -> bool:
        """Whether a scan need not be worked on, of a robot that stands, has nowhere to go and knows its pose."""
        status = self._orders.get(now)
        rests = self._settled and not self._alone and status is not None and status.goal is None
        return rests and 0.0 <= stamp - self._worked_at < self._params.rest_scan_period_s

    def _tell_pose(self, estimate: PoseEstimate, said: dict[str, Any]) -> None:
        self._T_map_odom = compose(estimate.pose, inverse(self._localizer.odometry_at(estimate.stamp)))
        self._told_at = estimate.stamp
        said["pose"] = estimate
        if isinstance(self._localizer, ParticleLocalizer):
            said["particles"] = self._localizer.particles

    def _say_how(self, now: float, *, used: bool) -> None:
        explained = self._localizer.explained
        values = {} if explained is None else {"explained": round(explained, 2)}
        stale = ""
        try:
            self._orders.at(now)
        except StaleInputError as exc:
            stale = str(exc)
        if math.isfinite(self._contradicted_since):
            long = now - self._contradicted_since >= self._params.contradicted_s
            share = "none" if explained is None else f"{explained:.0%}"
            expected = f"{self._params.min_explained:.0%}"
            text = f"scans contradict the pose: {share} of them lies on walls of the map, expected {expected}"
            self._say(Level.ERROR if long else Level.WARN, text, **values)
        elif not used:
            self._say(Level.WARN, "the scan shows too little of the map", **values)
        elif stale:
            self._say(Level.WARN, f"localizing, but {stale}", **values)
        else:
            self._say(Level.OK, "localizing", **values)

    # Mapping.

    def _map(self, scan: LaserScan, estimate: PoseEstimate, now: float, said: dict[str, Any]) -> None:
        newest = self._orders.newest()
        if newest is None or not newest.modules.MAP:
            return
        status = self._orders.get(now)  # where others were a while ago says nothing
        others = [] if status is None else [(Pose2D(robot.x, robot.y), robot.radius_m) for robot in status.robots]
        self._mapper.update(scan, estimate, self._T_base_laser, others)
        if self._mapper.obstacles != self._mapped and now - self._mapped_at >= self._params.map_period_s:
            self._tell_map(now, said)

    def _tell_map(self, now: float, said: dict[str, Any]) -> None:
        self._mapped, self._mapped_at = self._mapper.obstacles, now
        said["boxes"] = FoundObstacles(self._mapper.obstacles)
        said["grid"] = self._grid.with_obstacles(self._mapper.obstacles)

    def _say(self, level: Level, reason: str, **values: object) -> None:
        self._health = Health(level, reason, values)
