"""A robot that a human drives: what the human may, and that the robot stands when something is not known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from flat_world import CORRIDOR, LASER, P3DX, TURTLEBOT, FlatWorld
from hitchhike_ros.control.leg import Decision
from hitchhike_ros.control.local_planner import LocalPlanner
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.teleop_authority import TeleopAuthority, TeleopAuthorityParameters
from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.errors import TeleopError
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.experiments.scenarios.scripted_human import HumanParameters, ScriptedHuman
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.status import GoalCommand, Status
from protocol_helpers import driver_in

PARAMS, AVOIDANCE = TeleopAuthorityParameters(), LocalPlannerParameters()
AHEAD, BACK, LEFT = Twist2D(0.5, 0.0), Twist2D(-0.5, 0.0), Twist2D(0.0, 0.5)
HERE = Pose2D(1.0, 2.0, 0.0)
START, GOAL = Pose2D(8.0, 5.72, 0.0), Pose2D(20.0, 5.72, 0.0)


# What the protocol allows.


@pytest.mark.parametrize("state", DriverState)
def test_a_driver_is_driven_by_hand_only_where_it_drives(state: DriverState) -> None:
    goal = driver_in(state).machine.goal
    mode = Status(0.0, "p3dx", "driver", state.value, goal=goal).teleop_mode
    drives = state in (DriverState.NAVIGATING, DriverState.YIELDING, DriverState.DRIVING)
    assert mode == ("guided" if drives else "off")
    assert Status(0.0, "p3dx", "driver", state.value).teleop_mode == "off"


@pytest.mark.parametrize("state", [s for s in HitchhikerState if s is not HitchhikerState.IDLE])
def test_a_hitchhiker_is_not_driven_by_hand(state: HitchhikerState) -> None:
    for goal in (None, GoalCommand("1", 5.0, 0.0, 0.0)):
        assert Status(0.0, "turtlebot", "hitchhiker", state.value, goal=goal).teleop_mode == "off"


def test_a_robot_without_goal_and_ride_is_free() -> None:
    assert Status(0.0, "p3dx").teleop_mode == "free"
    assert Status(0.0, "p3dx", state="navigating", goal=GoalCommand("1", 5.0, 0.0, 0.0)).teleop_mode == "guided"


# What the human wants.


def test_nobody_has_it_in_hand() -> None:
    assert TeleopAuthority(PARAMS).wanted(HERE, False, 0.0) is None


def test_a_robot_in_hand_stands_until_it_is_told_to_go() -> None:
    hand = TeleopAuthority(PARAMS)
    hand.take(True, 0.0)
    assert hand.wanted(HERE, False, 0.1) == Twist2D()
    hand.command(AHEAD, 0.2)
    assert hand.wanted(HERE, False, 0.3) == AHEAD
    assert hand.wanted(HERE, False, 0.21 + PARAMS.command_timeout_s) == Twist2D()
    hand.take(False, 0.3)
    assert hand.wanted(HERE, False, 0.3) is None


def test_commands_of_others_hold_for_as_long_as_they_are_fresh() -> None:
    hand = TeleopAuthority(PARAMS)
    hand.command(AHEAD, 0.0)
    assert hand.wanted(HERE, False, 0.1) == AHEAD
    assert hand.wanted(HERE, False, 0.6) is None


def test_it_stands_when_the_human_is_out_of_reach() -> None:
    hand = TeleopAuthority(PARAMS)
    hand.take(True, 0.0)
    for now in (2.1, -2.1):  # also when time jumps back
        with pytest.raises(TeleopError, match="out of reach"):
            hand.wanted(HERE, False, now)
    hand.take(True, 3.0)
    assert hand.wanted(HERE, False, 3.1) == Twist2D()


@pytest.mark.parametrize("bad", [Twist2D(math.nan, 0.0), Twist2D(0.0, math.inf)])
def test_a_senseless_command_ends_the_one_before(bad: Twist2D) -> None:
    hand = TeleopAuthority(PARAMS)
    hand.take(True, 0.0)
    assert hand.command(AHEAD, 0.0)
    assert not hand.command(bad, 0.1)
    assert hand.wanted(HERE, False, 0.1) == Twist2D()


def test_with_a_rider_it_does_not_go_on_without_news_of_it() -> None:
    hand = TeleopAuthority(PARAMS)
    far = Pose2D(HERE.x + PARAMS.unheard_m + 0.01, HERE.y, 0.0)
    hand.command(AHEAD, 0.0)
    assert hand.wanted(HERE, True, 0.0) == AHEAD
    with pytest.raises(TeleopError, match="does not tell"):
        hand.wanted(far, True, 0.1)
    assert hand.wanted(far, False, 0.1) == AHEAD, "alone it does"
    hand.command(Twist2D(), 0.1)
    assert hand.wanted(far, True, 0.1) == Twist2D(), "standing it needs none"
    hand.command(AHEAD, 0.2)
    hand.hear_status()
    assert hand.wanted(far, True, 0.2) == AHEAD


# What the robot does.


class Hand:
    """A world, a controller with a plan through it, and a human."""

    def __init__(self, start: Pose2D = START, rectangles: tuple = CORRIDOR, limits: object = P3DX) -> None:
        assert limits in (P3DX, TURTLEBOT)
        self.world = FlatWorld(limits, rectangles, start)
        self.controller = LocalPlanner(limits, AVOIDANCE)
        self.controller.set_path(np.array([(START.x, START.y), (GOAL.x, GOAL.y)]), GOAL)
        self.decision = Decision(Twist2D(), "driving")
        self.twists: list[Twist2D] = []

    def drive(self, wanted: Twist2D | None, seconds: float, limit: float = 0.6, gentle: bool = False) -> Decision:
        w = self.world
        for _ in range(round(seconds / w.period_s)):
            self.decision = self.controller.step(
                w.now, w.pose, w.twist, w.scan(), LASER[w.limits], limit, gentle, (), wanted
            )
            w.drive(self.decision.twist)
            self.twists.append(w.twist)
            assert not w.touched
        return self.decision


def test_it_does_what_the_human_wants() -> None:
    hand = Hand()
    hand.drive(AHEAD, 4.0)
    assert hand.world.twist.v == pytest.approx(0.5, abs=0.01)
    hand.drive(Twist2D(0.5, 0.3), 1.0)
    assert hand.world.pose.theta > 0.1, "away from the path"
    hand.drive(Twist2D(), 2.0)
    assert hand.world.twist.v == pytest.approx(0.0, abs=0.01)
    before = hand.world.pose
    hand.drive(LEFT, 2.0)
    assert hand.world.pose.theta - before.theta > 0.5
    assert distance(before, hand.world.pose) < 0.05
    hand.drive(Twist2D(0.0, -0.5), 4.0)
    before = hand.world.pose
    hand.drive(BACK, 2.0)
    assert distance(before, hand.world.pose) < 0.05, "what is behind it nobody sees"


def test_a_robot_that_stands_by_hand_is_not_stuck() -> None:
    hand = Hand()
    assert hand.drive(Twist2D(), 40.0).state == "driving"
    assert hand.drive(None, 3.0).state == "driving"
    assert hand.world.twist.v > 0.3, "its own navigation goes on"


@pytest.mark.parametrize("gentle", [False, True])
def test_it_keeps_the_limits_of_its_state(gentle: bool) -> None:
    hand = Hand()
    hand.drive(Twist2D(1.0, 0.0), 4.0, 0.4, gentle)
    hand.drive(Twist2D(), 3.0, 0.4, gentle)
    speeds = [twist.v for twist in hand.twists]
    assert 0.38 < max(speeds) <= 0.4 + 1e-9
    limit = AVOIDANCE.rider_acceleration_mps2 if gentle else P3DX.max_acceleration_mps2
    changes = np.abs(np.diff(speeds)) / hand.world.period_s
    assert changes.max() == pytest.approx(limit, rel=0.05)


def test_with_a_rider_it_neither_backs_nor_turns_the_marker_away() -> None:
    hand = Hand()
    hand.drive(BACK, 2.0, gentle=True)
    assert hand.world.pose.x >= START.x
    hand.drive(Twist2D(0.0, 1.0), 2.0, gentle=True)
    assert abs(hand.world.twist.omega) <= 0.1 + 1e-6
    hand = Hand()
    hand.drive(Twist2D(0.2, 1.0), 2.0, gentle=True)
    assert max(t.omega for t in hand.twists) <= AVOIDANCE.rider_curvature_per_m * 0.2 + 0.1 + 1e-6


@pytest.mark.parametrize("limits", [P3DX, TURTLEBOT], ids=["p3dx", "turtlebot"])
@pytest.mark.parametrize("gentle", [False, True])
def test_it_stops_before_a_wall_and_lets_the_human_turn_away(limits: object, gentle: bool) -> None:
    hand = Hand(Pose2D(START.x, START.y, -0.6), CORRIDOR, limits)
    decision = hand.drive(Twist2D(0.6, 0.0), 20.0, gentle=gentle)
    assert "held back" in decision.reason
    assert abs(hand.world.twist.v) < 0.08, "the noise of the laser lets it creep"
    assert hand.world.pose.y < 5.2, "it came near"
    while hand.world.pose.theta < 0.0:
        hand.drive(Twist2D(0.5, 0.5), 0.1, gentle=gentle)
        assert hand.world.now < 50.0


def test_off_its_path_another_plan_is_asked_for_while_it_goes_on() -> None:
    hand = Hand(Pose2D(3.0, 5.6, -math.pi / 2))  # before the side door, away from where the path begins
    decision = hand.drive(Twist2D(0.4, 0.0), 3.0)
    assert decision.state == "blocked"
    assert "off the path" in decision.reason
    assert hand.world.twist.v > 0.3


def test_near_its_goal_it_parks_while_the_human_wants_it_to_move() -> None:
    hand = Hand(Pose2D(GOAL.x - 0.9, GOAL.y + 0.1, 0.1))
    hand.drive(Twist2D(), 2.0)
    assert hand.world.pose == Pose2D(GOAL.x - 0.9, GOAL.y + 0.1, 0.1)
    assert hand.drive(AHEAD, 8.0).state == "arrived"
    assert distance(hand.world.pose, GOAL) <= AVOIDANCE.goal_tolerance_m


wishes = st.lists(st.tuples(st.integers(-15, 15), st.integers(-20, 20)), min_size=3, max_size=8)  # tenths


@settings(max_examples=15)
@given(wishes, st.booleans())
@example([(0, 10), (-3, 0), (-10, 0)], False)  # towards a wall that it has forgotten
def test_whatever_the_human_wants_nothing_is_touched(wanted: list, gentle: bool) -> None:
    hand = Hand()
    for v, omega in wanted:
        hand.drive(Twist2D(v / 10.0, omega / 10.0), 2.0, 0.6, gentle)  # asserts that nothing is


# Who stands in for the human.


def test_the_scripted_human_drives_round_a_corner() -> None:
    """Out of the side room, by keys alone, with the teleoperation of keys between."""
    route = np.array([(3.0, 2.5), (3.0, 5.6), (10.0, 5.72)])
    human = ScriptedHuman(HumanParameters())
    hand = Hand(Pose2D(3.0, 2.5, math.pi / 2))
    twists = {"w": AHEAD, " ": Twist2D(), "a": LEFT, "d": Twist2D(0.0, -0.5)}
    hand.controller.set_path(route, Pose2D(10.0, 5.72, 0.0))
    wanted, pressed = Twist2D(), ""
    while distance(hand.world.pose, Pose2D(10.0, 5.72)) > 1.0:
        for key in human.keys(hand.world.pose, route, hand.world.now):
            pressed += key
            curve = key in "ad" and wanted.v > 0.0
            wanted = Twist2D(wanted.v, twists[key].omega) if curve else twists[key]
        hand.drive(wanted, 0.1)
        assert hand.world.now < 60.0, pressed
    assert {"w", "d"} <= set(pressed)
