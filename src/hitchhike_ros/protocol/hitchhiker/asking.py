"""What a hitchhiker hears while it asks for a ride, and which offer it takes."""

from __future__ import annotations

from dataclasses import dataclass

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.itinerary import SoloMetres
from hitchhike_ros.protocol.matching import Meeting, choose
from hitchhike_ros.protocol.messages import EVERYBODY, Accept
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.reasons import NONE, Ending


@dataclass(frozen=True)
class Choice:
    """An offer that is taken; ``meeting`` says where the robots meet, where it was arranged from afar."""

    offer: Accept
    meeting: Meeting | None = None
    agreed_m: float | None = None  # how long the driver says that the ride is, now that it is locked

    @property
    def ride_m(self) -> float:
        """How long the ride will be."""
        if self.agreed_m is not None:
            return self.agreed_m
        return self.offer.ride_m if self.meeting is None else self.meeting.ride_m


class Asking:
    """One request for a ride: the offers that stand, and who has answered."""

    def __init__(
        self,
        params: HitchhikingParameters,
        now: float,
        window_s: float,
        whom: str = EVERYBODY,
        told: Ending = NONE,
    ) -> None:
        """The request is made ``now`` of ``whom``, and offers are awaited for ``window_s``.

        ``told`` is why the request before this one came to nothing, and then what the last denial says.
        """
        self.choice: Choice | None = None
        self.told = told
        self.offers: dict[str, tuple[Accept, float]] = {}  # by driver: its newest offer, and when that came
        self._answered: set[str] = set()
        self._params, self._asked_at, self._window_s, self._whom = params, now, window_s, whom

    def note_offer(self, offer: Accept, now: float) -> None:
        """A driver offers a ride."""
        self.offers[offer.robot_id] = offer, now
        self._answered.add(offer.robot_id)

    def note_denial(self, driver: str, told: Ending) -> None:
        """A driver refuses, or takes its offer back."""
        self.told = told
        self.offers.pop(driver, None)
        self._answered.add(driver)

    def note_question(self, robot_id: str) -> None:
        """A robot that was asked for a ride asks for one itself: it wants the roles reversed."""
        self._answered.add(robot_id)

    def heard_enough(self, now: float, neighbours: Neighbours) -> bool:
        """Whether all that may answer have answered, or the time for offers is over.

        A robot that got its goal a moment ago offers places only from its next beacon on. For the period of one beacon
        all known robots count as drivers.
        """
        waited = now - self._asked_at
        if waited >= self._window_s:
            return True
        if self._whom != EVERYBODY:
            return self._whom in self._answered
        expected = neighbours.known if waited < self._params.beacon_period_s else neighbours.drivers
        return bool(self._answered) and expected(now, self._params.robot_timeout_s) <= self._answered

    def choose(
        self, here: Pose2D, goal: Pose2D, ready_in_s: float, now: float, sites: Sites, metres: SoloMetres
    ) -> None:
        """Set ``choice`` to the best of all offers, None where driving alone is better.

        Args:
            here: where it starts from, in ``map``.
            goal: where it wants to be, in ``map``.
            ready_in_s: in how many seconds from ``now`` it can start.
            now: the time of the choice.
            sites: the hitchhiking points of the world.
            metres: the ways of driving alone.
        """
        meeting = choose(here, goal, ready_in_s, self.offers, now, sites, self._params, metres)
        self.choice = None if meeting is None else Choice(self.offers[meeting.driver][0], meeting)

    def drop_offers(self, but_of: str = "") -> list[str]:
        """Forget all offers; returns the drivers that wait for an answer to theirs, without ``but_of``."""
        drivers = [driver for driver in self.offers if driver != but_of]
        self.offers = {}
        return drivers
