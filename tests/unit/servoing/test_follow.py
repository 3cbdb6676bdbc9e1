"""The follow law in a small kinematic simulation: what it keeps, and when it stops."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flat_world import TURTLEBOT as LIMITS
from hitchhike_ros.core.datatypes import MarkerObservation, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.geometry import between, compose, move, wrap_angle
from hitchhike_ros.servoing.driver_estimate import DriverEstimate
from hitchhike_ros.servoing.driver_trail import DriverTrail
from hitchhike_ros.servoing.follow import FollowDecision, FollowLaw
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.servo_laws import saturate

CAMERA_X, MARKER_OFFSET, GAP, DT, FRAME = 0.1, 0.3, 0.8, 0.02, 0.1


def straight(length=12.0):
    return np.stack([np.linspace(0.0, length, 600), np.zeros(600)], axis=1)


def s_curve():
    """Swings of 0.35 m to both sides over 2.5 m each, as around the boxes of P17 Exp. 1."""
    x = np.linspace(0.0, 12.0, 1200)
    inside = (x > 2.0) & (x < 9.5)
    return np.stack([x, np.where(inside, 0.175 * (1 - np.cos(2 * np.pi * (x - 2.0) / 2.5)), 0.0)], axis=1)


def corner(radius=0.6):
    """A right angle to the left between two straights."""
    a = np.linspace(-math.pi / 2, 0.0, 200)
    arc = np.stack([3.0 + radius * np.cos(a), radius + radius * np.sin(a)], axis=1)
    legs = np.linspace(0.0, 3.0, 300)
    before = np.stack([legs, np.zeros(300)], axis=1)
    after = np.stack([np.full(300, 3.0 + radius), radius + legs], axis=1)
    return np.concatenate([before, arc[1:-1], after])


@dataclass
class Run:
    """What happened, sampled at every step of 20 ms."""

    time: np.ndarray
    gap: np.ndarray
    lateral: np.ndarray
    bearing: np.ndarray
    twist: np.ndarray
    states: list[str]
    decisions: list[FollowDecision]


def distance_to_polyline(pose, points):
    legs = np.diff(points, axis=0)
    p = np.array([pose.x, pose.y])
    f = np.clip(((p - points[:-1]) * legs).sum(1) / np.maximum((legs**2).sum(1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(points[:-1] + f[:, None] * legs - p, axis=1).min()


def ride(
    path,
    *,
    seed=0,
    speed=0.5,
    duration=20.0,
    stop_at=math.inf,
    start_gap=GAP,
    hidden=(),
    feed_forward=True,
    range_noise=0.004,
    bearing_noise=0.002,
    yaw_noise=0.03,
    limits=LIMITS,
    law_name="trail",
):
    """A driver on ``path`` with its axle, the follower behind; camera at 10 Hz with a latency of one frame."""
    rng = np.random.default_rng(seed)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    law = FollowLaw(FollowParameters(law=law_name), limits, CAMERA_X)

    def driver_pose(s):
        p, q = (np.array([np.interp(s + d, arc, path[:, k]) for k in (0, 1)]) for d in (-0.02, 0.02))
        return Pose2D(*((p + q) / 2), math.atan2(q[1] - p[1], q[0] - p[0]))

    distance_of_axles = CAMERA_X + start_gap + MARKER_OFFSET
    s, v_driver = 0.1, 0.0
    first = driver_pose(s)
    own = compose(first, Pose2D(-distance_of_axles))
    odometry, twist, command = Pose2D(5.0, -3.0, 0.7), Twist2D(), Twist2D()
    driven = [(own.x - 1.0, own.y), (own.x, own.y), (first.x, first.y)]
    pending: list[MarkerObservation] = []
    log: dict[str, list] = {k: [] for k in ("time", "gap", "lateral", "bearing", "twist", "states", "decisions")}
    frame = 0
    for i in range(round(duration / DT)):
        now = i * DT
        target = speed if 1.0 <= now < stop_at and s < arc[-1] - 0.5 else 0.0
        v_driver += float(np.clip(target - v_driver, -0.5 * DT, 0.5 * DT))
        s += v_driver * DT
        driver = driver_pose(s)
        if math.hypot(driver.x - driven[-1][0], driver.y - driven[-1][1]) > 0.02:
            driven.append((driver.x, driver.y))
        # The base takes up the command within its acceleration limits.
        dv = float(np.clip(command.v - twist.v, -0.5 * DT, 0.5 * DT))
        dw = float(np.clip(command.omega - twist.omega, -1.5 * DT, 1.5 * DT))
        twist = Twist2D(twist.v + dv, twist.omega + dw)
        step = Pose2D(twist.v * DT, 0.0, twist.omega * DT)
        own = compose(own, step)
        slip = rng.normal(0.0, 0.01, 2)
        odometry = compose(odometry, Pose2D(step.x * (1 + slip[0]), 0.0, step.theta * (1 + slip[1])))
        law.add_odometry(Odometry(now, odometry, twist))

        marker = compose(driver, Pose2D(-MARKER_OFFSET, 0.0, math.pi))
        seen = between(compose(own, Pose2D(CAMERA_X)), marker)
        gap, bearing = math.hypot(seen.x, seen.y), math.atan2(seen.y, seen.x)
        if now >= frame * FRAME:
            frame += 1
            if abs(bearing) < 0.43 and not any(a <= now < b for a, b in hidden):
                r, b = gap + rng.normal(0.0, range_noise), bearing + rng.normal(0.0, bearing_noise)
                theta = wrap_angle(seen.theta + rng.normal(0.0, yaw_noise))
                C = np.diag([range_noise**2, (gap * bearing_noise) ** 2, yaw_noise**2])
                pose = Pose2D(CAMERA_X + r * math.cos(b), r * math.sin(b), theta)
                pending.append(MarkerObservation(now, 0, pose, C))
            seen_now = None
            while pending and pending[0].stamp <= now - FRAME + 1e-9:
                seen_now = pending.pop(0)
            decision = law.step(now, seen_now, None, GAP, v_driver if feed_forward else 0.0)
            command = decision.twist
        lateral = distance_to_polyline(own, np.array([*driven[-150:], (driver.x, driver.y)]))
        for key, value in zip(
            log,
            (now, gap, lateral, bearing, (twist.v, twist.omega), decision.state, decision),
            strict=True,
        ):
            log[key].append(value)
    return Run(
        *(np.array(log[k]) for k in ("time", "gap", "lateral", "bearing", "twist")), log["states"], log["decisions"]
    )


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_straight_behind_the_driver():
    run = ride(straight(), seed=1)
    assert set(run.states) == {"searching", "following"}
    assert run.states[-1] == "following"
    # The first seconds hold the driver's start, which the follower can see only after it.
    assert rms(run.gap[run.time > 5.0] - GAP) < 0.02
    assert rms(run.gap - GAP) < 0.06
    assert rms(run.lateral) < 0.01


def test_the_gap_is_held_without_the_drivers_speed_too():
    run = ride(straight(), seed=2, feed_forward=False)
    assert rms(run.gap[run.time > 5.0] - GAP) < 0.025


@pytest.mark.parametrize("law_name", ["image", "position"])
def test_the_other_laws_hold_the_gap_and_keep_the_marker_in_view_too(law_name):
    run = ride(straight(), seed=1, law_name=law_name, duration=12.0)
    assert run.states[-1] == "following"
    assert rms(run.gap[run.time > 5.0] - GAP) < 0.02
    curve = ride(corner(1.0), seed=3, law_name=law_name, duration=14.0)
    assert set(curve.states) == {"searching", "following"}
    assert np.abs(curve.bearing).max() < 0.25
    assert rms(curve.gap - GAP) < 0.10


@pytest.mark.parametrize("seed", [1, 2])
def test_swings_around_boxes_are_driven_not_cut(seed):
    run = ride(s_curve(), seed=seed)
    assert "lost" not in run.states
    assert rms(run.gap[run.time > 5.0] - GAP) < 0.03
    assert rms(run.lateral) < 0.035
    assert run.lateral.max() < 0.07


@pytest.mark.parametrize(("radius", "deviation"), [(1.0, 0.12), (0.6, 0.23), (0.3, 0.30)])
def test_a_right_angle_does_not_lose_the_marker(radius, deviation):
    """Behind a sharp corner the driver is out of view of who keeps to its track: seeing it goes first."""
    run = ride(corner(radius), seed=3, duration=14.0)
    assert "lost" not in run.states
    assert np.abs(run.bearing).max() < 0.42
    assert run.lateral.max() < deviation
    assert rms(run.gap - GAP) < 0.10


def test_a_fast_pair():
    fast = replace(LIMITS, max_speed_mps=1.5)
    run = ride(straight(25.0), seed=4, speed=1.0, limits=fast)
    assert "lost" not in run.states
    assert rms(run.gap[run.time > 8.0] - GAP) < 0.03


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_driver_that_stops_is_not_run_into(seed):
    run = ride(straight(), seed=seed, stop_at=8.0, duration=14.0)
    assert run.gap.min() > 0.5
    standing = run.time > 11.0
    assert np.abs(run.twist[standing, 0]).max() < 0.02


def test_approach_from_afar_ends_at_the_gap():
    run = ride(straight(), seed=6, speed=0.0, start_gap=2.0, duration=10.0)
    assert run.gap.min() > 0.74
    assert abs(run.gap[-1] - GAP) < 0.05
    assert abs(run.gap[run.time > 6.0][0] - run.gap[-1]) < 0.02


def test_approach_from_the_side_joins_the_drivers_track():
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    decision = law.step(0.0, observation(0.0, 1.5, 0.3), None, GAP)
    assert decision.state == "following"
    assert decision.twist.v > 0.2
    assert decision.twist.omega > 0.05


def test_a_short_cover_is_bridged():
    run = ride(straight(), seed=7, hidden=[(6.0, 6.3)], duration=12.0)
    assert "lost" not in run.states
    assert rms(run.gap[run.time > 8.0] - GAP) < 0.03


def test_a_driver_out_of_sight_is_coasted_after_and_taken_up_again():
    run = ride(straight(), seed=8, hidden=[(6.0, 7.5)], duration=16.0)
    states = np.array(run.states)
    assert set(states[(run.time > 6.8) & (run.time < 7.5)]) == {"coasting", "looking"}
    assert all("not seen" in d.reason for d in run.decisions if d.state == "coasting")
    assert states[run.time > 7.9][0] == "following"
    assert states[-1] == "following"
    assert abs(run.gap[-1] - GAP) < 0.05


def test_a_driver_that_stops_while_it_is_out_of_sight_is_not_run_into():
    run = ride(straight(), seed=9, hidden=[(6.0, math.inf)], stop_at=6.0, duration=12.0)
    assert run.gap.min() > 0.3
    assert np.ptp(run.lateral) < 0.05


def test_a_driver_lost_for_good_is_sought_for_so_long_and_then_stood_for():
    run = ride(straight(), seed=9, hidden=[(6.0, math.inf)], duration=20.0)
    states = [s for before, s in zip(["", *run.states], run.states, strict=False) if s != before]
    assert states[-5:] == ["following", "coasting", "looking", "turning", "lost"]
    p = FollowParameters()
    coasting = np.array(run.states) == "coasting"
    assert coasting.sum() * DT <= p.coast_s + FRAME
    fading = run.twist[coasting, 0]
    assert (np.diff(fading) <= 1e-9).all()
    assert run.twist[-1].tolist() == [0.0, 0.0]
    given_up = run.time[np.array(run.states) == "lost"][0] - 6.0
    assert given_up <= p.lost_timeout_s + p.coast_s + p.look_s + p.search_timeout_s + 0.2


def observation(stamp, x=1.2, y=0.0, theta=math.pi):
    return MarkerObservation(stamp, 0, Pose2D(x, y, theta), np.diag([1e-5, 1e-5, 1e-3]))


def test_stands_still_until_the_marker_is_seen():
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    decision = law.step(0.1, None, None, GAP)
    assert (decision.state, decision.twist) == ("searching", Twist2D())


def test_a_marker_that_is_not_in_view_at_first_is_sought_to_both_sides_and_then_no_more():
    params, own, turned, states = FollowParameters(), Pose2D(), [], []
    law = FollowLaw(params, LIMITS, 0.0)
    for step in range(200):
        now = 0.1 * step
        law.add_odometry(Odometry(now, own, Twist2D()))
        decision = law.step(now, None, None, GAP)
        assert decision.twist.v == 0.0
        own = Pose2D(own.x, own.y, own.theta + 0.1 * decision.twist.omega)
        turned.append(own.theta)
        states.append(decision.state)
    assert list(dict.fromkeys(states)) == ["searching", "turning", "lost"]
    assert max(turned) == pytest.approx(params.search_angle_rad, abs=0.1)
    assert min(turned) == pytest.approx(-params.search_angle_rad, abs=0.1)
    assert turned[-1] == pytest.approx(0.0, abs=0.1)
    law.step(20.0, observation(20.0), Odometry(20.0, own, Twist2D()), GAP)
    assert law.step(20.0, None, None, GAP).state == "following"


def test_stops_without_odometry():
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    assert (law.step(0.0, None, None, GAP).state, law.step(0.0, None, None, GAP).reason) == ("stopped", "no odometry")
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    law.step(0.0, observation(0.0), None, GAP)
    assert law.step(0.1, None, None, GAP).state == "following"
    law.step(0.0, observation(0.4), None, GAP)
    decision = law.step(0.5, None, None, GAP)
    assert (decision.state, decision.twist) == ("stopped", Twist2D())
    assert "0.50 s old" in decision.reason


@pytest.mark.parametrize(
    "broken",
    [
        Odometry(0.1, Pose2D(math.nan, 0.0, 0.0), Twist2D()),
        Odometry(0.1, Pose2D(), Twist2D(0.0, math.inf)),
        Odometry(math.nan, Pose2D(), Twist2D()),
    ],
)
def test_senseless_odometry_is_refused(broken):
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    with pytest.raises(SensorDataError, match="finite"):
        law.add_odometry(broken)


def test_senseless_observations_change_nothing():
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    law.step(0.0, observation(0.0, x=math.nan), None, GAP)
    law.step(0.0, observation(-5.0), None, GAP)
    assert law.step(0.0, None, None, GAP).state == "searching"
    law.step(0.0, observation(0.0), None, GAP)
    before = law.step(0.0, None, None, GAP)
    law.step(0.0, observation(0.0, y=0.5), None, GAP)
    assert law.step(0.0, None, None, GAP) == before


@pytest.mark.parametrize("later", [Odometry(0.0, Pose2D(), Twist2D()), Odometry(100.1, Pose2D(0.0, 3.0), Twist2D())])
def test_odometry_that_jumps_in_time_or_space_forgets_the_driver(later):
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    law.step(100.0, observation(100.0), Odometry(100.0, Pose2D(), Twist2D()), GAP)
    assert law.step(100.0, None, None, GAP).state == "following"
    with pytest.raises(SensorDataError, match=r"back in time|jumped"):
        law.add_odometry(later)
    assert law.step(later.stamp, None, None, GAP).state == "searching"


@given(
    st.floats(0.9, 4.0),
    st.floats(-1.5, 1.5),
    st.floats(-0.6, 0.6),
    st.floats(0.0, 2.0),
    st.sampled_from(["trail", "image", "position"]),
)
def test_commands_stay_within_the_limits_and_never_go_backwards(x, y, skew, told, law_name):
    law = FollowLaw(FollowParameters(law=law_name), LIMITS, 0.0)
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    twist = law.step(0.1, observation(0.0, x, y, math.pi + skew), None, GAP, told).twist
    assert 0.0 <= twist.v <= LIMITS.max_speed_mps + 1e-9
    assert abs(twist.omega) <= FollowParameters().max_yaw_rate_rps + 1e-9


@given(st.floats(0.0, 3.0), st.floats(-6.0, 6.0))
def test_saturation_keeps_the_curvature(v, omega):
    twist = saturate(v, omega, 0.7, 1.2)
    assert twist.v * omega == pytest.approx(twist.omega * v, abs=1e-9)


def test_a_new_ride_elsewhere_does_not_lead_back_to_the_old_trail():
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    law.step(0.0, observation(0.0), Odometry(0.0, Pose2D(), Twist2D()), GAP)
    # It drove on by itself and stands now 5 m to the left of where the trail ended.
    twist = law.step(60.0, observation(60.0), Odometry(60.0, Pose2D(1.0, 5.0, 0.0), Twist2D()), GAP).twist
    assert twist.v > 0.1
    assert abs(twist.omega) < 0.01


def test_an_image_between_two_readings_of_the_wheels_counts_from_the_pose_in_between():
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    start, twist = Pose2D(1.0, 2.0, 3.1), Twist2D(0.5, 0.8)
    law.add_odometry(Odometry(0.0, start, twist))
    law.add_odometry(Odometry(0.1, move(start, twist, 0.1), twist))
    for stamp in (0.0, 0.05, 0.25):
        own = law.pose_at(stamp)
        assert own is not None
        assert astuple(own) == pytest.approx(astuple(move(start, twist, stamp)))
    assert law.pose_at(0.35) is None


def test_speed_of_the_driver_is_learnt():
    rng = np.random.default_rng(0)
    C = np.diag([4e-6, 1e-5, 1e-3])
    driver = DriverEstimate(FollowParameters(), 0.0, Pose2D(1.0, 0.0, math.pi), C)
    speeds = []
    for i in range(1, 60):
        driver.update(0.1 * i, Pose2D(1.0 + 0.05 * i + rng.normal(0.0, 0.002), 0.0, math.pi), C)
        speeds.append(driver.speed)
    assert np.abs(np.array(speeds[10:]) - 0.5).max() < 0.1
    assert np.mean(speeds[10:]) == pytest.approx(0.5, abs=0.01)


def test_told_speed_counts_most_before_anything_was_seen_to_move():
    C = np.diag([1e-5, 1e-5, 1e-3])
    driver = DriverEstimate(FollowParameters(), 0.0, Pose2D(1.0, 0.0, math.pi), C)
    driver.tell_speed(0.5)
    assert 0.3 < driver.speed < 0.5
    for i in range(1, 20):
        driver.update(0.1 * i, Pose2D(1.0, 0.0, math.pi), C)
        driver.tell_speed(0.5)
    assert driver.speed < 0.1


def test_trail_goes_on_past_the_driver_and_forgets_what_is_behind():
    trail = DriverTrail((0.0, 0.0), (1.0, 0.0))
    trail.extend((1.01, 0.0), 0.0, 0.03)
    assert trail.at(5.0) == pytest.approx((5.0, 0.0))
    trail.extend((0.8, 0.0), 0.0, 0.03)
    assert trail.at(5.0) == pytest.approx((5.0, 0.0))
    trail.extend((1.0, 1.0), 1.5, 0.03)
    assert trail.at(1.5) == pytest.approx((1.0, 0.5))
    assert trail.advance(0.9, 0.1) == pytest.approx(0.9)
    assert trail.advance(1.0, 0.8) == pytest.approx(1.8)
    # A nearer point of the way already driven is not gone back to.
    assert trail.advance(0.5, 0.0) == pytest.approx(1.8)
    assert trail.at(1.9) == pytest.approx((1.0, 0.9))
    # What lies more than half a metre behind is forgotten, corner by corner.
    assert trail.at(0.0) == pytest.approx((1.0, 0.0))


def test_the_follower_is_sought_a_metre_ahead_so_that_a_loop_is_not_cut_short():
    trail = DriverTrail((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0))
    assert trail.advance(0.6, 0.7) == pytest.approx(0.6)  # though the way back is nearer
    assert trail.advance(3.0, 0.0) == pytest.approx(1.6)


def test_a_trail_of_one_place_leads_nowhere():
    trail = DriverTrail((1.0, 2.0))
    assert (trail.length, trail.at(0.5), trail.advance(3.0, 2.0)) == (0.0, (1.0, 2.0), 0.0)


def bearing_rate(camera, marker, twist, driver):
    """Rate of the marker's bearing from the camera's axis while the robot, now at 0, drives on; by numbers alone."""

    def bearing(t):
        moved = Pose2D(marker.x + t * driver[0], marker.y + t * driver[1])
        seen = between(compose(move(Pose2D(), twist, t), camera), moved)
        return math.atan2(seen.y, seen.x)

    return (bearing(1e-5) - bearing(-1e-5)) / 2e-5


@pytest.mark.parametrize(
    "camera",
    [Pose2D(0.0), Pose2D(0.1), Pose2D(0.35), Pose2D(-0.2), Pose2D(0.15, 0.25), Pose2D(0.2, -0.1, 0.15)],
)
@pytest.mark.parametrize(("bearing", "gap"), [(0.30, 0.8), (-0.30, 0.8), (0.33, 0.5), (-0.25, 1.5)])
def test_the_bearing_nears_its_limit_no_faster_than_exponentially_wherever_the_camera_is(camera, bearing, gap):
    """With the camera 0.35 m ahead of the axle and 0.5 m from the marker it went up to 1.7 times as fast as it may."""
    params = FollowParameters()
    law = FollowLaw(params, LIMITS, camera.x, camera.y, camera.theta)
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    at = compose(camera, Pose2D(gap * math.cos(bearing), gap * math.sin(bearing)))
    # The trail, once the driver has gone round behind the robot, leads away from the marker as sharply as can be.
    away = -math.copysign(1.0, bearing)
    law.step(0.0, observation(0.0, at.x, at.y), None, gap)
    driver = law._driver
    assert driver is not None
    law._trail = DriverTrail((0.0, 0.0), (0.0, 0.6 * away))
    driver.tell_speed(0.6, 0.0)
    twist = law.step(0.0, None, None, gap - 0.2).twist
    seen = Pose2D(at.x, at.y)
    rate = bearing_rate(camera, seen, twist, (driver.speed, 0.0))
    allowed = params.view_gain * (params.max_bearing_rad - abs(bearing))
    assert rate * -away <= allowed + 1e-6
    if abs(twist.omega) < min(params.max_yaw_rate_rps, LIMITS.max_yaw_rate_rps) - 1e-6:
        assert rate * -away == pytest.approx(allowed, abs=1e-6)


def test_a_follower_at_its_top_speed_keeps_the_marker_in_view_too():
    """The drift of the bearing is that of the speed that is driven, not of one that the robot cannot go."""
    slow = replace(LIMITS, max_speed_mps=0.3)
    law = FollowLaw(FollowParameters(), slow, CAMERA_X)
    law.add_odometry(Odometry(0.0, Pose2D(), Twist2D()))
    law.step(0.0, observation(0.0, 1.7, 0.5), None, GAP)
    law._trail = DriverTrail((0.0, 0.0), (0.0, -0.6))
    law._driver.tell_speed(0.9, 0.0)
    speed = law._driver.speed
    twist = law.step(0.0, None, None, GAP).twist
    assert twist.v <= 0.3 + 1e-9
    camera = Pose2D(CAMERA_X)
    bearing = math.atan2(0.5, 1.7 - CAMERA_X)
    rate = bearing_rate(camera, Pose2D(1.7, 0.5), twist, (speed, 0.0))
    p = FollowParameters()
    assert rate <= p.view_gain * (p.max_bearing_rad - bearing) + 1e-6


@pytest.mark.parametrize("behind_m", [0.15, 0.30, 0.55])
def test_a_follower_drives_the_track_of_the_axle_of_any_driver(behind_m):
    """With the offset of a P3DX for all, the trail cut and overshot bends by the difference."""
    mount, radius = Pose2D(-behind_m, 0.0, math.pi), 0.9
    law = FollowLaw(FollowParameters(), LIMITS, CAMERA_X)
    for step in range(30):
        now, a = 0.1 * step, 0.05 * step
        driver = Pose2D(1.2 + radius * math.sin(a), radius * (1.0 - math.cos(a)), a)
        marker = compose(driver, mount)
        seen = MarkerObservation(now, 0, marker, np.diag([1e-8, 1e-8, 1e-8]))
        law.step(now, seen, Odometry(now, Pose2D(), Twist2D()), GAP, T_driver_marker=mount)
    for s in np.arange(1.25, law._trail.length, 0.05):
        x, y = law._trail.at(float(s))
        assert abs(math.hypot(x - 1.2, y - radius) - radius) < 0.004


def test_coasting_stops_short_of_where_the_marker_was_seen_whatever_is_behind_it():
    ends = []
    for behind_m in (0.15, 0.55):
        mount, own, now = Pose2D(-behind_m, 0.0, math.pi), Pose2D(), 0.0
        law = FollowLaw(FollowParameters(), LIMITS, CAMERA_X)
        marker_x, twist = 0.9, Twist2D()
        for step in range(200):
            now = 0.1 * step
            seen = observation(now, marker_x - own.x) if step < 30 else None
            marker_x += 0.05 if step < 30 else 0.0
            twist = law.step(now, seen, Odometry(now, own, twist), GAP, 0.5, now, mount).twist
            own = move(own, Twist2D(twist.v, 0.0), 0.1)
        ends.append(marker_x - own.x - CAMERA_X)
    assert ends[0] == pytest.approx(ends[1], abs=0.03)
    assert min(ends) > 0.2


def test_place_of_the_robot_and_of_the_marker_are_of_the_same_moment():
    """Odometry 0.15 s old at 0.6 m/s: the gap was told 9 cm too large."""
    law = FollowLaw(FollowParameters(), LIMITS, 0.0)
    twist = Twist2D(0.6, 0.0)
    law.add_odometry(Odometry(0.0, Pose2D(), twist))
    law.step(0.0, observation(0.0, 1.5), None, GAP)
    law._driver.tell_speed(0.0, 0.0)
    decision = law.step(0.15, None, None, GAP)
    assert decision.gap_m == pytest.approx(1.5 - 0.6 * 0.15, abs=1e-6)
