"""Finds markers in the camera's images, and rides behind one (module VS of P17 Fig. 8).

The marker that it rides behind, or alone the one marker that it is there for, is carried from image to image by a
tracker between detections. What it says belongs to the image that it was seen in; a marker that is not seen has no
pose.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import ClassVar

import numpy as np

from hitchhike_ros.control.safety_limiter import SafetyLimiter
from hitchhike_ros.core.datatypes import (
    CameraInfo,
    FloatArray,
    LaserScan,
    MarkerObservation,
    NonNegative,
    Odometry,
    Positive,
    Twist2D,
)
from hitchhike_ros.core.errors import ParameterError, SensorDataError, StaleInputError, VisionError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import LaserMount, RobotLimits
from hitchhike_ros.mapping.laser import ScanParameters
from hitchhike_ros.modules.inputs import CameraImage, ServoingCommand
from hitchhike_ros.modules.module import Health, Level, Order, Orders, Outputs, Refused
from hitchhike_ros.modules.robot_files import RobotFiles
from hitchhike_ros.protocol.observations import Observations
from hitchhike_ros.protocol.status import ANY_MARKER, ModuleSwitches, ServoCommand, Status
from hitchhike_ros.servoing.driver_estimate import USUAL_MARKER
from hitchhike_ros.servoing.follow import FollowDecision, FollowLaw
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.marker_detector import (
    MarkerDetection,
    MarkerDetectorParameters,
    nearest,
    planar_observation,
)
from hitchhike_ros.servoing.marker_tracker import MarkerTracker, MarkerTrackerParameters
from hitchhike_ros.servoing.qr_codes import code_id

# What following says of itself; the rest are errors.
_LEVELS = {
    "following": Level.OK,
    "searching": Level.WARN,
    "coasting": Level.WARN,
    "looking": Level.WARN,
    "turning": Level.WARN,
}
# The robot follows steadily when it is no farther off its gap than this, drives at least so fast, as starting and
# stopping take every image, and hardly turns (chosen).
_STEADY_GAP_M, _STEADY_SPEED_MPS, _STEADY_YAW_RATE_RPS = 0.04, 0.25, 0.15
_BAD = {CameraImage: "bad_images", CameraInfo: "bad_camera_infos", Odometry: "bad_odometry", LaserScan: "bad_scans"}
# Optical frame (z forward, x right, y down) of a camera that looks along the robot's x axis.
_T_FORWARD_OPTICAL = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


@dataclass(frozen=True)
class VisualServoingParameters:
    """Section ``visual_servoing``; all values are chosen."""

    image_timeout_s: Positive = 0.3
    """Without an image for longer than this the robot stands."""
    watch_period_s: Positive = 0.1
    """How often it is told so while no image comes."""
    start_s: Positive = 1.0
    """For so long after the module was switched on, what is missing is not called an error."""
    steady_period_s: NonNegative = 0.19
    """While the robot follows steadily, an image that was taken sooner than this after the last one that was looked at
    is left out: at 10 Hz every other one (with one of three it weaves). 0: every image is looked at."""


class View(IntEnum):
    """How an image fared, as visp_auto_tracker says it; its 2, 4 and 5 are steps of one image's work here."""

    NO_IMAGE = 0
    SEEKING = 1
    SEEN = 3


@dataclass(frozen=True, eq=False)
class Look:
    """What is seen in an image: the marker that is followed or observed, and how many there are in all.

    ``carried`` says that the tracker looked for that marker alone, where it expected it.
    """

    image: CameraImage
    markers: int
    target: MarkerDetection | None
    carried: bool


@dataclass(frozen=True, kw_only=True)
class VisualServoingOutputs(Outputs):
    """What an image, or its absence, gives; ``look`` is None where the image cannot be used."""

    command: ServoingCommand | None = None
    observations: Observations | None = None
    view: View | None = None
    look: Look | None = None


class VisualServoing:
    """Looks for markers in the newest image while the status says so, and follows one while that is the task."""

    name: ClassVar[str] = "visual_servoing"
    inputs: ClassVar[frozenset[type]] = frozenset(_BAD)
    patient: ClassVar[frozenset[type]] = inputs - {CameraImage}  # they serve the next image

    def __init__(
        self,
        params: VisualServoingParameters,
        tracker: MarkerTracker,
        T_base_camera: FloatArray,
        law: FollowLaw | None = None,
        limiter: SafetyLimiter | None = None,
        *,
        alone: ServoCommand | None = None,
        unusable: str = "",
    ) -> None:
        """A module that is off until the status says otherwise, or that does ``alone`` what it is told here.

        Args:
            params: when to stand, and which images to leave out.
            tracker: finds the markers.
            T_base_camera: mount (4, 4) of the camera, in its optical frame.
            law: drives; without it the module can only observe.
            limiter: brakes for what comes between, and stands without a fresh scan; None where there is no laser.
            alone: a standing order.
            unusable: why the markers that the module is there for cannot be found; the robot then stands.
        """
        self._params, self._tracker, self._T_base_camera = params, tracker, T_base_camera
        self._law, self._limiter, self._unusable = law, limiter, unusable
        self.standing_order = alone
        self._orders = Orders(None if alone is None else Status(0.0, "", modules=ModuleSwitches(VS=True), servo=alone))
        self._servo: ServoCommand | None = None
        self._image: CameraImage | None = None  # the newest, where it has not been looked at
        self._info: CameraInfo | None = None
        self._no_info, self._odometry_problem = "", ""
        self._on_since = self._image_at = self._told_at = self._stepped_at = -math.inf
        self._looked_at = -math.inf  # stamp of the newest image that was searched
        self._steady: Twist2D | None = None  # the command, while it may stay as it is for an image
        self._asked = True  # whether the next step is to be taken at once
        self._halts = False  # whether the robot is to be stopped, as it follows no more
        self._drives = False  # whether the newest command was no stand
        self._counters: Counter[str] = Counter()
        self._health = Health(Level.OK, "off")

    @classmethod
    def build(
        cls, files: RobotFiles, *, follows: bool = True, alone: Mapping[str, object] | None = None, where: str = ""
    ) -> VisualServoing:
        """The module of the robot that ``files`` describe; without a model, its camera is its base and looks ahead.

        A marker that cannot be sought is spoken of for as long as it is asked for, and the robot stands.

        Args:
            files: the sections ``visual_servoing``, ``marker_detector``, ``marker_tracker`` and, to follow, ``follow``
                and ``robot``; the mounts of camera and laser.
            follows: whether it can follow, or only observe.
            alone: what it does without anyone's status, as fields of :class:`ServoCommand` or, in place of the marker's
                id, the ``code_message`` of its QR code; without any it observes whichever marker is nearest.
            where: ``alone`` comes from, for errors.

        Raises:
            ParameterError: a parameter is of no use, or ``alone`` is no order that it can obey.
            RobotModelError: the model cannot be read, or has no camera.
        """
        unusable = ""
        try:
            tracker = MarkerTracker(
                files.load(MarkerDetectorParameters, "marker_detector"),
                files.load(MarkerTrackerParameters, "marker_tracker"),
            )
        except (ParameterError, VisionError) as exc:
            tracker, unusable = MarkerTracker(), str(exc)
        described = files.has("base_footprint")
        T_base_camera = files.mount("camera_optical") if described else _T_FORWARD_OPTICAL
        law, limiter = None, None
        if follows:
            limits = files.load(RobotLimits, "robot")
            x, y, yaw = float(T_base_camera[0, 3]), float(T_base_camera[1, 3]), _looks_to(T_base_camera)
            law = FollowLaw(files.load(FollowParameters, "follow"), limits, x, y, yaw)
            if files.has("laser"):
                scan_params = files.load(ScanParameters, "scan")
                laser = LaserMount.of(files.mount("laser"))
                limiter = SafetyLimiter(limits, laser.pose, scan_params, upside_down=laser.upside_down)
        params = files.load(VisualServoingParameters, "visual_servoing")
        order = None if alone is None else _standing_order({} if unusable else alone, where, follows=follows)
        return cls(params, tracker, T_base_camera, law, limiter, alone=order, unusable=unusable)

    # What arrives.

    def listens(self) -> frozenset[type]:
        """To nothing while the module is off; to scans only while it follows and they can limit it."""
        if self._servo is None:
            return frozenset()
        limited = self._servo.task == "follow" and self._limiter is not None
        return self.inputs if limited else self.inputs - {LaserScan}

    def sense(self, x: object, now: float) -> None:
        """Store an image, its calibration, odometry or a scan; to a module that is off they say nothing."""
        if self._servo is None:
            return
        if isinstance(x, CameraImage):
            self._image = x
        elif isinstance(x, CameraInfo):
            self._info = x
        elif isinstance(x, Odometry):
            self._take(x)
        elif isinstance(x, LaserScan) and self._limiter is not None:
            if not self._limiter.see(x, now):
                self._counters["bad_scans"] += 1
        elif isinstance(x, Refused):
            self._refuse(x)

    def order(self, order: Order, now: float) -> None:
        """The status says whether the module is on, and which marker to follow or observe."""
        self._orders.put(order, now)
        self._obey(now)

    def _take(self, odometry: Odometry) -> None:
        self._odometry_problem = ""
        if self._law is None:
            return
        try:
            self._law.add_odometry(odometry)
        except SensorDataError as exc:
            self._refuse(Refused(Odometry, str(exc)))

    def _refuse(self, refused: Refused) -> None:
        self._counters[_BAD[refused.what]] += 1
        if refused.what is CameraInfo:
            self._info, self._no_info = None, refused.reason
        elif refused.what is Odometry:
            # What the robot did meanwhile is not known: the driver's trail is no longer where it was.
            self._odometry_problem, self._steady = refused.reason, None
            if self._law is not None:
                self._law.reset()
        elif refused.what is LaserScan and self._limiter is not None:
            self._limiter.refuse(refused.reason)

    def _obey(self, now: float) -> None:
        """Take up the newest order; a new one begins anew, as the trail of another time leads nowhere."""
        status, before = self._orders.newest(), self._servo
        servo = status.servo if status is not None and status.modules.VS else None
        self._servo = servo
        if (
            servo is not None
            and before is not None
            and (servo.task, servo.marker_id) == (before.task, before.marker_id)
        ):
            return
        if before is None and servo is None:
            return
        self._asked, self._steady = True, None
        self._halts = self._halts or (before is not None and before.task == "follow")
        self._tracker.reset()
        if self._law is not None:
            self._law.reset()
        if before is None or servo is None:
            self._image, self._info, self._no_info, self._odometry_problem = None, None, "none received", ""
            self._on_since = self._image_at = now
            self._drives = False
            if self._limiter is not None:
                self._limiter.forget()
            self._health = self._say(Level.OK, "off" if servo is None else "waiting for images")

    # What comes of it.

    def next_due(self, now: float) -> float:
        """At once for an image or a new order; when images or scans stay away, and when the order to follow has grown
        old."""
        if self._asked or self._image is not None or now < self._stepped_at:
            return now
        return math.inf if self._servo is None else min(self._silent_from(), self._ordered_until(), self._blind_from())

    def step(self, now: float) -> VisualServoingOutputs:
        """Look at the image that has come, or say that none comes."""
        self._obey(now)  # a standing order does not come by a message
        if now < self._stepped_at:  # time has jumped back
            self._on_since, self._image_at, self._told_at = (
                min(at, now) for at in (self._on_since, self._image_at, self._told_at)
            )
        silent, ended, blind = (now >= at for at in (self._silent_from(), self._ordered_until(), self._blind_from()))
        image, halts = self._image, self._halts
        self._image, self._halts, self._asked, self._stepped_at = None, False, False, now
        outputs = VisualServoingOutputs(health=self._health)
        if self._servo is not None and image is not None:
            self._image_at = now
            if not ended and self._may_leave_out(image.stamp, now):
                return replace(outputs, answered=image.stamp)
            outputs = self._look_at(image, self._servo, now)
        elif self._servo is not None and silent:
            self._told_at = now
            problem = self._unusable or f"no image for {now - self._image_at:.1f} s"
            command, _, health = self._decide(self._servo, None, problem, now)
            outputs = VisualServoingOutputs(health=health, command=command, view=View.NO_IMAGE)
        elif self._servo is not None and (ended or blind):
            command, _, health = self._decide(self._servo, None, "", now)
            outputs = VisualServoingOutputs(health=health, command=command)
        self._health = outputs.health
        if halts and outputs.command is None:
            outputs = replace(outputs, command=ServoingCommand(Twist2D()))
        return outputs

    def _silent_from(self) -> float:
        """When the next is to be said of images that do not come."""
        p = self._params
        return max(self._image_at + p.image_timeout_s, self._told_at + p.watch_period_s)

    def _ordered_until(self) -> float:
        """When the order to follow has grown too old; infinity where it has been found so already."""
        expires = self._orders.expires()
        follows = self._servo is not None and self._servo.task == "follow"
        return expires if follows and expires > self._stepped_at else math.inf

    def _blind_from(self) -> float:
        """When the newest scan becomes too old to drive by; infinity for a robot that stands, or has no laser."""
        return self._limiter.expires() if self._limiter is not None and self._drives else math.inf

    def _may_leave_out(self, stamp: float, now: float) -> bool:
        """Whether an image need not be looked at; not so where the robot has to brake for what comes between."""
        if self._steady is None or not 0.0 <= stamp - self._looked_at < self._params.steady_period_s:
            return False
        return self._limiter is None or not self._limiter.limit(now, self._steady)[1]

    def _look_at(self, image: CameraImage, servo: ServoCommand, now: float) -> VisualServoingOutputs:
        problem, found = "", list[MarkerDetection]()
        try:
            found = self._detect(image, servo)
        except (SensorDataError, VisionError) as exc:
            problem = str(exc)
            self._counters["bad_images"] += 1
        self._looked_at = image.stamp
        markers = tuple(planar_observation(d, self._T_base_camera, image.stamp) for d in found)
        target = nearest(d for d in found if servo.marker_id in (d.id, ANY_MARKER))
        seen = next((o for o, d in zip(markers, found, strict=True) if d is target), None)
        command, following, health = self._decide(servo, seen, problem, now)
        return VisualServoingOutputs(
            health=health,
            answered=image.stamp,
            command=command,
            observations=Observations(image.stamp, markers, following),
            view=View.NO_IMAGE if problem else View.SEEKING if target is None else View.SEEN,
            look=None if problem else Look(image, len(markers), target, self._tracker.tracking),
        )

    def _detect(self, image: CameraImage, servo: ServoCommand) -> list[MarkerDetection]:
        """Raises SensorDataError or VisionError where the image or its calibration cannot be used."""
        if self._unusable:
            raise VisionError(self._unusable)
        if self._info is None:
            raise SensorDataError(f"no camera_info: {self._no_info}")
        gray = image.gray()
        if servo.task != "follow" and self.standing_order is None:  # every marker says where the robot is
            self._tracker.reset()
        own = None if self._law is None else self._law.pose_at(image.stamp)
        anyone = servo.marker_id == ANY_MARKER
        return self._tracker.see(
            gray,
            self._info,
            self._T_base_camera,
            image.stamp,
            heading=0.0 if own is None else own.theta,
            target=None if anyone else servo.marker_id,
            sizes_m={} if anyone else {servo.marker_id: servo.marker_size_m},
        )

    def _decide(
        self, servo: ServoCommand, seen: MarkerObservation | None, problem: str, now: float
    ) -> tuple[ServoingCommand | None, str, Health]:
        """What the robot does about the marker, seen or not, in what state that is, and how the module fares.

        With a problem it stands. Nothing else steps the law.
        """
        self._steady, self._drives = None, False
        # The first image may come before the first calibration.
        bad = Level.ERROR if now - self._on_since > self._params.start_s else Level.WARN
        if servo.task != "follow":
            return None, "", self._say(bad if problem else Level.OK, problem or "observing")
        if self._law is None:
            return None, "", self._say(Level.ERROR, "cannot follow: no ~config with a section robot")
        mount = USUAL_MARKER if servo.marker_pose is None else servo.marker_pose
        decision = self._law.step(now, seen, None, servo.gap_m, servo.feed_forward_mps, servo.feed_forward_at, mount)
        unseen = "" if self._limiter is None else self._limiter.problem(now)
        problem = problem or self._odometry_problem or self._order_problem(now) or unseen
        if problem:
            decision = FollowDecision(Twist2D(), "stopped", problem)
        twist, limited, laser = decision.twist, False, dict[str, object]()
        if self._limiter is None:
            laser["laser"] = "none: it brakes for no obstacle"
        else:
            twist, limited = self._limiter.limit(now, decision.twist)
            if self._limiter.bad_share:
                laser["bad_beam_share"] = round(self._limiter.bad_share, 3)
        self._drives = twist != Twist2D()
        if seen is not None and not limited and _is_steady(decision, servo.gap_m):
            self._steady = twist
        health = self._say(
            _LEVELS.get(decision.state, bad),
            f"{decision.state}: {decision.reason}" if decision.reason else decision.state,
            gap_m="" if decision.gap_m is None else round(decision.gap_m, 3),
            braked_for_an_obstacle=limited,
            **laser,
        )
        return ServoingCommand(twist), decision.state, health

    def _order_problem(self, now: float) -> str:
        try:
            self._orders.at(now)
        except StaleInputError as exc:
            return str(exc)
        return ""

    def _say(self, level: Level, reason: str, **values: object) -> Health:
        return Health(level, reason, {**self._counters, **values})


def _looks_to(T_base_camera: FloatArray) -> float:
    """Heading in rad of a camera's z axis in the plane."""
    return math.atan2(T_base_camera[1, 2], T_base_camera[0, 2])


def _is_steady(decision: FollowDecision, gap_m: float) -> bool:
    """Whether the command may stay as it is for an image."""
    return (
        decision.state == "following"
        and decision.gap_m is not None
        and abs(decision.gap_m - gap_m) <= _STEADY_GAP_M
        and decision.twist.v >= _STEADY_SPEED_MPS
        and abs(decision.twist.omega) <= _STEADY_YAW_RATE_RPS
    )


def _standing_order(given: Mapping[str, object], where: str, *, follows: bool) -> ServoCommand:
    """Raises ParameterError where a field is of the wrong type or out of range, or it would follow and cannot."""
    fields: dict[str, object] = {"task": "observe", "marker_id": ANY_MARKER, **given}
    if "code_message" in fields:
        fields["marker_id"] = code_id(str(fields.pop("code_message")))
    servo = convert(fields, ServoCommand, where)
    if servo.task not in ("observe", "follow"):
        raise ParameterError(where, "~task", servo.task, "observe or follow")
    if servo.task == "follow" and not follows:
        raise ParameterError(where, "~config", "", "a file with a section robot, to follow")
    return servo
