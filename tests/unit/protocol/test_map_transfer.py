"""A map arrives bit for bit or not at all, whatever the network and a stranger do on the way."""

from __future__ import annotations

import heapq
import json
import random
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from hitchhike_ros.core.errors import MessageError, ParameterError
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.map_transfer import MapReceiver, MapSender, TransferParameters, map_id_of
from hitchhike_ros.protocol.messages import (
    LARGEST_PIECE,
    MAP_MESSAGES,
    MapAck,
    MapMessage,
    MapOffer,
    MapPiece,
    MapRequest,
    Request,
    decode,
    encode,
)
from hitchhike_ros.simulation.radio import NetworkModel, NetworkParameters
from protocol_helpers import DRIVER, RIDER, messages

PARAMS = TransferParameters(piece_bytes=1024, window=8, retry_s=1.0, patience_s=30.0)
HEAD: dict[str, Any] = {"robot_id": DRIVER, "to": RIDER, "ride_id": "ride"}
CONTENT = random.Random(7).randbytes(20_000)
STEP_S = 0.1
NEAR = NetworkParameters(delay_s=0.05)


class Link:
    """Both sides and a network between them, as text, on one clock."""

    def __init__(
        self,
        content: bytes = CONTENT,
        network: NetworkParameters = NEAR,
        tamper: Callable[[MapMessage], list[MapMessage]] = lambda message: [message],
        **of_receiver: Any,
    ) -> None:
        self.sender = MapSender(PARAMS, DRIVER, RIDER, "", content, 0.0)
        self.receiver = MapReceiver(replace(PARAMS, **of_receiver), RIDER, DRIVER, "ride", 0.0)
        self.model, self.tamper = NetworkModel(network), tamper
        self.said: list[MapMessage] = []
        self.most_held = 0
        self._under_way: list[tuple[float, int, str, str]] = []

    def run(self, limit_s: float = 200.0) -> None:
        """Until both sides are over, or the limit."""
        now = 0.0
        while now < limit_s and not (self.sender.transfer.over and self.receiver.transfer.over):
            now += STEP_S
            for side in (self.receiver, self.sender):
                due = side.next_due(now)
                said = side.step(now)
                assert said == [] or due <= now
                assert side.next_due(now) > now
                self.say(said, now)
            while self._under_way and self._under_way[0][0] <= now:
                _, _, to, text = heapq.heappop(self._under_way)
                message = decode(text)
                assert isinstance(message, MapMessage)
                side = self.sender if to == DRIVER else self.receiver
                self.say(side.hear(message, now), now)
            self.most_held = max(self.most_held, sum(map(len, self.receiver._pieces.values())))

    def say(self, said: list[MapMessage], now: float) -> None:
        for one in said:
            for message in self.tamper(one):
                self.said.append(message)
                stamped = replace(message, seq=len(self.said), time_stamp=now)
                for at in self.model.deliveries(now, message.robot_id, message.to, 0.0):
                    heapq.heappush(self._under_way, (at, len(self.said), message.to, encode(stamped)))

    @property
    def states(self) -> tuple[str, str]:
        return self.sender.transfer.state, self.receiver.transfer.state


def test_a_map_arrives_and_both_sides_know_and_count_the_same() -> None:
    link = Link()
    link.run()
    assert link.receiver.content == CONTENT
    sent, got = link.sender.transfer, link.receiver.transfer
    assert (sent.state, got.state) == ("arrived", "arrived")
    assert sent.map_id == got.map_id == map_id_of(CONTENT)
    assert (sent.map_bytes, sent.packed_bytes, sent.pieces) == (got.map_bytes, got.packed_bytes, got.pieces)
    assert sent.pieces == sent.messages == got.messages == 20
    assert (got.repeated, got.bad, sent.repeated) == (0, 0, 0)
    assert 0.0 < sent.seconds <= got.seconds < 3.0
    assert Counter(m.type for m in link.said) == {"map_request": 4, "map_offer": 1, "map_piece": 20, "map_ack": 1}


@pytest.mark.parametrize("size", [1, 1023, 1024, 1025, 8 * 1024, 100_000])
def test_every_size_arrives(size: int) -> None:
    content = random.Random(size).randbytes(size)
    link = Link(content)
    link.run()
    assert link.receiver.content == content


@pytest.mark.parametrize("seed", range(60))
def test_loss_copies_and_overtaking_cost_time_only(seed: int) -> None:
    rng = random.Random(seed)
    network = NetworkParameters(
        loss=rng.choice((0.1, 0.3, 0.5)),
        duplication=rng.choice((0.0, 0.3)),
        reordering=rng.choice((0.0, 0.3)),
        reorder_delay_s=rng.choice((0.3, 3.0)),
        delay_s=rng.choice((0.0, 0.2, 0.9)),
        jitter_s=rng.choice((0.0, 0.3)),
        seed=seed,
    )
    content = rng.randbytes(rng.randrange(1, 60_000))
    link = Link(content, network)
    link.run(600.0)
    assert link.receiver.content == content
    assert link.states == ("arrived", "arrived")
    assert link.sender.transfer.messages <= 20 * link.sender.transfer.pieces + 1000


@pytest.mark.parametrize("seed", range(10))
def test_a_network_that_breaks_down_leaves_nothing_of_a_map(seed: int) -> None:
    begin = random.Random(seed).uniform(0.0, 1.5)
    split: Any = {"begin_s": begin, "end_s": 1e9, "groups": ((DRIVER,), (RIDER,))}
    link = Link(
        network=load_parameters(NetworkParameters, "network", overrides={"delay_s": 0.1, "partitions": [split]})
    )
    link.run()
    whole = link.receiver.content
    assert whole in (None, CONTENT)
    assert link.receiver.transfer.state == ("arrived" if whole else "failed")
    assert link.sender.transfer.state in ("arrived", "failed")
    assert not link.receiver._pieces
    if not whole:
        assert f"nothing from {DRIVER} for 30 s" == link.receiver.transfer.reason


def test_a_short_silence_is_bridged() -> None:
    split: Any = {"begin_s": 0.3, "end_s": 20.0, "groups": ((DRIVER,), (RIDER,))}
    link = Link(
        network=load_parameters(NetworkParameters, "network", overrides={"delay_s": 0.1, "partitions": [split]})
    )
    link.run()
    assert link.receiver.content == CONTENT
    assert link.receiver.transfer.seconds > 20.0


def damage(seed: int, often: float) -> Callable[[MapMessage], list[MapMessage]]:
    """Some pieces get other bytes, without or with a matching checksum, another index or another length."""
    rng = random.Random(seed)

    def tamper(message: MapMessage) -> list[MapMessage]:
        if not isinstance(message, MapPiece) or rng.random() >= often:
            return [message]
        data = bytearray(message.data)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        forged = rng.choice(
            (
                replace(message, data=bytes(data)),
                replace(message, crc32=message.crc32 ^ 1),
                replace(message, data=message.data[:-1] or b"x", crc32=zlib.crc32(message.data[:-1] or b"x")),
                replace(message, data=message.data + b"x", crc32=zlib.crc32(message.data + b"x")),
                replace(message, index=16_000),
                replace(message, map_id="0" * 64),
            )
        )
        return [forged]

    return tamper


@pytest.mark.parametrize("seed", range(20))
def test_damaged_pieces_are_dropped_counted_and_asked_for_again(seed: int) -> None:
    link = Link(tamper=damage(seed, 0.3))
    link.run()
    assert link.receiver.content == CONTENT
    assert 0 < link.receiver.transfer.bad <= link.receiver.transfer.messages


def test_a_forged_piece_with_the_right_checksum_spoils_the_map_but_never_passes() -> None:
    left = 1

    def tamper(message: MapMessage) -> list[MapMessage]:
        nonlocal left
        if isinstance(message, MapPiece) and message.index == 3 and left:
            left -= 1
            data = bytes(len(message.data))
            return [replace(message, data=data, crc32=zlib.crc32(data))]
        return [message]

    link = Link(tamper=tamper)
    link.run()
    assert link.receiver.content == CONTENT, "the second time"
    assert link.receiver.transfer.bad == link.receiver.transfer.pieces
    left = 1000
    link = Link(tamper=tamper)
    link.run()
    assert link.receiver.content is None
    assert link.states == ("refused", "refused")
    assert "3 times its pieces did not make up the map" in link.sender.transfer.reason


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"map_bytes": 1 << 26}, "are too many"),
        ({"packed_bytes": 1 << 24}, "are too many"),
        ({"map_bytes": 19_999}, "did not make up"),
        ({"map_bytes": 20_001}, "did not make up"),
        ({"map_id": "ab" * 32}, "nothing from"),
    ],
)
def test_what_an_offer_says_falsely_is_found_out(change: dict[str, Any], text: str) -> None:
    def tamper(message: MapMessage) -> list[MapMessage]:
        return [replace(message, **change) if isinstance(message, MapOffer) else message]

    link = Link(tamper=tamper, largest_map=1 << 20, largest_packed=1 << 20)
    link.run()
    assert link.receiver.content is None
    assert link.receiver.transfer.state in ("refused", "failed")
    assert text in link.receiver.transfer.reason
    assert link.sender.transfer.over


def test_a_bomb_is_not_unpacked() -> None:
    """64 MB of zeros are 64 kB: it takes what was announced and no more."""
    content = bytes(1 << 26)

    def tamper(message: MapMessage) -> list[MapMessage]:
        return [replace(message, map_bytes=1000) if isinstance(message, MapOffer) else message]

    link = Link(content, tamper=tamper)
    link.run()
    assert link.receiver.content is None
    assert link.receiver.transfer.state == "refused"
    assert link.most_held < 100_000


def test_what_is_too_large_is_not_sent() -> None:
    sender = MapSender(replace(PARAMS, largest_map=19_999), DRIVER, RIDER, "ride", CONTENT, 0.0)
    assert sender.transfer.state == "refused"
    assert sender.hear(MapRequest(robot_id=RIDER, to=DRIVER, ride_id="ride"), 0.1) == []


def test_a_map_that_does_not_hold_what_it_should_is_refused_and_the_driver_hears_why() -> None:
    link = Link()
    link.receiver = MapReceiver(PARAMS, RIDER, DRIVER, "ride", 0.0, lambda content: f"{len(content)} bytes of noise")
    link.run()
    assert link.receiver.content is None
    assert link.states == ("refused", "refused")
    assert link.sender.transfer.reason == "20000 bytes of noise"


def test_maps_without_end_are_refused() -> None:
    receiver = MapReceiver(PARAMS, RIDER, DRIVER, "ride", 0.0)
    said: list[MapMessage] = []
    for i in range(20):
        offer = MapOffer(**HEAD, map_id=f"{i:064x}", map_bytes=9, packed_bytes=9, piece_bytes=1024, time_stamp=float(i))
        said += receiver.hear(offer, float(i))
    assert receiver.transfer.state == "refused"
    assert isinstance(said[10], MapAck)
    assert "too many" in said[10].reason


def test_a_newer_map_takes_the_place_of_the_one_under_way() -> None:
    link = Link(CONTENT[::-1])
    link.run(0.4)
    assert link.receiver.transfer.state == "moving"
    link.sender = MapSender(PARAMS, DRIVER, RIDER, "ride", CONTENT, 0.4)
    link.run()
    assert link.receiver.content == CONTENT
    assert link.states == ("arrived", "arrived")


def test_strangers_and_other_rides_are_not_heard() -> None:
    data = b"x"
    sender = MapSender(PARAMS, DRIVER, RIDER, "ride", CONTENT, 0.0)
    receiver = MapReceiver(PARAMS, RIDER, DRIVER, "ride", 0.0)
    for head in ({"robot_id": "ghost"}, {"to": "ghost"}, {"to": "*"}, {"ride_id": "other"}):
        to_driver = {**HEAD, "robot_id": RIDER, "to": DRIVER, **head}
        for asked in (MapRequest(**to_driver), MapAck(**to_driver, map_id=map_id_of(CONTENT), arrived=True)):
            assert sender.hear(asked, 0.1) == []
        offer = MapOffer(**{**HEAD, **head}, map_id="a" * 64, map_bytes=1, packed_bytes=1, piece_bytes=1024)
        piece = MapPiece(**{**HEAD, **head}, map_id="a" * 64, index=0, crc32=zlib.crc32(data), data=data)
        assert receiver.hear(offer, 0.1) == receiver.hear(piece, 0.1) == []
    assert sender.transfer.state == receiver.transfer.state == "waiting"
    assert sender.hear(MapRequest(robot_id=RIDER, to=DRIVER, ride_id="ride"), 0.2) != []


def test_requests_come_again_without_an_effect_and_no_request_makes_it_send_for_ever() -> None:
    sender = MapSender(PARAMS, DRIVER, RIDER, "ride", CONTENT, 0.0)
    request = MapRequest(
        robot_id=RIDER,
        to=DRIVER,
        ride_id="ride",
        seq=5,
        time_stamp=1.0,
        map_id=map_id_of(CONTENT),
        pieces=(1, 1, 2, 99),
    )
    assert [m.index for m in sender.hear(request, 1.0) if isinstance(m, MapPiece)] == [1, 2]
    assert sender.hear(request, 1.1) == sender.hear(replace(request, seq=4), 1.1) == []
    sent = sum(len(sender.hear(replace(request, seq=6 + i), 1.2)) for i in range(10_000))
    assert sent <= 20 * 20 + 1000
    assert sender.transfer.state == "failed"
    assert "has asked for" in sender.transfer.reason


def test_a_lost_last_word_is_asked_for() -> None:
    lost = 3

    def tamper(message: MapMessage) -> list[MapMessage]:
        nonlocal lost
        if isinstance(message, MapAck) and lost:
            lost -= 1
            return []
        return [message]

    link = Link(tamper=tamper)
    link.run()
    assert link.states == ("arrived", "arrived")
    assert link.sender.transfer.seconds < 12.0


def test_nobody_there() -> None:
    link = Link()
    link.model = NetworkModel(NetworkParameters(loss=1.0))
    link.run()
    assert link.states == ("failed", "failed")
    # It asks once a second and stops.
    assert {m.type for m in link.said} == {"map_request"}
    assert 28 <= len(link.said) <= 30


def test_a_clock_that_is_set_back_ends_nothing() -> None:
    receiver = MapReceiver(PARAMS, RIDER, DRIVER, "ride", 1000.0)
    assert len(receiver.step(1000.1)) == 1
    assert len(receiver.step(3.0)) == 1
    assert receiver.step(32.9) != []
    assert receiver.step(33.1) == []
    assert receiver.transfer.state == "failed"


EXAMPLES: tuple[MapMessage, ...] = (
    MapRequest(**HEAD, map_id="0f" * 32, pieces=(0, 5)),
    MapOffer(**HEAD, map_id="0f" * 32, map_bytes=10, packed_bytes=5000, piece_bytes=1024),
    MapPiece(**HEAD, map_id="0f" * 32, index=2, crc32=7, data=b"\x00\xff\n"),
    MapAck(**HEAD, map_id="0f" * 32, arrived=False, reason="disk full"),
)


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: message.type)
def test_every_message_survives_the_network(message: MapMessage) -> None:
    assert decode(encode(message)) == message
    assert {type(m) for m in EXAMPLES} == set(MAP_MESSAGES.values())


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("map_request", "map_id", "0f"),
        ("map_request", "map_id", "0F" * 32),
        ("map_request", "pieces", [-1]),
        ("map_request", "pieces", [1 << 20]),
        ("map_request", "pieces", list(range(65))),
        ("map_offer", "map_id", ""),
        ("map_offer", "map_bytes", 0),
        ("map_offer", "map_bytes", 1 << 40),
        ("map_offer", "packed_bytes", (1 << 24) + 1),
        ("map_offer", "piece_bytes", 0),
        ("map_offer", "piece_bytes", 1),
        ("map_offer", "piece_bytes", 1 << 20),
        ("map_piece", "index", -1),
        ("map_piece", "index", "nan"),
        ("map_piece", "crc32", 1 << 32),
        ("map_piece", "data", ""),
        ("map_piece", "data", "no base64!"),
        ("map_piece", "data", [1, 2]),
        ("map_piece", "data", "A" * (LARGEST_PIECE * 4 // 3 + 8)),
        ("map_ack", "arrived", "perhaps"),
        ("map_ack", "map_id", None),
    ],
)
def test_senseless_messages_are_refused(kind: str, field: str, value: object) -> None:
    content = json.loads(encode(next(message for message in EXAMPLES if message.type == kind)))
    with pytest.raises(MessageError, match=kind):
        decode(json.dumps({**content, field: value}))
    del content[field]
    if field != "pieces" and (kind, field) != ("map_request", "map_id"):
        with pytest.raises(MessageError, match=kind):
            decode(json.dumps(content))


@pytest.mark.parametrize("name", ["piece_bytes", "window", "retry_s", "patience_s", "largest_packed", "largest_map"])
def test_senseless_parameters_are_refused(name: str) -> None:
    for value in (0, -1, 1 << 40 if not name.endswith("_s") else "soon"):
        with pytest.raises(ParameterError, match=name):
            load_parameters(TransferParameters, "map_transfer", overrides={name: value})


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: message.type)
def test_maps_disturb_no_ride(message: MapMessage) -> None:
    """Two nodes of one robot speak, each with a count of its own; the machines' inbox hears one of them."""
    inbox = Inbox(RIDER)
    request = replace(messages(DRIVER, RIDER)[Request], seq=5, time_stamp=100.0)
    inbox.sent(replace(request, robot_id=RIDER, to=DRIVER))
    assert inbox.receive(encode(replace(message, seq=10**9, time_stamp=200.0))) is None
    assert inbox.receive(encode(replace(message, seq=1, time_stamp=1.0, robot_id=RIDER))) is None
    assert inbox.receive(encode(request)) == request
    assert inbox.receive(encode(replace(message, seq=1, time_stamp=1.0))) is None
    assert not inbox.dropped
