"""Sweeps: every job once, results in the order of the jobs, errors raised, and a cluster that is not there is said."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from distributed import Client

from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.experiments.scenarios import sweeps
from hitchhike_ros.experiments.scenarios.sweeps import SchedulerError, cluster, sweep


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    with Client(processes=False, n_workers=1, threads_per_worker=2, dashboard_address=None) as client:
        yield client


def double(job: int) -> int:
    if job == 13:
        raise PlanningError("no way")
    return 2 * job


def test_results_come_in_the_order_of_the_jobs(client: Client) -> None:
    told: list[tuple[str, int, int]] = []
    assert sweep("jobs", double, range(5), lambda *said: told.append(said), client) == (0, 2, 4, 6, 8)
    assert told == [("jobs", k, 5) for k in range(1, 6)]


def test_what_a_job_raises_is_raised(client: Client) -> None:
    with pytest.raises(PlanningError, match="no way"):
        sweep("jobs", double, [1, 13], lambda *_said: None, client)


def test_a_running_cluster_is_used(client: Client) -> None:
    with cluster(client.scheduler.address, 1) as other:
        assert sweep("jobs", double, [4], lambda *_said: None, other) == (8,)


def test_no_cluster_at_an_address_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "_ANSWER_S", 0.5)
    with pytest.raises(SchedulerError, match=r"--scheduler tcp://127\.0\.0\.1:9"), cluster("tcp://127.0.0.1:9", 1):
        pass
