"""How a run ended, and the files that it leaves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hitchhike_ros.experiments.report.ride_files import RideEnd, write_files
from hitchhike_ros.experiments.report.versions import versions
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord, load_record
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.simulation.world_file import load_world
from repository import ROOT
from synthetic_ride import CAMERA, DECOUPLING, MARKER, synthetic_ride


def alone() -> RideRecord:
    """Both robots reach their goals, and nobody asks for a ride."""
    record = synthetic_ride()
    for name, robot in record.robots.items():
        arrived = robot.statuses[-1]
        robot.statuses = [Status(0.5, name), Status(5.0, name, "none", "navigating"), arrived]
    return record


def broken_off() -> RideRecord:
    record = synthetic_ride()
    for robot in record.robots.values():
        robot.statuses = [s for s in robot.statuses if s.time_stamp < DECOUPLING]
        robot.newest_status = robot.statuses[-1]
    return record


@pytest.mark.parametrize(
    ("record", "cause", "completed", "verdict"),
    [
        (synthetic_ride(), "", True, "Ride completed"),
        (synthetic_ride(), "/p3dx/slam ended", False, "Ride not completed, at step 'Arrived': /p3dx/slam ended"),
        (broken_off(), "deadline of 900 s", False, "Ride not completed, at step 'Riding': deadline of 900 s"),
        (broken_off(), "", False, "Ride not completed, at step 'Riding': no robot goes on"),
        (alone(), "", False, "No ride: every robot drove alone"),
    ],
)
def test_a_run_ends_with_its_ride_or_says_why_not(
    record: RideRecord, cause: str, completed: bool, verdict: str
) -> None:
    end = RideEnd(record, cause, 100.0)
    assert (end.completed, end.verdict) == (completed, verdict)
    assert end.headline.startswith(f"{verdict}, 90.0 s simulated in 100.0 s, seed 3")


def test_a_ride_that_was_handed_over_has_tables_and_others_have_none() -> None:
    assert [table.title for table in RideEnd(synthetic_ride(), "", 1.0).tables()] == ["Figures", "Boxes", "CPU"]
    assert RideEnd(broken_off(), "", 1.0).tables() == []


def test_bounds_are_asked_apart_from_completion() -> None:
    end = RideEnd(synthetic_ride(), "", 1.0)  # its ghost of a box breaks a bound
    assert end.completed and not end.all_hold


def test_the_files_say_what_happened(tmp_path: Path) -> None:
    world = load_world(ROOT / "maps" / "p17_exp1.world.yaml")
    end = RideEnd(synthetic_ride(), "", 100.0, unreadable=2)
    write_files(end, tmp_path, world, ROOT)
    summary = json.loads((tmp_path / "ride.json").read_text())
    assert (summary["completed"], summary["seed"], summary["unreadable_messages"]) == (True, 3, 2)
    assert (summary["sim_s"], summary["wall_s"]) == (90.0, 100.0)
    assert {figure["name"]: figure["value"] for figure in summary["figures"]}["wait"] == 4.0
    assert summary["boxes"][0]["true"]["id"] == "obs1"
    assert summary["ride"]["hitchhiker"] == "turtlebot"
    assert load_record(tmp_path / "record.json") == end.record
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_in_which_nothing_was_heard_leaves_its_files_too(tmp_path: Path) -> None:
    world = load_world(ROOT / "maps" / "p17_exp1.world.yaml")
    end = RideEnd(RideRecord("p17_exp1", 0, (), {"p3dx": RobotRecord(CAMERA, MARKER)}), "interrupted", 1.0)
    write_files(end, tmp_path, world, ROOT)
    assert json.loads((tmp_path / "ride.json").read_text())["ride"] is None


def test_versions_are_those_of_package_and_wheels() -> None:
    found = versions(ROOT)
    assert {"hitchhike_ros", "python", "numpy", "msgspec", "pybullet", "machine"} == found.keys()
    assert all(found.values())
