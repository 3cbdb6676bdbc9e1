"""The simulated world and the robots' modules in one process, stepped in turn on the simulated clock.

It has no ROS and no threads: it is deterministic, faster than nodes, and meant for benchmarks and whatever needs many
seeds. Modules and wires are those of the nodes; a test replays one ride in all hosts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import LaserScan, Obstacle, PoseEstimate, Twist2D
from hitchhike_ros.localization.methods import Method
from hitchhike_ros.modules.hitchhike_comm import HitchhikeCommOutputs, Outcome
from hitchhike_ros.modules.inputs import CameraImage, HandedOverObstacles, InitialPose, NetworkText, TeleopCommand
from hitchhike_ros.modules.robot import build
from hitchhike_ros.modules.robot_files import PlainFiles
from hitchhike_ros.modules.slam import SlamOutputs
from hitchhike_ros.modules.velocity_mux import VelocityMuxOutputs
from hitchhike_ros.protocol.events import Award, GoalGiven
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.faults import Fault, FaultKind
from hitchhike_ros.simulation.physics.robot import SimulatedRobot
from hitchhike_ros.simulation.physics.world import World

FRAME_RATE_HZ = 10
ODOMETRY_PER_FRAME = 2
# Grey value of an image in which something is held before the lens.
_COVERED_GRAY = 90

# What differs from a robot's parameter file: field by section.
Changes = Mapping[str, Mapping[str, object]]


class ComposedRobot:
    """A robot's modules around its simulated body, and the newest of what they say."""

    def __init__(self, body: SimulatedRobot, files: PlainFiles, localization_method: Method) -> None:
        self.name, self.body, self.files = body.name, body, files
        self.params = files.load(HitchhikingParameters, "hitchhiking")
        self.robot = build(files, localization_method)
        self.status = Status(0.0, body.name)
        self.outcome: Outcome | None = None
        """How its goal ended, None while it is on its way to one."""
        self.boxes: tuple[Obstacle, ...] = ()
        self.awards: list[Award] = []
        self.taken: list[PoseEstimate] = []
        """Poses that were taken over from a driver."""

    def run(self, now: float) -> list[str]:
        """Step the modules that are due and move the wheels; the messages for the network."""
        messages: list[str] = []
        while self.robot.next_due(now) <= now:
            for _, outputs in self.robot.step(now):
                match outputs:
                    case SlamOutputs():
                        self.boxes = self.boxes if outputs.boxes is None else outputs.boxes.obstacles
                    case VelocityMuxOutputs():
                        self.body.command(outputs.twist, now)
                    case HitchhikeCommOutputs():
                        self._note(outputs)
                        messages += outputs.messages
        return messages

    def see(self, now: float, covered: bool) -> None:
        """Take an image; ``covered``: something is held before the lens."""
        if CameraImage in self.robot.listens():
            self.robot.sense(self.body.camera_info, now)
            self.robot.sense(CameraImage(now, cache(lambda: self._gray(covered)), self.body.camera), now)

    def _note(self, outputs: HitchhikeCommOutputs) -> None:
        self.status, self.outcome = outputs.status or self.status, outputs.outcome
        self.awards += outputs.awards
        if outputs.initial_pose is not None:
            self.taken.append(outputs.initial_pose.estimate)

    def _gray(self, covered: bool) -> npt.NDArray[np.uint8]:
        info = self.body.camera_info
        if covered:
            return np.full((info.height, info.width), _COVERED_GRAY, dtype=np.uint8)
        return np.asarray(cv2.cvtColor(self.body.camera(), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


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
            # Robots of one model share its file, but not the marker on the back.
            own: dict[str, object] = {} if entry.marker is None else {"marker_id": entry.marker}
            changes = self.changes.get(name, {})
            files = PlainFiles(
                name,
                self.package / "config" / f"{entry.model}.yaml",
                self.package / "urdf" / f"{entry.model}.urdf",
                self.world.file.sites,
                self.world.grid,
                {**changes, "hitchhiking": {**own, **entry.hitchhiking, **changes.get("hitchhiking", {})}},
            )
            self.robots[name] = ComposedRobot(self.world.robots[name], files, self.localization_method)

    def start(self, estimates: dict[str, PoseEstimate], boxes: Sequence[Obstacle] = ()) -> None:
        """Tell every robot where it is, which boxes it knows and, when it is time, where it is wanted."""
        now = self.world.now
        for name, robot in self.robots.items():
            robot.robot.sense(InitialPose(replace(estimates[name], stamp=now)), now)
            if boxes:
                robot.robot.sense(HandedOverObstacles(tuple(boxes)), now)
            self.messages += robot.run(now)
            entry = self.world.file.robots[name]
            if entry.goal is not None:
                self.goals[name] = now + entry.goal_at_s

    def step(self) -> None:
        """One frame: physics and odometry, then what was said before it, images and scans."""
        steps = self.world.params.physics_rate_hz // FRAME_RATE_HZ // ODOMETRY_PER_FRAME
        said: list[str] = []
        for part in range(ODOMETRY_PER_FRAME):
            for _ in range(steps):
                self.world.step()
            now, frame = self.world.now, part == ODOMETRY_PER_FRAME - 1
            self._give_goals()
            for robot in self.robots.values():
                robot.robot.sense(robot.body.odometry(), now)
                self._deliver(robot, frame, now)
                messages = robot.run(now)
                said += [] if self._fault(robot, "messages_lost") else messages
        self.messages = said

    def run(self, limit_s: float) -> bool:
        """Step until every robot has ended its errand; False when ``limit_s`` of simulated time did not suffice."""
        while self.world.now < limit_s:
            self.step()
            if not self.goals and all(robot.outcome is not None for robot in self.robots.values()):
                return True
        return False

    def _deliver(self, robot: ComposedRobot, frame: bool, now: float) -> None:
        """What comes beside odometry: at a frame its image and scan, and what others have said since the one before."""
        if not frame:
            return
        for text in () if self._fault(robot, "messages_lost") else self.messages:
            robot.robot.sense(NetworkText(text), now)
        if not self._fault(robot, "camera_silent"):
            robot.see(now, covered=self._fault(robot, "camera_covered") is not None)
        if LaserScan in robot.robot.listens():
            robot.robot.sense(robot.body.scan(), now)
        if (steered := self._fault(robot, "steered")) is not None:
            robot.robot.sense(TeleopCommand(steered.twist or Twist2D()), now)

    def _give_goals(self) -> None:
        """To those robots whose time has come."""
        for name in [name for name, at in self.goals.items() if at <= self.world.now]:
            del self.goals[name]
            goal = self.world.file.robots[name].goal
            assert goal is not None
            self.robots[name].robot.order(GoalGiven(goal), self.world.now)

    def _fault(self, robot: ComposedRobot, kind: FaultKind) -> Fault | None:
        return next(
            (f for f in self.faults if (f.robot, f.kind) == (robot.name, kind) and f.acts(self.world.now)), None
        )
