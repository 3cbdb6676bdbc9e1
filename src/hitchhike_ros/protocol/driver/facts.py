"""What a driver knows: always, and in each phase of a ride."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.errors import PlanningError
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.planning.free_place import taken_by
from hitchhike_ros.protocol.announcement import OwnPath
from hitchhike_ros.protocol.common_goal import SETTLED_WITHIN_M, Yield, occupied, settle, stands
from hitchhike_ros.protocol.driver.convoy import Convoy, Odometer, Offer, Rider
from hitchhike_ros.protocol.driver.navigation_watch import NavigationWatch
from hitchhike_ros.protocol.driver.route import Route, onward
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.machine import Facts, of_phases
from hitchhike_ros.protocol.matching import Planner
from hitchhike_ros.protocol.messages import Beacon, RearMarker, Waypoint
from hitchhike_ros.protocol.neighbours import Neighbours
from hitchhike_ros.protocol.parameters import TIME_CRITICAL_PRIORITY, HitchhikingParameters
from hitchhike_ros.protocol.phase import Phase

WITH_RIDER = DriverState.of(Phase.COUPLED, Phase.HANDING_OVER)
ENGAGED = DriverState.of(Phase.ASKING, Phase.MEETING, Phase.COUPLING, Phase.COUPLED, Phase.HANDING_OVER)


@dataclass(frozen=True)
class Boarding:
    """Where the driver aligns: ``at_m`` along its path, which it reaches within ``within_s`` of the lock."""

    at_m: float = 0.0
    within_s: float = 0.0


@dataclass(eq=False, kw_only=True)
class DriverFacts(Facts):
    """``planner`` gives the path (N, 2) in ``map`` between two poses and raises PlanningError where there is none."""

    robot_id: str
    params: HitchhikingParameters
    sites: Sites
    planner: Planner
    rear_marker: RearMarker  # on the own back
    neighbours: Neighbours
    radius_m: float
    said: Beacon | None = None  # the own beacon that others have heard last
    settled: Yield | None = None  # what the rule says now of the goal, or of the end of the ride
    yields: Yield | None = None  # and what the robot acts on: where it stops before another that has the place
    orders: int = 0  # to stop somewhere else
    set_down: bool = False  # by a driver, where it was given its goal
    stands_since: float = math.inf  # before a goal that it waits for
    navigation: NavigationWatch = field(init=False)
    route: Route | None = None  # to the own goal; only an idle robot has none
    judged: tuple[object, float, object] | None = None  # an event, when it came, and what offers.verdict made of it
    promised: dict[tuple[str, str], tuple[float, Offer]] = field(default_factory=dict)  # to whom, until when it holds
    convoy: Convoy = of_phases(Phase.ASKING, Phase.MEETING, Phase.COUPLING, Phase.COUPLED, Phase.HANDING_OVER)
    boarding: Boarding = of_phases(Phase.MEETING, Phase.COUPLING)
    odometer: Odometer = of_phases(Phase.COUPLED, Phase.HANDING_OVER)

    def __post_init__(self) -> None:
        self.navigation = NavigationWatch(self.params, self.planner)

    @property
    def riders(self) -> tuple[Rider, ...]:
        """Who rides or is about to, in the order of their places."""
        return tuple(self.convoy) if self.state in ENGAGED else ()

    @property
    def first(self) -> Rider | None:
        """The rider behind the driver."""
        return self.convoy.first if self.state in ENGAGED else None

    @property
    def estimate(self) -> PoseEstimate | None:
        return self.situation.estimate

    @property
    def free_places(self) -> int:
        """For hitchhikers who might ask now."""
        if not self.params.may_drive or self.params.priority >= TIME_CRITICAL_PRIORITY:
            return 0
        if self.state is DriverState.NAVIGATING:
            return self.params.places
        if self.state not in (DriverState.ALIGNING, DriverState.ALIGNED):
            return 0
        riders = self.riders  # the next one follows the last of them
        return self.params.places - len(riders) if riders[-1].rear_marker else 0

    @property
    def speed_limit_mps(self) -> float:
        """On the way to a hitchhiker who would wait, up to the safe limit (velocity tuning, P18 §4)."""
        if self.state in WITH_RIDER:
            return self.params.ride_speed_mps
        cruise, rider = self.params.cruise_speed_mps, self.first
        if self.state is not DriverState.ALIGNING or rider is None or self.params.mode == "local":
            return cruise
        needed = self.to_board_m() / max(rider.due - self.now, 1e-3)
        return min(max(cruise, needed), max(cruise, self.params.safe_speed_mps))

    def settlement(self, place: Pose2D) -> Yield | None:
        """Where it stops before ``place``, which it is on its way to and another robot has; None where it has that."""
        estimate, said = self.estimate, self.said
        if estimate is None or said is None or stands(said) or distance(estimate.pose, place) > SETTLED_WITHIN_M:
            return None
        beacons = self.neighbours.beacons(self.now, self.params.contact_timeout_s)
        riders = {rider.offer.hitchhiker for rider in self.riders}
        others = occupied(said, (beacon for beacon in beacons if beacon.robot_id not in riders))
        if taken_by(place, self.radius_m, others) is None:
            return None
        try:
            return settle(self.planner(estimate.pose, place), place, self.radius_m, others)
        except PlanningError:
            return None  # navigation finds out too, and says why

    def own_path(self) -> OwnPath | None:
        """The way to the own goal as far as it is ahead; None without one."""
        may_plan = self.state is DriverState.NAVIGATING
        return None if self.route is None else self.route.path(self.estimate, may_plan)

    def to_board_m(self) -> float:
        """Along the own path to where it aligns."""
        path = self.own_path()
        return 0.0 if path is None else max(0.0, self.boarding.at_m - path.come_m)

    def to_board_s(self) -> float:
        """Until it is there; where both stand already (P17) this is no question."""
        return self.to_board_m() / self.speed_limit_mps if self.params.mode == "network" else 0.0

    def announced(self) -> tuple[Waypoint, ...]:
        """The way on which it would take a hitchhiker along, and when: from here, or from where it aligns."""
        path = self.own_path() if self.free_places else None
        if path is None:
            return ()
        if self.state is DriverState.NAVIGATING:
            return path.waypoints(self.params.cruise_speed_mps)
        point, in_s = self.riders[0].offer.point, self.to_board_m() / self.speed_limit_mps
        return onward(path, point, self.boarding.at_m, self.params.ride_speed_mps, in_s)
