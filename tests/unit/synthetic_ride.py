"""A ride on paper: straight east along y = 5.72 at 0.5 m/s, with round numbers for everything that is scored."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.core.datatypes import Obstacle, Pose2D
from hitchhike_ros.experiments.scenarios.ride_record import (
    ClockSample,
    CpuSample,
    RideRecord,
    RobotRecord,
    TimedEstimate,
    TimedPose,
)
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.protocol.status import ModuleSwitches, RideStatus, ServoCommand, Status

REQUESTED, OFFERED, ALIGNING, RIDING, DECOUPLING, RELEASED, END = 10.0, 14.0, 15.0, 25.0, 65.8, 70.8, 90.0
SPEED, RIDE_M, GAP_M, GAP_ERROR_M = 0.5, 20.4, 0.8, 0.05
CAMERA, MARKER = Pose2D(0.12, 0.0, 0.0), Pose2D(-0.3, 0.0, np.pi)
BOXES = (Obstacle("obs1", 9.24, 6.08, 0.28, 0.16), Obstacle("obs2", 12.32, 5.16, 0.40, 0.44))
SIGMA = ((0.01, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.0025))

_OFF = ModuleSwitches(PP=False, OBS=False, LZN=False, MAP=False, COM=True, VS=True)


def synthetic_ride() -> RideRecord:
    """The hitchhiker keeps 0.05 m too far behind, 0.1 m to the left of its driver's trail."""
    driver, hitchhiker = RobotRecord(CAMERA, MARKER), RobotRecord(CAMERA, MARKER)
    lag = GAP_M + GAP_ERROR_M + CAMERA.x - MARKER.x
    for stamp in np.arange(0.0, END + 0.01, 0.1):
        x = 3.0 + SPEED * float(np.clip(stamp - RIDING, 0.0, RIDE_M / SPEED))
        driver.truth.append(TimedPose(float(stamp), x, 5.72, 0.0))
        driver.estimates.append(TimedEstimate(float(stamp), x + 0.03, 5.72 - 0.04, 0.0, SIGMA))
        hitchhiker.truth.append(TimedPose(float(stamp), x - lag, 5.82, 0.0))
    end = hitchhiker.truth[-1]
    hitchhiker.initial_poses = [
        TimedEstimate(1.0, 1.8, 5.72, 0.0, SIGMA),
        TimedEstimate(68.0, end.x + 0.1, end.y, end.theta - 2 * np.pi + 0.05, SIGMA),
    ]
    hitchhiker.obstacles = (
        Obstacle("b", 12.30, 5.16, 0.44, 0.44),
        Obstacle("a", 9.24, 6.08, 0.28, 0.16),
        Obstacle("ghost", 20.0, 5.0, 0.1, 0.1),
    )
    driver.awards = [Award("ride", "turtlebot", 20.0, 8.0)]
    for status in _driver_statuses():
        driver.add_status(status)
    for status in _hitchhiker_statuses():
        hitchhiker.add_status(status)
    record = RideRecord("p17_exp1", 3, BOXES, {"p3dx": driver, "turtlebot": hitchhiker})
    record.clock = [ClockSample(stamp, 1000.0 + stamp / 0.8) for stamp in (0.0, REQUESTED, RIDING, DECOUPLING, END)]
    # CPU seconds per simulated second: 0.3 until the ride, 0.01 on it, 0.3 after it.
    for stamp, cpu_s in ((0.0, 1.0), (RIDING, 8.5), (DECOUPLING, 8.908), (RELEASED, 9.408), (END, 15.168)):
        record.cpu.append(CpuSample(stamp, 0.0, "/turtlebot/slam", cpu_s, 50.0 + stamp))
        record.cpu.append(CpuSample(stamp, 0.0, "/p3dx/slam", 2 * cpu_s, 60.0))
    return record


def _ride(ridden_m: float) -> RideStatus:
    return RideStatus("ride", "p3dx", "turtlebot", RIDE_M, ridden_m)


def _driver_statuses() -> list[Status]:
    steps = [
        (OFFERED, "offering", 0.0),
        (ALIGNING, "aligning", 0.0),
        (24.0, "aligned", 0.0),
        (25.2, "driving", 0.0),
        (40.0, "driving", 7.5),
        (DECOUPLING, "decoupling", RIDE_M),
    ]
    statuses = [Status(0.5, "p3dx"), Status(5.0, "p3dx", "none", "navigating")]
    other = RideStatus("other", "p3dx", "turtlebot", RIDE_M)
    statuses += [Status(12.0, "p3dx", "driver", "offering", ride=other)]  # for a ride that nobody took
    statuses += [Status(t, "p3dx", "driver", state, ride=_ride(ridden)) for t, state, ridden in steps]
    return [*statuses, Status(70.0, "p3dx", "none", "navigating"), Status(85.0, "p3dx", reason=str(Reason.ARRIVED))]


def _hitchhiker_statuses() -> list[Status]:
    follow = ServoCommand("follow", 0, gap_m=GAP_M)
    return [
        Status(0.5, "turtlebot"),
        Status(REQUESTED, "turtlebot", "hitchhiker", "requesting"),
        Status(14.2, "turtlebot", "hitchhiker", "locking", ride=_ride(0.0)),
        Status(24.2, "turtlebot", "hitchhiker", "coupling", ride=_ride(0.0), servo=follow),
        Status(RIDING, "turtlebot", "hitchhiker", "riding", "", _OFF, servo=follow, ride=_ride(0.0)),
        Status(66.0, "turtlebot", "hitchhiker", "settling", "", _OFF, servo=follow, ride=_ride(RIDE_M)),
        Status(68.0, "turtlebot", "hitchhiker", "relocalizing", ride=_ride(RIDE_M)),
        Status(RELEASED, "turtlebot", "none", "navigating"),
        Status(88.0, "turtlebot", reason=str(Reason.ARRIVED)),
    ]
