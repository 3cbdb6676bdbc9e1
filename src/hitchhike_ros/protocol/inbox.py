"""The door for network messages: what is garbage, foreign or old never reaches the machines."""

from __future__ import annotations

from collections import Counter

from hitchhike_ros.errors import MessageError
from hitchhike_ros.protocol.messages import EVERYBODY, Message, decode


class Inbox:
    """Decodes what is meant for one robot and counts what it drops, by cause."""

    def __init__(self, robot_id: str) -> None:
        self.dropped: Counter[str] = Counter()
        self._robot_id = robot_id
        # Time first: a robot that restarts counts from anew.
        self._newest: dict[str, tuple[float, int]] = {}

    def receive(self, text: str) -> Message | None:
        """The message, or None where it is the robot's own or meant for another.

        Raises:
            MessageError: it is unreadable or has been seen before; it is counted in ``dropped``.
        """
        try:
            message = decode(text)
        except MessageError:
            self.dropped["unreadable"] += 1
            raise
        if message.robot_id == self._robot_id or message.to not in (self._robot_id, EVERYBODY):
            return None
        order = (message.time_stamp, message.seq)
        if message.robot_id in self._newest and order <= self._newest[message.robot_id]:
            self.dropped["replayed"] += 1
            raise MessageError(
                f"{message.type}: seq {message.seq} at {message.time_stamp} of {message.robot_id} "
                f"is not newer than its last"
            )
        self._newest[message.robot_id] = order
        return message
