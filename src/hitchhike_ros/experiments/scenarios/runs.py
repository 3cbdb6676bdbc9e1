"""Runs that depend on nothing but their arguments, on all cores."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from hitchhike_ros.experiments.scenarios.progress import Progress

J = TypeVar("J")
R = TypeVar("R")


def run_all(what: str, run: Callable[[J], R], jobs: Sequence[J], progress: Progress) -> tuple[R, ...]:
    """``run`` of every job, in the order of the jobs. ``run`` is a function of a module, or a partial of one.

    What a job raises is raised here, and jobs that have not begun by then are left out.
    """
    results: dict[int, R] = {}
    # Spawned: a fork takes along the locks of its parent's threads, OpenCV's and BLAS's, and not the threads.
    pool = ProcessPoolExecutor(min(os.cpu_count() or 1, max(len(jobs), 1)), get_context("spawn"))
    try:
        running = {pool.submit(run, job): i for i, job in enumerate(jobs)}
        for done in as_completed(running):
            results[running[done]] = done.result()
            progress(what, len(results), len(jobs))
    finally:
        pool.shutdown(cancel_futures=True)
    return tuple(results[i] for i in range(len(jobs)))


def write_results(path: Path, results: Mapping[str, Sequence[Any]]) -> None:
    """Each run's result, a dataclass, on a line of its own under the name of what was run: for whoever asks which."""
    runs = ((name, ",\n".join(f"  {json.dumps(asdict(run))}" for run in of_it)) for name, of_it in results.items())
    text = ",\n".join(f" {json.dumps(name)}: [\n{lines}\n ]" for name, lines in runs)
    path.write_text(f"{{\n{text}\n}}\n", encoding="utf-8")
