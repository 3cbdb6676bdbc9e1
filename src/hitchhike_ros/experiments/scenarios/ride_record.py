"""What is recorded of a ride, for scoring it: everything in ``map`` and on the simulated clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from hitchhike_ros.core.datatypes import Contact, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.messages import Covariance, covariance_rows
from hitchhike_ros.protocol.status import Status


@dataclass(frozen=True)
class TimedPose:
    """Where a robot was."""

    stamp: float
    x: float
    y: float
    theta: float

    @property
    def pose(self) -> Pose2D:
        return Pose2D(self.x, self.y, self.theta)


@dataclass(frozen=True)
class TimedEstimate(TimedPose):
    """Where a robot took itself to be; ``sigma`` is 3 x 3 in (x, y, theta)."""

    sigma: Covariance

    @classmethod
    def of(cls, estimate: PoseEstimate) -> TimedEstimate:
        pose = estimate.pose
        return cls(estimate.stamp, pose.x, pose.y, pose.theta, covariance_rows(estimate.covariance))


@dataclass(frozen=True)
class TimedSighting(TimedPose):
    """A marker as visual servoing saw it, in base_footprint."""

    marker_id: int


@dataclass(frozen=True)
class TimedText:
    """A message on the network, as it was sent."""

    stamp: float
    text: str


@dataclass(frozen=True)
class CpuSample:
    """CPU time a node's process has used since it started, its resident memory now and at most so far."""

    stamp: float
    wall_s: float
    node: str
    cpu_s: float
    memory_mb: float
    peak_mb: float = 0.0


@dataclass(frozen=True)
class TrafficSample:
    """What has gone through a node's connections since it started, but to the nodes that only watch."""

    stamp: float
    node: str
    messages_in: int = 0
    bytes_in: int = 0
    messages_out: int = 0
    bytes_out: int = 0


@dataclass(frozen=True)
class MemorySample:
    """The proportional set size of a process: its own memory, and its share of what it has in common with others."""

    stamp: float
    node: str
    pss_mb: float


@dataclass(frozen=True)
class StepSample:
    """How many steps the simulator has made on the system's clock, and how many of them began too late."""

    stamp: float
    steps: int
    late: int


@dataclass(frozen=True)
class ClockSample:
    """Simulated time at a wall time of the recording machine."""

    stamp: float
    wall_s: float


@dataclass
class RobotRecord:
    """One robot: its mounts (planar, in base_footprint), then what it did and what it believed."""

    camera: Pose2D
    marker: Pose2D
    has_goal: bool = True
    truth: list[TimedPose] = field(default_factory=list)
    estimates: list[TimedEstimate] = field(default_factory=list)  # amcl_pose
    initial_poses: list[TimedEstimate] = field(default_factory=list)  # initialpose
    statuses: list[Status] = field(default_factory=list)  # changes only
    sightings: list[TimedSighting] = field(default_factory=list)
    obstacles: tuple[Obstacle, ...] = ()  # the new boxes in its map, newest
    awards: list[Award] = field(default_factory=list)
    newest_status: Status | None = None

    @property
    def ended(self) -> bool:
        """Whether it had something to do and has no longer."""
        now = self.newest_status
        return now is not None and now.state == "idle" and any(s.state != "idle" for s in self.statuses)

    @property
    def arrived(self) -> bool:
        """Whether it stands at its goal, or never had one."""
        if not self.has_goal:
            return True
        newest = self.newest_status
        return self.ended and newest is not None and newest.ending.reached

    def add_status(self, status: Status) -> bool:
        """Take a status; whether anything but time, metres and feed-forward changed."""
        changed = self.newest_status is None or _essence(self.newest_status) != _essence(status)
        self.newest_status = status
        if changed:
            self.statuses.append(status)
        return changed


@dataclass
class RideRecord:
    """A run with all its robots. ``scenario`` is the world file's name without its endings."""

    scenario: str
    seed: int
    true_boxes: tuple[Obstacle, ...]
    robots: dict[str, RobotRecord]
    messages: list[TimedText] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    cpu: list[CpuSample] = field(default_factory=list)
    traffic: list[TrafficSample] = field(default_factory=list)
    memory: list[MemorySample] = field(default_factory=list)
    clock: list[ClockSample] = field(default_factory=list)
    steps: list[StepSample] = field(default_factory=list)
    simulator: dict[str, str] = field(default_factory=dict)  # its newest diagnostics

    @property
    def over(self) -> bool:
        """Whether every robot that was given a goal has come to an end with it."""
        active = [robot for robot in self.robots.values() if robot.has_goal]
        return bool(active) and all(robot.ended for robot in active)

    @property
    def lasted(self) -> tuple[float, float]:
        """Simulated and wall seconds from the first to the last look at both clocks."""
        if not self.clock:
            return 0.0, 0.0
        first, last = self.clock[0], self.clock[-1]
        return last.stamp - first.stamp, last.wall_s - first.wall_s

    def late_share(self, begin: float, end: float) -> float | None:
        """Of the simulator's steps between two stamps, the share that began too late; None where they are not known.

        The counts are those of the last sample before ``begin`` and the first after ``end``, or the nearest.
        """
        before = [s for s in self.steps if s.stamp <= begin] or self.steps[:1]
        after = [s for s in self.steps if s.stamp >= end] or self.steps[-1:]
        if not before or after[0].steps <= before[-1].steps:
            return None
        return (after[0].late - before[-1].late) / (after[0].steps - before[-1].steps)

    def ridden_m(self, robot: str) -> float:
        """How far the ride is by now in which ``robot`` takes part, as its driver reports it."""
        status = self.robots[robot].newest_status
        if status is None or status.ride is None or status.ride.driver not in self.robots:
            return 0.0
        driver = self.robots[status.ride.driver].newest_status
        return driver.ride.ridden_m if driver is not None and driver.ride is not None else 0.0


def save_record(record: RideRecord, path: Path) -> None:
    """Write the record as JSON."""
    path.write_bytes(msgspec.json.encode(record))


def load_record(path: Path) -> RideRecord:
    """A record that :func:`save_record` wrote.

    Raises:
        InputFileError: the file cannot be read or is no record.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=RideRecord)
    except OSError as exc:
        raise InputFileError(path, "", exc.strerror, "a readable file") from exc
    except msgspec.MsgspecError as exc:
        raise InputFileError(path, "", str(exc), "the record of a ride") from exc


def _essence(status: Status) -> tuple[object, ...]:
    goal = status.goal.id if status.goal is not None else None
    ride = status.ride.ride_id if status.ride is not None else None
    followed = status.servo.marker_id if status.servo is not None else None
    return status.role, status.state, status.reason, status.modules, goal, ride, followed
