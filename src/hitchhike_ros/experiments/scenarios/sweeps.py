"""Parameter sweeps on Dask: an embedded cluster of this machine's cores, or a running one by its address."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from distributed import Client, LocalCluster, as_completed

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.bench.registry import Progress

J = TypeVar("J")
R = TypeVar("R")

# For a scheduler that is called by its address to answer (chosen).
_ANSWER_S = 20


class SchedulerError(HitchhikeError):
    """No cluster at an address, or none that works."""


@contextmanager
def cluster(address: str | None, jobs: int) -> Iterator[Client]:
    """A client of the cluster at ``address``, or of one of this machine's cores that ends with the context.

    A running cluster's workers need this package, of the same version, and the files that jobs name.

    Raises:
        SchedulerError: nobody answers at the address.
    """
    logging.getLogger("distributed").setLevel(logging.ERROR)  # whose workers say when they come and go
    if address is not None:
        try:
            client = Client(address, timeout=_ANSWER_S)
        except (OSError, ValueError) as exc:
            raise SchedulerError(f"--scheduler {address}: {exc}, expected the address of a Dask scheduler") from exc
        with client:
            yield client
        return
    workers = max(1, min(os.cpu_count() or 1, jobs))
    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as local,
        Client(local) as client,
    ):
        yield client


def sweep(what: str, run: Callable[[J], R], jobs: Sequence[J], progress: Progress, client: Client) -> tuple[R, ...]:
    """``run`` of every job, in the order of the jobs; ``run`` is a function of a module. What it raises is raised."""
    futures = {client.submit(run, job, pure=False): i for i, job in enumerate(jobs)}
    results: dict[int, R] = {}
    for future in as_completed(list(futures)):
        results[futures[future]] = future.result()
        progress(what, len(results), len(jobs))
    return tuple(results[i] for i in range(len(jobs)))
