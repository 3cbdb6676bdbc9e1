"""Standing turns, ramps, and what counts as standing."""

from __future__ import annotations

import numpy as np
import pytest

from flat_world import P3DX
from hitchhike_ros.control.clearance import ClearanceField
from hitchhike_ros.control.leg import Leg, Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.path_following import PathFollowing
from hitchhike_ros.control.safe_motion import SafeMotion
from hitchhike_ros.core.datatypes import Pose2D, Twist2D
from hitchhike_ros.core.polyline import Polyline

PARAMS, STAND = LocalPlannerParameters(), Twist2D()


def scene(now: float = 0.0, twist: Twist2D = STAND) -> Scene:
    """In a free place."""
    return Scene(now, Pose2D(), twist, ClearanceField(np.empty((0, 2))), P3DX, False, 2.0)


@pytest.mark.parametrize(
    ("error", "last", "sense"),
    [(3.0, 0.0, 1.0), (3.0, 0.4, 1.0), (3.0, -0.4, -1.0), (-3.0, 0.4, 1.0), (2.4, -0.4, 1.0), (-1.0, 0.4, -1.0)],
)
def test_half_round_it_keeps_the_sense_in_which_it_turns(error: float, last: float, sense: float) -> None:
    motion = SafeMotion(PARAMS, P3DX)
    motion.command(Twist2D(0.0, last), 0.0)
    turn = motion.turn(scene(0.1), error)
    assert turn is not None
    assert np.sign(turn.omega) == sense


def test_it_stands_before_it_turns() -> None:
    motion = SafeMotion(PARAMS, P3DX)
    assert motion.turn(scene(twist=Twist2D(0.06)), 1.0) == Twist2D()
    assert motion.turn(scene(twist=Twist2D(0.04)), 1.0) != Twist2D()


def test_the_command_is_moved_by_what_the_base_can_do_in_a_period() -> None:
    motion = SafeMotion(PARAMS, P3DX)
    a = P3DX.max_acceleration_mps2
    assert motion.towards(scene(5.0), Twist2D(1.0)).v == pytest.approx(0.1 * a)
    assert motion.last == Twist2D(), "to propose is not to command"
    motion.command(Twist2D(0.1), 5.0)
    assert motion.towards(scene(5.05, Twist2D(0.1)), Twist2D(1.0)).v == pytest.approx(0.1 + 0.05 * a)
    assert motion.towards(scene(5.3, Twist2D(0.1)), Twist2D(1.0)).v == pytest.approx(0.1 + 0.1 * a)


@pytest.mark.parametrize(
    ("target", "state"),
    [
        (Twist2D(), "blocked"),
        (Twist2D(0.009, 0.019), "blocked"),
        (Twist2D(0.011, 0.0), "driving"),
        (Twist2D(0.0, 0.021), "driving"),
        (None, "blocked"),
    ],
)
def test_who_hardly_moves_stands(target: Twist2D | None, state: str, monkeypatch: pytest.MonkeyPatch) -> None:
    following = PathFollowing(P3DX, PARAMS, SafeMotion(PARAMS, P3DX))
    monkeypatch.setattr(following, "_target", lambda *_: target)
    leg = Leg(Polyline([(0.0, 0.0), (5.0, 0.0)]), Pose2D(5.0), 0.1, 0.1)
    assert following.step(scene(0.0), leg).state == "driving"
    assert following.step(scene(0.9), leg).state == "driving"
    assert following.step(scene(PARAMS.blocked_after_s), leg).state == state
