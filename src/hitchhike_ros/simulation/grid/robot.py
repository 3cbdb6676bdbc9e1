"""One robot of the grid simulator: what is known of it, and what it has been sent for."""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field

from hitchhike_ros.core.datatypes import NonNegative, Obstacle, Pose2D
from hitchhike_ros.protocol.agent import Agent
from hitchhike_ros.protocol.events import Award, Report
from hitchhike_ros.protocol.inbox import Inbox
from hitchhike_ros.protocol.outbox import Outbox
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.protocol.reasons import NONE, Ending
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.grid.body import Body
from hitchhike_ros.simulation.grid.inbox import ObjectInbox
from hitchhike_ros.simulation.grid.paths import Known

# A hitchhiker's metres are ridden in these phases.
_RIDDEN = (Phase.COUPLED, Phase.HANDING_OVER)
# In these it looks for a ride, and goes to where the ride begins.
_BEFORE_RIDE = (Phase.ASKING, Phase.MEETING, Phase.COUPLING)


@dataclass(frozen=True)
class Errand:
    """A goal, and when it is given: at a time, or so long after the errand before has ended, whichever is later."""

    goal: Pose2D
    at_s: NonNegative = 0.0
    after_s: NonNegative = 0.0


@dataclass
class Trip:
    """What became of an errand. Times are the world's, metres the body's."""

    goal: Pose2D
    began_s: float
    ended_s: float | None = None
    reason: Ending = NONE
    driven_m: float = 0.0
    ridden_m: float = 0.0
    coupled_s: float = 0.0  # with its own modules off
    asked_s: float = 0.0  # in the states before a ride

    @property
    def reached(self) -> bool:
        return self.reason.reached


@dataclass(eq=False)
class GridRobot:
    """One robot: its agent, its body, and what its modules know."""

    name: str
    index: int
    params: HitchhikingParameters
    start: Pose2D
    body: Body
    agent: Agent
    inbox: Inbox | ObjectInbox
    clock_offset_s: float = 0.0
    safe_speed_mps: float = math.inf  # of the body, whatever it is told
    errands: deque[Errand] = field(default_factory=deque)
    trips: list[Trip] = field(default_factory=list)
    known: dict[str, Obstacle] = field(default_factory=dict)  # the boxes in its map
    awards: list[Award] = field(default_factory=list)
    reports: list[tuple[float, Report]] = field(default_factory=list)
    history: list[tuple[float, str, str]] = field(default_factory=list)  # when it came to which state, and why
    state_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    sent: Counter[str] = field(default_factory=Counter)
    ridden_m: float = 0.0
    coupled_s: float = 0.0
    asked_s: float = 0.0
    alive: bool = True
    # Of the event loop.
    status: Status = field(default_factory=lambda: Status(0.0, ""))
    key: tuple[object, ...] = ()  # the states of its machines when its status was last asked for
    outbox: Outbox = field(default_factory=Outbox)
    due: float = math.inf  # of its next tick
    beacon_due: float = 0.0
    engaged: bool = False  # in more than driving alone
    # Of its navigation and its camera.
    goal_id: str = ""
    goal_error: str | None = None
    news: bool = False  # its navigation has something to say
    perceives_at_m: float = math.inf  # by its odometer
    followed: tuple[str, int] | None = None
    known_ids: Known = ()
    obstacles: tuple[Obstacle, ...] = ()
    # When the current state began, and what the odometer said then.
    since: float = 0.0
    metres_at: float = 0.0

    @property
    def trip(self) -> Trip | None:
        """The one under way."""
        return self.trips[-1] if self.trips and self.trips[-1].ended_s is None else None

    @property
    def idle(self) -> bool:
        """Whether nothing is asked of it any more."""
        return self.trip is None and not self.errands

    @property
    def coupled(self) -> bool:
        """Whether it rides, with its own modules off."""
        return self.status.role == "hitchhiker" and self.status.phase in _RIDDEN

    def take_status(self, status: Status, now: float) -> None:
        """Its status has become this one."""
        before = self.status
        if (status.state, status.reason, status.role) != (before.state, before.reason, before.role):
            self.account(now)
            self.history.append((now, status.state, status.reason))
        self.status = status
        self.engaged = status.phase is not Phase.ALONE

    def account(self, now: float) -> None:
        """Credit time and metres since the last change of state to the state that ends."""
        status = self.status
        passed, metres = now - self.since, self.body.odometer_m - self.metres_at
        self.state_s[status.state] += passed
        if self.coupled:
            self.ridden_m += metres
            self.coupled_s += passed
        elif status.role == "hitchhiker" and status.phase in _BEFORE_RIDE:
            self.asked_s += passed
        self.since, self.metres_at = now, self.body.odometer_m

    def begin_trip(self, goal: Pose2D, now: float) -> None:
        """It has been given a goal."""
        self.body.advance(now)
        self.account(now)
        trip = Trip(goal, now)
        trip.driven_m, trip.ridden_m = -self.body.odometer_m, -self.ridden_m
        trip.coupled_s, trip.asked_s = -self.coupled_s, -self.asked_s
        self.trips.append(trip)

    def end_trip(self, trip: Trip, now: float, ending: Ending) -> None:
        """The trip under way is over."""
        self.account(now)
        trip.ended_s, trip.reason = now, ending
        trip.driven_m += self.body.odometer_m
        trip.ridden_m += self.ridden_m
        trip.coupled_s += self.coupled_s
        trip.asked_s += self.asked_s

    def fall_silent(self, now: float) -> None:
        """Its computer is off, and it stands."""
        self.body.advance(now)
        self.account(now)
        self.body.stop()
        self.alive, self.due, self.engaged, self.followed, self.goal_id = False, math.inf, False, None, ""

    def wake(self, agent: Agent, inbox: Inbox | ObjectInbox, now: float) -> None:
        """Its computer is on again, and remembers nothing but the map."""
        self.agent, self.inbox, self.outbox = agent, inbox, Outbox()
        self.alive, self.key = True, ()
        self.status, self.since = agent.status(now + self.clock_offset_s, others=False), now
