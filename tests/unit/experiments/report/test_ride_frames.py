"""Which camera frames of a ride are kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from hitchhike_ros.experiments.report.ride_frames import (
    FOLDER,
    FramePlan,
    KeptFrameParameters,
    find_frames,
    frame_name,
    frames_due,
)
from hitchhike_ros.protocol.status import ModuleSwitches, RideStatus, Status
from synthetic_ride import RIDE_M, synthetic_ride

ON = ModuleSwitches(VS=True)


def riding(ride_id: str = "ride", ride_m: float = RIDE_M, state: str = "riding") -> Status:
    return Status(0.0, "turtlebot", "hitchhiker", state, "", ON, ride=RideStatus(ride_id, "p3dx", "turtlebot", ride_m))


def test_each_step_of_a_hitchhiker_is_kept_once_and_its_end() -> None:
    plan, taken = FramePlan(), []
    for status in synthetic_ride().robots["turtlebot"].statuses:
        for late in (0.0, 0.4, 0.6):
            if plan.due(status, 0.0, status.time_stamp + late):
                taken.append(status.state)
    assert taken == ["requesting", "coupling", "riding", "settling", "relocalizing", "navigating"]


def test_frames_are_due_of_the_robots_that_have_a_plan() -> None:
    record = synthetic_ride()
    for robot in record.robots.values():
        robot.newest_status = next(s for s in robot.statuses if s.time_stamp >= 10.0)
    plans = {"p3dx": FramePlan(), "turtlebot": FramePlan()}
    assert frames_due(record, {}, 20.0) == {}
    assert frames_due(record, plans, 20.0) == {"turtlebot": "requesting"}
    assert frames_due(record, plans, 20.1) == {}
    record.robots["turtlebot"].newest_status = None
    assert frames_due(record, plans, 20.2) == {}


def test_nobody_who_does_not_ride_is_looked_through() -> None:
    plan = FramePlan()
    assert not any(plan.due(s, 0.0, s.time_stamp) for s in synthetic_ride().robots["p3dx"].statuses)


def test_servoing_has_time_to_subscribe_first() -> None:
    plan = FramePlan()
    due = [plan.due(riding(state="coupling"), 0.0, now) for now in (0.0, 0.3, 0.49, 0.5, 0.6)]
    assert due == [False, False, False, True, False]


def test_frames_on_the_way_are_five_metres_apart_and_few_on_a_long_ride() -> None:
    for ride_m, expected in ((20.4, [0, 5, 10, 15, 20]), (50.0, [0, 10, 20, 30, 40, 50])):
        plan = FramePlan()
        plan.due(riding(ride_m=ride_m), 0.0, 0.0)  # servoing was switched on
        at = [m for m in range(int(ride_m) + 1) if plan.due(riding(ride_m=ride_m), float(m), 1.0 + m)]
        assert at == expected


def test_a_ride_that_is_tried_again_and_again_leaves_a_bounded_number() -> None:
    plan = FramePlan()
    plan.due(riding(), 0.0, 0.0)
    taken = [
        plan.due(riding(f"ride {k}", 20.0, state), 0.0, 1.0) for k in range(40) for state in ("coupling", "riding")
    ]
    assert sum(taken) == 48


def test_frames_are_found_by_their_names_in_order_of_time(tmp_path: Path) -> None:
    folder = tmp_path / FOLDER
    folder.mkdir()
    for stamp, state in ((102.5, "awaiting_aligned"), (9.05, "requesting")):
        (folder / frame_name(stamp, "turtlebot_2", state)).write_bytes(b"")
    (folder / "holiday.jpg").write_bytes(b"")
    found = [(f.stamp, f.robot, f.state) for f in find_frames(tmp_path)]
    assert found == [(9.05, "turtlebot_2", "requesting"), (102.5, "turtlebot_2", "awaiting_aligned")]
    assert find_frames(tmp_path / "nowhere") == []


@pytest.mark.parametrize(
    ("shape", "size"), [((480, 640, 3), (320, 240)), ((600, 800), (320, 240)), ((101, 320), (320, 101))]
)
def test_a_frame_is_kept_small_and_in_its_proportions(shape: tuple[int, ...], size: tuple[int, int]) -> None:
    assert KeptFrameParameters().size(shape) == size
