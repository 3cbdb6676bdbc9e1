"""What the parts of the local planner share: the scene of one step, and one path with how far the robot has come."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from hitchhike_ros.control.clearance import ClearanceField
from hitchhike_ros.control.detour import Detour
from hitchhike_ros.control.pose_approach import Curve
from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.core.polyline import Polyline
from hitchhike_ros.core.robot_model import RobotLimits

State = Literal["driving", "arrived", "blocked"]
TOUCHED = "an obstacle touches the footprint"


@dataclass(frozen=True)
class Decision:
    """What to do now, and why when it is not simply driving."""

    twist: Twist2D
    state: State
    reason: str = ""


@dataclass(frozen=True)
class Scene:
    """The robot and what is around it at one step.

    ``pose`` is in ``map``, ``field`` in the robot's frame. ``limits`` are those that hold now. ``gentle`` says that a
    hitchhiker follows. ``clearance_m`` is how far the footprint is from the nearest obstacle, negative in contact;
    ``touched`` says which obstacle that is then.
    """

    now: float
    pose: Pose2D
    twist: Twist2D
    field: ClearanceField
    limits: RobotLimits
    gentle: bool
    clearance_m: float
    touched: str = TOUCHED


@dataclass
class ProgressCheck:
    """Whether the robot gets on: since when it stands, and since when it has stayed about one place."""

    moved_at: float = math.inf
    about: Pose2D | None = None  # where it has been since it last came on
    came_on_at: float = math.inf
    stuck: bool = False
    """It has moved for long without coming on."""

    def watch(self, scene: Scene, moving: bool, within_m: float, for_s: float) -> float:
        """Take note of one step; seconds without motion.

        It is stuck when it has moved ``for_s`` without leaving a circle of ``within_m``; who waits is not stuck.
        """
        if moving or scene.now < self.moved_at:
            self.moved_at = scene.now
        away = self.about is None or distance(self.about, scene.pose) > within_m
        if away or not moving or scene.now < self.came_on_at:
            self.about, self.came_on_at = scene.pose, scene.now
        self.stuck |= scene.now - self.came_on_at >= for_s
        return scene.now - self.moved_at


@dataclass
class Leg:
    """One path (in ``map``) on the way to its goal, and how far the robot has come along it."""

    path: Polyline
    goal: Pose2D
    tolerance_m: float
    tolerance_rad: float
    s: float | None = None  # arc length of the robot's foot on the path
    detour: Detour | None = None
    curve: Curve | None = None  # on which the goal is approached
    turning: bool = False  # standing, towards the path
    aligning: bool = False  # standing, to the goal's heading
    settled: bool = False
    arrived: bool = False
    progress: ProgressCheck = field(default_factory=ProgressCheck)
