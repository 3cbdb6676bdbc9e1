"""Sums over a node's connections, from what the slave APIs of rospy and roscpp answer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import psutil
import pytest

from hitchhike_ros.nodes.sim.processes import Traffic, TrafficCounter, _peak_mb, pss_mb

# As rospy answered: /rosout, /odom to two nodes of which one records; /clock in.
ROSPY = [
    [["/rosout", 0, [[1, 1256, 0, True]]], ["/odom", 5000, [[2, 3000, 7, True], [3, 2000, 5, True]]]],
    [["/clock", [[4, 657, 26, -1, True]]]],
    [],
]
INFO = [
    [1, "/rosout", "o", "TCPROS", "/rosout", True, ""],
    [2, "/slam", "o", "TCPROS", "/odom", True, ""],
    [3, "/record", "o", "TCPROS", "/odom", True, ""],
    [4, "http://localhost:44885/", "i", "TCPROS", "/clock", True, ""],
]


def info() -> Sequence[Sequence[Any]]:
    return INFO


def test_everything_is_summed_but_what_goes_to_watchers() -> None:
    counter = TrafficCounter(watchers=("/record",))
    counter.update(ROSPY, info)
    assert counter.total == Traffic(26, 657, 7, 4256)


def test_without_watchers_nobody_is_asked_who_listens() -> None:
    counter = TrafficCounter()
    counter.update(ROSPY, lambda: pytest.fail("asked"))
    assert counter.total == Traffic(26, 657, 12, 6256)


def test_a_connection_that_closed_still_counts_and_a_new_one_adds() -> None:
    counter = TrafficCounter(watchers=("/record",))
    counter.update(ROSPY, info)
    asked = []
    later = [[["/odom", 9000, [[3, 9000, 50, True]]]], [["/clock", [[4, 700, 30, -1, True], [9, 10, 1, -1, True]]]], []]
    counter.update(later, lambda: asked.append(1) or INFO)  # type: ignore[func-returns-value]
    counter.update(later, lambda: asked.append(1) or INFO)  # type: ignore[func-returns-value]
    assert counter.total == Traffic(31, 710, 7, 4256)
    assert asked == [1]


def test_roscpp_says_it_in_another_order() -> None:
    counter = TrafficCounter(watchers=("/record",))
    stats = [
        [["/tf", [[3, 956, 900, 4, 0]]], ["/tf_static", [[5, 800, 800, 1, 0]]]],
        [["/clock", [[2, 200, 25, 2, 0]]]],
    ]
    counter.update(stats, lambda: [[3, "/record", "o"], [5, "/slam", "o"]])
    assert counter.total == Traffic(25, 200, 1, 800)


def test_peak_memory_is_at_least_what_is_in_use() -> None:
    ballast = bytearray(32 * 2**20)
    assert _peak_mb(os.getpid()) >= 0.95 * psutil.Process().memory_info().rss / 2**20 > 32.0
    del ballast
    assert _peak_mb(os.getpid()) > 32.0


def test_own_memory_counts_whole_and_is_part_of_what_is_resident() -> None:
    before = pss_mb(os.getpid())
    ballast = bytearray(64 * 2**20)
    assert 60.0 < pss_mb(os.getpid()) - before < 68.0
    assert pss_mb(os.getpid()) <= psutil.Process().memory_info().rss / 2**20 + 1.0
    del ballast
