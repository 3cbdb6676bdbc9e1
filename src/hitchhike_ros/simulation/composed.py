"""The simulated world and the robots' cores in one process, stepped in turn on the simulated clock.

No ROS, no threads: deterministic and faster than the nodes, for benchmarks and anything with many seeds. The wiring is
that of the nodes, and a test compares the two on one ride.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import LaserScan, MarkerObservation, Obstacle, Odometry, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.robot_model import RobotLimits, fixed_transforms
from hitchhike_ros.localization.methods import Method
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.modules.inputs import (
    CameraImage,
    FoundObstacles,
    HandedOverObstacles,
    InitialPose,
    PlanReport,
    TeleopCommand,
)
from hitchhike_ros.modules.module import Fresh, Module
from hitchhike_ros.modules.obstacle_avoidance import ObstacleAvoidance
from hitchhike_ros.modules.path_planning import PathPlanning
from hitchhike_ros.modules.robot_files import PlainFiles
from hitchhike_ros.modules.slam import Slam
from hitchhike_ros.modules.velocity_mux import VelocityMux, VelocityMuxParameters
from hitchhike_ros.modules.visual_servoing import VisualServoing
from hitchhike_ros.planning.global_planner import GlobalPlanner, GlobalPlannerParameters
from hitchhike_ros.protocol.agent import Traveller
from hitchhike_ros.protocol.events import (
    Award,
    Effect,
    GoalGiven,
    NavigationReport,
    Send,
    Situation,
    TakeObstacles,
    TakePose,
    Tick,
)
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.messages import encode
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.faults import Fault, FaultKind
from hitchhike_ros.simulation.physics.robot import SimulatedRobot
from hitchhike_ros.simulation.physics.world import World
from hitchhike_ros.simulation.world_file import RobotEntry

FRAME_RATE_HZ = 10
ODOMETRY_PER_FRAME = 2
# An estimate older than this is no longer the robot's pose, as for hitchhike_comm (s).
_ESTIMATE_AGE_S = 1.0
# Grey value of an image in which something is held before the lens.
_COVERED_GRAY = 90

T = TypeVar("T")
# What differs from a robot's parameter file: field by section.
Changes = Mapping[str, Mapping[str, object]]


class ComposedRobot:
    """One robot's cores around its simulated body."""

    def __init__(
        self,
        body: SimulatedRobot,
        grid: OccupancyGrid,
        sites: Sites,
        package: Path,
        entry: RobotEntry,
        localization_method: Method = "ekf",
        changes: Changes | None = None,
    ) -> None:
        config = package / "config" / f"{entry.model}.yaml"
        mounts = fixed_transforms(package / "urdf" / f"{entry.model}.urdf")
        changes = changes or {}

        def load(cls: type[T], section: str) -> T:
            return load_parameters(cls, section, config, changes.get(section))

        self.name, self.body = body.name, body
        self.limits = load(RobotLimits, "robot")
        self._planner = GlobalPlanner(load(GlobalPlannerParameters, "global_planner"), self.limits)
        urdf = package / "urdf" / f"{entry.model}.urdf"
        files = PlainFiles(body.name, config, urdf, sites, grid, changes)
        self._slam = Slam.build(files, method=localization_method)
        self._path_planning = PathPlanning.build(files)
        self._obstacle_avoidance = ObstacleAvoidance.build(files)
        self._mux = VelocityMux(load(VelocityMuxParameters, "velocity_mux"), self.limits)
        self._servoing = VisualServoing.build(files)
        camera = pose_from_matrix(mounts["camera"])
        # Robots of one model share its file, but not the rear marker.
        own: dict[str, object] = {} if entry.marker is None else {"marker_id": entry.marker}
        own = {**own, **entry.hitchhiking, **changes.get("hitchhiking", {})}
        params = load_parameters(HitchhikingParameters, "hitchhiking", config, own)
        self.traveller = Traveller(
            self.name,
            params,
            sites,
            lambda start, goal: self._planner.plan(self.map, start, goal),
            pose_from_matrix(mounts["marker"]),
            (camera.x, camera.y),
            self.limits.circumscribed_m,
        )
        self.inbox = Inbox(self.name)
        self.status: Status = self.traveller.status(0.0)
        self._estimate: Fresh[PoseEstimate] = Fresh("pose", _ESTIMATE_AGE_S)
        self.following = ""
        """What the law behind the marker said last."""
        self.awards: list[Award] = []
        self.taken: list[PoseEstimate] = []
        self.map, self.obstacles = grid, FoundObstacles(()).obstacles
        """The robot's own map with the boxes that it knows, and these."""
        self._planning = PlanReport("", "idle")
        self._navigation = NavigationReport("", "idle")
        self._observations: tuple[MarkerObservation, ...] = ()
        self._seen_from = Pose2D()  # in odom, when the observations were made
        self._outbox = Outbox()
        self._slam.order(self.status, 0.0)

    def sense_odometry(self, odometry: Odometry) -> None:
        """The wheels' reading."""
        for module in (self._slam, self._servoing, self._obstacle_avoidance):
            _hand(module, odometry, odometry.stamp)

    def sense_scan(self, scan: LaserScan, now: float) -> None:
        """Localize, map and drive by one scan, as far as these are on."""
        for module in (self._slam, self._servoing):
            _hand(module, scan, now)
        self._localize(now)
        _hand(self._obstacle_avoidance, scan, now)
        self._navigate(now)

    def sense_image(self, now: float, covered: bool = False) -> None:
        """Look for markers, and follow, when servoing is on; ``covered``: something is held before the lens."""
        gray, rgb = partial(self._gray, covered), self.body.camera
        _hand(self._servoing, self.body.camera_info, now)
        _hand(self._servoing, CameraImage(now, gray, rgb), now)
        self.servo(now)

    def servo(self, now: float) -> None:
        """Step servoing while it is due, as it is when no image comes."""
        while self._servoing.next_due(now) <= now:
            outputs = self._servoing.step(now)
            if outputs.command is not None:
                self._mux.sense(outputs.command, now)
            if outputs.observations is not None:
                _hand(self._slam, outputs.observations, now)
                self._observations = outputs.observations.markers
                self._seen_from, self.following = self.body.odometry().pose, outputs.observations.following

    def steer(self, now: float, twist: Twist2D) -> None:
        """Somebody has taken the joystick."""
        self._mux.sense(TeleopCommand(twist), now)
        _hand(self._obstacle_avoidance, TeleopCommand(twist), now)

    def _gray(self, covered: bool) -> npt.NDArray[np.uint8]:
        info = self.body.camera_info
        if covered:
            return np.full((info.height, info.width), _COVERED_GRAY, dtype=np.uint8)
        return np.asarray(cv2.cvtColor(self.body.camera(), cv2.COLOR_RGB2GRAY), dtype=np.uint8)

    def tick(self, now: float, send: Callable[[str], None], event: object = None) -> None:
        """Step the protocol with ``event`` or the passing of time, and carry out what it wants."""
        servo = self.status.servo
        seen = [o for o in self._observations if servo is not None and o.marker_id == servo.marker_id]
        failed, plan = self._planning.state == "failed", self._planning
        situation = Situation(
            self._estimate.get(now),
            self.body.odometry().twist.v,
            self.obstacles,
            NavigationReport(plan.goal_id, plan.state, plan.reason) if failed else self._navigation,
            seen[0] if seen else None,
            self._seen_from if seen else None,
            self.body.odometry().pose,
            self.following,
        )
        for effect in self.traveller.step(Tick(situation) if event is None else event, now):
            self._carry_out(effect, now, send)
        self.status = self.traveller.status(now)
        self._mux.order(self.status, now)
        for module in (self._slam, self._obstacle_avoidance, self._path_planning, self._servoing):
            module.order(self.status, now)
        self._localize(now)
        self.servo(now)
        self._navigate(now)

    def drive(self, now: float) -> None:
        """Pass the velocity command on to the wheels."""
        self.body.command(self._mux.step(now).twist, now)

    def start(self, estimate: PoseEstimate) -> None:
        """Where an operator says that the robot is."""
        _hand(self._slam, InitialPose(estimate), estimate.stamp)

    def learn(self, boxes: Iterable[Obstacle], now: float) -> None:
        """Boxes that it knows of beforehand."""
        _hand(self._slam, HandedOverObstacles(tuple(boxes)), now)
        self._localize(now)

    def _carry_out(self, effect: Effect, now: float, send: Callable[[str], None]) -> None:
        if isinstance(effect, Send):
            send(encode(self._outbox.stamp(effect.message, now)))
        elif isinstance(effect, TakePose):
            self.taken.append(effect.estimate)
            _hand(self._slam, InitialPose(effect.estimate), now)
        elif isinstance(effect, TakeObstacles):
            _hand(self._slam, HandedOverObstacles(effect.obstacles), now)
        elif isinstance(effect, Award):
            self.awards.append(effect)

    def _localize(self, now: float) -> None:
        """Localize and map, as far as that is due."""
        while self._slam.next_due(now) <= now:
            outputs = self._slam.step(now)
            if outputs.pose is not None:
                self._estimate.put(outputs.pose, outputs.pose.stamp)
                for module in (self._path_planning, self._obstacle_avoidance):
                    _hand(module, outputs.pose, now)
            if outputs.grid is not None:
                self.map = outputs.grid
                self._path_planning.sense(self.map, now)  # which a topic would keep for it while it is off
            if outputs.boxes is not None:
                self.obstacles = outputs.boxes.obstacles

    def _navigate(self, now: float) -> None:
        """Plan and drive, as far as that is due."""
        while self._path_planning.next_due(now) <= now or self._obstacle_avoidance.next_due(now) <= now:
            if self._path_planning.next_due(now) <= now:
                planned = self._path_planning.step(now)
                self._planning = planned.report or self._planning
                if planned.plan is not None:
                    _hand(self._obstacle_avoidance, planned.plan, now)
            if self._obstacle_avoidance.next_due(now) <= now:
                driven = self._obstacle_avoidance.step(now)
                if driven.command is not None:
                    self._mux.sense(driven.command, now)
                if driven.report is not None:
                    self._navigation = driven.report
                    _hand(self._path_planning, driven.report, now)


@dataclass
class ComposedRide:
    """A world file's robots under way to their goals; :meth:`step` advances one sensor frame."""

    world: World
    package: Path
    robots: dict[str, ComposedRobot] = field(default_factory=dict)
    messages: list[str] = field(default_factory=list)
    localization_method: Method = "ekf"
    changes: Mapping[str, Changes] = field(default_factory=dict)
    """By robot."""
    faults: list[Fault] = field(default_factory=list)
    """What goes wrong; more may be added under way."""
    goals: dict[str, float] = field(default_factory=dict)
    """When those robots get their goals that have none yet."""

    def __post_init__(self) -> None:
        for name, entry in self.world.file.robots.items():
            robot = ComposedRobot(
                self.world.robots[name],
                self.world.grid,
                self.world.file.sites,
                self.package,
                entry,
                self.localization_method,
                self.changes.get(name),
            )
            self.robots[name] = robot

    def start(self, estimates: dict[str, PoseEstimate]) -> None:
        """Tell every robot where it is and, when it is time, where it is wanted."""
        for name, robot in self.robots.items():
            robot.sense_odometry(self.world.robots[name].odometry())
            robot.start(replace(estimates[name], stamp=self.world.now))
            entry = self.world.file.robots[name]
            if entry.goal is not None:
                self.goals[name] = self.world.now + entry.goal_at_s
        self._give_goals()

    def step(self) -> None:
        """One frame: physics, odometry, scans, images, protocol."""
        steps = self.world.params.physics_rate_hz // FRAME_RATE_HZ // ODOMETRY_PER_FRAME
        for _ in range(ODOMETRY_PER_FRAME):
            for _ in range(steps):
                self.world.step()
            for robot in self.robots.values():
                robot.sense_odometry(robot.body.odometry())
                robot.drive(self.world.now)
        now = self.world.now
        self._give_goals()
        for robot in self.robots.values():
            if self._fault(robot, "camera_silent") is None:
                robot.sense_image(now, self._fault(robot, "camera_covered") is not None)
            else:
                robot.servo(now)
            robot.sense_scan(robot.body.scan(), now)
            if (steered := self._fault(robot, "steered")) is not None:
                robot.steer(now, steered.twist or Twist2D())
        inbox, self.messages = self.messages, []
        for robot in self.robots.values():
            cut_off = self._fault(robot, "messages_lost") is not None
            for text in () if cut_off else inbox:
                message = robot.inbox.receive(text)
                if message is not None:
                    robot.tick(now, self._broadcast, message)
            robot.tick(now, _nowhere if cut_off else self._broadcast)
            robot.drive(now)

    def run(self, limit_s: float) -> bool:
        """Step until every robot has ended its errand; False when ``limit_s`` of simulated time did not suffice."""
        while self.world.now < limit_s:
            self.step()
            if not self.goals and all(robot.status.state == "idle" for robot in self.robots.values()):
                return True
        return False

    def _give_goals(self) -> None:
        """To those robots whose time has come."""
        for name in [name for name, at in self.goals.items() if at <= self.world.now]:
            del self.goals[name]
            goal = self.world.file.robots[name].goal
            assert goal is not None
            self.robots[name].tick(self.world.now, self._broadcast, GoalGiven(goal))

    def _fault(self, robot: ComposedRobot, kind: FaultKind) -> Fault | None:
        return next(
            (f for f in self.faults if (f.robot, f.kind) == (robot.name, kind) and f.acts(self.world.now)), None
        )

    def _broadcast(self, text: str) -> None:
        self.messages.append(text)


def _hand(module: Module[Any], x: object, now: float) -> None:
    """Hand on what arrived, if the module listens to it."""
    if type(x) in module.listens():
        module.sense(x, now)


def _nowhere(_text: str) -> None:
    """Where the messages of a robot go that is cut off."""
