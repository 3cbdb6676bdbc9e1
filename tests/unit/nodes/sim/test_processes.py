"""Memory of a process as Linux counts it."""

from __future__ import annotations

import mmap
import os

import psutil

from hitchhike_ros.nodes.sim.processes import _peak_mb, pss_mb


def test_peak_memory_is_at_least_what_is_in_use() -> None:
    ballast = bytearray(b"x") * (32 * 2**20)
    assert _peak_mb(os.getpid()) >= 0.95 * psutil.Process().memory_info().rss / 2**20 > 32.0
    del ballast
    assert _peak_mb(os.getpid()) > 32.0


def test_own_memory_counts_whole_and_is_part_of_what_is_resident() -> None:
    before = pss_mb(os.getpid())
    ballast = mmap.mmap(-1, 64 * 2**20)  # pages of its own: what was freed before may be handed out again
    ballast.write(bytes(len(ballast)))
    assert 60.0 < pss_mb(os.getpid()) - before < 68.0
    assert pss_mb(os.getpid()) <= psutil.Process().memory_info().rss / 2**20 + 1.0
    ballast.close()
