"""Figures of a ride whose every number is known beforehand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Obstacle
from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.experiments.scenarios.ride_record import (
    Contact,
    RideRecord,
    RobotRecord,
    TimedPose,
    load_record,
    save_record,
)
from hitchhike_ros.experiments.scoring.figures import Figure, all_hold, summarize
from hitchhike_ros.experiments.scoring.ride_figures import (
    distances_from_trail,
    find_ride,
    mahalanobis,
    match_boxes,
    module_changes,
    node_costs,
    phases,
    ride_figures,
)
from hitchhike_ros.protocol.driver.machine import ARRIVED
from hitchhike_ros.protocol.status import ServoCommand, Status
from synthetic_ride import CAMERA, DECOUPLING, END, MARKER, RELEASED, REQUESTED, RIDING, synthetic_ride


@pytest.fixture
def record() -> RideRecord:
    return synthetic_ride()


def figures_of(record: RideRecord) -> dict[str, Figure]:
    return {figure.name: figure for figure in ride_figures(record)}


@pytest.mark.parametrize(
    ("name", "value", "peer", "bound", "ok"),
    [
        ("couple", 10.0, 15.33, 15.0, True),
        ("decouple", 5.0, 22.0, 17.0, True),
        ("wait", 4.0, 21.67, None, None),
        ("driver_delay", 15.0, 37.33, None, None),
        ("hitchhiker_delay", 19.0, 59.0, None, None),
        ("ride", 20.4, 20.4, None, None),
        ("ride_deviation", 0.0, None, 2.0, True),
        ("award", 8.0, 8.2, None, None),
        ("award_deviation", 100.0 * 0.2 / 8.2, None, 2.0, False),
        ("gap_error_rms", 0.05, None, 0.10, True),
        ("gap_error_max", 0.05, None, None, None),
        ("lateral_error_rms", 0.1, None, None, None),
        ("driver_pose_error_rms", 0.05, None, None, None),
        ("handover_position_error", 0.1, None, 0.15, True),
        ("handover_heading_error", np.degrees(0.05), None, 5.0, True),
        ("handover_mahalanobis", np.sqrt(2.0), None, 3.0, True),
        ("boxes_found", 2.0, 2.0, 2.0, True),
        ("false_boxes", 1.0, None, 0.0, False),
        ("box_place_error", 0.0, None, 0.10, True),
        ("box_size_error", 0.04, None, 0.10, True),
        ("contacts", 0.0, None, 0.0, True),
        ("real_time_factor", 0.8, None, 0.5, True),
        ("hitchhiker_cpu_riding", 0.01, None, None, None),
        ("hitchhiker_cpu_alone", 0.3, None, None, None),
    ],
)
def test_each_figure_has_its_value_peer_and_bound(
    record: RideRecord, name: str, value: float, peer: float | None, bound: float | None, ok: bool | None
) -> None:
    figure = figures_of(record)[name]
    # The gap is 0.1 m oblique, which adds half a percent to its 0.85 m.
    assert figure.value == pytest.approx(value, abs=0.01 if name.startswith("gap") else 1e-6)
    assert (figure.peer, figure.bound, figure.ok) == (peer, bound, ok)


def test_a_ride_that_comes_to_nothing_has_no_values_and_breaks_its_bounds() -> None:
    figures = figures_of(RideRecord("p17_exp1", 0, (), {"turtlebot": RobotRecord(CAMERA, MARKER)}))
    assert all(figures[name].value is None and figures[name].ok is False for name in ("couple", "gap_error_rms"))
    assert figures["wait"].peer == 19.33  # without boxes
    assert not all_hold(list(figures.values()))


def test_other_worlds_have_no_length_to_compare_with(record: RideRecord) -> None:
    record.scenario = "willow"
    figures = figures_of(record)
    assert figures["ride"].peer is None
    assert "ride_deviation" not in figures


def test_contacts_and_missing_boxes_break_their_bounds(record: RideRecord) -> None:
    record.contacts.append(Contact(3.0, "p3dx", "walls", 1.0, 2.0))
    record.robots["turtlebot"].obstacles = record.robots["turtlebot"].obstacles[:1]
    figures = figures_of(record)
    assert (figures["contacts"].ok, figures["boxes_found"].ok) == (False, False)


def test_the_ride_is_the_one_that_was_coupled_and_its_wait_counts_from_the_first_request(record: RideRecord) -> None:
    ride = find_ride(record)
    assert ride is not None
    assert (ride.hitchhiker, ride.driver) == ("turtlebot", "p3dx")
    assert (ride.requested_at, ride.riding_at, ride.decoupling_at, ride.released_at) == (
        REQUESTED,
        RIDING,
        DECOUPLING,
        RELEASED,
    )


def test_where_another_left_before_the_nearer_decoupling_counts_although_it_is_stamped_later(
    record: RideRecord,
) -> None:
    driver, hitchhiker = record.robots["p3dx"], record.robots["turtlebot"]
    settled_at = next(s.time_stamp for s in hitchhiker.statuses if s.state == "settling")
    own = next(i for i, s in enumerate(driver.statuses) if s.state == "decoupling")
    of_both = replace(driver.statuses[own], time_stamp=50.0, convoy=("other", "turtlebot"))
    driver.statuses[own : own + 1] = [of_both, replace(driver.statuses[own], time_stamp=settled_at + 0.1)]
    ride = find_ride(record)
    assert ride is not None and ride.decoupling_at == settled_at + 0.1


def test_before_coupling_the_ride_knows_the_steps_so_far(record: RideRecord) -> None:
    hitchhiker = record.robots["turtlebot"]
    hitchhiker.statuses = [s for s in hitchhiker.statuses if s.time_stamp < RIDING]
    ride = find_ride(record)
    assert ride is not None
    assert (ride.aligning_at, ride.riding_at, ride.released_at, ride.couple_s) == (15.0, None, None, None)


def test_gap_error_follows_the_robots_apart(record: RideRecord) -> None:
    hitchhiker = record.robots["turtlebot"]
    hitchhiker.truth = [replace(p, x=p.x - 0.2, y=5.72) for p in hitchhiker.truth]
    assert figures_of(record)["gap_error_rms"].value == pytest.approx(0.25, abs=1e-9)


def test_lateral_error_counts_beside_the_trail_and_not_before_it() -> None:
    trail = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    points = np.array([[-0.5, 0.3], [0.5, 0.1], [0.9, 0.5], [1.0, 1.5]])
    assert distances_from_trail(points, trail) == pytest.approx([0.1, 0.1, 0.5])


def test_boxes_pair_by_nearest_centre_and_each_only_once() -> None:
    true = [Obstacle("a", 0.0, 0.0, 0.4, 0.4), Obstacle("b", 0.5, 0.0, 0.4, 0.4), Obstacle("c", 5.0, 0.0, 1.0, 1.0)]
    found = [Obstacle("x", 0.3, 0.0, 0.4, 0.5), Obstacle("y", -0.4, 0.0, 0.4, 0.4)]
    matches = match_boxes(true, found)
    assert [m.found.id if m.found else None for m in matches] == ["y", "x", None]
    assert matches[1].place_m == pytest.approx(np.hypot(0.2, 0.05))
    assert matches[1].size_m == pytest.approx(0.1)


def test_mahalanobis_needs_a_covariance() -> None:
    assert mahalanobis(np.array([0.3, 0.4, 0.0]), np.eye(3) * 0.01) == pytest.approx(5.0)
    assert mahalanobis(np.array([0.3, 0.4, 0.0]), np.zeros((3, 3))) is None


def test_cpu_is_told_by_node_and_phase_on_both_clocks(record: RideRecord) -> None:
    ride = find_ride(record)
    assert phases(record, ride) == {"coupling": (10.0, 25.0), "riding": (25.0, 65.8), "alone": (70.8, END)}
    cost = {cost.node: cost for cost in node_costs(record, ride)}["/turtlebot/slam"]
    assert (cost.cpu_s, cost.memory_mb) == (15.168, 50.0 + END)
    use = cost.phases["riding"]
    assert (use.cpu_s, use.sim_s, use.wall_s) == pytest.approx((0.408, 40.8, 51.0))


def test_modules_over_time_are_those_of_table_3(record: RideRecord) -> None:
    changes = [change for change in module_changes(record) if change.robot == "turtlebot"]
    assert [change.state for change in changes] == ["idle", "riding", "relocalizing"]
    riding = changes[1].modules
    assert (riding.PP, riding.OBS, riding.LZN, riding.MAP, riding.COM, riding.VS) == (False,) * 4 + (True, True)


def test_statuses_that_only_count_metres_are_not_kept() -> None:
    robot = RobotRecord(CAMERA, MARKER)
    first = Status(1.0, "t", "hitchhiker", "riding", servo=ServoCommand("follow", 0))
    assert robot.add_status(first)
    assert not robot.add_status(replace(first, time_stamp=2.0, servo=ServoCommand("follow", 0, feed_forward_mps=0.3)))
    assert len(robot.statuses) == 1
    assert robot.newest_status is not None
    assert robot.newest_status.time_stamp == 2.0


def test_a_robot_has_arrived_when_it_moved_and_says_so() -> None:
    robot = RobotRecord(CAMERA, MARKER)
    robot.add_status(Status(0.0, "t"))
    assert not robot.ended
    robot.add_status(Status(1.0, "t", state="navigating"))
    robot.add_status(Status(2.0, "t", reason="Navigation failed: blocked"))
    assert robot.ended
    assert not robot.arrived
    robot.add_status(Status(3.0, "t", reason=ARRIVED))
    assert robot.arrived


def test_records_survive_their_file(record: RideRecord, tmp_path: Path) -> None:
    file = tmp_path / "record.json"
    save_record(record, file)
    assert load_record(file) == record


@pytest.mark.parametrize("content", [None, "{}", "not JSON"])
def test_a_file_that_is_no_record_is_named(content: str | None, tmp_path: Path) -> None:
    file = tmp_path / "record.json"
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputFileError, match=r"record\.json"):
        load_record(file)


def test_bounds_hold_in_the_direction_that_is_better() -> None:
    assert Figure("a", 1.0, "s", 1.0).ok is True
    assert Figure("a", 1.1, "s", 1.0).ok is False
    assert Figure("a", 1.0, "", 1.1, "higher").ok is False
    assert Figure("a", float("nan"), "", 1.1).ok is False
    assert Figure("a", 5.0, "").ok is None


def test_a_summary_has_median_worst_and_every_failure() -> None:
    runs = [
        [Figure("gap", value, "m", 0.1), Figure("rtf", factor, "", 0.5, "higher")]
        for value, factor in ((0.02, 0.9), (0.2, 0.6), (0.05, 0.7))
    ]
    gap, rtf = summarize([*runs, [Figure("gap", None, "m", 0.1)]])
    assert (gap.value, gap.worst, gap.ok, gap.failed, gap.runs) == (0.05, 0.2, False, 2, 4)
    assert (rtf.value, rtf.worst, rtf.ok, rtf.failed) == (0.7, 0.6, False, 1)
    assert not all_hold([gap])


def test_truth_is_interpolated_across_the_turn(record: RideRecord) -> None:
    hitchhiker = record.robots["turtlebot"]
    hitchhiker.truth = [TimedPose(67.0, 1.0, 2.0, np.pi - 0.1), TimedPose(69.0, 3.0, 2.0, -np.pi + 0.1)]
    taken = hitchhiker.initial_poses[1]
    hitchhiker.initial_poses[1] = replace(taken, x=2.0, y=2.0, theta=-np.pi)
    figures = figures_of(record)
    assert figures["handover_heading_error"].value == pytest.approx(0.0, abs=1e-9)
    assert figures["handover_position_error"].value == pytest.approx(0.0, abs=1e-9)
