"""What a record keeps of a status, when a robot has ended, and that a record survives its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.experiments.scenarios.ride_record import (
    RideRecord,
    RobotRecord,
    StepSample,
    load_record,
    save_record,
)
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.protocol.status import ServoCommand, Status
from synthetic_ride import CAMERA, MARKER, synthetic_ride


@pytest.fixture
def record() -> RideRecord:
    return synthetic_ride()


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
    robot.add_status(Status(3.0, "t", reason=str(Reason.ARRIVED)))
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


def test_late_steps_are_counted_between_two_stamps(record: RideRecord) -> None:
    assert record.late_share(0.0, 10.0) is None
    record.steps = [StepSample(float(t), 10 * t, late) for t, late in ((1, 5), (2, 5), (3, 6), (4, 8), (5, 8))]
    assert record.late_share(2.0, 4.0) == pytest.approx(3 / 20)
    assert record.late_share(2.5, 3.5) == pytest.approx(3 / 20)  # whole samples around them
    assert record.late_share(-9.0, 99.0) == pytest.approx(3 / 40)
    assert record.late_share(4.5, 99.0) == 0.0
    assert record.late_share(6.0, 7.0) is None
