"""Which frames of a hitchhiker's camera are kept of a ride, as P17 Fig. 13 shows it, and how their files are called."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.protocol.status import Status

FOLDER = "frames"

# Of one ride, and of one robot in all (chosen: a few pictures a ride, however often it is tried).
_MOST_A_RIDE, _MOST = 12, 48
# A frame after so many metres of the ride, and fewer on long rides (chosen).
_SPACING_M, _SPACINGS = 5.0, 5
# After servoing is switched on: it subscribes first, so that nobody waits for its answers to frames it did not ask for.
_SERVOING_STARTS_S = 0.5
# Nothing is to be seen of a step that lasts for one exchange of messages.
_UNSEEN = frozenset({"locking"})
_NAME = re.compile(r"(\d+\.\d+)-(\w+)-(\w+)\.jpg")


@dataclass(frozen=True)
class KeptFrameParameters:
    """How a frame is kept (chosen)."""

    width_px: int = 320
    quality: int = 80  # of JPEG, to 100
    timeout_s: float = 5.0  # wall time; a camera that sends nothing is left alone

    def size(self, shape: Sequence[int]) -> tuple[int, int]:
        """Width and height in pixels at which an image of ``shape`` (H, W, ...) is kept."""
        return self.width_px, round(self.width_px * shape[0] / shape[1])


@dataclass(frozen=True)
class CameraFrame:
    """A camera frame that was kept."""

    stamp: float
    robot: str
    state: str
    path: Path


class FramePlan:
    """When to keep a frame of one robot: at each new step of a hitchhiker, and on the way."""

    def __init__(self) -> None:
        self._taken: dict[str, int] = {}
        self._seen: set[tuple[str, str]] = set()
        self._rode = self._servoing = False
        self._servoing_at = 0.0
        self._next_m = 0.0

    def due(self, status: Status, ridden_m: float, now: float) -> bool:
        """Whether to take a frame at ``now``, with the robot's newest ``status`` and after ``ridden_m`` of its ride.

        Whoever asks takes it: each step counts once.
        """
        rides, rode = status.role == "hitchhiker", self._rode
        self._rode = rides
        if status.modules.VS and not self._servoing:
            self._servoing_at = status.time_stamp
        self._servoing = status.modules.VS
        ride_id = status.ride.ride_id if status.ride is not None else ""
        step = (ride_id, status.state)
        new = (rides and step not in self._seen and status.state not in _UNSEEN) or (rode and not rides)
        ride_m = status.ride.ride_m if status.ride is not None else 0.0
        if new and status.modules.VS and now < self._servoing_at + _SERVOING_STARTS_S:
            return False
        if new and status.state == "riding":
            self._next_m = _spacing(ride_m)
        on_the_way = rides and status.state == "riding" and not new and ridden_m >= self._next_m
        if on_the_way:
            self._next_m += _spacing(ride_m)
        if not (new or on_the_way):
            return False
        self._seen.add(step)
        if self._taken.get(ride_id, 0) >= _MOST_A_RIDE or sum(self._taken.values()) >= _MOST:
            return False
        self._taken[ride_id] = self._taken.get(ride_id, 0) + 1
        return True


def frames_due(record: RideRecord, plans: Mapping[str, FramePlan], now: float) -> dict[str, str]:
    """Of the robots that have a plan those of whose camera a frame is to be kept at ``now``, and their states."""
    due = {}
    for name, plan in plans.items():
        status = record.robots[name].newest_status
        if status is not None and plan.due(status, record.ridden_m(name), now):
            due[name] = status.state
    return due


def frame_name(stamp: float, robot: str, state: str) -> str:
    """A file's name; names sort as their stamps."""
    return f"{stamp:08.2f}-{robot}-{state}.jpg"


def find_frames(folder: Path) -> list[CameraFrame]:
    """The frames that a run left in its ``folder``, in order of time."""
    found = []
    for path in sorted((folder / FOLDER).glob("*.jpg")):
        match = _NAME.fullmatch(path.name)
        if match is not None:
            found.append(CameraFrame(float(match[1]), match[2], match[3], path))
    return found


def _spacing(ride_m: float) -> float:
    return max(_SPACING_M, ride_m / _SPACINGS)
