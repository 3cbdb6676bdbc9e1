"""The door for network messages."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.messages import Beacon, Lock, Message, encode
from protocol_helpers import DRIVER, RIDER, messages

LOCK = replace(messages(RIDER, DRIVER)[Lock], seq=5, time_stamp=100.0)


def _receive(inbox: Inbox, *changes: dict[str, object]) -> list[Message | None]:
    return [inbox.receive(encode(replace(LOCK, **c))) for c in changes]


def test_what_is_for_this_robot_or_everybody_comes_in() -> None:
    received = _receive(Inbox(DRIVER), {}, {"seq": 6, "to": "*"}, {"seq": 1, "robot_id": "other"})
    assert all(isinstance(message, Lock) for message in received)


def test_its_own_and_foreign_messages_stay_out_without_a_complaint() -> None:
    inbox = Inbox(DRIVER)
    assert _receive(inbox, {"robot_id": DRIVER, "to": "*"}, {"to": "other"}) == [None, None]
    assert not inbox.dropped


def test_another_robot_of_the_same_name_is_noticed_and_counted() -> None:
    inbox = Inbox(DRIVER)
    own = replace(LOCK, robot_id=DRIVER, to="*")
    inbox.sent(own)
    assert inbox.receive(encode(own)) is None
    for stranger in (replace(own, seq=6), replace(own, time_stamp=99.0)):
        with pytest.raises(MessageError, match=f"another robot is called {DRIVER} too"):
            inbox.receive(encode(stranger))
    assert inbox.dropped == {"own_id": 2}


@pytest.mark.parametrize("changes", [{}, {"seq": 4}, {"seq": 4, "time_stamp": 99.0}, {"seq": 6, "time_stamp": 99.0}])
def test_replayed_and_overtaken_messages_are_dropped_and_counted(changes: dict[str, object]) -> None:
    inbox = Inbox(DRIVER)
    _receive(inbox, {})
    with pytest.raises(MessageError, match=f"of {RIDER} is not newer"):
        _receive(inbox, changes)
    assert inbox.dropped == {"replayed": 1}


def test_a_beacon_overtakes_no_question_and_no_question_a_beacon() -> None:
    inbox, beacon = Inbox(DRIVER), messages(RIDER, DRIVER)[Beacon]
    for seq, time_stamp in ((6, 100.0), (9, 101.0)):
        assert isinstance(inbox.receive(encode(replace(beacon, seq=seq, time_stamp=time_stamp))), Beacon)
    assert _receive(inbox, {})[0] is not None
    assert _receive(inbox, {"seq": 12, "time_stamp": 102.0})[0] is not None
    assert inbox.receive(encode(replace(beacon, seq=11, time_stamp=101.5))) is not None
    with pytest.raises(MessageError):
        inbox.receive(encode(replace(beacon, seq=10, time_stamp=101.2)))
    assert inbox.dropped == {"replayed": 1}


def test_a_robot_that_restarts_and_counts_anew_is_heard_but_its_past_is_not() -> None:
    inbox = Inbox(DRIVER)
    assert _receive(inbox, {}, {"seq": 0, "time_stamp": 130.0})[1] is not None
    with pytest.raises(MessageError):
        _receive(inbox, {"seq": 9, "time_stamp": 101.0})


def test_unreadable_messages_are_dropped_and_counted() -> None:
    inbox = Inbox(DRIVER)
    for text in ("", "{", '{"version": 7}'):
        with pytest.raises(MessageError):
            inbox.receive(text)
    assert inbox.dropped == {"unreadable": 3}
