"""Records a run: takes what is heard and measured of it, and keeps what scoring needs.

The composed simulation and the node ``ride_monitor`` record through the same object, so that both are scored alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hitchhike_ros.core.datatypes import Contact, MarkerObservation, Obstacle, Pose2D, PoseEstimate, Positive
from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.robot_model import mount
from hitchhike_ros.experiments.scenarios.ride_record import (
    ClockSample,
    CpuSample,
    MemorySample,
    RideRecord,
    RobotRecord,
    StepSample,
    TimedEstimate,
    TimedPose,
    TimedSighting,
    TimedText,
    TrafficSample,
)
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.world_file import RobotEntry, WorldFile

WATCHERS = ("/ride_monitor", "/record", "/rviz")
"""Nodes that only look on: what is sent to them is no cost of a robot's."""
_ESSENTIAL = frozenset(
    {
        *("hitchhike_comm", "map_server", "network_model", "obstacle_avoidance", "path_planning", "robot"),
        *("simulator", "slam", "velocity_mux", "visual_servoing"),
    }
)

Sample = Literal["nodes", "cpu", "memory", "traffic"]


@dataclass(frozen=True)
class SamplingParameters:
    """How often a run is sampled, in wall time (chosen): seldom where an answer costs the node that is asked."""

    look_s: Positive = 0.2  # at what is recorded, to show it and to see the end
    nodes_s: Positive = 1.0  # which nodes there are
    cpu_s: Positive = 0.4
    memory_s: Positive = 5.0
    traffic_s: Positive = 4.0
    answer_timeout_s: Positive = 2.0  # of a node that is asked; one that hangs is asked again next time

    def period_s(self, what: Sample) -> float:
        return {"nodes": self.nodes_s, "cpu": self.cpu_s, "memory": self.memory_s, "traffic": self.traffic_s}[what]


class Sampling:
    """Says when the next sample of a kind is due."""

    def __init__(self, params: SamplingParameters) -> None:
        self.params = params
        self._due_at: dict[Sample, float] = {}

    def due(self, what: Sample, wall_s: float) -> bool:
        """Whether to take that sample at ``wall_s``; whoever asks takes it."""
        if wall_s < self._due_at.get(what, wall_s):
            return False
        self._due_at[what] = wall_s + self.params.period_s(what)
        return True

    def hurry(self, what: Sample) -> None:
        """Let the next sample of this kind be due at once."""
        self._due_at.pop(what, None)


class RideRecorder:
    """A record that grows. It has no lock: several threads feed it under one of theirs."""

    def __init__(self, record: RideRecord) -> None:
        self.record = record
        self._switched = False

    @classmethod
    def of_world(cls, world: WorldFile, seed: int, package: Path) -> RideRecorder:
        """For a run in ``world``; ``package`` is the folder with the robots' URDFs.

        Raises:
            RobotModelError: a robot has no camera or no marker.
        """
        robots = {name: _robot(entry, package) for name, entry in world.robots.items()}
        return cls(RideRecord(world.path.name.split(".")[0], seed, world.boxes, robots))

    def truth(self, robot: str, stamp: float, pose: Pose2D) -> None:
        """Where the robot was."""
        self.record.robots[robot].truth.append(TimedPose(stamp, pose.x, pose.y, pose.theta))

    def estimate(self, robot: str, estimate: PoseEstimate) -> None:
        """Where the robot took itself to be."""
        self.record.robots[robot].estimates.append(TimedEstimate.of(estimate))

    def initial_pose(self, robot: str, estimate: PoseEstimate) -> None:
        """The pose that an operator or its driver gave the robot."""
        self.record.robots[robot].initial_poses.append(TimedEstimate.of(estimate))

    def status(self, robot: str, status: Status) -> None:
        """What the robot reported."""
        self._switched |= self.record.robots[robot].add_status(status)

    def switched(self) -> bool:
        """Whether since it was last asked a robot reported more than other times, metres and feed-forward."""
        switched, self._switched = self._switched, False
        return switched

    def award(self, robot: str, award: Award) -> None:
        """What the robot earned as a driver."""
        self.record.robots[robot].awards.append(award)

    def obstacles(self, robot: str, boxes: Iterable[Obstacle]) -> None:
        """All new boxes in the robot's map as it is now."""
        self.record.robots[robot].obstacles = tuple(boxes)

    def markers(self, robot: str, seen: Iterable[MarkerObservation]) -> None:
        """Markers that the robot's camera saw, in base_footprint."""
        self.record.robots[robot].sightings += [
            TimedSighting(s.stamp, s.pose.x, s.pose.y, s.pose.theta, s.marker_id) for s in seen
        ]

    def message(self, stamp: float, text: str) -> None:
        """A message that a robot sent to the others."""
        self.record.messages.append(TimedText(stamp, text))

    def contact(self, contact: Contact) -> None:
        """A robot touched something."""
        self.record.contacts.append(contact)

    def simulator(self, stamp: float, values: Mapping[str, str]) -> None:
        """The simulator's newest diagnostics."""
        self.record.simulator = dict(values)
        if "steps" in values and "late_steps" in values:
            self.record.steps.append(StepSample(stamp, int(values["steps"]), int(values["late_steps"])))

    def clock(self, stamp: float, wall_s: float) -> None:
        """Simulated time and wall time at one moment."""
        self.record.clock.append(ClockSample(stamp, wall_s))

    def memory(self, sample: MemorySample) -> None:
        """What a node's process takes of the machine's memory."""
        self.record.memory.append(sample)

    def cpu(self, sample: CpuSample) -> None:
        """What a node has used so far."""
        self.record.cpu.append(sample)

    def traffic(self, sample: TrafficSample) -> None:
        """What has gone through a node's connections so far."""
        self.record.traffic.append(sample)


def missed(gone: Iterable[str]) -> list[str]:
    """Of nodes that have ended, those without which a ride cannot go on."""
    return [node for node in gone if node.rpartition("/")[2] in _ESSENTIAL]


def _robot(entry: RobotEntry, package: Path) -> RobotRecord:
    urdf = package / "urdf" / f"{entry.model}.urdf"
    camera, marker = (pose_from_matrix(mount(urdf, link)) for link in ("camera", "marker"))
    return RobotRecord(camera, marker, has_goal=entry.goal is not None)
