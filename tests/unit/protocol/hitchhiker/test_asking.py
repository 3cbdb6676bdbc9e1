"""Offers, denials and the choice of a hitchhiker that asks for a ride."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scipy.spatial.distance import cdist

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.hitchhiker.asking import Asking, Choice
from hitchhike_ros.protocol.messages import EVERYBODY, Accept, Beacon
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import Ending, Reason
from protocol_helpers import RIDER_GOAL, SITES, WEST, messages

PARAMS = HitchhikingParameters(mode="network", beacon_period_s=1.0, robot_timeout_s=3.0)
NO = Ending(Reason.PATH_TOO_SHORT)


def _offer(driver: str, **changes: object) -> Accept:
    offer = messages(driver)[Accept]
    assert isinstance(offer, Accept)
    return replace(offer, **changes)


def _neighbours(now: float, **free_places: int) -> Neighbours:
    neighbours = Neighbours()
    for robot, places in free_places.items():
        beacon = messages(robot)[Beacon]
        assert isinstance(beacon, Beacon)
        neighbours.hear(replace(beacon, free_places=places), now)
    return neighbours


def test_offers_are_kept_until_they_are_taken_back() -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    for now, driver in ((10.5, "a"), (10.6, "b"), (10.7, "a")):
        asking.note_offer(_offer(driver), now)
    assert {driver: at for driver, (_, at) in asking.offers.items()} == {"a": 10.7, "b": 10.6}
    asking.note_denial("a", NO)
    assert list(asking.offers) == ["b"]
    assert asking.told == NO


def test_offers_are_dropped_once_and_the_one_that_is_taken_needs_no_cancel() -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    for driver in ("a", "b", "c"):
        asking.note_offer(_offer(driver), 10.5)
    assert asking.drop_offers(but_of="b") == ["a", "c"]
    assert asking.drop_offers() == []


def test_it_remembers_why_the_request_before_came_to_nothing() -> None:
    why = Ending(Reason.LOCK_NOT_CONFIRMED)
    assert Asking(PARAMS, 10.0, 3.0, told=why).told == why
    assert not Asking(PARAMS, 10.0, 3.0).told


def test_it_has_heard_enough_when_the_window_closes_though_nobody_answered() -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    neighbours = _neighbours(12.9, a=1)
    assert not asking.heard_enough(12.9, neighbours)
    assert asking.heard_enough(13.0, neighbours)


@pytest.mark.parametrize("how", ["offer", "denial", "question"])
def test_it_has_heard_enough_when_all_drivers_have_answered_in_whatever_way(how: str) -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    neighbours = _neighbours(11.4, a=1, b=2, full=0)
    asking.note_offer(_offer("a"), 11.2)
    assert not asking.heard_enough(11.5, neighbours)
    if how == "offer":
        asking.note_offer(_offer("b"), 11.5)
    elif how == "denial":
        asking.note_denial("b", NO)
    else:
        asking.note_question("b")
    assert asking.heard_enough(11.5, neighbours)  # "full" drives nobody and need not answer


def test_for_a_beacon_period_all_robots_are_awaited() -> None:
    """A robot that got its goal a moment ago offers places only from its next beacon on."""
    asking = Asking(PARAMS, 10.0, 3.0)
    neighbours = _neighbours(10.2, a=1, new=0)
    asking.note_offer(_offer("a"), 10.3)
    assert not asking.heard_enough(10.9, neighbours)
    assert asking.heard_enough(11.0, neighbours)


def test_a_robot_that_has_fallen_silent_is_not_awaited() -> None:
    asking = Asking(PARAMS, 10.0, 9.0)
    neighbours = _neighbours(10.0, gone=1)
    neighbours.hear(messages("a")[Beacon], 12.0)
    asking.note_offer(_offer("a"), 12.0)
    assert not asking.heard_enough(13.0, neighbours)
    assert asking.heard_enough(13.1, neighbours)


def test_one_answer_at_least_is_awaited() -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    assert not asking.heard_enough(12.0, Neighbours())
    asking.note_denial("a", NO)
    assert asking.heard_enough(12.0, Neighbours())


def test_a_question_to_one_robot_waits_for_that_one_alone() -> None:
    asking = Asking(PARAMS, 10.0, 9.0, "chosen")
    neighbours = _neighbours(11.0, chosen=1, other=1)
    asking.note_offer(_offer("other"), 11.0)
    assert not asking.heard_enough(12.0, neighbours)
    asking.note_denial("chosen", NO)
    assert asking.heard_enough(12.0, neighbours)
    assert Asking(PARAMS, 10.0, 9.0, EVERYBODY).heard_enough(19.0, neighbours)


def test_the_best_offer_is_chosen_with_its_meeting() -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    asking.note_offer(_offer("poor", profile=20.0), 10.5)
    asking.note_offer(_offer("good", profile=80.0), 10.5)
    asking.choose(WEST.waiting_pose, RIDER_GOAL, 0.0, 11.0, SITES, cdist)
    choice = asking.choice
    assert choice is not None and choice.meeting is not None
    assert (choice.offer.robot_id, choice.meeting.driver, choice.meeting.point) == ("good", "good", WEST)
    assert choice.ride_m == choice.meeting.ride_m != choice.offer.ride_m


def test_where_driving_alone_is_better_none_is_chosen() -> None:
    asking = Asking(PARAMS, 10.0, 3.0)
    asking.note_offer(_offer("a"), 10.5)
    asking.choose(WEST.waiting_pose, Pose2D(2.5, 5.72), 0.0, 11.0, SITES, cdist)
    assert asking.choice is None


def test_a_ride_that_was_not_arranged_from_afar_is_as_long_as_its_offer_says() -> None:
    assert Choice(_offer("a", ride_m=12.5)).ride_m == 12.5
