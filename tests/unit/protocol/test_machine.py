"""The base of the machines: what a table may say, in which order rows are taken, and what is forgotten when."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pytest

from hitchhike_ros.core.errors import TransitionError
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven, Report, Situation, Tick
from hitchhike_ros.protocol.machine import Deadline, Do, Facts, Machine, Row, of_phases
from hitchhike_ros.protocol.messages import Deny, Message, Terminate
from hitchhike_ros.protocol.phase import Phase, RoleState
from hitchhike_ros.protocol.reasons import NONE, Ending, Reason

TICK = Tick(Situation())


class State(RoleState):
    """Of a machine for tests."""

    OFF = "off", Phase.ALONE
    ASKING = "asking", Phase.ASKING
    ON = "on", Phase.COUPLED


@dataclass(eq=False)
class LampFacts(Facts):
    """What the lamp knows."""

    voltage: float = 0.0
    patience_s: float = 3.0
    asked: list[str] = of_phases(Phase.ASKING, Phase.COUPLED)


def powered(f: LampFacts) -> bool:
    return f.voltage > 0.0


def bright(f: LampFacts) -> bool:
    return f.voltage > 10.0


def patience(f: LampFacts) -> float:
    return f.patience_s


S = State
WAITED = Deadline(patience)
ROWS = (
    Row((S.OFF,), GoalGiven, "_ask", S.ASKING),
    Do((S.ASKING,), "_buzz"),
    Row((S.ASKING,), Tick, "_shine", S.ON, (powered, bright), Reason.SEEN_AGAIN),
    Row((S.ASKING,), Tick, "_shine", S.ON, (powered,)),
    Do((S.ASKING,), "_complain"),
    Row((S.ASKING,), WAITED, "_say_why", S.OFF, why=Reason.DRIVER_LATE),
    Row((S.ON,), Terminate, ("_mourn", "_end"), S.OFF),
    Row((S.ON,), GoalGiven, None, S.ON),
)


class Lamp(Machine[State, LampFacts]):
    """It asks, waits for power, and shines."""

    INITIAL = S.OFF
    ROWS = ROWS

    def _ask(self, _event: GoalGiven) -> None:
        self.facts.asked = ["goal"]

    def _buzz(self) -> None:
        self._report("buzz")

    def _complain(self) -> None:
        self._report("no power")

    def _shine(self, _tick: Tick) -> None:
        self._report(f"{self.state.value} since {self.facts.asked}")

    def _say_why(self) -> None:
        self._report(self.ending)

    def _mourn(self) -> None:
        self._report(f"{self.facts.asked} are forgotten")

    def say_last(self, word: Terminate, now: float) -> None:
        """For a while, at 2 Hz."""
        self.facts.now = now
        self._send_last_word(word, 0.5, 1.5)

    def _end(self, message: Terminate) -> None:
        self.ending = Ending.told(message.reason)


def lamp(voltage: float = 0.0) -> Lamp:
    return Lamp(LampFacts(voltage=voltage))


def texts(effects: list[Any]) -> list[str]:
    return [effect.text for effect in effects]


def test_the_first_row_whose_guards_hold_is_taken_and_do_is_done_above_it_alone() -> None:
    machine = lamp()
    machine.step(GoalGiven(None), 1.0)
    assert texts(machine.step(TICK, 2.0)) == ["buzz", "no power"]
    machine.facts.voltage = 5.0
    assert texts(machine.step(TICK, 3.0)) == ["buzz", "on since ['goal']"]
    assert (machine.state, machine.ending) == (S.ON, NONE)


def test_an_earlier_row_goes_before_a_later_one() -> None:
    machine = lamp(voltage=20.0)
    machine.step(GoalGiven(None), 1.0)
    machine.step(TICK, 2.0)
    assert (machine.state, machine.ending) == (S.ON, Ending(Reason.SEEN_AGAIN))


def test_a_deadline_goes_before_all_and_counts_from_where_its_function_says() -> None:
    machine = lamp()
    machine.step(GoalGiven(None), 1.0)
    assert machine.step(TICK, 3.9) != []
    assert machine.state is S.ASKING
    machine.facts.voltage = 20.0
    assert machine.step(TICK, 4.0) == [Report("Driver is late", Reason.DRIVER_LATE)]
    assert (machine.state, machine.ending, machine.facts.entered) == (S.OFF, Ending(Reason.DRIVER_LATE), 4.0)


def test_a_machine_says_when_it_acts_by_itself_and_a_tick_then_is_not_too_early() -> None:
    machine = lamp()
    assert machine.next_deadline() == math.inf
    machine.step(GoalGiven(None), 0.1)
    machine.facts.patience_s = 0.2  # 0.1 + 0.2 - 0.1 is not 0.2
    due = machine.next_deadline()
    assert due == pytest.approx(0.3)
    machine.step(TICK, due)
    assert machine.state is S.OFF
    assert machine.next_deadline() == math.inf


def test_last_words_are_due_one_after_another_whatever_the_state() -> None:
    machine = lamp()
    machine.say_last(Terminate(robot_id="lamp", reason="Riders move up"), 1.0)
    due = []
    while machine.next_deadline() < math.inf:
        due.append(machine.next_deadline())
        assert len(machine.step(TICK, due[-1])) == 1
    assert due == pytest.approx([1.5, 2.0, 2.5])


def test_facts_of_a_phase_are_there_in_it_and_for_the_action_that_leaves_it() -> None:
    machine = lamp(voltage=20.0)
    with pytest.raises(AttributeError, match="asked"):
        machine.facts.asked  # noqa: B018
    machine.step(GoalGiven(None), 1.0)
    machine.step(TICK, 2.0)
    assert machine.facts.asked == ["goal"]
    end = Terminate(robot_id="other", reason="Riders move up")
    assert texts(machine.step(end, 3.0)) == ["['goal'] are forgotten"]
    assert (machine.state, machine.ending) == (S.OFF, Ending(Reason.CLOSING_UP))
    assert not hasattr(machine.facts, "asked")


def test_facts_of_a_single_state_are_forgotten_within_its_phase() -> None:
    class Steps(RoleState):
        """Two states of one phase."""

        FIRST = "first", Phase.ASKING
        SECOND = "second", Phase.ASKING

    @dataclass(eq=False)
    class StepFacts(Facts):
        """What is known in the first of them, and in both."""

        once: str = of_phases(Steps.FIRST)
        always: str = of_phases(Phase.ASKING)

    class Stepper(Machine[Steps, StepFacts]):
        INITIAL = Steps.FIRST
        ROWS = (
            Row((Steps.FIRST,), Deny, "_note", Steps.FIRST),
            Row((Steps.FIRST,), Tick, None, Steps.SECOND),
            Row((Steps.SECOND,), Tick, None, Steps.FIRST),
        )

        def _note(self, _message: Deny) -> None:
            self.facts.once = self.facts.always = "told"

    machine = Stepper(StepFacts())
    machine.step(Deny(robot_id="other", reason="no"), 1.0)
    assert (machine.facts.once, machine.facts.always) == ("told", "told")
    machine.step(TICK, 2.0)
    assert machine.facts.always == "told"
    assert not hasattr(machine.facts, "once")


def test_a_row_may_keep_the_ending() -> None:
    class Keeper(Lamp):
        ROWS = (*ROWS[:-2], Row((S.ON,), Terminate, None, S.OFF, why=None))

    machine = Keeper(LampFacts(voltage=20.0))
    machine.step(GoalGiven(None), 1.0)
    machine.step(TICK, 2.0)
    assert machine.ending == Ending(Reason.SEEN_AGAIN)
    machine.step(Terminate(robot_id="other", reason="over"), 3.0)
    assert (machine.state, machine.ending) == (S.OFF, Ending(Reason.SEEN_AGAIN))


def test_a_state_that_leads_to_itself_begins_anew() -> None:
    machine = lamp(voltage=20.0)
    machine.step(GoalGiven(None), 1.0)
    machine.step(TICK, 2.0)
    machine.step(GoalGiven(None), 5.0)
    assert (machine.state, machine.facts.entered, machine.ending) == (S.ON, 5.0, NONE)


def test_messages_without_use_are_counted_and_commands_raise_with_state_and_event() -> None:
    machine = lamp()
    assert machine.step(Deny(robot_id="other", reason="no"), 1.0) == []
    assert machine.ignored == 1
    with pytest.raises(TransitionError, match="GoalCancelled is not allowed in off") as caught:
        machine.step(GoalCancelled(), 2.0)
    assert (caught.value.state, caught.value.event) == ("off", "GoalCancelled")


def test_a_message_whose_guards_do_not_hold_is_counted() -> None:
    class Picky(Machine[State, LampFacts]):
        INITIAL = S.OFF
        ROWS = (
            Row((S.OFF,), Deny, None, S.ASKING, (bright,)),
            Row((S.ASKING,), Tick, None, S.ON),
            Row((S.ON,), Tick, None, S.OFF),
        )

    machine = Picky(LampFacts())
    machine.step(Deny(robot_id="other", reason="no"), 1.0)
    assert (machine.ignored, machine.state) == (1, S.OFF)
    machine.facts.voltage = 20.0
    machine.step(Deny(robot_id="other", reason="no"), 1.0)
    assert (machine.ignored, machine.state) == (1, S.ASKING)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ((*ROWS, Row((S.ON,), Deny, "_dance")), "there is no method _dance"),
        ((*ROWS, Do((S.ON,), "_dance")), "there is no method _dance"),
        ((*ROWS, Row((S.ON,), Deny)), "nothing is done in"),
        ((*ROWS, Row((S.ON,), Deny, to=Phase.ALONE)), "Phase.ALONE is no State"),
        ((*ROWS, Row((Phase.ALONE,), Deny, to=S.ON)), "Phase.ALONE is no State"),
        ((*ROWS, Row((S.ON,), Terminate, None, S.OFF, (bright,))), "on on Terminate: a row stands below one without"),
        ((*ROWS, Do((S.ON,), "_buzz"), Row((S.ON,), Tick, None, S.OFF), Do((S.ON,), "_buzz")), "on on tick: a row"),
        ((*ROWS, Row((S.ON,), WAITED, None, S.OFF, (bright,))), "on: expected one deadline"),
        (
            (*ROWS, Row((S.ON,), WAITED, None, S.OFF, (bright,)), Row((S.ON,), Deadline(powered), None, S.OFF)),
            "on: expected one deadline",
        ),
        (ROWS[1:], "off cannot be left; asking cannot be reached; on cannot be reached"),
        ((*ROWS[:6], ROWS[7]), "on cannot be left"),
    ],
)
def test_a_table_that_promises_too_much_is_no_class(rows: tuple[Row | Do, ...], told: str) -> None:
    with pytest.raises(TypeError) as caught:
        type("Broken", (Lamp,), {"ROWS": rows})
    assert str(caught.value).startswith("Broken: ")
    assert told in str(caught.value)


def test_last_words_are_repeated_until_they_are_taken_back() -> None:
    machine = lamp()
    word = Terminate(robot_id="lamp", ride_id="ride", reason="over")
    machine._send_last_word(word, 1.0, 3.0)
    machine._send_last_word(Terminate(robot_id="lamp", ride_id="other", reason="over"), 1.0, 1.0)

    def said(now: float) -> list[Message]:
        return [effect.message for effect in machine.step(TICK, now)]

    assert [message.ride_id for message in said(1.0)] == ["ride", "other"]
    assert said(1.5) == []
    machine._take_back_last_words("ride")
    assert said(9.0) == []


def test_what_is_done_every_so_often_is_done_at_once_in_a_new_state() -> None:
    machine = lamp()
    machine.step(GoalGiven(None), 1.0)
    assert [machine._every(2.0, "ring"), machine._every(2.0, "ring"), machine._every(2.0, "call")] == [1, 0, 1]
    machine.facts.voltage = 20.0
    machine.step(TICK, 1.5)
    assert machine._every(2.0, "ring")
