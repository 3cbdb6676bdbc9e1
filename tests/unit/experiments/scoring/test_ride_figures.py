"""Figures of a ride whose every number is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Contact
from hitchhike_ros.experiments.scenarios.ride_record import (
    RideRecord,
    RobotRecord,
    TimedPose,
)
from hitchhike_ros.experiments.scoring.figures import Figure, all_hold
from hitchhike_ros.experiments.scoring.ride_figures import ride_figures
from synthetic_ride import CAMERA, MARKER, synthetic_ride


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


def test_gap_error_follows_the_robots_apart(record: RideRecord) -> None:
    hitchhiker = record.robots["turtlebot"]
    hitchhiker.truth = [replace(p, x=p.x - 0.2, y=5.72) for p in hitchhiker.truth]
    assert figures_of(record)["gap_error_rms"].value == pytest.approx(0.25, abs=1e-9)


def test_truth_is_interpolated_across_the_turn(record: RideRecord) -> None:
    hitchhiker = record.robots["turtlebot"]
    hitchhiker.truth = [TimedPose(67.0, 1.0, 2.0, np.pi - 0.1), TimedPose(69.0, 3.0, 2.0, -np.pi + 0.1)]
    taken = hitchhiker.initial_poses[1]
    hitchhiker.initial_poses[1] = replace(taken, x=2.0, y=2.0, theta=-np.pi)
    figures = figures_of(record)
    assert figures["handover_heading_error"].value == pytest.approx(0.0, abs=1e-9)
    assert figures["handover_position_error"].value == pytest.approx(0.0, abs=1e-9)
