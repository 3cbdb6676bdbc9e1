"""Inputs and orders have an age beyond which they no longer count."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.errors import StaleInputError
from hitchhike_ros.modules.module import ORDER_MAX_AGE_S, Fresh, Orders
from hitchhike_ros.protocol.events import GoalCancelled
from hitchhike_ros.protocol.status import Status


@pytest.mark.parametrize("now", [10.0, 10.9, 9.0])  # the clock of who stamped it may be a little ahead
def test_a_value_counts_up_to_its_age(now: float) -> None:
    fresh = Fresh[int]("pose", 1.0)
    fresh.put(7, 10.0)
    assert fresh.at(now) == fresh.get(now) == fresh.newest == 7
    assert fresh.expires() == 11.0


@pytest.mark.parametrize(
    ("now", "reason"), [(11.0, "no pose for 1.0 s"), (11.5, "no pose for 1.5 s"), (5.0, "no pose for 5.0 s")]
)
def test_an_old_value_does_not_count_and_the_error_says_what_is_missing(now: float, reason: str) -> None:
    fresh = Fresh[int]("pose", 1.0)
    fresh.put(7, 10.0)
    assert fresh.get(now) is None
    with pytest.raises(StaleInputError, match=reason):
        fresh.at(now)


@given(stamp=st.floats(-1e9, 2e9), age=st.floats(1e-3, 1e3))
def test_at_its_expiry_a_value_has_expired(stamp: float, age: float) -> None:
    fresh = Fresh[int]("pose", age)
    fresh.put(7, stamp)
    assert fresh.get(fresh.expires()) is None
    assert fresh.get(math.nextafter(fresh.expires(), -math.inf)) == 7 or fresh.expires() == stamp


def test_nothing_counts_before_the_first_value_or_after_it_was_forgotten() -> None:
    fresh = Fresh[int]("scan", 1.0)
    with pytest.raises(StaleInputError, match=r"no scan$"):
        fresh.at(0.0)
    fresh.put(7, 10.0)
    fresh.clear()
    assert fresh.get(10.0) is None
    assert fresh.expires() == math.inf


def test_a_value_that_is_nothing_is_a_value() -> None:
    fresh = Fresh[bool]("hand", 1.0)
    fresh.put(False, 10.0)
    assert fresh.at(10.0) is False


def test_an_order_that_is_not_repeated_ends() -> None:
    orders, status = Orders(), Status(0.0, "p3dx")
    orders.put(status, 10.0)
    orders.put(GoalCancelled(), 13.0)
    assert orders.at(9.9 + ORDER_MAX_AGE_S) is status
    assert orders.expires() == 10.0 + ORDER_MAX_AGE_S
    with pytest.raises(StaleInputError, match="no status for"):
        orders.at(orders.expires())
    assert orders.newest() is status


def test_a_standing_order_holds_for_ever_and_nothing_else_is_obeyed() -> None:
    standing = Status(0.0, "alone")
    orders = Orders(standing)
    orders.put(Status(5.0, "p3dx"), 5.0)
    assert orders.at(1e9) is orders.newest() is standing
    assert orders.expires() == math.inf
