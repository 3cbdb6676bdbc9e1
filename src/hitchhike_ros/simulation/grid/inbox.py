"""An inbox for messages that come as objects."""

from __future__ import annotations

from collections import Counter

from hitchhike_ros.protocol.messages import Message


class ObjectInbox:
    """Drops what is old, as :class:`hitchhike_ros.protocol.inbox.Inbox` does with messages that come as text."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self._newest: dict[str, tuple[float, int]] = {}
        self._newest_beacon: dict[str, tuple[float, int]] = {}

    def receive(self, message: Message) -> Message | None:
        """A message that is no beacon; None if it is old."""
        return message if self._is_new(self._newest, message.robot_id, (message.time_stamp, message.seq)) else None

    def is_new(self, sender: str, order: tuple[float, int]) -> bool:
        """Whether a beacon, by its (time_stamp, seq), is newer than those before."""
        return self._is_new(self._newest_beacon, sender, order)

    def _is_new(self, known: dict[str, tuple[float, int]], sender: str, order: tuple[float, int]) -> bool:
        newest = known.get(sender)
        if newest is not None and order <= newest:
            self.dropped["replayed"] += 1
            return False
        known[sender] = order
        return True
