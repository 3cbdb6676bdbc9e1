"""Runs that depend on nothing but their arguments, on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

from hitchhike_ros.experiments.benchmark import Progress

J = TypeVar("J")
R = TypeVar("R")


def run_all(what: str, run: Callable[[J], R], jobs: Sequence[J], progress: Progress) -> tuple[R, ...]:
    """``run`` of every job, in the order of the jobs. ``run`` is a function of a module, or a partial of one."""
    results: dict[int, R] = {}
    # Spawned: a fork takes along the locks of its parent's threads, OpenCV's and BLAS's, and not the threads.
    with ProcessPoolExecutor(min(os.cpu_count() or 1, max(len(jobs), 1)), get_context("spawn")) as pool:
        running = {pool.submit(run, job): i for i, job in enumerate(jobs)}
        for done in as_completed(running):
            results[running[done]] = done.result()
            progress(what, len(results), len(jobs))
    return tuple(results[i] for i in range(len(jobs)))
