"""Sums over a node's connections, from what the slave APIs of rospy and roscpp answer; memory from proc."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from hitchhike_ros.experiments.scenarios.node_use import Traffic, TrafficCounter, megabytes

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


@pytest.mark.parametrize(("field", "mb"), [("Pss", 12.5), ("Pss_Anon", 2.0), ("VmHWM", 0.0)])
def test_memory_is_read_from_the_line_of_its_field(field: str, mb: float) -> None:
    rollup = "55d0-7ffd ---p 00000000 00:00 0   [rollup]\nRss:   20480 kB\nPss:   12800 kB\nPss_Anon:    2048 kB\n"
    assert megabytes(rollup, field) == mb
