"""What goes wrong on the rides on which the driver is lost."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.experiments.scenarios.following_rides import DRIVER, RIDER
from hitchhike_ros.experiments.scenarios.lost_drivers import MISHAPS
from hitchhike_ros.simulation.faults import Fault


def test_every_mishap_begins_now_and_concerns_one_of_the_pair() -> None:
    for mishap in MISHAPS:
        for seed in range(20):
            (fault,) = mishap.plan(np.random.default_rng(seed), 10.0)
            assert isinstance(fault, Fault)
            assert (fault.start_s, fault.robot in (DRIVER, RIDER)) == (10.0, True)
            assert fault.end_s > 10.5
