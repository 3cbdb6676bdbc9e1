"""Where and when a hitchhiker meets its driver, how it gets there, and why the meeting comes to nothing."""

from __future__ import annotations

from hitchhike_ros.core.datatypes import Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, distance, wrap_angle
from hitchhike_ros.mapping.sites import Sites
from hitchhike_ros.protocol.events import NavigationReport, Situation
from hitchhike_ros.protocol.matching import Meeting
from hitchhike_ros.protocol.parameters import HitchhikingParameters
from hitchhike_ros.protocol.status import GoalCommand

# A hitchhiker within this of the heading of its hitchhiking point is in line. It turns where it stands (chosen).
_IN_LINE_RAD, _IN_LINE_M = 0.06, 0.25


class Rendezvous:
    """The hitchhiker's side of a ride that is agreed upon, until driver and hitchhiker stand behind one another.

    Without a ``meeting`` (P17) the hitchhiker stays where it is, and at a hitchhiking point turns into line.
    """

    def __init__(
        self,
        params: HitchhikingParameters,
        sites: Sites,
        ride_id: str,
        meeting: Meeting | None,
        now: float,
        ready_in_s: float,
    ) -> None:
        """``meeting`` was chosen ``now``, when the hitchhiker could start in ``ready_in_s``."""
        self.meeting = meeting
        self.way: GoalCommand | None = None
        self._params, self._sites, self._ride_id = params, sites, ride_id
        in_s = 0.0 if meeting is None else meeting.in_s
        self._way_s, self._due_at = in_s - ready_in_s, now + in_s
        self._place = 1  # behind the driver
        self._sent_off = False
        self._agreed_at = self._heard_at = self._driver_due_at = now
        self._lost_way_at: float | None = None

    # What the driver says.

    def agree(self, place: int, driver_in_s: float, now: float, estimate: PoseEstimate | None) -> None:
        """The driver has confirmed the lock, with the hitchhiker's place and when it will be aligned."""
        self._place, self._agreed_at, self._heard_at, self._driver_due_at = place, now, now, now + driver_in_s
        if self.meeting is None:
            self.way = self._turn_into_line(estimate)

    def hear(self, now: float) -> None:
        """The driver has said something."""
        self._heard_at = now

    def update(self, place: int, driver_in_s: float, now: float) -> None:
        """The driver says anew which place the hitchhiker has, and when it will be aligned."""
        self._driver_due_at = now + driver_in_s
        if place != self._place:
            self._place, self._sent_off = place, False

    # The own way.

    def go(self, situation: Situation, now: float, ready_in_s: float) -> None:
        """Start when it is time, rest when there, and note since when there is no way."""
        if self._arrived(situation.navigation):
            self.way = None
        if self.meeting is None:
            return
        if not self._sent_off and ready_in_s <= 0.0 and situation.estimate is not None:
            self.way, self._sent_off = self._way_to_wait(self.meeting, situation.estimate), True
        if not self._failed(situation.navigation):
            self._lost_way_at = None
        elif self._lost_way_at is None:
            self._lost_way_at = now

    def in_place(self, situation: Situation) -> bool:
        """Whether it stands where it meets its driver."""
        return self.meeting is None or (self._sent_off and (self.way is None or self._arrived(situation.navigation)))

    def arrives_in_s(self, situation: Situation, now: float, ready_in_s: float) -> float:
        """How long until it is where it meets its driver.

        While it cannot start it will be there later and later, and notes so.
        """
        assert self.meeting is not None
        if ready_in_s > 0.0:
            self._due_at = now + ready_in_s + self._way_s
            return ready_in_s + self._way_s
        estimate, waiting = situation.estimate, self.meeting.point.waiting_pose
        away_m = 0.0 if estimate is None or self.in_place(situation) else distance(estimate.pose, waiting)
        return max(self._due_at - now, away_m / self._params.cruise_speed_mps, 0.0)

    def ride_ends_in_s(self, now: float) -> float:
        """How long until the ride has ended that has not begun yet."""
        if self.meeting is None:
            return 0.0
        return max(0.0, self._due_at - now) + self.meeting.ends_in_s - self.meeting.in_s

    # Why the meeting comes to nothing.

    def driver_is_gone(self, now: float) -> bool:
        """Whether a driver that is to come from afar has not been heard of for too long."""
        return self.meeting is not None and now - self._heard_at > self._params.contact_timeout_s

    @property
    def driver_is_late(self) -> bool:
        """Whether the driver will come later than the hitchhiker would have waited for it."""
        if self.meeting is None:
            return False
        return self._driver_due_at > self._agreed_at + self.meeting.begins_in_s + self._params.patience_s

    def there_is_no_way(self, now: float) -> bool:
        """Whether navigation has had no path to the place for a while."""
        return self._lost_way_at is not None and now - self._lost_way_at > self._params.planner_patience_s

    @property
    def patience_s(self) -> float:
        """For how long the hitchhiker waits for its driver to align; one that meets it from afar has a way to go."""
        if self.meeting is None:
            return self._params.max_align_s
        return 2.0 * self.meeting.begins_in_s + self._params.patience_s + self._params.max_align_s

    # What that needs.

    def _arrived(self, report: NavigationReport | None) -> bool:
        return self._reports(report, "arrived")

    def _failed(self, report: NavigationReport | None) -> bool:
        return self._reports(report, "failed")

    def _reports(self, report: NavigationReport | None, state: str) -> bool:
        """Whether navigation says this of the way that was ordered."""
        way = self.way
        return report is not None and way is not None and (report.goal_id, report.state) == (way.id, state)

    def _way_to_wait(self, meeting: Meeting, estimate: PoseEstimate) -> GoalCommand | None:
        """The way to where it waits; robots with places farther back wait behind one another."""
        point = meeting.point
        apart_m = distance(point.aligning_pose, point.waiting_pose)
        pose = compose(point.waiting_pose, Pose2D(-(self._place - 1) * apart_m))
        if distance(estimate.pose, pose) <= _IN_LINE_M:
            return self._turn_into_line(estimate)
        return GoalCommand(f"{self._ride_id}-meet-{self._place}", pose.x, pose.y, pose.theta)

    def _turn_into_line(self, estimate: PoseEstimate | None) -> GoalCommand | None:
        """A turn on the spot, None where it stands as its hitchhiking point asks.

        A wall tells better than localization how it stands.
        """
        point = None if estimate is None else self._sites.hitchhiking_point_at(estimate.pose.x, estimate.pose.y)
        if estimate is None or point is None:
            return None
        own, heading = estimate.pose, point.waiting_pose.theta
        if abs(wrap_angle(own.theta - heading)) <= _IN_LINE_RAD:
            return None
        order = f"{self._ride_id}-line"
        return GoalCommand(order, own.x, own.y, heading, _IN_LINE_M, _IN_LINE_RAD, along_wall=point.wall)
