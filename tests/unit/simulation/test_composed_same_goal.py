"""Two robots with one goal, with bodies that cannot pass through each other."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import PoseEstimate
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.physics.world import World, WorldParameters
from repository import ROOT

DRIVER, RIDER = "p3dx", "turtlebot"
LIMIT_S = 90.0


@pytest.mark.parametrize("world_file", ["same_goal", "same_goal_network"])
def test_the_hitchhiker_stays_behind_its_driver(world_file: str) -> None:
    file = ROOT / "tests" / "rostest" / f"{world_file}.world.yaml"
    with World(file, 0, WorldParameters(renderer="tiny"), package=ROOT) as world:
        ride = ComposedRide(world, ROOT)
        entries = world.file.robots
        ride.start({name: PoseEstimate(0.0, e.start, np.diag([1e-4] * 3)) for name, e in entries.items()})
        rider, set_down = ride.robots[RIDER], None
        while world.now < LIMIT_S and (ride.goals or any(robot.outcome is None for robot in ride.robots.values())):
            ride.step()
            if rider.status.phase is Phase.HANDING_OVER:
                set_down = world.robots[RIDER].ground_truth()[0]
        driver_at, rider_at = (world.robots[name].ground_truth()[0] for name in (DRIVER, RIDER))
        outcomes = {name: robot.outcome for name, robot in ride.robots.items()}
        assert all(outcome is not None and outcome.reached for outcome in outcomes.values()), outcomes
        goal = entries[RIDER].goal
        assert goal is not None and set_down is not None
        assert outcomes[DRIVER] is not None and outcomes[DRIVER].text == "Goal reached"
        assert distance(driver_at, goal) <= 0.15
        away = distance(rider_at, goal)
        assert outcomes[RIDER] is not None and outcomes[RIDER].text.startswith(f"goal taken by {DRIVER}, ")
        assert float(outcomes[RIDER].text.split()[4]) == pytest.approx(away, abs=0.15)
        assert 0.8 <= away <= 1.6
        assert distance(rider_at, set_down) <= 0.05, "nothing is driven after the ride (P17 Algorithm 2, line 14)"
        assert not world.contacts()
