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
        self._newest: dict[str, int] = {}

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
        if message.seq <= self._newest.get(message.robot_id, -1):
            self.dropped["replayed"] += 1
            raise MessageError(f"{message.type}: seq {message.seq} of {message.robot_id} is not newer than the last")
        self._newest[message.robot_id] = message.seq
        return message
