"""Inputs of modules that have a meaning of their own beyond their data: one type a meaning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray, Obstacle, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.protocol.events import GoalReport


@dataclass(frozen=True, eq=False)
class CameraImage:
    """An image of the camera. It is converted only when a module looks at it.

    ``gray()`` gives uint8 (H, W), C-contiguous, and ``rgb()`` the colours (H, W, 3) for whoever looks on; both raise
    SensorDataError where the message is no usable image. ``frame_id`` is empty where the camera does not tell it.
    """

    stamp: float
    gray: Callable[[], npt.NDArray[np.uint8]]
    rgb: Callable[[], npt.NDArray[np.uint8]]
    frame_id: str = ""


@dataclass(frozen=True, eq=False)
class DepthImage:
    """An image of the depth camera; ``depth()`` gives float32 (H, W) in m, NaN for none, or raises SensorDataError."""

    stamp: float
    depth: Callable[[], npt.NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class DepthCameraInfo:
    """Calibration of the depth camera, whose images are rectified."""

    info: CameraInfo


@dataclass(frozen=True)
class Joystick:
    """Axes in [-1, 1] and buttons, 1 where pressed, in the order of the driver ``joy``."""

    axes: Sequence[float]
    buttons: Sequence[int]


@dataclass(frozen=True)
class TeleopCommand:
    """What a human wants the robot to do."""

    twist: Twist2D


@dataclass(frozen=True)
class TeleopActive:
    """Whether a human has the robot in hand; repeated while that is so."""

    active: bool


@dataclass(frozen=True)
class NavigationCommand:
    """What obstacle avoidance wants the base to do."""

    twist: Twist2D


@dataclass(frozen=True)
class ServoingCommand:
    """What visual servoing wants the base to do."""

    twist: Twist2D


@dataclass(frozen=True, eq=False)
class InitialPose:
    """Where localization starts from: an operator's estimate in ``map``, or the one taken over from a driver."""

    estimate: PoseEstimate


@dataclass(frozen=True)
class HandedOverObstacles:
    """Boxes in ``map`` that a driver handed over."""

    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True)
class FoundObstacles:
    """All boxes in ``map`` that the robot knows beyond the map."""

    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True, eq=False)
class PlannedPath:
    """The path to the goal: points (N, 2) in m in ``map`` and the pose at its end; None: there is none."""

    points: FloatArray
    end: Pose2D | None


NO_PATH = PlannedPath(np.empty((0, 2)), None)


@dataclass(frozen=True)
class PlanReport(GoalReport):
    """How planning for a goal fares: ``state`` is idle, waiting, planned or failed."""


@dataclass(frozen=True)
class NetworkText:
    """A JSON message as it came over the network, and the node that published it."""

    text: str
    sender: str = ""
