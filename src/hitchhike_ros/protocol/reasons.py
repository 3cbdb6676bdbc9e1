"""Why something ended, was refused or goes on otherwise: compared as enum members, told as text.

The text goes over the wire and to people; no program decides by it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Self


class Reason(Enum):
    """A reason that a robot of this package knows, with its text."""

    NONE = ""  # there is none, or it is told in another robot's own words

    # A driver refuses (P17 Algorithm 1). The paper's driver of high priority says nothing (P17) or denies at once
    # (P18 §4): this one denies.
    INVALID_PLACE = "Invalid HH place"
    PATH_TOO_SHORT = "Path too short"
    PROFILE_MISMATCH = "Profile mismatch"
    HIGH_PRIORITY = "High priority"
    ALREADY_DRIVING = "Already carrying a hitchhiker"
    NO_DRIVER = "Does not drive others"
    DRIVES_NOWHERE = "Drives nowhere"
    NOT_OFFERED = "No such offer"

    # A driver ends a ride, or waits.
    OFFER_NOT_TAKEN = "Offer not taken"
    UNABLE_TO_ALIGN = "Unable to align"
    LARGE_COUPLE_TIME = "Large couple_time"  # a hitchhiker says the same
    RIDER_GONE = "Hitchhiker not heard of"
    RIDER_LOST = "Hitchhiker lost"
    ASKED_ANEW = "Hitchhiker asks anew"
    REQUEST_CANCELLED = "Request cancelled"
    NO_ACKNOWLEDGEMENT = "No acknowledgement"
    NOT_FOLLOWING = "Hitchhiker does not follow"
    CLOSING_UP = "Riders move up"
    NO_HANDOVER = "Handover not acknowledged"
    RIDE_COMPLETED = "Ride completed"

    # A goal ends.
    ARRIVED = "Goal reached"
    GOAL_TAKEN = "goal taken"  # by a robot that keeps it: this one stands before it, which counts as reached
    GOAL_STAYS_TAKEN = "Goal did not become free"  # for one that wants to be there exactly
    CANNOT_GO_ON = "Navigation failed"
    NOT_LOCALIZED = "Not localized"
    GOAL_CANCELLED = "Goal cancelled"
    GOAL_CHANGED = "Goal changed"

    # A hitchhiker gets no ride.
    DRIVER_NOT_FOUND = "Driver not found"
    ALONE_IS_BETTER = "Driving alone is better"
    LOCK_NOT_CONFIRMED = "Lock not confirmed"
    DRIVER_GONE = "Driver not heard of"
    DRIVER_LATE = "Driver is late"
    CANNOT_MEET = "No way to the hitchhiking point"
    DRIVER_NOT_ALIGNED = "Driver did not align"

    # A ride breaks off, or is not simply ridden.
    DRIVER_LOST = "Driver lost"
    DRIVER_SILENT = "No message from the driver"
    NOT_CAUGHT = "Driver not caught up with"
    OUT_OF_SIGHT = "Driver out of sight"
    SEEN_AGAIN = "Driver seen again"

    SAME_GOAL = "Same goal"  # as the other robot of a ride
    ROLES_REVERSED = "Asks the better profile for a ride instead"

    __hash__ = object.__hash__

    def __str__(self) -> str:
        return self.value

    def __bool__(self) -> bool:
        return self is not Reason.NONE


LOCALIZATION_SILENT = "localization did not answer"
"""As the detail of a ride that ends."""

# How a detail is told where it is not simply added.
_DETAILED = {
    Reason.CANNOT_GO_ON: "{}: {}",
    Reason.NOT_LOCALIZED: "{}: {}",
    Reason.DRIVER_NOT_FOUND: "{} ({})",
    Reason.GOAL_TAKEN: "{} by {}",
    Reason.GOAL_STAYS_TAKEN: "{}: taken by {}",
    Reason.SAME_GOAL: "{}: {}",
}
_REACHED = (Reason.ARRIVED, Reason.GOAL_TAKEN)


@dataclass(frozen=True)
class Ending:
    """A reason, and what there is to say beside it; false where there is neither."""

    reason: Reason = Reason.NONE
    detail: str = ""

    @classmethod
    def told(cls, text: str) -> Self:
        """What another robot or module says: a reason where it is one, else its own words."""
        reason = _BY_TEXT.get(text)
        if reason is None and text.startswith(_TAKEN_BY):
            return cls(Reason.GOAL_TAKEN, text.removeprefix(_TAKEN_BY))
        return cls(Reason.NONE, text) if reason is None else cls(reason)

    def __str__(self) -> str:
        text = str(self.reason)
        if not self.detail:
            return text
        return _DETAILED.get(self.reason, "{}; {}").format(text, self.detail) if text else self.detail

    def __bool__(self) -> bool:
        return bool(self.reason or self.detail)

    @property
    def reached(self) -> bool:
        """Whether the goal counts as reached: nobody can stand where another robot does."""
        return self.reason in _REACHED

    def adding(self, detail: str) -> Self:
        """The same, with more to say."""
        return replace(self, detail=f"{self.detail}; {detail}" if self.detail else detail)


NONE = Ending()
"""Nothing is to be said."""

_TAKEN_BY = _DETAILED[Reason.GOAL_TAKEN].format(Reason.GOAL_TAKEN, "")
_BY_TEXT: dict[str, Reason] = {reason.value: reason for reason in Reason}
