"""How often a robot decides: at every step, or at every other one while nothing happens."""

from __future__ import annotations

from hitchhike_ros.protocol.status import Status


class Pace:
    """Says of each step in turn whether it is left out; never of two in succession."""

    def __init__(self) -> None:
        self._left_out = False  # the step before

    def leaves_out(self, published: Status | None, following: str, waiting: bool) -> bool:
        """Whether this step is left out.

        Args:
            published: the newest status of the robot, None before the first.
            following: what servoing says that it does to follow, as :attr:`Status.following`.
            waiting: whether there are events that no step has taken yet.
        """
        self._left_out = not self._left_out and not waiting and _is_quiet(published, following)
        return self._left_out


def _is_quiet(published: Status | None, following: str) -> bool:
    """Whether the robot rides, with its driver in sight, or has nothing to do."""
    if published is None:
        return False
    follows = published.state == "riding" and following == "following"
    return follows or (published.goal is None and published.servo is None)
