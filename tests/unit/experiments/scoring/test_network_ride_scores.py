"""Rides of a network, scored where every number is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord, TimedPose
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide, network_rides
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.status import RideStatus, ServoCommand, Status
from synthetic_ride import CAMERA, DECOUPLING, GAP_M, MARKER, RELEASED, RIDE_M, RIDING, SPEED, synthetic_ride

MARKERS = {0: "p3dx", 1: "turtlebot"}
LAG = GAP_M + CAMERA.x - MARKER.x
MOVED_UP, SECOND_M = 40.0, 5.0


def follow(marker_id: int) -> ServoCommand:
    return ServoCommand("follow", marker_id, gap_m=GAP_M)


def convoy() -> RideRecord:
    """A third robot drives 5 m to its place, rides 0.1 m too far behind the second, and later behind the first."""
    record = synthetic_ride()
    last, ride = RobotRecord(CAMERA, MARKER), RideStatus("other", "p3dx", "last")
    for stamp in np.arange(0.0, 90.01, 0.1):
        ahead = record.robots["turtlebot" if stamp < MOVED_UP else "p3dx"].truth[round(stamp * 10)]
        aside = SECOND_M * (1.0 - float(np.clip((stamp - 15.0) / 5.0, 0.0, 1.0)))
        last.truth.append(TimedPose(float(stamp), ahead.x - LAG - 0.1, ahead.y - aside, 0.0))
    for status in (
        Status(14.0, "last", "hitchhiker", "awaiting_aligned", ride=ride),
        Status(RIDING + 0.1, "last", "hitchhiker", "riding", servo=follow(1), ride=ride),
        Status(MOVED_UP, "last", "hitchhiker", "riding", servo=follow(0), ride=ride),
        Status(66.0, "last", "hitchhiker", "settling", servo=follow(0), ride=ride),
        Status(67.0, "last", "hitchhiker", "relocalizing", ride=ride),
        Status(68.0, "last", "none", "navigating"),
    ):
        last.add_status(status)
    record.robots["last"] = last
    record.robots["p3dx"].awards.append(Award("other", "last", 19.0, 7.6))
    return record


def test_one_ride() -> None:
    (ride,) = network_rides(synthetic_ride(), MARKERS)
    assert (ride.hitchhiker, ride.driver, ride.ride_id) == ("turtlebot", "p3dx", "ride")
    assert (ride.riding_at, ride.settled_at, ride.released_at) == (RIDING, 66.0, RELEASED)
    assert (ride.alone_m, ride.points, ride.followed) == (0.0, (8.0,), ("p3dx",))
    assert ride.ride_m == pytest.approx(RIDE_M, abs=0.01)
    assert ride.driver_waited_s == pytest.approx(1.2)
    assert (ride.gap_rms_m, ride.gap_max_m) == pytest.approx((0.05, 0.05), abs=0.01)
    assert ride.handover_m == pytest.approx(0.1)
    assert ride.handover_deg == pytest.approx(np.degrees(0.05))


def test_a_driver_that_pulls_away_a_tick_before_its_hitchhiker_says_that_it_rides() -> None:
    record = synthetic_ride()
    robot = record.robots["turtlebot"]
    pulls_away = next(s.time_stamp for s in record.robots["p3dx"].statuses if s.state == "driving")
    robot.statuses = [replace(s, time_stamp=pulls_away + 0.1) if s.time_stamp == RIDING else s for s in robot.statuses]
    (ride,) = network_rides(record, MARKERS)
    assert ride.driver_waited_s == pytest.approx(1.2)


def test_a_convoy_where_one_moves_up() -> None:
    first, last = network_rides(convoy(), MARKERS)
    assert (first.hitchhiker, last.hitchhiker, last.points) == ("turtlebot", "last", (7.6,))
    assert (first.followed, last.followed) == (("p3dx",), ("turtlebot", "p3dx"))
    assert last.alone_m == pytest.approx(SECOND_M, abs=0.1)
    assert last.ride_m == pytest.approx(SPEED * (DECOUPLING - RIDING - 0.1), abs=0.1)
    assert last.driver_waited_s == pytest.approx(1.2)
    assert last.gap_rms_m == pytest.approx(0.1, abs=0.01)
    assert (last.handover_m, last.handover_sigmas) == (None, None)


def test_a_ride_that_breaks_off_has_no_handover() -> None:
    record = synthetic_ride()
    robot = record.robots["turtlebot"]
    kept = [s for s in robot.statuses if s.state not in ("settling", "relocalizing")]
    robot.statuses = [replace(s, state="parting") if s.time_stamp == RELEASED else s for s in kept]
    robot.statuses[-2] = replace(robot.statuses[-2], role="hitchhiker", ride=kept[-3].ride)
    (ride,) = network_rides(record, MARKERS)
    assert (ride.settled_at, ride.released_at, ride.handover_m) == (None, 88.0, None)


def test_who_only_asks_has_no_ride() -> None:
    record = synthetic_ride()
    robot = record.robots["turtlebot"]
    robot.statuses = [s for s in robot.statuses if s.state in ("idle", "requesting", "locking")]
    rides: list[NetworkRide] = network_rides(record, MARKERS)
    assert rides == []
