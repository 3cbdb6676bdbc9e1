"""How often a robot decides: at every step, or at every third one while nothing happens."""

from __future__ import annotations

from hitchhike_ros.protocol.status import Status

# So many steps in succession may be left out (chosen: with ten steps a second, what only time tells is noticed 0.3 s
# later at most; servoing stops a robot by itself).
_LEFT_OUT = 2


class Pace:
    """Says of each step in turn whether it is left out; never of more than two in succession."""

    def __init__(self) -> None:
        self._left_out = 0  # steps in succession

    def leaves_out(self, published: Status | None, following: str, waiting: bool) -> bool:
        """Whether this step is left out.

        Args:
            published: the newest status of the robot, None before the first.
            following: what servoing says that it does to follow, as :attr:`Status.following`.
            waiting: whether there are events that no step has taken yet.
        """
        leaves_out = self._left_out < _LEFT_OUT and not waiting and _is_quiet(published, following)
        self._left_out = self._left_out + 1 if leaves_out else 0
        return leaves_out


def _is_quiet(published: Status | None, following: str) -> bool:
    """Whether the robot rides, with its driver in sight, or has nothing to do."""
    if published is None:
        return False
    follows = published.state == "riding" and following == "following"
    return follows or (published.goal is None and published.servo is None)
