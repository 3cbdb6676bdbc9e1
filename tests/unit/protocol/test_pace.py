"""Which steps of a robot are left out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.protocol.pace import Pace
from hitchhike_ros.protocol.status import ANY_MARKER, GoalCommand, ServoCommand, Status

GOAL, FOLLOW, OBSERVE = GoalCommand("g", 1.0, 2.0, 0.0), ServoCommand("follow", 1), ServoCommand("observe", ANY_MARKER)
IDLE = Status(0.0, "r")
RIDING = Status(0.0, "r", role="hitchhiker", state="riding", servo=FOLLOW)
DRIVING = Status(0.0, "r", role="driver", state="driving", goal=GOAL)

situations = st.tuples(
    st.none()
    | st.builds(
        Status,
        st.just(0.0),
        st.just("r"),
        state=st.sampled_from(["idle", "riding", "seeking", "navigating"]),
        goal=st.sampled_from([None, GOAL]),
        servo=st.sampled_from([None, FOLLOW]),
    ),
    st.sampled_from(["", "following", "coasting"]),
    st.booleans(),
)


@pytest.mark.parametrize(
    ("published", "following", "left_out"),
    [
        (None, "", 0),
        (IDLE, "", 1),
        (RIDING, "following", 2),
        *((RIDING, f, 0) for f in ("", "coasting", "looking", "turning", "searching", "stopped")),
        (Status(0.0, "r", role="hitchhiker", state="seeking", servo=FOLLOW), "following", 0),
        (Status(0.0, "r", role="hitchhiker", state="coupling", servo=FOLLOW), "following", 0),
        (Status(0.0, "r", role="hitchhiker", state="requesting"), "", 1),
        (DRIVING, "", 0),
        (Status(0.0, "r", role="driver", state="aligning", goal=GOAL, servo=OBSERVE), "", 0),
        (Status(0.0, "r", servo=OBSERVE), "", 0),
    ],
)
def test_steps_are_left_out_while_nothing_happens(published: Status | None, following: str, left_out: int) -> None:
    pace = Pace()
    once = [*(True,) * left_out, False]
    assert [pace.leaves_out(published, following, False) for _ in range(3 * len(once))] == 3 * once


@given(st.lists(situations, max_size=30))
def test_never_three_in_succession_nor_one_that_an_event_waits_for(steps: list) -> None:
    pace, before = Pace(), [False, False]
    for published, following, waiting in steps:
        left_out = pace.leaves_out(published, following, waiting)
        assert not (left_out and (all(before) or waiting))
        before = [before[1], left_out]


@pytest.mark.parametrize(("published", "following"), [(IDLE, ""), (RIDING, "following")])
def test_an_event_is_taken_at_once_and_what_begins_is_stepped_each_time(published: Status, following: str) -> None:
    pace = Pace()
    assert pace.leaves_out(published, following, False)
    assert not pace.leaves_out(published, following, True)
    assert not any(pace.leaves_out(DRIVING, following, False) for _ in range(5))
    assert pace.leaves_out(published, following, False)
