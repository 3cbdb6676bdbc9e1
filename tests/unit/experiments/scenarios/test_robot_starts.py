"""What an operator says to robots at their start, and when."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import compose, inverse
from hitchhike_ros.experiments.scenarios.robot_starts import RobotStarts, StartParameters
from hitchhike_ros.simulation.world_file import RobotEntry

GOAL, OTHER = Pose2D(5.0, 1.0, 0.0), Pose2D(9.0, 2.0, 0.5)
ENTRIES = {
    "late": RobotEntry("p3dx", Pose2D(1.0, 2.0, 1.5), GOAL, goal_at_s=10.0),
    "early": RobotEntry("p3dx", Pose2D(3.0, 4.0, 0.0), GOAL),
    "parked": RobotEntry("p3dx", Pose2D(0.0, 0.0, 0.0)),
}
EXACT = StartParameters(position_sigma_m=0.0, heading_sigma_rad=0.0)


def starts(params: StartParameters = EXACT, chosen: tuple[str, ...] = ()) -> RobotStarts:
    return RobotStarts(ENTRIES, {}, chosen, params)


def test_the_start_pose_is_said_until_the_robot_knows_it() -> None:
    robot = starts().robots["late"]
    assert robot.pose(7.0, heard=False) is None
    said = robot.pose(7.0, heard=True)
    assert said is not None
    assert (said.stamp, said.pose) == (7.0, Pose2D(1.0, 2.0, 1.5))
    assert not robot.ready(heard=True)
    robot.localized = True
    assert robot.pose(8.0, heard=True) is None


@pytest.mark.parametrize(
    ("name", "heard", "ready"), [("late", False, False), ("late", True, True), ("parked", False, True)]
)
def test_a_robot_is_ready_when_it_hears_of_its_goal(name: str, heard: bool, ready: bool) -> None:
    robot = starts().robots[name]
    robot.localized = True
    assert robot.ready(heard=heard) is ready


def test_goals_are_given_once_when_it_is_time() -> None:
    given = starts()
    assert given.due(0.0) == {"early": GOAL}
    assert (given.due(9.9), given.over) == ({}, False)
    assert (given.due(10.0), given.over) == ({"late": GOAL}, True)
    assert given.due(20.0) == {}


def test_other_goals_replace_those_of_the_world() -> None:
    given = RobotStarts(ENTRIES, {"parked": OTHER, "early": OTHER}, (), EXACT)
    assert given.due(100.0) == {"early": OTHER, "parked": OTHER, "late": GOAL}


def test_only_those_chosen_are_started() -> None:
    given = starts(chosen=("parked", "early"))
    assert list(given.robots) == ["early", "parked"]
    assert given.due(0.0) == {"early": GOAL}
    assert given.over


def test_the_error_is_as_wide_as_the_covariance_says_and_that_of_the_seed() -> None:
    params = StartParameters(position_sigma_m=0.2, heading_sigma_rad=0.1)
    errors = []
    for seed in range(400):
        for name, robot in RobotStarts(ENTRIES, {}, (), StartParameters(0.2, 0.1, seed)).robots.items():
            said = robot.pose(0.0, heard=True)
            assert said is not None
            np.testing.assert_allclose(said.covariance, np.diag([0.04, 0.04, 0.01]))
            error = compose(inverse(ENTRIES[name].start), said.pose)
            errors.append([error.x, error.y, error.theta])
    np.testing.assert_allclose(np.std(errors, axis=0), [0.2, 0.2, 0.1], rtol=0.1)
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.03)
    again = [starts(params).robots["late"].pose(0.0, heard=True) for _ in range(2)]
    assert again[0] is not None
    assert again[1] is not None
    assert again[0].pose == again[1].pose
