"""What happens to a robot in the protocol, what it knows then, and what it wants done.

Events are network messages and the classes here; effects come back from every step, for whoever hosts the machines.
"""

from __future__ import annotations

from dataclasses import dataclass

from hitchhike_ros.core.datatypes import MarkerObservation, Obstacle, Pose2D, PoseEstimate
from hitchhike_ros.protocol.messages import Message
from hitchhike_ros.protocol.reasons import NONE, Ending, Reason

# Events, beside the network messages themselves.


@dataclass(frozen=True)
class GoalGiven:
    """Somebody wants this robot at ``goal`` in ``map``.

    ``why`` it gets the goal now, where a ride came to nothing; ``set_down``: it comes from a ride.
    """

    goal: Pose2D
    why: Ending = NONE
    set_down: bool = False


@dataclass(frozen=True)
class GoalCancelled:
    """The goal is withdrawn: stop."""


@dataclass(frozen=True)
class GoalReport:
    """What a module says of the goal it was given; whose report it is, the type tells."""

    goal_id: str
    state: str
    reason: str = ""


@dataclass(frozen=True)
class NavigationReport(GoalReport):
    """How driving to a goal fares: ``state`` is idle, driving, arrived, blocked or failed."""


@dataclass(frozen=True, eq=False)
class Situation:
    """What the robot's own modules know now; None where a module is off or has not spoken."""

    estimate: PoseEstimate | None = None
    speed_mps: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    navigation: NavigationReport | None = None
    observation: MarkerObservation | None = None
    seen_from: Pose2D | None = None  # own pose in ``odom`` when that observation was made
    odom_pose: Pose2D | None = None  # own pose in ``odom`` now
    following: str = ""  # what servoing does with the driver, in its words
    yaw_rate_rps: float = 0.0

    def stands(self, most_mps: float, most_rps: float) -> bool:
        """Whether the robot neither drives nor turns faster than that."""
        return abs(self.speed_mps) <= most_mps and abs(self.yaw_rate_rps) <= most_rps


@dataclass(frozen=True, eq=False)
class Tick:
    """Time has passed; the situation is this."""

    situation: Situation


# Effects.


@dataclass(frozen=True)
class Send:
    """Broadcast this message; the outbox of the robot numbers and stamps it."""

    message: Message


@dataclass(frozen=True, eq=False)
class TakePose:
    """Localization starts from this estimate."""

    estimate: PoseEstimate


@dataclass(frozen=True)
class TakeObstacles:
    """Mapping adds these boxes to the robot's own map."""

    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True)
class Award:
    """The driver earned points for a ride (P17 §5)."""

    ride_id: str
    hitchhiker: str
    ride_m: float
    points: float


@dataclass(frozen=True)
class Report:
    """Something an operator wants to read; ``reason`` is what it is about, where that is one of the known reasons."""

    text: str
    reason: Reason = Reason.NONE


Effect = Send | TakePose | TakeObstacles | Award | Report
