"""The door for network messages: what is garbage, foreign or old never reaches the machines."""

from __future__ import annotations

from collections import Counter, deque

from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.messages import EVERYBODY, Beacon, MapMessage, Message, decode

# So many of its own messages a robot knows again when they come back to it (chosen).
_OWN = 1000


class Inbox:
    """Decodes what is meant for one robot and counts what it drops, by cause."""

    def __init__(self, robot_id: str) -> None:
        self.dropped: Counter[str] = Counter()
        self._robot_id = robot_id
        # Of each sender's beacons, and of all else that it says: a beacon tells where a robot is, and overtakes nothing
        # that is asked or answered. Time first: a robot that restarts counts from anew.
        self._newest: dict[tuple[str, bool], tuple[float, int]] = {}
        self._own: deque[tuple[float, int]] = deque(maxlen=_OWN)  # the newest first, as it is what comes back

    def sent(self, message: Message) -> None:
        """The robot has sent this; from then on what comes in its name and is none of its own is noticed."""
        self._own.appendleft((message.time_stamp, message.seq))

    def receive(self, text: str) -> Message | None:
        """The message, or None where it is the robot's own, meant for another, or of the transfer of a map.

        Another node of a robot sends its map: what that says has its own ``seq``, and overtakes nothing said here.

        Raises:
            MessageError: it is unreadable, has been seen before, or is another robot's that has the same id; it is
                counted in ``dropped``.
        """
        try:
            message = decode(text)
        except MessageError:
            self.dropped["unreadable"] += 1
            raise
        if isinstance(message, MapMessage):
            return None
        order = (message.time_stamp, message.seq)
        if message.robot_id == self._robot_id:
            if self._own and order not in self._own:
                self.dropped["own_id"] += 1
                raise MessageError(
                    f"{message.type}: another robot is called {self._robot_id} too, expected ids to differ"
                )
            return None
        if message.to not in (self._robot_id, EVERYBODY):
            return None
        stream = message.robot_id, isinstance(message, Beacon)
        if stream in self._newest and order <= self._newest[stream]:
            self.dropped["replayed"] += 1
            raise MessageError(
                f"{message.type}: seq {message.seq} at {message.time_stamp} of {message.robot_id} "
                f"is not newer than its last"
            )
        self._newest[stream] = order
        return message
