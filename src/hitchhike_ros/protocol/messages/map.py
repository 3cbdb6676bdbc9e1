"""The messages by which a 3D map is handed over after a ride (P17 §7.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import msgspec

from hitchhike_ros.protocol.messages.fields import Message

# Of the transfer of a 3D map (chosen): bytes of a piece before base64, pieces asked for at a time, and bytes of the
# whole, compressed and not.
LEAST_PIECE, LARGEST_PIECE, MOST_ASKED = 1 << 10, 1 << 15, 64
LARGEST_PACKED, LARGEST_MAP = 1 << 24, 1 << 26
_MOST_PIECES = LARGEST_PACKED // LEAST_PIECE
MapId = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
PieceIndex = Annotated[int, msgspec.Meta(ge=0, lt=_MOST_PIECES)]


@dataclass(frozen=True, kw_only=True)
class MapMessage(Message):
    """What two nodes mapping_3d say to each other (P17 §7.4); the machines of the ride do not hear it.

    ``ride_id`` is that of the ride on which the map was made. A map's id is the SHA-256 of its .bt file.
    """


@dataclass(frozen=True, kw_only=True)
class MapRequest(MapMessage):
    """The hitchhiker asks which map there is, or, with the ``map_id`` of an offer, for pieces of that one."""

    type = "map_request"

    map_id: Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{64})?$")] = ""
    pieces: Annotated[tuple[PieceIndex, ...], msgspec.Meta(max_length=MOST_ASKED)] = ()


@dataclass(frozen=True, kw_only=True)
class MapOffer(MapMessage):
    """The driver has a map of ``map_bytes``, in zlib's format ``packed_bytes``, in pieces of ``piece_bytes``."""

    type = "map_offer"

    map_id: MapId
    map_bytes: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_MAP)]
    packed_bytes: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_PACKED)]
    piece_bytes: Annotated[int, msgspec.Meta(ge=LEAST_PIECE, le=LARGEST_PIECE)]

    @property
    def pieces(self) -> int:
        """How many there are; the last may be shorter than the others."""
        return -(-self.packed_bytes // self.piece_bytes)


@dataclass(frozen=True, kw_only=True)
class MapPiece(MapMessage):
    """Bytes of a packed map from ``index`` times its ``piece_bytes`` on, base64 in JSON, and their CRC-32."""

    type = "map_piece"

    map_id: MapId
    index: PieceIndex
    crc32: Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]
    data: Annotated[bytes, msgspec.Meta(min_length=1, max_length=LARGEST_PIECE)]


@dataclass(frozen=True, kw_only=True)
class MapAck(MapMessage):
    """The hitchhiker has the map, whole; or it does not want it, or no longer, with the reason."""

    type = "map_ack"

    map_id: MapId
    arrived: bool
    reason: str = ""
