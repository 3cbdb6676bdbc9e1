"""The ledger of two runs on paper, whose every cost is known beforehand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import msgspec
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.experiments.report.cost_tables import comparison_table, ledger_table, steps_table
from hitchhike_ros.experiments.report.screen import text_of
from hitchhike_ros.experiments.scenarios.ride_record import (
    ClockSample,
    CpuSample,
    RideRecord,
    RobotRecord,
    TimedPose,
    TrafficSample,
)
from hitchhike_ros.experiments.scoring.cost_ledger import (
    MAX_RIDE_COST,
    compare,
    cost_figures,
    module_costs,
    modules_off,
    ride_steps,
    run_window,
    total,
    window_between,
)
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.rides import find_ride
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.protocol.status import Status
from synthetic_ride import CAMERA, DECOUPLING, MARKER, RELEASED, REQUESTED, RIDING, SPEED, synthetic_ride

END_OF_RUN = 88.0
# Seconds of CPU per simulated second of the hitchhiker's nodes on the ride and off it.
RIDING_SHARE, OTHER_SHARE, ALONE_SHARE = 0.05, 0.2, 0.3
KB = 1000


def _samples(node: str, steps: list[tuple[float, float]], peak_mb: float) -> list[CpuSample]:
    """CPU samples where each step is (until, share of a core from the step before)."""
    samples, used, before = [CpuSample(0.0, 0.0, node, 0.0, peak_mb, peak_mb)], 0.0, 0.0
    for until, share in steps:
        used += share * (until - before)
        before = until
        samples.append(CpuSample(until, until, node, used, peak_mb, peak_mb + until))
    return samples


def _traffic(node: str, *stamps: float) -> list[TrafficSample]:
    """A message of 1 kB each 0.1 s in."""
    return [TrafficSample(t, node, round(10 * t), KB * round(10 * t), 7, 70) for t in stamps]


@pytest.fixture
def ridden() -> RideRecord:
    record = synthetic_ride()
    steps = [(RIDING, OTHER_SHARE), (DECOUPLING, RIDING_SHARE), (90.0, OTHER_SHARE)]
    idle = [(90.0, 0.01)]
    record.cpu = [
        *_samples("/turtlebot/slam", steps, 100.0),
        *_samples("/turtlebot/hitchhike_comm", [(90.0, 0.02)], 50.0),
        *_samples("/p3dx/visual_servoing", [(90.0, 0.016)], 50.0),
        *_samples("/idle", idle, 40.0),
        *_samples("/record", idle, 40.0),
    ]
    record.traffic = _traffic("/turtlebot/slam", 0.0, 22.0, 90.0)
    return record


@pytest.fixture
def alone() -> RideRecord:
    """East at the ride's speed, from where the hitchhiker asked, standing for two seconds first."""
    start = synthetic_ride().robots["turtlebot"].truth[0]
    robot = RobotRecord(CAMERA, MARKER)
    for k in range(1001):
        stamp = 0.1 * k
        robot.truth.append(TimedPose(stamp, start.x + SPEED * min(max(stamp - 4.0, 0.0), 50.0), 5.82, 0.0))
    for status in (Status(0.5, "turtlebot"), Status(2.0, "turtlebot", "none", "navigating")):
        robot.add_status(status)
    robot.add_status(Status(60.0, "turtlebot", reason=str(Reason.ARRIVED)))
    record = RideRecord("p17_exp1", 3, (), {"turtlebot": robot})
    record.clock = [ClockSample(0.0, 0.0), ClockSample(100.0, 100.0)]
    record.cpu = [
        *_samples("/turtlebot/slam", [(100.0, ALONE_SHARE)], 100.0),
        *_samples("/turtlebot/hitchhike_comm", [(100.0, 0.02)], 50.0),
        *_samples("/idle", [(100.0, 0.01)], 40.0),
    ]
    return record


def figures_of(*records: RideRecord) -> dict[str, Figure]:
    return {figure.name: figure for figure in cost_figures(*records)}


def test_costs_are_interpolated_between_samples(ridden: RideRecord) -> None:
    (slam,) = (c for c in module_costs(ridden, (20.0, 30.0)) if c.module == "slam")
    assert slam.robot == "turtlebot"
    assert slam.cpu_s == pytest.approx(5.0 * OTHER_SHARE + 5.0 * RIDING_SHARE)
    assert slam.messages_in == pytest.approx(100.0, abs=1.0)
    assert slam.bytes_in == pytest.approx(100.0 * KB, rel=0.01)
    assert slam.peak_mb == 100.0 + RIDING


def test_what_was_not_seen_of_a_node_is_taken_to_be_as_the_rest_unless_that_is_more(ridden: RideRecord) -> None:
    def cpu_s(since: float) -> list[float]:
        ridden.cpu = [
            CpuSample(since, since, "/turtlebot/slam", 3.0, 1.0),
            CpuSample(50.0, 50.0, "/turtlebot/slam", 5.0, 1.0),
        ]
        return [cost.cpu_s for cost in module_costs(ridden, (20.0, 40.0))]

    assert cpu_s(20.0) == pytest.approx([20.0 * 2.0 / 30.0])
    assert cpu_s(25.0) == pytest.approx([20.0 * 2.0 / 25.0])
    msgspec.json.encode(module_costs(ridden, (20.0, 40.0)))  # it is kept as JSON: none of NumPy's numbers
    assert cpu_s(31.0) == []


def test_who_belongs_to_no_robot_is_not_added_to_one(ridden: RideRecord) -> None:
    costs = module_costs(ridden, (20.0, 30.0))
    assert {c.module for c in costs if not c.robot} == {"idle", "record"}
    own = total(c for c in costs if c.robot == "turtlebot")
    assert own.robot == "turtlebot"
    assert own.cpu_s == pytest.approx(5.0 * (OTHER_SHARE + RIDING_SHARE) + 10.0 * 0.02)
    assert total([]).cpu_s == 0.0


def test_the_run_is_from_the_goal_to_the_end(ridden: RideRecord, alone: RideRecord) -> None:
    assert run_window(ridden.robots["turtlebot"]) == (REQUESTED, END_OF_RUN)
    assert run_window(alone.robots["turtlebot"]) == (2.0, 60.0)
    idle = RobotRecord(CAMERA, MARKER)
    idle.add_status(Status(0.5, "p3dx"))
    assert run_window(idle) is None


def test_parts_of_the_run_leave_nothing_out(ridden: RideRecord) -> None:
    ride = find_ride(ridden)
    assert ride is not None
    steps = ride_steps(ridden, ride)
    assert [step.name for step in steps] == ["waiting", "coupling", "riding", "decoupling", "after"]
    assert all(a.end == b.begin for a, b in pairwise(steps))
    whole = total(c for c in module_costs(ridden, (REQUESTED, END_OF_RUN)) if c.robot == "turtlebot")
    assert sum(step.total.cpu_s for step in steps) == pytest.approx(whole.cpu_s)
    assert [row[0] for row in steps_table(steps).rows] == [step.name for step in steps]


def test_places_are_found_in_the_order_in_which_they_come(alone: RideRecord) -> None:
    robot = alone.robots["turtlebot"]
    x = robot.truth[0].x
    window = window_between(robot, Pose2D(x + 5.0, 5.8, 0.0), Pose2D(x + 10.0, 5.8, 0.0))
    assert window == pytest.approx((14.0, 24.0), abs=0.15)
    back = window_between(robot, Pose2D(x + 10.0, 5.8, 0.0), Pose2D(x + 5.0, 5.8, 0.0))
    assert back is not None and back[0] == pytest.approx(24.0, abs=0.15) and back[1] > back[0]


def test_ride_against_alone_counts_everything_from_asking_to_being_released(
    ridden: RideRecord, alone: RideRecord
) -> None:
    figures = figures_of(ridden, alone)
    cpu = OTHER_SHARE * (RIDING - REQUESTED + RELEASED - DECOUPLING) + RIDING_SHARE * (DECOUPLING - RIDING)
    cpu += 0.02 * (RELEASED - REQUESTED)
    assert figures["ride_cpu_rider"].value == pytest.approx(cpu / 20.4, rel=1e-3)
    # It stands at the start from 2 to 4 s, and gets there at once.
    seconds = 20.4 / SPEED + 2.0
    assert figures["ride_cpu_alone"].value == pytest.approx((ALONE_SHARE + 0.02) * seconds / 20.4, rel=0.01)
    ratio = figures["ride_cpu_ratio"]
    assert ratio.value == pytest.approx(cpu / ((ALONE_SHARE + 0.02) * seconds), rel=0.01)
    assert (ratio.bound, ratio.ok) == (MAX_RIDE_COST, False)
    assert figures["riding_cpu_ratio"].value == pytest.approx(0.07 / 0.32, rel=0.06)
    assert figures["riding_cpu_ratio"].bound is None
    assert figures["whole_run_cpu_ratio"].value is not None


def test_a_cheap_ride_holds_the_bound(ridden: RideRecord, alone: RideRecord) -> None:
    ridden.cpu = [replace(sample, cpu_s=0.2 * sample.cpu_s) for sample in ridden.cpu]
    assert figures_of(ridden, alone)["ride_cpu_ratio"].ok is True


def test_without_a_ride_there_are_figures_without_values(alone: RideRecord) -> None:
    assert compare(alone, alone) == []
    figures = figures_of(alone, alone)
    assert figures["ride_cpu_ratio"].ok is False and figures["ride_cpu_ratio"].value is None
    assert figures["module_off_cost"].ok is False


def test_modules_that_are_off_are_read_against_the_idle_node(ridden: RideRecord, alone: RideRecord) -> None:
    off = {(robot, module): extra for robot, module, extra in modules_off(ridden)}
    # Off from riding (25) to relocalizing (68) but for a second at each end; busy again from 65.8.
    expected = 100.0 * ((39.8 * RIDING_SHARE + 1.2 * OTHER_SHARE) / 41.0 - 0.01)
    assert off[("turtlebot", "slam")] == pytest.approx(expected)
    assert off[("p3dx", "visual_servoing")] == pytest.approx(0.6)
    assert figures_of(ridden, alone)["module_off_cost"].value == pytest.approx(expected)
    ridden.cpu = [sample for sample in ridden.cpu if sample.node != "/idle"]
    assert modules_off(ridden) == []


def test_tables_name_every_module_once(ridden: RideRecord, alone: RideRecord) -> None:
    comparison = compare(ridden, alone)[0]
    text = text_of(comparison_table(comparison))
    assert text.count("slam") == 1 and text.count("hitchhike_comm") == 1 and "\n  all " in text
    ledger = text_of(ledger_table(comparison.rider.modules))
    assert "turtlebot/slam" in ledger and "messages in" in ledger
