"""Driving in a flat world: no contact, whatever stands there, and the goal where there is a way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flat_world import BOXES, CORRIDOR, LASER, P3DX, TURTLEBOT, FlatWorld, Rectangle, overlaps
from hitchhike_ros.control.clearance import ClearanceField, Footprint
from hitchhike_ros.control.dynamic_window import brake, roll_out
from hitchhike_ros.control.leg import Decision
from hitchhike_ros.control.local_planner import LocalPlanner
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.obstacle_memory import ObstacleMemory, scan_points
from hitchhike_ros.control.recovery import Recovery, RecoveryStep
from hitchhike_ros.core.datatypes import LaserScan, Pose2D, Twist2D
from hitchhike_ros.core.errors import PlanningError, SensorDataError
from hitchhike_ros.core.geometry import compose, wrap_angle
from hitchhike_ros.core.robot_model import RobotLimits

PARAMS = LocalPlannerParameters()
ROBOTS = pytest.mark.parametrize("limits", [P3DX, TURTLEBOT], ids=["p3dx", "turtlebot"])
AHEAD = [(6.0, 5.72), (20.0, 5.72)]  # along the middle of the corridor


class Drive:
    """A world and a controller, stepped until it no longer drives or time is up."""

    def __init__(
        self,
        limits: RobotLimits,
        rectangles: tuple[Rectangle, ...],
        start: Pose2D,
        path: list,
        goal: Pose2D,
        seed: int = 0,
    ) -> None:
        self.world = FlatWorld(limits, rectangles, start, seed)
        self.goal = goal
        self.controller = LocalPlanner(limits, PARAMS)
        self.controller.set_path(np.array(path), goal)
        self.decision = Decision(Twist2D(), "driving")
        self.poses, self.twists = [start], [Twist2D()]

    def step(self, speed_limit: float = 0.5, gentle: bool = False) -> Decision:
        w = self.world
        self.decision = self.controller.step(w.now, w.pose, w.twist, w.scan(), LASER[w.limits], speed_limit, gentle)
        w.drive(self.decision.twist)
        self.poses.append(w.pose)
        self.twists.append(w.twist)
        return self.decision

    def run(self, duration_s: float, speed_limit: float = 0.5, gentle: bool = False) -> Decision:
        end = self.world.now + duration_s
        while self.world.now < end and self.step(speed_limit, gentle).state == "driving":
            assert not self.world.touched, f"contact at {self.world.pose}"
        return self.decision

    def assert_arrived(self) -> None:
        assert self.decision.state == "arrived", self.decision
        assert not self.world.touched
        assert math.hypot(self.world.pose.x - self.goal.x, self.world.pose.y - self.goal.y) <= 0.10
        assert abs(wrap_angle(self.world.pose.theta - self.goal.theta)) <= math.radians(5.0)
        assert abs(self.world.twist.v) < 0.05


@ROBOTS
def test_it_passes_the_boxes_of_the_corridor_beside_a_path_that_grazes_them(limits: RobotLimits) -> None:
    path = [(8.0, 5.72), (16.5, 5.72)]
    drive = Drive(limits, CORRIDOR + BOXES, Pose2D(8.0, 5.72, 0.0), path, Pose2D(16.5, 5.72, 0.0))
    drive.run(40.0, 0.7)
    drive.assert_arrived()


@ROBOTS
def test_it_turns_through_a_door_into_the_corridor_and_out_of_it(limits: RobotLimits) -> None:
    lobby = [(2.6, 2.9), (3.0, 3.6), (3.0, 5.72), (4.6, 5.72)]
    drive = Drive(limits, CORRIDOR, Pose2D(2.6, 2.9, math.pi / 2), lobby, Pose2D(4.6, 5.72, 0.0))
    drive.run(40.0)
    drive.assert_arrived()
    out = [(23.0, 5.72), (25.0, 5.72), (25.0, 7.6)]
    drive = Drive(limits, CORRIDOR, Pose2D(23.0, 5.72, 0.0), out, Pose2D(25.0, 7.6, math.pi / 2))
    drive.run(40.0)
    drive.assert_arrived()


@pytest.mark.parametrize("theta", [math.pi / 2, math.pi, -2.0])
def test_it_turns_standing_when_the_path_starts_far_off_its_heading(theta: float) -> None:
    drive = Drive(P3DX, CORRIDOR, Pose2D(10.0, 5.72, theta), [(10.0, 5.72), (13.0, 5.72)], Pose2D(13.0, 5.72, 0.0))
    while abs(wrap_angle(drive.world.pose.theta)) > math.radians(60.0):
        assert drive.step().state == "driving"
        assert math.hypot(drive.world.pose.x - 10.0, drive.world.pose.y - 5.72) < 0.02
    drive.run(30.0)
    drive.assert_arrived()


@pytest.mark.parametrize("goal", [Pose2D(11.4, 5.9, 2.0), Pose2D(11.4, 5.5, -math.pi / 2), Pose2D(10.2, 5.72, 3.0)])
def test_it_arrives_within_tolerance_of_any_heading(goal: Pose2D) -> None:
    drive = Drive(P3DX, CORRIDOR, Pose2D(10.0, 5.72, 0.0), [(10.0, 5.72), (goal.x, goal.y)], goal, seed=3)
    drive.run(40.0)
    drive.assert_arrived()
    assert drive.step().state == "arrived"
    assert drive.decision.twist == Twist2D()


def test_a_box_right_in_front_is_passed_by_turning_first() -> None:
    box = (8.0, 5.5, 0.44, 0.44)
    drive = Drive(P3DX, (*CORRIDOR, box), Pose2D(7.6, 5.72, 0.0), [(7.6, 5.72), (10.0, 5.72)], Pose2D(10.0, 5.72, 0.0))
    drive.run(40.0)
    drive.assert_arrived()


@ROBOTS
def test_a_blocked_corridor_stops_it_with_a_reason_and_an_opened_one_lets_it_on(limits: RobotLimits) -> None:
    barrier = (10.0, 4.6, 0.4, 2.24)
    path = [(8.0, 5.72), (12.0, 5.72)]
    drive = Drive(limits, (*CORRIDOR, barrier), Pose2D(8.0, 5.72, 0.0), path, Pose2D(12.0, 5.72, 0.0))
    decision = drive.run(30.0)
    assert decision.state == "blocked"
    assert "no way past" in decision.reason
    assert decision.twist == Twist2D()
    assert 8.5 < drive.world.pose.x < 10.0 - limits.front_m - 0.05
    opened = Drive(limits, CORRIDOR, drive.world.pose, path, drive.goal)
    opened.controller = drive.controller
    opened.world.now = drive.world.now
    opened.run(60.0)
    opened.assert_arrived()


@ROBOTS
def test_blocked_it_tries_one_thing_after_the_other_and_never_touches_anything(limits: RobotLimits) -> None:
    pen = ((9.2, 5.3, 0.1, 0.9), (*CORRIDOR[2][:1], 6.3, 24.0, 0.1), (0.0, 5.1, 24.0, 0.1))
    path = [(8.0, 5.72), (12.0, 5.72)]
    drive = Drive(limits, CORRIDOR + pen, Pose2D(8.2, 5.72, 0.0), path, Pose2D(12.0, 5.72, 0.0))
    drive.run(10.0)
    said, turned = [], 0.0
    for second in range(25):
        for _ in range(10):
            decision = drive.step()
            assert decision.state == "blocked"
            said += [decision.reason.split("; ")[1]]
            turned += abs(drive.world.twist.omega) * 0.1 * (said[-1] == "turning to look")
        if second % 2:  # path_planning tries again and again
            drive.controller.set_path(np.array(path), drive.goal)
    steps = ["waiting", "forgetting obstacles out of view", "turning to look", "waiting for another plan"]
    steps += ["making room"]
    assert list(dict.fromkeys(said)) == steps
    assert [said.count(step) for step in steps[1:3]] == [10, 80]
    assert turned > 1.5 * math.pi
    assert not drive.world.touched
    while not drive.step().reason.endswith("; waiting"):
        assert drive.world.now < 90.0
    for _ in range(70):  # from the top, and with a rider it does not turn
        assert drive.step(gentle=True).twist == Twist2D()


@ROBOTS
def test_it_makes_room_for_those_who_wait_for_it_to_go(limits: RobotLimits) -> None:
    barrier, path = (10.0, 4.6, 0.4, 2.24), [(8.0, 5.72), (12.0, 5.72)]
    drive = Drive(limits, (*CORRIDOR, barrier), Pose2D(8.0, 5.72, 0.0), path, Pose2D(12.0, 5.72, 0.0))
    assert drive.run(30.0).state == "blocked"
    stopped = drive.world.pose.x
    for _ in range(250):
        drive.step()
        if drive.world.pose.x < stopped - 0.8:
            break
    assert drive.decision.reason.endswith("making room")
    drive.world._array = drive.world._array[:-1]
    for _ in range(80):
        drive.step()
    drive.run(30.0)
    drive.assert_arrived()


@ROBOTS
def test_before_a_closed_way_it_makes_room_once_and_does_not_go_to_and_fro(limits: RobotLimits) -> None:
    barrier, path = (10.0, 4.6, 0.4, 2.24), [(8.0, 5.72), (12.0, 5.72)]
    drive = Drive(limits, (*CORRIDOR, barrier), Pose2D(8.0, 5.72, 0.0), path, Pose2D(12.0, 5.72, 0.0))
    for second in range(80):
        for _ in range(10):
            drive.step()
        if second % 2 and drive.decision.state == "blocked":
            drive.controller.set_path(np.array([(drive.world.pose.x, drive.world.pose.y), path[-1]]), drive.goal)
    assert not drive.world.touched
    x = [pose.x for pose in drive.poses]
    assert min(x[200:400]) < 8.7  # it has made room
    assert min(x[400:]) > 9.2
    assert drive.decision.state == "blocked"


def test_it_backs_out_of_where_it_cannot_turn() -> None:
    """A long robot between a wall and a box: it has come in, and its corners are too far out to turn round."""
    limits = P3DX
    beside = ((9.0, 4.6, 1.6, 0.78), (9.0, 6.06, 1.6, 0.78), (10.4, 5.38, 0.2, 0.68))
    path = [(8.0, 5.72), (12.0, 5.72)]
    drive = Drive(limits, (*CORRIDOR, *beside), Pose2D(8.0, 5.72, 0.0), [(8.0, 5.72), (9.9, 5.72)], Pose2D(9.9, 5.72))
    drive.run(20.0)
    inside = drive.world.pose.x
    assert inside > 9.5
    drive.controller.set_path(np.array([(inside, 5.72), path[-1]]), Pose2D(12.0, 5.72, 0.0))
    for _ in range(300):
        drive.step()
        if drive.world.pose.x < inside - 0.8:
            break
    assert drive.world.pose.x < inside - 0.8
    assert abs(drive.world.pose.theta) < 0.5
    assert not drive.world.touched


def test_recovery_starts_over_after_a_calm_time_only() -> None:
    recovery = Recovery((RecoveryStep("wait", 2.0, ""), RecoveryStep("turn", 3.0, "")), calm_s=1.0)

    def act(now: float, blocked: bool = True) -> str | None:
        step = recovery.step(now, blocked)
        return None if step is None else step.action

    assert [act(t) for t in (0.0, 1.0)] == ["wait", "wait"]
    assert act(1.5, blocked=False) is None
    assert [act(t) for t in (2.0, 3.0, 4.0, 5.0)] == ["turn", "turn", "turn", "wait"]
    assert act(6.5, blocked=False) is None
    assert act(8.0) == "wait"
    assert act(0.0) == "wait"  # time ran backwards


def test_a_gap_too_narrow_is_not_tried() -> None:
    gap = ((10.0, 4.6, 0.3, 0.9), (10.0, 5.96, 0.3, 0.88))  # 0.46 m between them, the robot is 0.425 m wide
    drive = Drive(P3DX, CORRIDOR + gap, Pose2D(8.0, 5.72, 0.0), AHEAD, Pose2D(20.0, 5.72, 0.0))
    assert drive.run(30.0).state == "blocked"
    assert drive.world.pose.x < 10.0


def test_someone_stepping_into_the_way_stops_it_and_it_goes_on_when_they_have_gone() -> None:
    drive = Drive(P3DX, CORRIDOR, Pose2D(6.0, 5.72, 0.0), AHEAD, Pose2D(20.0, 5.72, 0.0))
    drive.run(2.5)
    crowd = (drive.world.pose.x + 1.0, 4.6, 0.3, 2.24)
    alone = drive.world._array
    drive.world._array = np.vstack([alone, crowd])
    for _ in range(30):
        drive.step()
    assert not drive.world.touched
    assert drive.world.twist.v < 0.01
    drive.world._array = alone
    for _ in range(30):
        drive.step()
    assert drive.decision.state == "driving"
    assert drive.world.twist.v > 0.3


def test_with_a_rider_it_turns_gently() -> None:
    boxes = ((19.0, 5.16, 0.40, 0.44), (21.7, 6.00, 0.44, 0.28))
    path = [(17.5, 5.72), (24.2, 5.72), (25.0, 6.5), (25.0, 9.0)]
    drive = Drive(P3DX, CORRIDOR + boxes, Pose2D(17.5, 5.72, 0.0), path, Pose2D(25.0, 9.0, math.pi / 2))
    while drive.world.pose.y < 8.0:
        assert drive.step(0.7, gentle=True).state == "driving"
        twist = drive.decision.twist
        assert abs(twist.omega) <= PARAMS.rider_yaw_rate_rps + 1e-9
        assert twist.v <= PARAMS.rider_speed_mps + 1e-9
    speeds = np.array([(t.v, t.omega) for t in drive.twists[:-5]])
    changes = np.abs(np.diff(speeds, axis=0)) / drive.world.period_s
    assert np.percentile(changes[:, 0], 99) <= PARAMS.rider_acceleration_mps2 + 1e-6
    assert changes[:, 1].max() <= PARAMS.rider_yaw_acceleration_rps2 + 1e-6
    assert not drive.world.touched


def test_the_speed_limit_holds_and_zero_is_a_pause() -> None:
    drive = Drive(P3DX, CORRIDOR, Pose2D(6.0, 5.72, 0.0), AHEAD, Pose2D(20.0, 5.72, 0.0))
    drive.run(4.0, speed_limit=0.3)
    assert max(t.v for t in drive.twists) == pytest.approx(0.3, abs=0.01)
    for _ in range(170):  # longer than it may be without progress
        assert drive.step(speed_limit=0.0) == Decision(Twist2D(), "driving", "speed limit is zero")
    drive.run(4.0)
    assert drive.world.twist.v > 0.4


def still(**changes: object) -> dict:
    """Good arguments of one step in a free place, with some of them changed."""
    scan = LaserScan(10.0, -2.0, 0.01, 0.02, 8.0, np.full(400, np.inf))
    good = {
        "now": 10.1,
        "pose": Pose2D(),
        "twist": Twist2D(),
        "scan": scan,
        "T_base_laser": Pose2D(0.17),
        "speed_limit": 0.5,
    }
    return {**good, **changes}


def controller(limits: RobotLimits = P3DX) -> LocalPlanner:
    planner = LocalPlanner(limits, PARAMS)
    planner.set_path(np.array([(0.0, 0.0), (5.0, 0.0)]), Pose2D(5.0, 0.0, 0.0))
    return planner


def ranges(values: object) -> LaserScan:
    return replace(still()["scan"], ranges=np.array(values, dtype=float))


def test_all_beams_free_is_driving() -> None:
    decision = controller().step(**still())
    assert decision.state == "driving"
    assert decision.twist.v > 0.0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"pose": Pose2D(math.nan)}, "not finite"),
        ({"twist": Twist2D(0.0, math.inf)}, "not finite"),
        ({"now": math.nan}, "not finite"),
        ({"now": 10.6}, "scan is 0.60 s old"),
        ({"now": 9.0}, "scan is -1.00 s old"),
        ({"speed_limit": math.nan}, "speed limit"),
        ({"speed_limit": -0.1}, "speed limit"),
        ({"scan": ranges([])}, "scan is empty"),
        ({"scan": ranges([math.nan] * 361 + [1.0] * 39)}, "361 of 400 beams are NaN or below range_min 0.02 m"),
        ({"scan": ranges([0.0] * 400)}, "400 of 400 beams are NaN or below range_min 0.02 m"),
        ({"scan": replace(still()["scan"], angle_increment=0.0)}, "senseless"),
        ({"scan": replace(still()["scan"], range_max=math.nan)}, "senseless"),
        ({"scan": ranges([-math.inf] * 400)}, "touches the footprint"),
        ({"pose": Pose2D(1.0, 3.0)}, "off the path"),
    ],
)
def test_senseless_input_is_a_stand_with_a_reason(changes: dict, reason: str) -> None:
    planner = controller()
    planner.step(**still(now=9.9, scan=replace(still()["scan"], stamp=9.9)))
    decision = planner.step(**still(**changes))
    assert decision.state == "blocked"
    assert decision.twist == Twist2D()
    assert reason in decision.reason


def test_without_a_path_it_stands() -> None:
    planner = controller()
    planner.clear()
    assert planner.step(**still()) == Decision(Twist2D(), "blocked", "no path")


@pytest.mark.parametrize(
    "path",
    [np.empty((0, 2)), np.array([[0.0, math.nan]]), np.zeros((3, 3)), np.array([[0.0, 0.0], [4.0, 0.0]])],
)
def test_a_senseless_path_is_refused(path: np.ndarray) -> None:
    with pytest.raises(PlanningError):
        controller().set_path(path, Pose2D(5.0, 0.0, 0.0))


def test_no_velocity_is_chosen_that_cannot_stop_before_contact() -> None:
    """At full speed towards a wall, from every distance: either it brakes now or it still could a period later."""
    wall = np.linspace(-2.0, 2.0, 400)
    for gap in np.arange(0.6, 2.5, 0.05):
        x = P3DX.front_m + gap - 0.17
        scan = LaserScan(10.0, -1.2, 0.006, 0.02, 8.0, x / np.cos(-1.2 + 0.006 * np.arange(wall.size)))
        planner = controller()
        twist = Twist2D(0.8, 0.0)
        chosen = planner.step(**still(twist=twist, scan=scan, now=10.0, speed_limit=1.0)).twist
        v = max(twist.v + min(0.25 * 0.5, max(chosen.v - twist.v, -0.25 * 0.5)), 0.0)
        braking = 0.25 * (twist.v + v) / 2.0 + v * v / (2.0 * P3DX.max_acceleration_mps2)
        assert chosen.v == 0.0 or braking < gap


boxes = st.lists(
    st.tuples(st.floats(7.6, 10.0), st.floats(4.6, 6.4), st.floats(0.16, 0.44), st.floats(0.16, 0.44)),
    min_size=1,
    max_size=4,  # as dense as six over the double length
)


@settings(max_examples=10)
@given(boxes, st.sampled_from([P3DX, TURTLEBOT]), st.sampled_from([0.5, 0.7, 1.0]), st.integers(0, 3))
def test_random_boxes_are_never_touched(rectangles: list, limits: RobotLimits, speed: float, seed: int) -> None:
    path = [(6.5, 5.72), (11.0, 5.72)]
    drive = Drive(limits, CORRIDOR + tuple(rectangles), Pose2D(6.5, 5.72, 0.0), path, Pose2D(11.0, 5.72, 0.0), seed)
    drive.run(14.0, speed)
    assert not drive.world.touched


@ROBOTS
@given(
    st.floats(-math.pi, math.pi),
    st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=1, max_size=20),
)
def test_clearance_is_close_to_the_exact_distance(limits: RobotLimits, theta: float, points: list) -> None:
    pose, points = Pose2D(0.1, -0.2, theta), np.array(points)
    c, s = math.cos(theta), math.sin(theta)
    own = (points - (pose.x, pose.y)) @ np.array([[c, -s], [s, c]])
    if limits.radius_m is not None:
        exact = float(np.hypot(own[:, 0], own[:, 1]).min()) - limits.radius_m
    else:
        over = np.maximum(
            np.maximum(own - (limits.front_m, limits.half_width_m), (-limits.rear_m, -limits.half_width_m) - own), 0.0
        )
        exact = float(np.hypot(over[:, 0], over[:, 1]).min())
    found = float(ClearanceField(points).clearance(Footprint(limits), np.array([pose.x, pose.y, theta])))
    if exact > 0.0:
        assert exact - 0.10 < found < exact + 0.04
    else:
        assert found < 0.04


def test_rolled_out_motion_is_what_the_robot_does() -> None:
    world = FlatWorld(P3DX, (), Pose2D())
    world.twist, target = Twist2D(0.2, -0.1), Twist2D(0.5, 0.6)
    times = 0.1 * np.arange(1, 21)
    poses, velocities = roll_out(world.twist, np.array([[target.v, target.omega]]), P3DX, times)
    world._pending = target
    for i in range(20):
        world.drive(target)
        assert poses[0, i] == pytest.approx((world.pose.x, world.pose.y, world.pose.theta), abs=0.01)
        assert velocities[0, i] == pytest.approx((world.twist.v, world.twist.omega))
    stop = brake(poses[:, -1], velocities[:, -1], P3DX, 10)[0, -1]
    distance = 0.5**2 / (2.0 * P3DX.max_acceleration_mps2)
    assert math.hypot(*(stop[:2] - poses[0, -1, :2])) == pytest.approx(distance, abs=0.01)


def test_memory_keeps_what_is_out_of_view_for_a_while_and_drops_what_is_seen_through() -> None:
    memory = ObstacleMemory(3.0, 15.0, Footprint(P3DX))
    laser = Pose2D(0.17)

    def see(stamp: float, values: np.ndarray, pose: Pose2D) -> np.ndarray:
        scan = LaserScan(stamp, -1.0, 0.01, 0.02, 8.0, values)
        return memory.update(scan, scan_points(scan, 0.1), pose, laser)

    free, one = np.full(201, np.inf), np.full(201, np.inf)
    one[100] = 1.0
    assert see(0.0, one, Pose2D()) == pytest.approx(np.array([[1.17, 0.0]]), abs=1e-6)
    assert len(see(0.1, free, Pose2D())) == 0  # seen through
    see(1.0, one, Pose2D())
    turned = see(2.0, free, Pose2D(theta=math.pi))  # behind now
    assert turned == pytest.approx(np.array([[-1.17, 0.0]]), abs=0.02)
    assert len(see(4.5, free, Pose2D(theta=math.pi))) == 0  # forgotten
    assert len(see(0.0, one, Pose2D())) == 1  # time ran backwards


@pytest.mark.parametrize("value", [math.nan, 0.0, 0.019])
def test_what_was_near_before_a_beam_went_bad_is_still_there(value: float) -> None:
    planner, box = controller(), np.full(400, np.inf)
    box[170:230] = 0.15  # ahead of the laser
    assert planner.step(**still(scan=ranges(box))).twist.v == 0.0
    box[170:230] = value
    for stamp in (10.1, 10.2, 12.0, 14.0):
        scan = replace(ranges(box), stamp=stamp)
        assert planner.step(**still(scan=scan, now=stamp + 0.1)).twist.v <= 0.0


def test_what_touches_the_footprint_is_named() -> None:
    planner, one = controller(), np.full(400, np.inf)
    one[int(2.0 / 0.01) + 157] = -math.inf  # to the left of the laser, which is 0.17 m ahead of the middle
    decision = planner.step(**still(scan=ranges(one)))
    assert decision.state == "blocked"
    assert decision.reason.startswith("an obstacle touches the footprint at 7°, 0.17 m from its middle (scan)")
    far = [(Pose2D(0.0, 3.0), 0.2)]
    assert planner.step(**still(scan=ranges(np.full(400, np.inf)), others=far)).state == "driving"


@pytest.mark.parametrize("value", [math.nan, 0.0, 0.019, -1.0])
def test_beams_that_are_bad_from_the_start_are_no_obstacle(value: float) -> None:
    """Lasers that send 0.0 for no return once pinned the robot for ever."""
    planner, some = controller(), np.full(400, np.inf)
    some[::2] = value
    decision = planner.step(**still(scan=ranges(some)))
    assert (decision.state, decision.twist.v > 0.0) == ("driving", True)


@pytest.mark.parametrize("angle_min", [0.0, -math.pi, 1.0])
def test_a_laser_that_looks_all_round_looks_through_what_has_gone(angle_min: float) -> None:
    memory, step = ObstacleMemory(3.0, 15.0, Footprint(P3DX)), math.pi / 180.0
    for bearing in np.arange(0.0, 2.0 * math.pi, 0.3):
        one = np.full(360, np.inf)
        one[int(np.rint(np.mod(bearing - angle_min, 2.0 * math.pi) / step)) % 360] = 1.0
        for stamp, values, left in ((0.0, one, 1), (0.1, np.full(360, np.nan), 1), (0.2, np.full(360, np.inf), 0)):
            scan = LaserScan(stamp, angle_min, step, 0.02, 8.0, values)
            points = scan_points(scan) if left == 0 or stamp == 0.0 else np.empty((0, 2))
            assert len(memory.update(scan, points, Pose2D(), Pose2D())) == left


def test_readings_by_rep_117() -> None:
    values = [math.inf, -math.inf, 0.01, 9.0, 2.0, 0.0, math.nan, -3.0]
    points = scan_points(LaserScan(0.0, 0.0, 0.0001, 0.1, 8.0, np.array(values)), 0.5)
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx([0.1, 2.0])
    endless = scan_points(LaserScan(0.0, 0.0, 0.0001, 0.0, math.inf, np.array(values)), 0.5)
    assert np.hypot(endless[:, 0], endless[:, 1]) == pytest.approx([0.0, 0.01, 2.0, 0.0])
    with pytest.raises(SensorDataError):
        scan_points(LaserScan(0.0, 0.0, 0.1, 0.1, 8.0, np.array([1.0, math.nan])), 0.4)


def test_the_worlds_own_overlap_is_exact() -> None:
    box = np.array([[0.30, 0.0, 0.1, 0.1]])
    assert not overlaps(P3DX, Pose2D(), box)
    assert overlaps(P3DX, Pose2D(0.1), box)
    assert overlaps(P3DX, Pose2D(0.05, 0.05, math.pi), box)
    assert overlaps(TURTLEBOT, Pose2D(0.15, 0.05), box)
    assert not overlaps(TURTLEBOT, compose(Pose2D(0.1), Pose2D(0.0, 0.05)), box)


def test_busy_without_coming_on_is_no_progress_even_with_ever_new_plans() -> None:
    controller = LocalPlanner(TURTLEBOT, PARAMS)
    world = FlatWorld(TURTLEBOT, CORRIDOR, Pose2D(10.0, 5.72, 0.0))
    goal, said = Pose2D(20.0, 5.72, 0.0), []
    for step in range(250):
        if step % 20 == 0:  # as a planner does that cannot decide between two ways
            controller.set_path(np.array([(10.0, 5.72 + 0.01 * (step % 3)), (20.0, 5.72)]), goal)
        said.append(controller.step(world.now, world.pose, Twist2D(), world.scan(), LASER[TURTLEBOT], 0.5))
        world.now += 0.1  # whatever is commanded, it stays where it is
    assert any("no progress" in decision.reason for decision in said)


def test_who_waited_long_is_not_stuck() -> None:
    person = (11.0, 4.6, 0.3, 2.24)  # across the whole corridor
    drive = Drive(TURTLEBOT, (*CORRIDOR, person), Pose2D(10.0, 5.72, 0.0), AHEAD, Pose2D(20.0, 5.72, 0.0))
    for _ in range(250):
        drive.step()
    assert drive.decision.state == "blocked"
    drive.world._array = drive.world._array[:-1]
    while drive.decision.state == "blocked":
        assert drive.world.now < 60.0
        drive.step()
    drive.run(40.0)
    drive.assert_arrived()


@ROBOTS
def test_robots_that_say_where_they_are_are_gone_around_unseen(limits: RobotLimits) -> None:
    """The laser of a low robot sees only the mast of another one, or nothing of it."""
    start, goal, other, radius = Pose2D(6.0, 5.72), Pose2D(12.0, 5.72), Pose2D(9.0, 5.60), 0.37
    drive = Drive(limits, CORRIDOR, start, [(6.0, 5.72), (12.0, 5.72)], goal)
    w, controller = drive.world, drive.controller
    nearest = math.inf
    for _ in range(300):
        decision = controller.step(w.now, w.pose, w.twist, w.scan(), LASER[limits], 0.5, others=[(other, radius)])
        w.drive(decision.twist)
        nearest = min(nearest, math.hypot(w.pose.x - other.x, w.pose.y - other.y))
        if decision.state == "arrived":
            break
    assert decision.state == "arrived"
    assert nearest > radius + limits.inscribed_m


def test_a_robot_that_is_too_near_leaves_room_to_drive_away() -> None:
    drive = Drive(TURTLEBOT, CORRIDOR, Pose2D(6.0, 5.72), [(6.0, 5.72), (9.0, 5.72)], Pose2D(9.0, 5.72))
    w = drive.world
    for _ in range(40):
        others = [(Pose2D(5.6, 5.72), 0.4)]
        decision = drive.controller.step(w.now, w.pose, w.twist, w.scan(), LASER[TURTLEBOT], 0.5, others=others)
        w.drive(decision.twist)
    assert w.pose.x > 6.5
