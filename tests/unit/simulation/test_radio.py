"""The radio between simulated robots: each effect as often as its parameter says; a seed repeats all of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.simulation.radio import COUNTED, NetworkModel, NetworkParameters, Partition, Radio

CLEAN = NetworkParameters()
SHARE = st.floats(0.0, 1.0)
SECONDS = st.floats(0.0, 10.0)
SEED = st.integers(0, 2**63)
NOISY = st.builds(
    NetworkParameters,
    delay_s=SECONDS, jitter_s=SECONDS, loss=SHARE, duplication=SHARE, reordering=SHARE, reorder_delay_s=SECONDS,
    seed=SEED,
)  # fmt: skip
# Of so many messages the share that meets an event of probability p is p ± 0.02 in all but one of 10,000 tests; the
# seeds of those here are fixed.
MANY = 10_000


def sent(params: NetworkParameters, times: Iterable[float], pair: str = "ab") -> list[tuple[float, ...]]:
    """What arrives of messages that one robot sends to another at these times."""
    model = NetworkModel(params)
    return [model.deliveries(t, pair[0], pair[1], 3.0) for t in times]


def share(events: Iterable[bool]) -> float:
    listed = list(events)
    return sum(listed) / len(listed)


@given(SECONDS, SEED)
def test_a_clean_network_only_delays(delay_s: float, seed: int) -> None:
    params = NetworkParameters(delay_s=delay_s, seed=seed)
    assert sent(params, range(50)) == [(t + delay_s,) for t in range(50)]


@pytest.mark.parametrize("p", [0.05, 0.3, 0.5, 0.9])
@pytest.mark.parametrize("seed", [0, 1, 2**40])
def test_frequencies(p: float, seed: int) -> None:
    params = replace(CLEAN, delay_s=0.5, seed=seed)
    lossy = sent(replace(params, loss=p), range(MANY))
    assert share(not copies for copies in lossy) == pytest.approx(p, abs=0.02)
    doubled = sent(replace(params, duplication=p), range(MANY))
    assert share(copies == (t + 0.5,) * 2 for t, copies in enumerate(doubled)) == pytest.approx(p, abs=0.02)
    reordered = sent(replace(params, reordering=p, reorder_delay_s=4.0), range(MANY))
    assert share(copies == (t + 4.5,) for t, copies in enumerate(reordered)) == pytest.approx(p, abs=0.02)
    both = sent(replace(params, loss=p, duplication=p), range(MANY))
    assert share(len(copies) == 2 for copies in both) == pytest.approx((1 - p) * p, abs=0.02)


@pytest.mark.parametrize(("p", "copies"), [("loss", 0), ("duplication", 2)])
def test_never_and_always(p: str, copies: int) -> None:
    assert {len(c) for c in sent(replace(CLEAN, **{p: 1.0}), range(MANY))} == {copies}
    assert {len(c) for c in sent(replace(CLEAN, jitter_s=1.0, **{p: 0.0}), range(MANY))} == {1}


def test_neither_losses_nor_copies_come_in_bursts() -> None:
    lossy = [not copies for copies in sent(replace(CLEAN, loss=0.3), range(MANY))]
    assert share(b for a, b in pairwise(lossy) if a) == pytest.approx(0.3, abs=0.03)
    assert share(b for a, b in pairwise(lossy) if not a) == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("jitter_s", [0.02, 3.0])
def test_jitter_is_uniform_and_each_copys_own(jitter_s: float) -> None:
    params = replace(CLEAN, delay_s=1.0, jitter_s=jitter_s, duplication=1.0)
    arrived = sent(params, [0.0] * MANY)
    late = [(t - 1.0) / jitter_s for copies in arrived for t in copies]
    assert min(late) >= 0.0
    assert max(late) <= 1.0
    for q in (0.1, 0.25, 0.5, 0.75, 0.9):
        assert share(value < q for value in late) == pytest.approx(q, abs=0.02)
    # Of two numbers of [0, 1) each, the smaller is 1/3 in the mean, and they differ by 1/3.
    assert sum((b - a) / jitter_s for a, b in arrived) / MANY == pytest.approx(1 / 3, abs=0.02)


@given(NOISY, st.lists(SECONDS, min_size=1, max_size=30))
def test_at_most_two_copies_in_order_and_within_the_delays(params: NetworkParameters, times: list[float]) -> None:
    for t, copies in zip(times, sent(params, times), strict=True):
        assert len(copies) <= 2
        assert list(copies) == sorted(copies)
        latest = t + params.delay_s + params.jitter_s + params.reorder_delay_s + 1e-9
        assert all(t + params.delay_s <= c <= latest for c in copies)


@given(NOISY, st.lists(SECONDS, min_size=2, max_size=30))
def test_without_jitter_and_reordering_messages_keep_their_order(params: NetworkParameters, times: list[float]) -> None:
    params = replace(params, jitter_s=0.0, reordering=0.0)
    arrived = [t for copies in sent(params, sorted(times)) for t in copies]
    assert arrived == sorted(arrived)


def test_reordered_messages_are_overtaken() -> None:
    arrived = sent(replace(CLEAN, reordering=0.2, reorder_delay_s=2.5), range(1000))
    overtaken = [t for t, later in pairwise(arrived) if t > later]
    assert 100 < len(overtaken) < 200  # every fifth, but for those whose next is late too


@given(NOISY, st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from("abcd")), max_size=60))
def test_a_pairs_luck_is_its_own(params: NetworkParameters, others: list[tuple[str, str]]) -> None:
    """Whatever others send, and in whatever order, what happens to a pair's messages stays the same."""
    model, times = NetworkModel(params), [0.5 * i for i in range(10)]
    expected, found = sent(params, times), []
    waiting = list(others)
    for t in times:
        for sender, receiver in waiting[:6]:
            if (sender, receiver) != ("a", "b"):
                model.deliveries(t, sender, receiver, 1.0)
        del waiting[:6]
        found.append(model.deliveries(t, "a", "b", 3.0))
    assert found == expected


@given(NOISY)
def test_seeds_repeat(params: NetworkParameters) -> None:
    assert sent(params, range(20)) == sent(params, range(20))


def test_seeds_and_pairs_differ() -> None:
    params = replace(CLEAN, loss=0.5)
    fates = {
        tuple(map(bool, sent(replace(params, seed=seed), range(64), pair)))
        for seed in range(20)
        for pair in ("ab", "ba", "ac", "bc")
    }
    assert len(fates) == 80


def test_the_stream_does_not_change_between_versions() -> None:
    """Or a seed that a report names would no longer show what it showed."""
    params = NetworkParameters(delay_s=0.2, jitter_s=0.1, loss=0.3, duplication=0.3, reordering=0.1, seed=7)
    found = [[round(t, 6) for t in copies] for copies in sent(params, [0.0] * 6)]
    assert found == [[0.264998, 1.22401], [1.270073], [], [0.207126], [0.203807], [0.291058]]


@given(SEED, st.lists(st.integers(0, 1000), min_size=2, max_size=6))
def test_more_loss_loses_more_of_the_same_messages(seed: int, permille: list[int]) -> None:
    """And duplication, jitter and reordering leave the losses as they are."""
    lost: set[int] = set()
    for p in sorted(permille):
        params = NetworkParameters(loss=p / 1000, seed=seed)
        now = {i for i, copies in enumerate(sent(params, range(100))) if not copies}
        assert now >= lost
        lost = now
        spoilt = replace(params, duplication=0.5, jitter_s=1.0, reordering=0.5)
        assert {i for i, copies in enumerate(sent(spoilt, range(100))) if not copies} == lost


@given(st.floats(0.0, 100.0), st.floats(0.0, 200.0))
def test_range(range_m: float, distance_m: float) -> None:
    model = NetworkModel(NetworkParameters(range_m=range_m))
    assert bool(model.deliveries(0.0, "a", "b", distance_m)) == (distance_m <= range_m)
    assert not model.deliveries(0.0, "a", "b", math.inf)
    assert not model.deliveries(0.0, "a", "b", math.nan)


def test_without_a_range_everybody_hears_everybody_but_itself() -> None:
    model = NetworkModel(CLEAN)
    assert model.deliveries(1.0, "a", "b", math.inf) == (1.0,)
    assert model.deliveries(1.0, "a", "a", 0.0) == ()


def test_what_is_out_of_reach_takes_nobodys_luck() -> None:
    params = NetworkParameters(range_m=10.0, loss=0.5)
    model, found = NetworkModel(params), []
    for t in range(50):
        assert model.deliveries(t, "a", "b", 11.0) == ()
        found.append(model.deliveries(t, "a", "b", 3.0))
    assert found == sent(params, range(50))


def test_partitions() -> None:
    partitions = (Partition(5.0, 10.0, (("a", "b"), ("c",))), Partition(8.0, 12.0, (("a",), ("b", "e"))))
    model = NetworkModel(NetworkParameters(partitions=partitions))

    def hear(now: float) -> set[str]:
        """Pairs, in both directions, that hear each other."""
        pairs = {"ab", "ac", "bc", "ad", "cd", "ae", "ce"}
        heard = {pair for pair in pairs if model.deliveries(now, pair[0], pair[1], 1.0)}
        assert heard == {pair for pair in pairs if model.deliveries(now, pair[1], pair[0], 1.0)}
        return heard

    everybody = {"ab", "ac", "bc", "ad", "cd", "ae", "ce"}
    assert hear(4.999) == everybody
    assert hear(5.0) == everybody - {"ac", "bc"}
    assert hear(8.0) == everybody - {"ac", "bc", "ab", "ae"}
    assert hear(10.0) == everybody - {"ab", "ae"}
    assert hear(12.0) == everybody


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"loss": 1.01}, "loss"),
        ({"loss": math.nan}, "loss"),
        ({"duplication": -0.1}, "duplication"),
        ({"reordering": "often"}, "reordering"),
        ({"delay_s": -1.0}, "delay_s"),
        ({"delay_s": math.inf}, "delay_s"),
        ({"jitter_s": math.nan}, "jitter_s"),
        ({"reorder_delay_s": math.inf}, "reorder_delay_s"),
        ({"range_m": -1.0}, "range_m"),
        ({"range_m": math.nan}, "range_m"),
        ({"seed": -1}, "seed"),
        ({"seed": 0.5}, "seed"),
        ({"partitions": (Partition(3.0, 3.0, (("a",), ("b",))),)}, r"partitions[0].end_s"),
        ({"partitions": (Partition(0.0, math.nan, (("a",), ("b",))),)}, r"partitions[0].end_s"),
        ({"partitions": (Partition(0.0, 3.0, (("a", "b"),)),)}, r"partitions[0].groups"),
        ({"partitions": (Partition(0.0, 3.0, (("a", "b"), ("b",))),)}, r"partitions[0].groups"),
    ],
)
def test_bad_parameters(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(ParameterError) as caught:
        NetworkModel(replace(CLEAN, **changes), "radio.yaml")
    assert caught.value.file == "radio.yaml"
    assert caught.value.field == field
    assert "expected" in str(caught.value)


def test_parameters_as_a_file_has_them() -> None:
    given_ = {"loss": "0.3", "partitions": [{"begin_s": 1, "end_s": 2, "groups": [["a"], ["b", "c"]]}]}
    params = load_parameters(NetworkParameters, "network", overrides=given_)
    assert params == NetworkParameters(loss=0.3, partitions=(Partition(1.0, 2.0, (("a",), ("b", "c"))),))
    assert NetworkModel(params).params == params


def radio(start_s: float = 0.0, max_waiting: int = 100, **network: Any) -> Radio[str]:
    return Radio(NetworkModel(NetworkParameters(**network)), ["a", "b", "c"], max_waiting, start_s)


def heard(air: Radio[str], now: float) -> list[tuple[str, str]]:
    return list(air.arrived(now))


def test_all_but_the_sender_hear_a_message_when_its_time_has_come() -> None:
    air = radio(delay_s=2.0)
    for robot in "abc":
        air.place(robot, 0.0, 0.0)
    air.send(10.0, "b", "first")
    air.send(11.0, "a", "second")
    assert (heard(air, 11.9), air.waiting) == ([], 4)
    assert heard(air, 12.5) == [("a", "first"), ("c", "first")]
    assert air.latest_s == pytest.approx(0.5)
    assert heard(air, 13.0) == [("b", "second"), ("c", "second")]
    assert heard(air, 99.0) == []
    assert air.totals() == {**dict.fromkeys(COUNTED, 0), "sent": 4, "delivered": 4}


def test_who_is_far_away_or_has_not_been_seen_hears_nothing() -> None:
    air = radio(range_m=5.0)
    air.place("a", 0.0, 0.0)
    air.place("b", 3.0, 4.0)
    air.send(1.0, "a", "hello")
    assert heard(air, 1.0) == [("b", "hello")]
    air.place("b", 3.0, 4.1)
    air.send(2.0, "a", "hello")
    assert heard(air, 2.0) == []
    assert air.counts["out_of_reach", "a", "c"] == 2
    assert air.counts["out_of_reach", "a", "b"] == 1


def test_copies_are_counted_and_the_air_may_be_full() -> None:
    air = radio(max_waiting=3, duplication=1.0, delay_s=1.0)
    for robot in "abc":
        air.place(robot, 0.0, 0.0)
    air.send(0.0, "a", "x")
    assert air.totals() == {"sent": 2, "delivered": 0, "lost": 0, "doubled": 2, "out_of_reach": 0, "overflowed": 1}
    well, text, values = air.diagnosis()
    assert (well, text) == (False, "1 copies more than ~max_waiting")
    assert (values["waiting"], values["doubled_a_to_b"], values["latest_s"]) == (3, 1, "0.000")
    assert [receiver for receiver, _ in heard(air, 1.0)] == ["b", "b", "c"]
    assert radio().diagnosis()[:2] == (True, "running")


def test_what_is_lost_is_counted() -> None:
    air = radio(loss=1.0)
    for robot in "abc":
        air.place(robot, 0.0, 0.0)
    air.send(0.0, "a", "x")
    assert (heard(air, 9.0), air.totals()["lost"]) == ([], 2)


def test_a_clock_that_jumps_back_ends_what_is_under_way() -> None:
    air = radio(delay_s=5.0)
    for robot in "abc":
        air.place(robot, 0.0, 0.0)
    air.send(100.0, "a", "old")
    assert heard(air, 1.0) == []
    air.send(2.0, "a", "new")
    assert {text for _, text in heard(air, 200.0)} == {"new"}


def test_partitions_count_from_the_start() -> None:
    partition = Partition(10.0, 20.0, (("a",), ("b", "c")))
    air = radio(start_s=1.7e9, delay_s=0.5, partitions=(partition,))
    for robot in "abc":
        air.place(robot, 0.0, 0.0)
    air.send(1.7e9 + 5.0, "a", "before")
    assert heard(air, 1.7e9 + 5.4) == []
    assert heard(air, 1.7e9 + 5.5) == [("b", "before"), ("c", "before")]
    air.send(1.7e9 + 15.0, "a", "apart")
    assert heard(air, 1.7e9 + 16.0) == []
    air.send(1.7e9 + 20.0, "a", "after")
    assert len(heard(air, 1.7e9 + 21.0)) == 2
