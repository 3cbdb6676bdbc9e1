"""The driver's table: P17 Algorithm 1, with P18 §4 from afar, and convoys.

A *group* is a function of the facts that gives riders: those whom an event is about, or whose time is over. Guards ask
what becomes of the convoy when they go.
"""

from __future__ import annotations

from collections.abc import Callable

from hitchhike_ros.core.geometry import distance, wrap_angle
from hitchhike_ros.protocol.driver.convoy import Offer, Rider
from hitchhike_ros.protocol.driver.facts import ENGAGED, WITH_RIDER, DriverFacts
from hitchhike_ros.protocol.driver.offers import verdict
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven, Tick
from hitchhike_ros.protocol.machine import Deadline, Do, Guard, Row
from hitchhike_ros.protocol.messages import (
    Ack,
    Coupled,
    Decouple,
    Driver,
    Lock,
    Request,
    RequestCancel,
    Terminate,
)
from hitchhike_ros.protocol.reasons import Reason

# A rider that follows has caught up when it is no farther behind than this beyond the gap (chosen).
_CAUGHT_UP_M = 0.3
# As obstacle avoidance has it by default: a robot that is set down so near to its goal is there.
GOAL_TOLERANCE_M, GOAL_TOLERANCE_RAD = 0.10, 0.087
# A place to stop at is another one beyond this, and one that is so near is not driven to; a robot that is set down
# behind its driver stays there although it could come a little nearer (chosen).
_THERE_M, _SET_DOWN_M = 0.3, 1.0

S = DriverState
Group = Callable[[DriverFacts], tuple[Rider, ...]]


# Groups.


def sender(f: DriverFacts) -> tuple[Rider, ...]:
    """Of a message of a present ride."""
    rider = f.convoy.find(f.event)
    return () if rider is None else (rider,)


def asker(f: DriverFacts) -> tuple[Rider, ...]:
    """Of a request, whatever ride it is about."""
    rider = f.convoy.of(f.event.robot_id)
    return () if rider is None else (rider,)


def silent(f: DriverFacts) -> tuple[Rider, ...]:
    """A hitchhiker that comes from afar says now and then when it will be there; one that does not is gone."""
    return f.convoy.silent(f.now, f.params.contact_timeout_s) if f.params.mode == "network" else ()


def late(f: DriverFacts) -> tuple[Rider, ...]:
    """The one that is to couple."""
    rider = f.convoy.next_to_couple
    return () if rider is None else (rider,)


def behind(f: DriverFacts) -> tuple[Rider, ...]:
    """Those for whom the driver waits (P17 §4)."""
    return f.convoy.behind(f.params.gap_m + _CAUGHT_UP_M)


def leaving(f: DriverFacts) -> tuple[Rider, ...]:
    """Those for whom it is the end of the ride."""
    return f.convoy.leaving


# Guards.


def _guard(name: str, holds: Guard) -> Guard:
    holds.__name__ = name
    return holds


def only(group: Group) -> Guard:
    """Nobody is left when those go."""
    return _guard(f"only {group.__name__}", lambda f: len(group(f)) == len(f.convoy))


def rest_coupled(group: Group) -> Guard:
    """All others ride."""

    def holds(f: DriverFacts) -> bool:
        going = group(f)
        return bool(going) and all(rider.coupled for rider in f.convoy if rider not in going)

    return _guard(f"all but {group.__name__} coupled", holds)


def last_leaving(group: Group) -> Guard:
    """They are all of those that leave."""
    return _guard(f"{group.__name__} last to leave", lambda f: bool(group(f)) and f.convoy.leaving == group(f))


def is_rider(f: DriverFacts) -> bool:
    return f.convoy.find(f.event) is not None


def is_no_rider(f: DriverFacts) -> bool:
    return f.convoy.find(f.event) is None


def is_stranger(f: DriverFacts) -> bool:
    return f.convoy.of(f.event.robot_id) is None


def asks_for_later(f: DriverFacts) -> bool:
    """Another driver is meant, for when this ride is over."""
    return f.event.in_s > 0.0


def asks_anew(f: DriverFacts) -> bool:
    """The hitchhiker has begun anew, and forgotten the ride that it had."""
    return all(f.event.ride_id != rider.offer.ride_id for rider in asker(f))


def is_offered(f: DriverFacts) -> bool:
    """There is a ride to offer to a hitchhiker that stands at the same hitchhiking point (P17)."""
    return f.params.mode == "local" and isinstance(verdict(f), Offer)


def is_promised(f: DriverFacts) -> bool:
    """The lock takes a ride that was promised."""
    return isinstance(verdict(f), Offer)


def arrived(f: DriverFacts) -> bool:
    ending = f.navigation.ending
    return ending is not None and ending.reason is Reason.ARRIVED


def given_up(f: DriverFacts) -> bool:
    """Navigation has been stuck or without a path for too long."""
    ending = f.navigation.ending
    return ending is not None and ending.reason is not Reason.ARRIVED


def is_at_goal(f: DriverFacts) -> bool:
    """A driver has set it down there: nothing is driven any more (P17 Algorithm 2, line 14)."""
    assert f.route is not None
    if not f.set_down or f.estimate is None:
        return False
    here, goal = f.estimate.pose, f.route.goal
    off_rad = abs(wrap_angle(here.theta - goal.theta))
    return distance(here, goal) <= GOAL_TOLERANCE_M and off_rad <= GOAL_TOLERANCE_RAD


def is_taken(f: DriverFacts) -> bool:
    """Another robot has the goal."""
    return f.settled is not None


def is_free(f: DriverFacts) -> bool:
    """Nobody has the goal any more."""
    return f.settled is None


def need_not_move(f: DriverFacts) -> bool:
    """It stands where it would stop before the goal, or nearly: behind its driver, where that has set it down."""
    return f.settled is not None and f.settled.place.to_go_m <= (_SET_DOWN_M if f.set_down else _THERE_M)


def is_elsewhere(f: DriverFacts) -> bool:
    """Where it is to stop now is not where it was to stop before."""
    now, before = f.settled, f.yields
    if now is None or before is None:
        return now is not before
    return now.to != before.to or distance(now.place.pose, before.place.pose) > _THERE_M


def need_not_be_exact(f: DriverFacts) -> bool:
    return not f.params.exact_goal


def stands_before_goal(f: DriverFacts) -> bool:
    return f.stands_since <= f.now


def somebody_silent(f: DriverFacts) -> bool:
    return bool(silent(f))


def is_new(f: DriverFacts) -> bool:
    """The rider couples; it says so until it is answered."""
    return not any(rider.coupled for rider in sender(f))


def rider_missing(f: DriverFacts) -> bool:
    return bool(f.convoy.missing(f.now - f.params.ack_timeout_s))


def all_follow(f: DriverFacts) -> bool:
    """As far as they have said."""
    return all(rider.following for rider in f.convoy.coupled)


def all_there(f: DriverFacts) -> bool:
    return not behind(f)


def is_of_driver(f: DriverFacts) -> bool:
    """The message of every δ seconds is acknowledged."""
    return bool(f.event.of == Driver.type)


def takes_over(f: DriverFacts) -> bool:
    """The handover is acknowledged by one that leaves."""
    return f.event.of == Decouple.type and any(rider.leaving for rider in sender(f))


# Deadlines. Who meets from afar has a way to go first, and waits for whoever comes later.


def confirm_timeout(f: DriverFacts) -> float:
    return f.params.confirm_timeout_s


def max_align(f: DriverFacts) -> float:
    """T_align (P17)."""
    return f.boarding.within_s + f.params.max_align_s


def max_couple(f: DriverFacts) -> float:
    """T_coupling (P17)."""
    rider = f.convoy.next_to_couple or f.convoy.first
    if f.params.mode == "local" or rider is None:
        return f.params.max_couple_s
    return max(0.0, rider.due - f.entered) + f.params.patience_s + f.params.max_couple_s


def lost_timeout(f: DriverFacts) -> float:
    """T_lost (P17 §4)."""
    return f.params.lost_timeout_s


def decouple_timeout(f: DriverFacts) -> float:
    return f.params.decouple_timeout_s


def exact_goal_wait(f: DriverFacts) -> float:
    return f.params.exact_goal_wait_s


def since_it_stands(f: DriverFacts) -> float:
    """For the first time before this goal: one that becomes free now and then is not waited for again and again."""
    return f.stands_since


GOAL_TIME = Deadline(exact_goal_wait, since_it_stands)
OFFER_TIME, ALIGN_TIME, COUPLE_TIME = Deadline(confirm_timeout), Deadline(max_align), Deadline(max_couple)
LOST_TIME, HANDOVER_TIME = Deadline(lost_timeout), Deadline(decouple_timeout)

# Without a rider the driver goes on to its own goal; with those that are left once they have moved up.
R, ON, YIELD, WAIT = Reason, S.NAVIGATING, S.YIELDING, S.WAITING_FOR_RIDER
BOARDING = (S.ALIGNING, S.ALIGNED)
ALONE = (S.IDLE, S.NAVIGATING, S.YIELDING)
END = ("_tell", "_forget_goal")

ROWS = (
    # Its own goal.
    Row(ALONE, GoalGiven, "_start", S.NAVIGATING),
    Row(ENGAGED, GoalGiven, ("_end_rides", "_start"), S.NAVIGATING, why=R.GOAL_CANCELLED),
    Row(ALONE, GoalCancelled, "_forget_goal", S.IDLE, why=R.GOAL_CANCELLED),
    Row(ENGAGED, GoalCancelled, ("_end_rides", "_forget_goal"), S.IDLE, why=R.GOAL_CANCELLED),
    Do((S.NAVIGATING, S.YIELDING, S.ALIGNING, S.DRIVING), "_watch_navigation"),
    Do((S.OFFERING, S.ALIGNED, WAIT, S.DECOUPLING), "_pause_watch"),
    Row((S.NAVIGATING,), Tick, ("_note_outcome", *END), S.IDLE, (arrived,)),
    Row((S.NAVIGATING, S.YIELDING), Tick, ("_note_outcome", *END), S.IDLE, (given_up,)),
    Row((S.NAVIGATING,), Tick, END, S.IDLE, (is_at_goal,), R.ARRIVED),
    # Another robot has its goal, or the end of the ride.
    Do((S.NAVIGATING, S.YIELDING, S.DRIVING), "_settle"),
    Row((S.NAVIGATING,), Tick, ("_note_taken", *END), S.IDLE, (need_not_move, need_not_be_exact), R.GOAL_TAKEN),
    Row((S.NAVIGATING,), Tick, ("_yield", "_stand"), YIELD, (need_not_move,)),
    Row((S.NAVIGATING,), Tick, "_yield", YIELD, (is_taken,)),
    Do((S.YIELDING,), "_stand", (arrived,)),
    Row(
        *((S.YIELDING,), Tick, ("_note_taken", *END), S.IDLE, (is_taken, stands_before_goal, need_not_be_exact)),
        why=R.GOAL_TAKEN,
    ),
    Row((S.YIELDING,), Tick, "_go_to_goal", ON, (is_free,)),
    Row((S.YIELDING,), Tick, "_yield", YIELD, (is_elsewhere,)),
    Row((S.YIELDING,), GOAL_TIME, ("_note_taken", *END), S.IDLE, why=R.GOAL_STAYS_TAKEN),
    Do((S.DRIVING,), "_yield", (is_elsewhere,)),
    # Requests.
    Row((S.NAVIGATING,), Request, "_offer", S.OFFERING, (is_offered,)),
    Row(ALONE, Request, "_answer"),
    Row(ENGAGED, Request, "_answer", when=(is_stranger,)),
    Row(ENGAGED, Request, "_refuse_later", when=(asks_for_later,)),
    Row(ENGAGED, Request, ("_drop_asker", "_set_out", "_offer"), S.OFFERING, (asks_anew, only(asker), is_offered)),
    Row(ENGAGED, Request, ("_drop_asker", "_set_out", "_answer"), ON, (asks_anew, only(asker)), R.ASKED_ANEW),
    Row(
        (S.ALIGNED,),
        Request,
        ("_drop_asker", "_pull_away", "_answer"),
        S.DRIVING,
        (asks_anew, rest_coupled(asker)),
        R.ASKED_ANEW,
    ),
    Row(
        (S.DECOUPLING,),
        Request,
        ("_drop_asker", "_wait", "_answer"),
        WAIT,
        (asks_anew, last_leaving(asker)),
        R.CLOSING_UP,
    ),
    Row(ENGAGED, Request, ("_drop_asker", "_answer"), when=(asks_anew,)),
    Row((S.OFFERING,), Request, "_accept"),
    # An offer, and the lock that takes it.
    Row((S.OFFERING,), OFFER_TIME, ("_end_rides", "_set_out"), ON, why=R.OFFER_NOT_TAKEN),
    Do((S.OFFERING,), "_repeat_accept"),
    Row((S.OFFERING,), Lock, ("_board_here", "_confirm_lock"), S.ALIGNING, (is_rider,)),
    Row((S.NAVIGATING,), Lock, ("_board_there", "_confirm_lock"), S.ALIGNING, (is_promised,)),
    Row(BOARDING, Lock, "_confirm_lock", when=(is_rider,)),
    Row(BOARDING, Lock, ("_take_along", "_confirm_lock"), when=(is_promised,)),
    Row((*ALONE, S.OFFERING, *BOARDING), Lock, "_refuse_lock"),
    Row(WITH_RIDER, Lock, "_refuse_lock", when=(is_no_rider,)),
    # Alignment.
    Row((S.ALIGNING,), ALIGN_TIME, ("_end_rides", "_set_out"), ON, why=R.UNABLE_TO_ALIGN),
    Row((S.ALIGNING,), Tick, ("_end_rides", "_set_out"), ON, (given_up,), R.UNABLE_TO_ALIGN),
    Row(BOARDING, Tick, ("_drop_silent", "_set_out"), ON, (only(silent),), R.RIDER_GONE),
    Row((S.ALIGNED,), Tick, ("_drop_silent", "_pull_away"), S.DRIVING, (rest_coupled(silent),), R.RIDER_GONE),
    Do(BOARDING, "_drop_silent", (somebody_silent,)),
    Row((S.ALIGNING,), Tick, "_invite", S.ALIGNED, (arrived,)),
    # Coupling, one after another.
    Row((S.ALIGNED,), COUPLE_TIME, ("_drop_late", "_set_out"), ON, (only(late),), R.LARGE_COUPLE_TIME),
    Row((S.ALIGNED,), COUPLE_TIME, ("_drop_late", "_pull_away"), S.DRIVING, (rest_coupled(late),), R.LARGE_COUPLE_TIME),
    Row((S.ALIGNED,), COUPLE_TIME, "_drop_late", S.ALIGNED),
    Do((S.ALIGNED,), "_inform_all"),
    Do((S.ALIGNED,), "_invite"),
    Row((S.ALIGNED,), Coupled, ("_couple", "_pull_away", "_inform"), S.DRIVING, (is_new, rest_coupled(sender))),
    Row((S.ALIGNED,), Coupled, ("_couple", "_inform"), S.ALIGNED, (is_new,)),
    Row((S.ALIGNED, *WITH_RIDER), Coupled, "_inform"),
    # The ride.
    Row((S.ALIGNED, *WITH_RIDER), Ack, "_hear", when=(is_of_driver,)),
    Do((S.DRIVING, WAIT), "_count_metres"),
    Row((S.DRIVING,), Tick, ("_let_leave", "_hand_over"), S.DECOUPLING, (arrived,)),
    Row((S.DRIVING,), Tick, ("_note_outcome", "_end_rides", "_set_out"), ON, (given_up,)),
    Do((S.DRIVING, WAIT), "_inform_all"),
    Row((S.DRIVING,), Tick, "_wait", WAIT, (rider_missing, all_follow), R.NO_ACKNOWLEDGEMENT),
    Row((S.DRIVING,), Tick, "_wait", WAIT, (rider_missing,), R.NOT_FOLLOWING),
    Row((WAIT,), LOST_TIME, ("_drop_lost", "_set_out"), ON, (only(behind),), R.RIDER_LOST),
    Row((WAIT,), LOST_TIME, ("_drop_lost", "_wait"), WAIT, why=R.CLOSING_UP),
    Row((WAIT,), Tick, to=S.DRIVING, when=(all_there,)),
    # Its end.
    Do((S.DECOUPLING,), "_hand_over"),
    Row((S.DECOUPLING,), Ack, ("_complete", "_set_out"), ON, (takes_over, only(sender)), R.RIDE_COMPLETED),
    Row((S.DECOUPLING,), Ack, ("_complete", "_wait"), WAIT, (takes_over, last_leaving(sender)), R.CLOSING_UP),
    Row((S.DECOUPLING,), Ack, "_complete", when=(takes_over,)),
    Row((S.DECOUPLING,), HANDOVER_TIME, ("_drop_leaving", "_set_out"), ON, (only(leaving),), R.NO_HANDOVER),
    Row((S.DECOUPLING,), HANDOVER_TIME, ("_drop_leaving", "_wait"), WAIT, why=R.CLOSING_UP),
    # A hitchhiker ends its ride.
    Row((S.OFFERING, *BOARDING), RequestCancel, ("_note_why", "_drop_sender", "_set_out"), ON, (only(sender),)),
    Row((S.ALIGNED,), RequestCancel, ("_note_why", "_drop_sender", "_pull_away"), S.DRIVING, (rest_coupled(sender),)),
    Row((S.OFFERING, *BOARDING), RequestCancel, "_drop_sender"),
    Row(ENGAGED, Terminate, ("_note_why", "_drop_sender", "_set_out"), ON, (only(sender),)),
    Row((S.ALIGNED,), Terminate, ("_note_why", "_drop_sender", "_pull_away"), S.DRIVING, (rest_coupled(sender),)),
    Row((S.DECOUPLING,), Terminate, ("_drop_sender", "_wait"), WAIT, (last_leaving(sender),), R.CLOSING_UP),
    Row(ENGAGED, Terminate, "_drop_sender"),
)
