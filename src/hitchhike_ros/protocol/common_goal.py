"""Who has a place that several robots want, by a rule that is the same on all of them (P17 §3.1, P18 §5).

The best case of the papers is one goal for both robots, and two bodies cannot stand there. Robots judge by what their
beacons say, their own as well as the others', so that all who have heard both come to the same end.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hitchhike_ros.core.datatypes import FloatArray, Pose2D
from hitchhike_ros.planning.free_place import FreePlace, Occupied, nearest_free_place, taken_by
from hitchhike_ros.protocol.messages import Beacon
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.status import phase_of

# Who has what is settled when a robot is so near to its goal (chosen: ten seconds of driving, so beacons that are lost
# come again in time).
SETTLED_WITHIN_M = 6.0
# In these phases a robot stands, with a goal of its own elsewhere.
_STANDING = (Phase.ASKING, Phase.COUPLING)


def stands(beacon: Beacon) -> bool:
    """Whether the robot stays where it is: it has no goal, or waits for another robot."""
    return beacon.goal is None or phase_of(beacon.state) in _STANDING


def goes_first(one: Beacon, other: Beacon) -> bool:
    """Whether ``one`` keeps a place that ``other`` wants too.

    Who stands there keeps it; then a driver comes before its hitchhikers; then who is nearer along its way; then who
    comes first by name. Who does not say how near it is (a rider does not localize) is far away.
    """
    if stands(one) != stands(other):
        return stands(one)
    if (one.robot_id == other.driver) != (other.robot_id == one.driver):
        return one.robot_id == other.driver
    if one.left_m is None or other.left_m is None:
        return (one.left_m is not None, other.robot_id) > (other.left_m is not None, one.robot_id)
    return (one.left_m, one.robot_id) < (other.left_m, other.robot_id)


def occupied(own: Beacon, others: Iterable[Beacon]) -> list[Occupied]:
    """The places that others take up, as far as they go before the robot that says ``own``."""
    found = []
    for other in others:
        place = other.pose if stands(other) else other.goal if goes_first(other, own) else None
        if place is not None:
            found.append(Occupied(other.robot_id, place, other.radius_m))
    return found


def same_place(goal: Pose2D, radius_m: float, other: Pose2D | None, other_radius_m: float) -> bool:
    """Whether two robots cannot both be where they want to be."""
    return other is not None and taken_by(goal, radius_m, [Occupied("", other, other_radius_m)]) is not None


@dataclass(frozen=True)
class Yield:
    """A goal is left to ``to``: this robot stops at ``place``."""

    to: str
    place: FreePlace

    def says(self) -> str:
        """In words, for whoever wanted the robot at the goal."""
        return f"{self.to}, {self.place.before_m:.1f} m before it"


def settle(path: FloatArray, goal: Pose2D, radius_m: float, occupied: list[Occupied]) -> Yield | None:
    """Where a robot of ``radius_m`` stops on its ``path`` (N, 2) to ``goal``; None where the goal is its own."""
    holder = taken_by(goal, radius_m, occupied)
    return None if holder is None else Yield(holder.by, nearest_free_place(path, radius_m, occupied))
