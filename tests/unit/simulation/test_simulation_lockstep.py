"""Lock-step: who owes an answer, and who is no longer waited for."""

import pytest

from hitchhike_ros.protocol.status import ModuleSwitches
from hitchhike_ros.simulation.lockstep import IMAGE, SCAN, Lockstep

ALONE = ModuleSwitches()
RIDING = ModuleSwitches(PP=False, OBS=False, LZN=False, MAP=False, VS=True)


@pytest.fixture
def lockstep() -> Lockstep:
    lockstep = Lockstep(patience=2)
    lockstep.set_modules("p3dx", ALONE)
    lockstep.set_modules("turtlebot", RIDING)
    return lockstep


def test_only_modules_that_are_on_are_waited_for(lockstep: Lockstep) -> None:
    for robot in ("p3dx", "turtlebot", "stranger"):
        lockstep.sent(robot, SCAN, 1.0)
        lockstep.sent(robot, IMAGE, 1.0)
    assert set(lockstep.waiting_for) == {
        ("p3dx", "slam"), ("p3dx", "obstacle_avoidance"), ("turtlebot", "visual_servoing")
    }  # fmt: skip


@pytest.mark.parametrize(
    ("modules", "who"),
    [
        (ModuleSwitches(OBS=False, MAP=False), {"slam"}),
        (ModuleSwitches(OBS=False, LZN=False), {"slam"}),
        (ModuleSwitches(LZN=False, MAP=False), {"obstacle_avoidance"}),
        (ModuleSwitches(VS=True), {"slam", "obstacle_avoidance", "visual_servoing"}),
        (ModuleSwitches(OBS=False, LZN=False, MAP=False), set()),
    ],
)
def test_switches_decide_who_answers(modules: ModuleSwitches, who: set[str]) -> None:
    lockstep = Lockstep()
    lockstep.set_modules("r", modules)
    lockstep.sent("r", SCAN, 1.0)
    lockstep.sent("r", IMAGE, 1.0)
    assert {module for _, module in lockstep.waiting_for} == who


def test_answers_close_their_frame_and_older_ones(lockstep: Lockstep) -> None:
    lockstep.sent("p3dx", SCAN, 1.0)
    lockstep.answered("p3dx", "slam", 0.9)  # late, to the frame before
    assert ("p3dx", "slam") in lockstep.waiting_for
    lockstep.answered("p3dx", "slam", 1.0)
    lockstep.answered("p3dx", "obstacle_avoidance", 1.1)
    lockstep.answered("turtlebot", "slam", 1.0)  # nobody asked
    assert lockstep.waiting_for == ()


def test_misses_are_counted_and_patience_ends(lockstep: Lockstep) -> None:
    slam = ("p3dx", "slam")
    for stamp in (1.0, 2.0):
        lockstep.sent("p3dx", SCAN, stamp)
        lockstep.answered("p3dx", "obstacle_avoidance", stamp)
        assert lockstep.give_up() == (slam,)
    lockstep.sent("p3dx", SCAN, 3.0)
    assert lockstep.waiting_for == (("p3dx", "obstacle_avoidance"),)
    lockstep.answered("p3dx", "slam", 2.0)  # it lives after all
    lockstep.sent("p3dx", SCAN, 4.0)
    assert slam in lockstep.waiting_for
    assert lockstep.misses[slam] == 2


def test_switching_off_forgives_and_on_gives_new_patience(lockstep: Lockstep) -> None:
    slam = ("p3dx", "slam")
    for stamp in (1.0, 2.0):
        lockstep.sent("p3dx", SCAN, stamp)
        lockstep.give_up()
    lockstep.set_modules("p3dx", RIDING)
    lockstep.set_modules("p3dx", ALONE)
    lockstep.sent("p3dx", SCAN, 3.0)
    assert slam in lockstep.waiting_for
    lockstep.set_modules("p3dx", RIDING)
    assert slam not in lockstep.waiting_for


def test_who_has_answered_before_is_waited_for_longer() -> None:
    lockstep = Lockstep(timeout_s=5.0, join_timeout_s=0.5)
    lockstep.set_modules("p3dx", ALONE)
    assert not lockstep.waits(0.0)
    lockstep.sent("p3dx", SCAN, 1.0)
    assert lockstep.waits(0.4)
    assert not lockstep.waits(0.6)
    lockstep.answered("p3dx", "slam", 1.0)
    lockstep.give_up()
    lockstep.sent("p3dx", SCAN, 2.0)
    assert lockstep.waits(4.9)
    assert not lockstep.waits(5.1)
    for modules in (RIDING, ALONE):  # off and on again: it has to join anew
        lockstep.set_modules("p3dx", modules)
    lockstep.sent("p3dx", SCAN, 3.0)
    assert not lockstep.waits(0.6)
