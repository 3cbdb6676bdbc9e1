"""What hitchhike_comm tells the modules of its own robot: which are on, where to drive, whom to follow.

One latched JSON object on ``hhike_msg/status`` is the only place this is said (P17 Fig. 8).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec

from hitchhike_ros.core.datatypes import NonNegative, Pose2D, Positive, Side, TeleopMode
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.reasons import Ending


@dataclass(frozen=True)
class ModuleSwitches:
    """On and off of P17 Table 3: path planning, obstacle avoidance, localization, mapping, communication, servoing."""

    PP: bool = True
    OBS: bool = True
    LZN: bool = True
    MAP: bool = True
    COM: bool = True
    VS: bool = False


@dataclass(frozen=True)
class GoalCommand:
    """Where the robot drives to by itself now; a new ``id`` is a new order.

    With ``along_wall`` it only turns where it stands, parallel to the wall on that side; ``theta`` is then rough.
    """

    id: str
    x: float
    y: float
    theta: float
    tolerance_m: Positive = 0.10
    tolerance_rad: Positive = 0.087
    along_wall: Side | None = None

    @property
    def pose(self) -> Pose2D:
        return Pose2D(self.x, self.y, self.theta)


# As the marker of a ServoCommand: whichever there are.
ANY_MARKER = -1


@dataclass(frozen=True)
class ServoCommand:
    """What the camera is for: ``follow`` drives behind the marker, ``observe`` only reports markers.

    ``marker_pose`` is where the marker is mounted on the driver, in its ``base_footprint``, where it has said so. The
    driver told the speed ``feed_forward_mps`` at ``feed_forward_at`` in s, on this robot's clock. That the same speed
    was told again makes no new order: it stands in the next status.
    """

    task: str
    marker_id: int
    marker_size_m: Positive = 0.16
    gap_m: Positive = 0.8
    feed_forward_mps: float = 0.0
    feed_forward_at: float | None = field(default=None, compare=False)
    marker_pose: Pose2D | None = None


@dataclass(frozen=True)
class KnownRobot:
    """Another robot where its messages say it is, so that it is not taken for a new obstacle."""

    x: float
    y: float
    radius_m: Positive


@dataclass(frozen=True)
class RideStatus:
    """The ride as this robot knows it; a hitchhiker counts whole metres of it."""

    ride_id: str
    driver: str
    hitchhiker: str
    ride_m: NonNegative = 0.0
    ridden_m: NonNegative = 0.0


_PHASES: dict[str, Phase] = {state.value: state.phase for state in (*DriverState, *HitchhikerState)}


def phase_of(state: str) -> Phase | None:
    """Of a state's name on the wire; None where this package has no such state."""
    return _PHASES.get(state)


_RIDES = (Phase.COUPLED, Phase.RETURNING, Phase.HANDING_OVER)


@dataclass(frozen=True)
class Status:
    """The whole of ``hhike_msg/status``."""

    time_stamp: float
    robot_id: str
    role: str = "none"
    state: str = "idle"
    phase: Phase = field(init=False, default=Phase.ALONE)  # of the state
    reason: str = ""
    modules: ModuleSwitches = field(default_factory=ModuleSwitches)
    goal: GoalCommand | None = None
    speed_limit_mps: Positive | None = None
    servo: ServoCommand | None = None
    following: str = ""  # what servoing does to follow: following, or coasting, looking, turning, searching, stopped
    ride: RideStatus | None = None
    convoy: tuple[str, ...] = ()  # who rides with this robot, in the order of their places
    robots: tuple[KnownRobot, ...] = ()

    def __post_init__(self) -> None:
        """Look the phase up.

        Raises:
            ValueError: there is no such state.
        """
        if self.state not in _PHASES:
            raise ValueError(f"state is {self.state!r}, expected one of {', '.join(_PHASES)}")
        object.__setattr__(self, "phase", _PHASES[self.state])

    @property
    def ending(self) -> Ending:
        """Why the robot is in its state."""
        return Ending.told(self.reason)

    @property
    def carries_rider(self) -> bool:
        """Whether the robot drives with a hitchhiker coupled behind it, and so drives gently."""
        return self.role == "driver" and self.phase is Phase.COUPLED

    @property
    def rides(self) -> bool:
        """Whether the robot is coupled to its driver, or was and wants to be again."""
        return self.role == "hitchhiker" and self.phase in _RIDES

    @property
    def teleop_mode(self) -> TeleopMode:
        """What a human who teleoperates the robot may do to it now.

        A driver is guided on its way, alone or with its riders. Where it aligns it drives by itself, elsewhere it
        stands.
        """
        if self.goal is not None and self.phase in (Phase.ALONE, Phase.COUPLED) and self.role != "hitchhiker":
            return "guided"
        return "free" if self.goal is None and self.role == "none" and self.state == "idle" else "off"


# Made once: msgspec crashes when two threads ask for the decoder of a type at the same time for the first time.
_DECODER = msgspec.json.Decoder(Status)


def encode_status(status: Status) -> str:
    """``status`` as JSON."""
    return msgspec.json.encode(status).decode()


def decode_status(text: str) -> Status:
    """The status in a JSON text; raises MessageError where it is none."""
    try:
        return _DECODER.decode(text)
    except msgspec.MsgspecError as exc:
        raise MessageError(f"hhike_msg/status: {exc}") from exc
