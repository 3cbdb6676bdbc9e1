"""The person who teleoperates: which keys, into whose teleop, and what is counted."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.experiments.scenarios.scripted_human import (
    DrivenRobot,
    HumanParameters,
    OperatorScript,
    ScriptedHuman,
)
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.protocol.status import GoalCommand, Status

ROUTE = np.array([(0.0, 0.0), (5.0, 0.0)])
GOAL = GoalCommand("goal", 5.0, 0.0, 0.0)


def test_the_scripted_human_turns_on_the_spot_first_where_the_route_lies_behind() -> None:
    human = ScriptedHuman(HumanParameters())
    route = np.array([(0.0, 0.0), (-5.0, 0.0)])
    assert human.keys(Pose2D(-4.5, 0.0, 0.1), route, 0.0) == "w", "there it parks"
    human = ScriptedHuman(HumanParameters())
    assert human.keys(Pose2D(0.0, 0.0, 0.1), route, 0.0) == " a"
    assert human.keys(Pose2D(0.0, 0.0, 0.2), route, 0.05) == "", "a held key repeats so often"
    assert human.keys(Pose2D(0.0, 0.0, 2.5), route, 0.2) == "a"
    assert human.keys(Pose2D(0.0, 0.0, 3.1), route, 0.4) == "w"


def on_its_way(name: str = "p3dx", state: str = "navigating", stamp: float = 1.0) -> Status:
    return Status(stamp, name, "none", state, goal=GOAL)


def robot_in_hand() -> DrivenRobot:
    robot = DrivenRobot(HumanParameters())
    robot.take()
    robot.sent(50)
    return robot


def test_a_robot_is_stopped_until_it_is_in_hand() -> None:
    robot = DrivenRobot(HumanParameters())
    assert [robot.take(), robot.take(), robot.in_hand] == [" ", " ", False]
    robot.sent(50)
    assert (robot.in_hand, robot.take()) == (True, "")
    assert robot.counts == {"idle": {"keys": 2, "bytes": 52, "commands": 1}}


def test_keys_need_a_pose_and_a_route_to_the_goal_of_a_robot_that_lets_itself_be_driven() -> None:
    robot = robot_in_hand()
    robot.status(on_its_way())
    robot.pose(Pose2D(0.0, 0.0, 0.0))
    assert robot.keys(0.0) == ""
    robot.route(np.array([(0.0, 0.0), (5.0, 1.0)]))  # to the goal before
    assert robot.keys(0.0) == ""
    robot.route(ROUTE)
    assert robot.keys(0.0) == "w"
    robot.status(on_its_way(state="aligning"))
    assert robot.keys(1.0) == ""
    robot.status(on_its_way())
    robot.route(None)
    assert robot.keys(2.0) == ""
    assert robot.counts["navigating"] == {"keys": 1, "bytes": 1}


def script() -> OperatorScript:
    """Both robots are driven, the first before the second; a third only has a goal."""
    made = OperatorScript(["p3dx", "turtlebot"], ["turtlebot", "p3dx", "p3dx2"], HumanParameters())
    for robot in made.driven.values():
        robot.pose(Pose2D(0.0, 0.0, 0.0))
        robot.route(ROUTE)
    return made


def test_robots_are_driven_one_after_another_once_all_have_goals() -> None:
    made = script()
    made.status("p3dx", on_its_way())
    assert made.keys(0.0) is None
    for name in ("turtlebot", "p3dx2"):
        made.status(name, on_its_way(name))
    assert (made.turn, made.keys(0.0)) == ("p3dx", ("p3dx", "w"))
    made.status("p3dx", Status(9.0, "p3dx", reason=str(Reason.ARRIVED)))
    assert (made.turn, made.keys(9.0)) == ("turtlebot", ("turtlebot", "w"))
    made.status("turtlebot", Status(19.0, "turtlebot", reason=str(Reason.ARRIVED)))
    assert (made.turn, made.keys(19.0), made.completed) == ("p3dx2", None, False)
    made.status("p3dx2", Status(20.0, "p3dx2", reason=str(Reason.ARRIVED)))
    assert (made.turn, made.completed) == (None, True)


def test_a_robot_that_gives_up_ends_its_turn_but_completes_nothing() -> None:
    made = OperatorScript(["p3dx"], ["p3dx"], HumanParameters())
    made.status("p3dx", Status(0.0, "p3dx"))
    assert made.turn == "p3dx"  # it stands because it has no goal yet
    made.status("p3dx", on_its_way())
    made.status("p3dx", Status(9.0, "p3dx", reason="Navigation failed: blocked"))
    assert (made.turn, made.completed) == (None, False)


def test_it_says_what_it_waits_for() -> None:
    made = script()
    said = [made.waits_for]
    for robot in made.driven.values():
        robot.sent(50)
        said.append(made.waits_for)
    for name in ("p3dx", "turtlebot", "p3dx2"):
        made.status(name, on_its_way(name))
    said.append(made.waits_for)
    assert said == [
        "p3dx is in hand",
        "turtlebot is in hand",
        "p3dx, turtlebot, p3dx2 has a goal",
        "p3dx is at its goal",
    ]
    assert made.in_hand


def test_the_report_counts_by_robot_and_by_state() -> None:
    made = script()
    assert made.report(0.0) == {
        "completed": False,
        "keys": 0,
        "commands": 0,
        "bytes": 0,
        "seconds": None,
        "robots": {"p3dx": {}, "turtlebot": {}},
        "states": {},
    }
    for name in ("p3dx", "turtlebot", "p3dx2"):
        made.status(name, on_its_way(name, stamp=2.0))
    assert made.keys(3.0) == ("p3dx", "w")
    made.driven["p3dx"].sent(48)
    made.driven["turtlebot"].sent(48)
    made.status("p3dx", on_its_way(state="driving"))
    made.driven["p3dx"].sent(48)
    report = made.report(12.5)
    assert (report["keys"], report["commands"], report["bytes"], report["seconds"]) == (1, 3, 145, 10.5)
    assert report["robots"] == {
        "p3dx": {"keys": 1, "commands": 2, "bytes": 97},
        "turtlebot": {"commands": 1, "bytes": 48},
    }
    assert report["states"] == {
        "navigating": {"keys": 1, "commands": 2, "bytes": 97},
        "driving": {"commands": 1, "bytes": 48},
    }


@pytest.mark.parametrize("now", [0.0, 0.05])
def test_a_key_that_is_held_repeats_no_more_often_than_a_keyboard_would(now: float) -> None:
    human = ScriptedHuman(HumanParameters(repeat_s=0.1))
    human.keys(Pose2D(), ROUTE, 0.0)
    assert human.keys(Pose2D(), ROUTE, now) == ""
    assert human.keys(Pose2D(), ROUTE, 0.1) == "w"
