"""How often a robot decides: at every step, or at every second or third one while nothing happens."""

from __future__ import annotations

from hitchhike_ros.protocol.status import Status

# How many steps in succession, of ten a second, are left out where a robot rides with its driver in sight, and where it
# has nothing to do or asks for a ride: who drives past is asked each second, of which three steps are no part (chosen).
_RIDING, _IDLE = 2, 1


class Pace:
    """Says of each step in turn whether it is left out."""

    def __init__(self) -> None:
        self._left_out = 0  # steps in succession

    def leaves_out(self, published: Status | None, following: str, waiting: bool) -> bool:
        """Whether this step is left out.

        Args:
            published: the newest status of the robot, None before the first.
            following: what servoing says that it does to follow, as :attr:`Status.following`.
            waiting: whether there are events that no step has taken yet.
        """
        leaves_out = not waiting and self._left_out < _may_leave_out(published, following)
        self._left_out = self._left_out + 1 if leaves_out else 0
        return leaves_out


def _may_leave_out(published: Status | None, following: str) -> int:
    """How many steps in succession."""
    if published is None:
        return 0
    if published.state == "riding" and following == "following":
        return _RIDING
    return _IDLE if published.goal is None and published.servo is None else 0
