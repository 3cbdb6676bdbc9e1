"""The hitchhiker of P17 Algorithm 2 as a table: ask, lock, meet, couple, ride, take over the pose, go on.

In a network (P18 §4) it asks all drivers, hears their answers for a while, chooses, and goes to where they meet. When
nobody can drive it, or driving alone is better, it leaves at once.

A driver that is lost from sight is sought by the camera first (``seeking``, while servoing coasts and looks around).
When that fails, the hitchhiker goes on by itself: it localizes from what it knows of the driver (``locating``), drives
up behind the driver, who waits (``catching_up``), couples anew (``recoupling``), and rides on. When one of these fails
or takes too long, the ride ends: the robot lets the driver go first (``parting``) and drives to its goal alone, as
P17 §4 does at once.
"""

from __future__ import annotations

from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven, Tick
from hitchhike_ros.protocol.hitchhiker.facts import HitchhikerFacts as Facts
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState as S
from hitchhike_ros.protocol.machine import Deadline, Do, Row
from hitchhike_ros.protocol.messages import Accept, Ack, Aligned, Decouple, Deny, Driver, Lock, Request, Terminate
from hitchhike_ros.protocol.reasons import Reason

# Guards.


def first_come_first_served(f: Facts) -> bool:
    """P17; in a network (P18) all offers are heard first."""
    return f.params.mode == "local"


def has_heard_enough(f: Facts) -> bool:
    """All drivers, from where the hitchhiker knows that it is."""
    located = f.situation.estimate is not None
    return f.params.mode == "network" and located and f.asking.heard_enough(f.now, f.neighbours)


def has_a_good_offer(f: Facts) -> bool:
    return f.asking.choice is not None


def has_offers(f: Facts) -> bool:
    return bool(f.asking.offers)


def is_of_another_driver(f: Facts) -> bool:
    """The driver that is taken may make its offer once more."""
    return isinstance(f.event, Accept) and f.event.robot_id != f.choice.offer.robot_id


def confirms_the_lock(f: Facts) -> bool:
    return isinstance(f.event, Ack) and f.event.of == Lock.type


def meets_from_afar(f: Facts) -> bool:
    return f.choice.meeting is not None


def driver_is_gone(f: Facts) -> bool:
    return f.rendezvous.driver_is_gone(f.now)


def driver_is_late(f: Facts) -> bool:
    return f.rendezvous.driver_is_late


def there_is_no_way(f: Facts) -> bool:
    return f.rendezvous.there_is_no_way(f.now)


def is_in_place(f: Facts) -> bool:
    return f.rendezvous.in_place(f.situation)


def sees_driver(f: Facts) -> bool:
    return f.ride.seen(f.situation, f.now) is not None


def keeps_the_gap(f: Facts) -> bool:
    return f.ride.settled(f.situation, f.now)


def driver_has_not_spoken(f: Facts) -> bool:
    return f.ride.report is None


def driver_is_silent(f: Facts) -> bool:
    return f.ride.silent(f.now)


def driver_is_out_of_sight(f: Facts) -> bool:
    return f.ride.out_of_sight(f.now)


def driver_is_within_reach(f: Facts) -> bool:
    return f.ride.within_reach(f.situation, f.now)


def nowhere_left_to_look(f: Facts) -> bool:
    return f.pursuit.nowhere_left


def stands_behind_driver(f: Facts) -> bool:
    """The driver's pose and the marker's must be of one moment: both robots stand, and the marker was seen since."""
    standing = f.situation.stands(f.params.standstill_mps, f.params.standstill_rps)
    return standing and sees_driver(f) and f.in_state_s >= f.params.repeat_period_s


def is_located(f: Facts) -> bool:
    """Whether localization goes on from the pose that it was given."""
    return f.restart is not None and f.restart.taken(f.situation.estimate)


def took_the_pose_over(f: Facts) -> bool:
    return f.handed_over


def did_not_take_the_pose_over(f: Facts) -> bool:
    return not f.handed_over


def may_go_first(f: Facts) -> bool:
    """A driver that has handed its pose over stands; and a robot without a goal stays where it is."""
    return f.handed_over or f.goal is None


# Limits of states, in s, and from when they count where that is not the beginning of the state.


def max_wait(f: Facts) -> float:
    """T_hwait (P17), which the priority stretches and shrinks (P18 §4)."""
    return f.params.patience_s


def first_request(f: Facts) -> float:
    """However often drivers have failed to come since."""
    return f.asked_since


def confirm_timeout(f: Facts) -> float:
    return f.params.confirm_timeout_s


def max_align(f: Facts) -> float:
    """T_align (P17); robots that meet from afar have a way to go first."""
    return f.rendezvous.patience_s


def max_couple(f: Facts) -> float:
    """T_coupling (P17)."""
    return f.params.max_couple_s


def seek_timeout(f: Facts) -> float:
    return f.params.seek_timeout_s


def localize_timeout(f: Facts) -> float:
    return f.params.localize_timeout_s


def catch_up_timeout(f: Facts) -> float:
    return f.params.catch_up_timeout_s


def part_time(f: Facts) -> float:
    return f.params.part_s


def settle_timeout(f: Facts) -> float:
    return f.params.settle_timeout_s


# Rows.

_LOCKED = (S.LOCKING, S.AWAITING_ALIGNED)
_MEETING = (S.AWAITING_ALIGNED,)
_BOARDING = (S.AWAITING_ALIGNED, S.COUPLING)
_RIDING = (S.RIDING, S.SEEKING)
_FOUND = (S.CATCHING_UP, S.RECOUPLING)
_OVER = (S.RELOCALIZING, S.PARTING, S.IDLE)
_WITH_DRIVER = tuple(state for state in S if state not in (S.IDLE, S.REQUESTING))

_END_REQUEST = ("_cancel_offers", "_finish")
_REQUEST_ANEW = ("_report_ending", "_request_anew")
_LEAVE_OFFERS = ("_report_ending", "_cancel_offers", "_request_anew")
_CALL_OFF = ("_tell_driver", *_REQUEST_ANEW)

ASKING = (
    Row((S.IDLE,), GoalGiven, ("_take_goal", "_request_anew", "_repeat_request"), S.REQUESTING),
    Row((S.REQUESTING,), Accept, ("_take_offer", "_repeat_lock"), S.LOCKING, (first_come_first_served,)),
    Row((S.REQUESTING,), Accept, "_note_offer"),
    Row((S.REQUESTING,), Deny, "_note_denial"),
    Row((S.REQUESTING,), Request, "_note_question"),
    Do((S.REQUESTING,), "_choose", (has_heard_enough,)),
    Row((S.REQUESTING,), Tick, ("_take_best_offer", "_repeat_lock"), S.LOCKING, (has_a_good_offer,)),
    Row((S.REQUESTING,), Tick, _END_REQUEST, S.IDLE, (has_heard_enough, has_offers), Reason.ALONE_IS_BETTER),
    Row((S.REQUESTING,), Tick, ("_add_denial", "_finish"), S.IDLE, (has_heard_enough,), Reason.DRIVER_NOT_FOUND),
    Do((S.REQUESTING,), "_repeat_request"),
    Row(
        *((S.REQUESTING,), Deadline(max_wait, first_request), ("_add_denial", *_END_REQUEST), S.IDLE),
        why=Reason.DRIVER_NOT_FOUND,
    ),
    Row(_WITH_DRIVER, Accept, "_refuse_offer", when=(is_of_another_driver,)),
    Row((S.IDLE,), Accept, "_refuse_offer"),
)
MEETING = (
    Do((S.LOCKING,), "_repeat_lock"),
    Row((S.LOCKING,), Ack, ("_cancel_other_offers", "_agree"), S.AWAITING_ALIGNED, (confirms_the_lock,)),
    Row((S.LOCKING,), Deny, ("_take_reason", *_LEAVE_OFFERS), S.REQUESTING),
    Row((S.LOCKING,), Terminate, ("_take_reason", *_LEAVE_OFFERS), S.REQUESTING),
    Row(
        *((S.LOCKING,), Deadline(confirm_timeout), ("_take_request_back", *_LEAVE_OFFERS), S.REQUESTING),
        why=Reason.LOCK_NOT_CONFIRMED,
    ),
    Do(_MEETING, "_go_to_meet"),
    Row(_MEETING, Tick, _CALL_OFF, S.REQUESTING, (driver_is_gone,), Reason.DRIVER_GONE),
    Row(_MEETING, Tick, _CALL_OFF, S.REQUESTING, (driver_is_late,), Reason.DRIVER_LATE),
    Row(_MEETING, Tick, _CALL_OFF, S.REQUESTING, (there_is_no_way,), Reason.CANNOT_MEET),
    Do(_MEETING, "_say_when", (meets_from_afar,)),
    Row(_MEETING, Ack, ("_note_contact", "_note_place"), when=(confirms_the_lock,)),
    Row(_MEETING, Ack, "_note_contact"),
    Row(_MEETING, Deadline(max_align), _CALL_OFF, S.REQUESTING, why=Reason.DRIVER_NOT_ALIGNED),
    Row(_LOCKED, Aligned, "_couple", S.COUPLING, (is_in_place,)),
    Row(_LOCKED, Aligned, "_note_contact"),  # the driver says so again
    Row(_BOARDING, Deny, ("_take_reason", *_REQUEST_ANEW), S.REQUESTING),
    Row(_BOARDING, Terminate, ("_take_reason", *_REQUEST_ANEW), S.REQUESTING),
)
RIDING = (
    Do((S.COUPLING, *_RIDING, S.SETTLING, S.RECOUPLING), "_look"),
    Row((S.COUPLING,), Tick, ("_begin_ride", "_ride"), S.RIDING, (keeps_the_gap,)),
    Row((S.COUPLING,), Deadline(max_couple), _CALL_OFF, S.REQUESTING, why=Reason.LARGE_COUPLE_TIME),
    Do((S.RIDING,), "_repeat_coupled", (sees_driver, driver_has_not_spoken)),
    Row(_RIDING, Tick, ("_tell_driver", "_localize"), S.RELOCALIZING, (driver_is_silent,), Reason.DRIVER_SILENT),
    Row((S.RIDING,), Tick, None, S.SEEKING, (driver_is_out_of_sight,), Reason.OUT_OF_SIGHT),
    Row((S.SEEKING,), Tick, "_ride", S.RIDING, (sees_driver,), Reason.SEEN_AGAIN),
    Row((S.SEEKING,), Deadline(seek_timeout), "_localize", S.LOCATING, why=Reason.DRIVER_LOST),
    Row((*_RIDING, S.LOCATING, *_FOUND), Driver, ("_hear", "_match", "_acknowledge")),
    Row(_RIDING, Decouple, "_hear", S.SETTLING),
)
RETURNING = (
    Row((S.LOCATING,), Tick, "_tell_driver", S.RELOCALIZING, (driver_is_silent,), Reason.DRIVER_SILENT),
    Row((S.LOCATING,), Tick, "_pursue", S.CATCHING_UP, (is_located,), Reason.OUT_OF_SIGHT),
    Row(
        *((S.LOCATING,), Deadline(localize_timeout), ("_add_silence", "_tell_driver"), S.PARTING),
        why=Reason.DRIVER_LOST,
    ),
    Row((S.LOCATING,), Decouple, ("_hear", "_tell_driver"), S.RELOCALIZING, why=Reason.DRIVER_LOST),
    Row(_FOUND, Tick, "_tell_driver", S.PARTING, (driver_is_silent,), Reason.DRIVER_SILENT),
    Row((S.CATCHING_UP,), Tick, "_settle_anew", S.RECOUPLING, (driver_is_within_reach,), Reason.SEEN_AGAIN),
    Do((S.CATCHING_UP,), "_aim"),
    Row((S.CATCHING_UP,), Tick, "_tell_driver", S.PARTING, (nowhere_left_to_look,), Reason.NOT_CAUGHT),
    Row((S.CATCHING_UP,), Deadline(catch_up_timeout), "_tell_driver", S.PARTING, why=Reason.NOT_CAUGHT),
    Row((S.RECOUPLING,), Tick, "_ride", S.RIDING, (keeps_the_gap,), Reason.SEEN_AGAIN),
    Row((S.RECOUPLING,), Deadline(max_couple), "_tell_driver", S.PARTING, why=Reason.LARGE_COUPLE_TIME),
    Row(_FOUND, Decouple, ("_hear", "_tell_driver"), S.PARTING, why=Reason.DRIVER_LOST),
    Row(_FOUND, Terminate, "_take_reason", S.PARTING),
)
ENDING = (
    Row((*_RIDING, S.LOCATING, S.SETTLING), Terminate, ("_take_reason", "_localize"), S.RELOCALIZING),
    Row((S.SETTLING,), Decouple, "_hear"),
    Row((S.SETTLING,), Tick, "_take_over", S.RELOCALIZING, (stands_behind_driver,)),
    Row((S.SETTLING,), Deadline(settle_timeout), "_take_over", S.RELOCALIZING, (sees_driver,)),
    Row(
        *((S.SETTLING,), Deadline(settle_timeout), ("_tell_driver", "_localize"), S.RELOCALIZING),
        why=Reason.DRIVER_LOST,
    ),
    Row((S.RELOCALIZING,), Tick, ("_place_ahead", "_finish"), S.IDLE, (is_located, may_go_first), None),
    Row((S.RELOCALIZING,), Tick, "_place_ahead", S.PARTING, (is_located,), None),
    Row((S.RELOCALIZING,), Deadline(localize_timeout), ("_add_silence", "_finish"), S.IDLE, why=None),
    Row((S.PARTING,), Deadline(part_time), "_finish", S.IDLE, why=None),
    Row((S.RELOCALIZING, S.IDLE), Decouple, "_acknowledge_handover", when=(took_the_pose_over,)),
    Row(_OVER, Decouple, "_say_it_is_over"),
    Row(_OVER, Driver, "_say_it_is_over", when=(did_not_take_the_pose_over,)),
    Row((S.IDLE,), Aligned, "_say_it_is_over", when=(did_not_take_the_pose_over,)),
)
CANCELLING = (
    Row((S.REQUESTING,), GoalCancelled, _END_REQUEST, S.IDLE, why=Reason.GOAL_CANCELLED),
    Row(
        *((S.LOCKING,), GoalCancelled, ("_cancel_offers", "_take_request_back", "_finish"), S.IDLE),
        why=Reason.GOAL_CANCELLED,
    ),
    Row(_BOARDING, GoalCancelled, ("_take_request_back", "_finish"), S.IDLE, why=Reason.GOAL_CANCELLED),
    Row(
        *((*_RIDING, S.SETTLING, S.LOCATING), GoalCancelled, ("_forget_goal", "_tell_driver", "_localize")),
        *(S.RELOCALIZING,),
        why=Reason.GOAL_CANCELLED,
    ),
    Row(_FOUND, GoalCancelled, ("_forget_goal", "_tell_driver", "_finish"), S.IDLE, why=Reason.GOAL_CANCELLED),
    Row((S.PARTING,), GoalCancelled, ("_forget_goal", "_finish"), S.IDLE, why=Reason.GOAL_CANCELLED),
    Row((S.IDLE, S.RELOCALIZING), GoalCancelled, "_forget_goal"),
)
ROWS = (*ASKING, *MEETING, *RIDING, *RETURNING, *ENDING, *CANCELLING)
