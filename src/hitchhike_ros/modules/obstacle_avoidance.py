"""Drives along the plan to the goal, around what the map does not know (module OBS).

One decision for each scan, once the pose of the scan's stamp is there; a later pose is awaited for a moment, then the
last one is carried on by odometry. The robot stands, and the report and the health say why, while a scan, odometry, a
pose or an order is missing, old or senseless, and while there is no plan to its goal.

A human who drives is followed in place of the plan, within the speed limit, gently with a rider behind and never into
an obstacle; the robot stands while the human wants nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hitchhike_ros.control.local_planner import LocalPlanner
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.teleop_authority import TeleopAuthority, TeleopAuthorityParameters
from hitchhike_ros.control.wall_alignment import WallAlignmentParameters, in_line
from hitchhike_ros.control.wheel_watch import WheelWatch
from hitchhike_ros.core.datatypes import LaserScan, Odometry, Pose2D, PoseEstimate, Positive, Side, Twist2D
from hitchhike_ros.core.errors import PlanningError, SensorDataError, TeleopError
from hitchhike_ros.core.geometry import compose, distance, wrap_angle
from hitchhike_ros.core.pose_buffer import PoseBuffer
from hitchhike_ros.core.robot_model import LaserMount, RobotLimits
from hitchhike_ros.mapping.laser import ScanParameters, check_scan
from hitchhike_ros.modules.inputs import NavigationCommand, PlannedPath, TeleopActive, TeleopCommand
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Health, Level, Order, Orders, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.protocol.events import NavigationReport
from hitchhike_ros.protocol.status import GoalCommand, Status

# A plan whose last pose is farther than this from the goal, in m and rad, is to another one.
_SAME_PLACE_M, _SAME_HEADING_RAD = 0.2, 0.02
_STAMP_TOLERANCE_S = 1e-4
_IDLE = NavigationReport("", "idle")
_NO_STATUS = f"no status for {ORDER_MAX_AGE_S} s"
_COUNTERS: dict[type, str] = {
    LaserScan: "bad_scans",
    Odometry: "bad_odometry",
    PoseEstimate: "bad_poses",
    PlannedPath: "bad_plans",
    TeleopCommand: "bad_teleop",
    TeleopActive: "bad_teleop",
}


@dataclass(frozen=True)
class ObstacleAvoidanceParameters(LocalPlannerParameters):
    """Section ``obstacle_avoidance``: those of the local planner and this one."""

    pose_wait_s: Positive = 0.1
    """How long the pose of a scan is awaited (chosen)."""


@dataclass(frozen=True, kw_only=True)
class ObstacleAvoidanceOutputs(Outputs):
    """What the base is to do, and how driving to the goal fares, when that has changed."""

    command: NavigationCommand | None = None
    report: NavigationReport | None = None


class ObstacleAvoidance:
    """Keeps what arrives, and decides for each scan."""

    name: ClassVar[str] = "obstacle_avoidance"
    inputs: ClassVar[frozenset[type]] = frozenset(_COUNTERS)
    patient: ClassVar[frozenset[type]] = frozenset({Odometry})  # it serves the next scan

    def __init__(
        self,
        params: ObstacleAvoidanceParameters,
        wall_params: WallAlignmentParameters,
        teleop_params: TeleopAuthorityParameters,
        limits: RobotLimits,
        T_base_laser: Pose2D,
        scan_params: ScanParameters | None = None,
        *,
        upside_down: bool = False,
    ) -> None:
        self._params, self._wall_params, self._limits = params, wall_params, limits
        self._T_base_laser, self._scan_params = T_base_laser, scan_params or ScanParameters()
        self._upside_down = upside_down
        self._local_planner = LocalPlanner(limits, params, self._scan_params)
        self._teleop_authority = TeleopAuthority(teleop_params)
        self._wheels, self._driven = WheelWatch(), Twist2D()  # and what they were told last
        self._orders = Orders()
        self._refused = dict.fromkeys(_COUNTERS.values(), 0)
        self._status: Status | None = None  # the order that counted at the last step
        self._goal: GoalCommand | None = None  # of the newest order then, which may count no more
        self._report, self._level = _IDLE, Level.OK
        self._command: Twist2D | None = None  # of this step
        self._news = True  # since the last step
        self._stepped_at = -math.inf
        self._forget(-math.inf)

    @classmethod
    def build(cls, files: RobotFiles) -> ObstacleAvoidance:
        """That of the robot that ``files`` describe."""
        laser = LaserMount.of(files.mount("laser"))
        return cls(
            files.load(ObstacleAvoidanceParameters, "obstacle_avoidance"),
            files.load(WallAlignmentParameters, "wall_alignment"),
            files.load(TeleopAuthorityParameters, "teleop_authority"),
            files.load(RobotLimits, "robot"),
            laser.pose,
            files.load(ScanParameters, "scan"),
            upside_down=laser.upside_down,
        )

    def _forget(self, now: float) -> None:
        """What was seen before the module was off says nothing about now."""
        self._plan: PlannedPath | None = None
        self._followed: tuple[str, PlannedPath] | None = None
        self._turns_for = ""  # the order for which it turns along a wall
        self._estimate: PoseEstimate | None = None
        self._odometry = PoseBuffer()
        self._odometry_problem = self._pose_problem = ""
        self._scan: LaserScan | None = None  # no decision has been made on it
        self._decide_by = math.inf  # on a scan that waits for its pose
        self._awaits_poses = True  # one that did not come is not awaited again until one comes
        self._heard_at = now  # of the laser
        self._bad_share = 0.0  # of the beams of its newest scan
        self._stand_because = ""  # of something senseless that has come
        self._answered: float | None = None  # of a scan that was refused

    @property
    def on(self) -> bool:
        """Whether the module is switched on."""
        status = self._orders.newest()
        return status is not None and status.modules.OBS

    def listens(self) -> frozenset[type]:
        """All of its inputs while it is on."""
        return self.inputs if self.on else frozenset()

    def sense(self, x: object, now: float) -> None:
        """Store an input. A scan, or something senseless, wants a step."""
        match x:
            case LaserScan():
                self._take_laser(x, now)
            case PoseEstimate() if x.pose.is_finite():
                self._estimate, self._pose_problem, self._awaits_poses = x, "", True
            case PoseEstimate():
                self._refuse(Refused(PoseEstimate, "pose is not finite"), now)
            case Odometry():
                self._take_odometry(x, now)
            case PlannedPath():
                self._plan = x
            case TeleopCommand():
                if not self._teleop_authority.command(x.twist, now):
                    self._refuse(Refused(TeleopCommand, "not finite"), now)
            case TeleopActive():
                self._teleop_authority.take(x.active, now)
            case Refused():
                self._refuse(x, now)

    def order(self, order: Order, now: float) -> None:
        """The status says whether the module is on, the goal, the speed limit and whether somebody rides."""
        if isinstance(order, Status):
            was_on = self.on
            self._orders.put(order, now)
            self._teleop_authority.hear_status()
            self._news = True
            if self.on != was_on:
                self._forget(now)

    def next_due(self, now: float) -> float:
        """At once on news and on a scan with its pose; when a pose, a scan or an order has not come for too long."""
        if self._news or now < self._stepped_at:
            return now
        due = self._orders.expires() if self._status is not None else math.inf
        if self._goal is None or self._status is None:
            return due if self._scan is None else now
        return min(due, self._decide_at(now), self._heard_at + self._params.max_age_s)

    def step(self, now: float) -> ObstacleAvoidanceOutputs:
        """Decide on the scan, where it is time, or stand because of what has gone wrong or stays away."""
        first, report_before = not math.isfinite(self._stepped_at), self._report
        if now < self._stepped_at:
            self._heard_at = now
            self._decide_by = math.inf if self._scan is None else now
        self._stepped_at, self._news, self._command = now, False, None
        self._take_order(now)
        if self._goal is None or self._status is None:
            self._take_scan()
        else:
            self._decide(self._goal, self._status, now)
        answered, self._answered, self._stand_because = self._answered, None, ""
        return ObstacleAvoidanceOutputs(
            health=self._health(),
            answered=answered,
            command=None if self._command is None else NavigationCommand(self._command),
            report=self._report if first or self._report != report_before else None,
        )

    # What arrives.

    def _take_laser(self, scan: LaserScan, now: float) -> None:
        self._bad_share = scan.bad_share()
        try:
            check_scan(scan, self._scan_params.max_bad_share)
        except SensorDataError as exc:
            self._refuse(Refused(LaserScan, str(exc), stamp=scan.stamp), now)
            return
        self._decide_by = min(self._decide_by, now + self._params.pose_wait_s)
        self._scan, self._heard_at = scan.mirrored() if self._upside_down else scan, now

    def _take_odometry(self, odometry: Odometry, now: float) -> None:
        try:
            self._odometry.add(odometry)
            self._odometry_problem = ""
        except SensorDataError as exc:
            self._refuse(Refused(Odometry, str(exc)), now)

    def _refuse(self, refused: Refused, now: float) -> None:
        """Count what is senseless. What the robot drives by ends with it."""
        self._refused[_COUNTERS[refused.what]] += 1
        self._news = True
        if refused.what is LaserScan:
            self._take_scan()
            self._answered, self._heard_at, self._stand_because = refused.stamp, now, refused.reason
        elif refused.what is Odometry:
            self._odometry.clear()
            self._odometry_problem = self._stand_because = refused.reason
        elif refused.what is PoseEstimate:
            self._estimate, self._pose_problem, self._awaits_poses = None, refused.reason, False
        elif refused.what is PlannedPath:
            self._plan = None
        elif refused.what is TeleopCommand:
            self._teleop_authority.command(Twist2D(math.nan), now)

    def _take_order(self, now: float) -> None:
        """Begin or end what the newest order says."""
        before, newest = self._goal, self._orders.newest()
        self._goal = newest.goal if newest is not None and newest.modules.OBS else None
        self._status = self._orders.get(now) if self.on else None
        if self._goal is None:
            self._local_planner.clear()
            self._followed, self._turns_for = None, ""
            self._wheels.clear()
            self._say(_IDLE, Level.OK, None if before is None else Twist2D())
        elif self._status is None:
            self._stand(self._goal, _NO_STATUS)
        elif before is None or before.id != self._goal.id:
            self._heard_at = now  # silence counts from here

    def _decide_at(self, now: float) -> float:
        """When there is to be a decision on the scan that waits, if there is one."""
        if self._scan is None:
            return math.inf
        waits = self._awaits_poses and not self._located(self._scan) and not self._odometry_trouble(self._scan.stamp)
        return self._decide_by if waits else now

    # Decisions.

    def _decide(self, goal: GoalCommand, status: Status, now: float) -> None:
        """What to do about a scan, its absence or something senseless; if there is none of that, go on as before."""
        if self._stand_because:
            self._stand(goal, self._stand_because)
        scan = self._take_scan() if self._decide_at(now) <= now else None
        if scan is not None:
            self._drive(goal, status, scan, now)
        if now >= self._heard_at + self._params.max_age_s:
            self._heard_at = now
            if scan is None:
                self._stand(goal, f"no scan for {self._params.max_age_s} s")

    def _take_scan(self) -> LaserScan | None:
        """The scan that waits, which is then taken into account."""
        scan, self._scan, self._decide_by = self._scan, None, math.inf
        if scan is not None:
            self._answered = scan.stamp
        return scan

    def _drive(self, goal: GoalCommand, status: Status, scan: LaserScan, now: float) -> None:
        self._awaits_poses &= self._located(scan) or bool(self._odometry_trouble(scan.stamp))
        if self._arrived(goal):
            self._say(self._report, Level.OK, Twist2D())
            return
        try:
            pose = self._pose_at(scan.stamp)
            followed = self._line_up(goal, goal.along_wall, pose, scan) if goal.along_wall else self._follow(goal)
        except (SensorDataError, PlanningError) as exc:
            self._stand(goal, str(exc))
            return
        if not followed:
            self._say(NavigationReport(goal.id, "idle", "no plan to the goal"), Level.WARN, Twist2D())
            return
        limit = self._limits.max_speed_mps if status.speed_limit_mps is None else status.speed_limit_mps
        others = [(Pose2D(r.x, r.y), r.radius_m) for r in status.robots]
        gentle = status.carries_rider
        try:
            hand = self._teleop_authority.wanted(pose, gentle, now) if status.teleop_mode == "guided" else None
        except TeleopError as exc:
            self._stand(goal, str(exc))
            return
        twist = self._odometry.newest.twist
        # The wheels answer what was said for the scan before.
        wheels = self._wheels.problem(now, self._driven, twist)
        decision = self._local_planner.step(now, pose, twist, scan, self._T_base_laser, limit, gentle, others, hand)
        self._driven = decision.twist
        level = Level.ERROR if wheels or decision.state == "blocked" else Level.OK
        state, reason = ("blocked", wheels) if wheels else (decision.state, decision.reason)
        self._say(NavigationReport(goal.id, state, reason), level, decision.twist)

    def _follow(self, goal: GoalCommand) -> bool:
        """Take a new plan to the goal; whether there is one.

        Raises:
            PlanningError: the plan cannot be used.
        """
        plan = self._plan
        if plan is None or not leads_to(plan, goal):
            self._local_planner.clear()
            self._followed = None
            return False
        if self._followed != (goal.id, plan):
            self._local_planner.set_path(plan.points, goal.pose, goal.tolerance_m, goal.tolerance_rad)
            self._followed = (goal.id, plan)
        return True

    def _line_up(self, goal: GoalCommand, side: Side, pose: Pose2D, scan: LaserScan) -> bool:
        """Take up the order to turn parallel to a wall, by the wall in the first scan after it.

        Raises:
            PlanningError: there is no such wall.
        """
        if self._turns_for != goal.id:
            line = in_line(pose, goal.theta, side, scan, self._T_base_laser, self._wall_params)
            self._local_planner.set_path(np.array([(line.x, line.y)]), line, goal.tolerance_m, goal.tolerance_rad)
            self._turns_for = goal.id
        return True

    def _located(self, scan: LaserScan) -> bool:
        """Whether the pose at the scan's stamp, or a later one, has come."""
        return self._estimate is not None and self._estimate.stamp >= scan.stamp - _STAMP_TOLERANCE_S

    def _odometry_trouble(self, stamp: float) -> str:
        """Why no pose would help at a scan's stamp, as far as that is known; empty: none that is known."""
        if self._odometry and not abs(stamp - self._odometry.newest.stamp) <= self._params.max_age_s:
            return f"odometry is more than {self._params.max_age_s} s off the scan"
        return self._odometry_problem

    def _pose_at(self, stamp: float) -> Pose2D:
        """The pose in ``map`` at a scan's stamp.

        Raises:
            SensorDataError: pose or odometry is missing, old or senseless.
        """
        estimate, max_age_s = self._estimate, self._params.max_age_s
        if trouble := self._odometry_trouble(stamp):
            raise SensorDataError(trouble)
        if not self._odometry:
            raise SensorDataError("no odometry")
        if estimate is None:
            raise SensorDataError(self._pose_problem or "no pose")
        if not abs(stamp - estimate.stamp) <= max_age_s:
            raise SensorDataError(f"pose is more than {max_age_s} s off the scan")
        if abs(stamp - estimate.stamp) <= _STAMP_TOLERANCE_S:
            return estimate.pose
        return compose(estimate.pose, self._odometry.motion(estimate.stamp, stamp, "pose or scan"))

    # What it comes to.

    def _arrived(self, goal: GoalCommand) -> bool:
        return (self._report.goal_id, self._report.state) == (goal.id, "arrived")

    def _stand(self, goal: GoalCommand, reason: str) -> None:
        """Stand on the way to the goal, because of something that is not as it should be."""
        self._wheels.clear()
        if not self._arrived(goal):
            self._say(NavigationReport(goal.id, "blocked", reason), Level.ERROR, Twist2D())

    def _say(self, report: NavigationReport, level: Level, command: Twist2D | None) -> None:
        self._report, self._level, self._command = report, level, command

    def _health(self) -> Health:
        counters: dict[str, object] = {name: count for name, count in self._refused.items() if count}
        if self._bad_share:
            counters["bad_beam_share"] = round(self._bad_share, 3)
        if not self.on:
            return Health(Level.OK, "off", counters)
        if self._goal is None and self._status is None:
            return Health(Level.ERROR, _NO_STATUS, counters)
        report = self._report
        return Health(self._level, f"{report.state}: {report.reason}" if report.reason else report.state, counters)


def leads_to(plan: PlannedPath, goal: GoalCommand) -> bool:
    """Whether ``plan`` ends where ``goal`` is."""
    if plan.end is None:
        return False
    turned = abs(wrap_angle(plan.end.theta - goal.theta))
    return distance(plan.end, goal.pose) <= _SAME_PLACE_M and turned <= _SAME_HEADING_RAD
