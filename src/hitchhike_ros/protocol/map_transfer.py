"""A 3D map on its way from a driver to its hitchhiker, in checked pieces over a network that loses and reorders.

The hitchhiker asks, the driver answers: what is lost is asked for again, and the driver remembers nothing of what it
sent. The map arrives whole, bit for bit, or not at all. Each side is stepped: messages in, messages out.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import msgspec

from hitchhike_ros.core.datatypes import Positive
from hitchhike_ros.protocol.messages import (
    LARGEST_MAP,
    LARGEST_PACKED,
    LARGEST_PIECE,
    LEAST_PIECE,
    MOST_ASKED,
    MapAck,
    MapMessage,
    MapOffer,
    MapPiece,
    MapRequest,
)

State = Literal["waiting", "moving", "arrived", "refused", "failed"]

# Maps whose pieces were all right and whose whole was not, and maps offered in place of another; after so many the
# driver is not asked again (chosen).
_MOST_SPOILT, _MOST_OFFERS = 3, 10


@dataclass(frozen=True)
class TransferParameters:
    """Section ``map_transfer``; all chosen.

    ``window`` pieces are asked for at a time, and again after ``retry_s`` without an answer. A side gives up when it
    has got nothing new for ``patience_s``.
    """

    piece_bytes: Annotated[int, msgspec.Meta(ge=LEAST_PIECE, le=LARGEST_PIECE)] = 4096
    window: Annotated[int, msgspec.Meta(ge=1, le=MOST_ASKED)] = 16
    retry_s: Annotated[float, msgspec.Meta(ge=0.01)] = 1.0
    patience_s: Positive = 60.0
    largest_packed: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_PACKED)] = LARGEST_PACKED
    largest_map: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_MAP)] = LARGEST_MAP


@dataclass(frozen=True)
class Transfer:
    """How a transfer stands, as one side knows it: JSON on ``map_3d/transfer``.

    ``map_id`` is the SHA-256 of the .bt file. ``seconds`` are from the first request to the end. ``messages`` and
    ``message_bytes`` are pieces sent or taken in, in base64 too; ``repeated`` of them had been sent or had come before;
    ``bad`` ones were dropped.
    """

    side: Literal["driver", "hitchhiker"]
    state: State
    robot_id: str
    other: str
    ride_id: str
    reason: str = ""
    map_id: str = ""
    map_bytes: int = 0
    packed_bytes: int = 0
    pieces: int = 0
    messages: int = 0
    repeated: int = 0
    bad: int = 0
    seconds: float = 0.0

    @property
    def over(self) -> bool:
        return self.state in ("arrived", "refused", "failed")


def map_id_of(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


class _Side:
    """What both sides keep: how it stands, and when the other was last heard."""

    def __init__(self, params: TransferParameters, transfer: Transfer, now: float) -> None:
        self.params, self.transfer = params, transfer
        self._began = self._progress_at = now
        self._newest: tuple[float, int] = (-math.inf, -1)

    def _is_of_this(self, message: MapMessage) -> bool:
        t = self.transfer
        return (message.robot_id, message.to) == (t.other, t.robot_id)

    def _overtaken(self, message: MapMessage) -> bool:
        """Whether a newer one of the same kind has been heard: what it wanted is out of date."""
        order = (message.time_stamp, message.seq)
        if order <= self._newest:
            return True
        self._newest = order
        return False

    def _end(self, state: State, now: float, reason: str = "") -> None:
        self.transfer = replace(self.transfer, state=state, reason=reason, seconds=now - self._began)

    def _give_up(self, now: float) -> bool:
        """Whether nothing has come for too long, for the first time; a clock that was set back starts anew."""
        self._progress_at = min(self._progress_at, now)
        if self.transfer.over or now < self._progress_at + self.params.patience_s:
            return False
        self._end("failed", now, f"nothing from {self.transfer.other} for {self.params.patience_s:g} s")
        return True


class MapSender(_Side):
    """The driver's side: has one map ready for one hitchhiker."""

    def __init__(
        self, params: TransferParameters, robot_id: str, hitchhiker: str, ride_id: str, content: bytes, now: float
    ) -> None:
        """``ride_id`` may be empty: the hitchhiker knows it.

        A map that is larger than may be sent is refused at once.
        """
        self._packed = zlib.compress(content, 9)
        count = -(-len(self._packed) // params.piece_bytes)
        transfer = Transfer(
            "driver",
            "waiting",
            robot_id,
            hitchhiker,
            ride_id,
            map_id=map_id_of(content),
            map_bytes=len(content),
            packed_bytes=len(self._packed),
            pieces=count,
        )
        super().__init__(params, transfer, now)
        self._sent: set[int] = set()
        self._nudged_at = -math.inf
        # So that the other side cannot make this one send for ever.
        self._most = 20 * count + 1000
        if len(content) > params.largest_map or len(self._packed) > params.largest_packed:
            self._end("refused", now, f"{len(content)} bytes, {len(self._packed)} compressed, are too many to send")

    def hear(self, message: MapMessage, now: float) -> list[MapMessage]:
        """Answers, in the order to send them; nothing to what is not meant for this transfer."""
        t = self.transfer
        if not self._is_of_this(message) or t.over or (t.ride_id and message.ride_id != t.ride_id):
            return []
        if isinstance(message, MapAck) and message.map_id == t.map_id:
            self._end("arrived" if message.arrived else "refused", now, message.reason)
        if not isinstance(message, MapRequest) or self._overtaken(message):
            return []
        if t.state == "waiting":
            self._began = now
        self._progress_at = now
        self.transfer = replace(t, state="moving", ride_id=message.ride_id)
        if message.map_id != t.map_id:
            return [self._offer()]
        return [piece for index in dict.fromkeys(message.pieces) if (piece := self._piece(index, now)) is not None]

    def step(self, now: float) -> list[MapMessage]:
        """Asks how it stands when a hitchhiker that has begun is quiet: what it said last may be lost."""
        if self._give_up(now) or now < self._nudge_at(now):
            return []
        self._nudged_at = now
        return [self._offer()]

    def next_due(self, now: float) -> float:
        """When :meth:`step` has something to do if nothing is heard; never after the end."""
        if self.transfer.over:
            return math.inf
        return min(self._nudge_at(now), self._progress_at + self.params.patience_s)

    def _nudge_at(self, now: float) -> float:
        """At once after the clock was set back."""
        last = max(self._progress_at, self._nudged_at)
        if self.transfer.state != "moving":
            return math.inf
        return last + self.params.retry_s if now >= last else now

    def _offer(self) -> MapOffer:
        t = self.transfer
        return MapOffer(
            robot_id=t.robot_id,
            to=t.other,
            ride_id=t.ride_id,
            map_id=t.map_id,
            map_bytes=t.map_bytes,
            packed_bytes=t.packed_bytes,
            piece_bytes=self.params.piece_bytes,
        )

    def _piece(self, index: int, now: float) -> MapPiece | None:
        t, size = self.transfer, self.params.piece_bytes
        data = self._packed[index * size : (index + 1) * size]
        if not data or t.over:
            return None
        if t.messages >= self._most:
            self._end("failed", now, f"{t.other} has asked for {self._most} pieces of {t.pieces}")
            return None
        self.transfer = replace(t, messages=t.messages + 1, repeated=t.repeated + (index in self._sent))
        self._sent.add(index)
        return MapPiece(
            robot_id=t.robot_id,
            to=t.other,
            ride_id=t.ride_id,
            map_id=t.map_id,
            index=index,
            crc32=zlib.crc32(data),
            data=data,
        )


class MapReceiver(_Side):
    """The hitchhiker's side: asks its driver for the map of one ride; ``content`` is it once it is whole."""

    def __init__(
        self,
        params: TransferParameters,
        robot_id: str,
        driver: str,
        ride_id: str,
        now: float,
        check: Callable[[bytes], str] = lambda _content: "",
    ) -> None:
        """``check`` says what is wrong with a map that has arrived, if anything: such a map is refused."""
        super().__init__(params, Transfer("hitchhiker", "waiting", robot_id, driver, ride_id), now)
        self.content: bytes | None = None
        self._check = check
        self._offer: MapOffer | None = None
        self._pieces: dict[int, bytes] = {}
        self._awaited: set[int] = set()
        self._asked_at = -math.inf
        self._spoilt = self._offers = 0

    def hear(self, message: MapMessage, now: float) -> list[MapMessage]:
        """Answers, in the order to send them; nothing to what is not meant for this transfer."""
        t = self.transfer
        if not self._is_of_this(message) or message.ride_id != t.ride_id:
            return []
        if t.over:
            return self._repeat_ack(message, now)
        if isinstance(message, MapOffer):
            return self._hear_offer(message, now)
        if isinstance(message, MapPiece) and self._offer is not None:
            return self._hear_piece(message, self._offer, now)
        return []

    def step(self, now: float) -> list[MapMessage]:
        """Asks, again where the answer has not come in time."""
        if self._give_up(now):
            self._pieces.clear()
            return self._ack(now)
        if self.transfer.over or now < self._ask_at(now):
            return []
        return self._ask(now)

    def next_due(self, now: float) -> float:
        """When :meth:`step` has something to do if nothing is heard; never after the end."""
        if self.transfer.over:
            return math.inf
        return min(self._ask_at(now), self._progress_at + self.params.patience_s)

    def _ask_at(self, now: float) -> float:
        """At once after the clock was set back."""
        return self._asked_at + self.params.retry_s if now >= self._asked_at else now

    def _ask(self, now: float) -> list[MapMessage]:
        t = self.transfer
        wanted: list[int] = []
        if self._offer is not None:
            wanted = [i for i in range(self._offer.pieces) if i not in self._pieces][: self.params.window]
        self._asked_at, self._awaited = now, set(wanted)
        return [MapRequest(robot_id=t.robot_id, to=t.other, ride_id=t.ride_id, map_id=t.map_id, pieces=tuple(wanted))]

    def _hear_offer(self, offer: MapOffer, now: float) -> list[MapMessage]:
        if self._overtaken(offer) or offer.map_id == self.transfer.map_id:
            return []
        # Also in place of the one before: the driver had to make its map anew.
        self._offer, self._progress_at = offer, now
        self._offers += 1
        self._pieces.clear()
        self.transfer = replace(
            self.transfer,
            state="moving",
            map_id=offer.map_id,
            map_bytes=offer.map_bytes,
            packed_bytes=offer.packed_bytes,
            pieces=offer.pieces,
        )
        if offer.packed_bytes > self.params.largest_packed or offer.map_bytes > self.params.largest_map:
            return self._refuse(now, f"{offer.map_bytes} bytes, {offer.packed_bytes} compressed, are too many")
        if self._offers > _MOST_OFFERS:
            return self._refuse(now, f"{self._offers} maps of one ride are too many")
        return self._ask(now)

    def _hear_piece(self, piece: MapPiece, offer: MapOffer, now: float) -> list[MapMessage]:
        if piece.map_id != offer.map_id:
            return []
        t = self.transfer = replace(self.transfer, messages=self.transfer.messages + 1)
        expected = min(offer.piece_bytes, offer.packed_bytes - piece.index * offer.piece_bytes)
        if len(piece.data) != expected or zlib.crc32(piece.data) != piece.crc32:
            self.transfer = replace(t, bad=t.bad + 1)
            return []
        self._awaited.discard(piece.index)
        if piece.index in self._pieces:
            self.transfer = replace(t, repeated=t.repeated + 1)
            return []
        self._pieces[piece.index] = piece.data
        self._progress_at = now
        if len(self._pieces) == offer.pieces:
            return self._unpack(offer, now)
        return [] if self._awaited else self._ask(now)

    def _unpack(self, offer: MapOffer, now: float) -> list[MapMessage]:
        packed = b"".join(self._pieces[i] for i in range(offer.pieces))
        self._pieces.clear()
        content = _unpacked(packed, offer.map_bytes)
        if content is None or map_id_of(content) != offer.map_id:
            self._spoilt += 1
            self.transfer = replace(self.transfer, bad=self.transfer.bad + offer.pieces)
            if self._spoilt >= _MOST_SPOILT:
                return self._refuse(now, f"{self._spoilt} times its pieces did not make up the map that was offered")
            return self._ask(now)
        if problem := self._check(content):
            return self._refuse(now, problem)
        self.content = content
        self._end("arrived", now)
        return self._ack(now)

    def _refuse(self, now: float, reason: str) -> list[MapMessage]:
        self._pieces.clear()
        self._end("refused", now, reason)
        return self._ack(now)

    def _ack(self, now: float) -> list[MapMessage]:
        t, self._asked_at = self.transfer, now
        if not t.map_id:
            return []
        ack = MapAck(
            robot_id=t.robot_id,
            to=t.other,
            ride_id=t.ride_id,
            map_id=t.map_id,
            arrived=t.state == "arrived",
            reason=t.reason,
        )
        return [ack]

    def _repeat_ack(self, message: MapMessage, now: float) -> list[MapMessage]:
        """The driver has not heard how it ended."""
        return self._ack(now) if isinstance(message, MapOffer | MapPiece) else []


def _unpacked(packed: bytes, size: int) -> bytes | None:
    """What zlib makes of it when that is ``size`` bytes, and never more in memory."""
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(packed, size + 1)
    except zlib.error:
        return None
    return content if len(content) == size and stream.eof and not stream.unused_data else None
