"""What one module publishes is what another one takes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import rospy
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, String

from hitchhike_ros.core.datatypes import CameraInfo, Pose2D, Twist2D
from hitchhike_ros.core.errors import MessageError, SensorDataError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.modules.inputs import (
    NO_PATH,
    DepthCameraInfo,
    DepthImage,
    Joystick,
    NavigationCommand,
    PlannedPath,
    PlanReport,
    TeleopActive,
    TeleopCommand,
)
from hitchhike_ros.protocol.events import NavigationReport
from hitchhike_ros.ros_io.conversions import grid_to_msg
from hitchhike_ros.ros_io.images import camera_info_to_msg, image_to_msg
from hitchhike_ros.ros_io.inlets import INLETS
from hitchhike_ros.ros_io.outlets import OBSTACLE_AVOIDANCE, PATH_PLANNING, TELEOP, Outlet


@pytest.fixture(autouse=True)
def _ros_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rospy, "get_time", lambda: 12.5)


def handed_on(outlets: tuple[Outlet, ...], what: type, value: object) -> Any:
    """``value`` as it arrives at a module that takes ``what``, by way of its topic."""
    inlet = INLETS[what]
    (outlet,) = (outlet for outlet in outlets if outlet.topic == inlet.topic)
    (msg,) = outlet.convert(value)
    assert isinstance(msg, outlet.cls)
    return inlet.convert(msg)


def test_a_plan_arrives_with_its_end() -> None:
    points, end = np.array([(0.0, 0.5), (1.0, 0.5), (1.0, 2.0)]), Pose2D(1.0, 2.0, -2.5)
    arrived = handed_on(PATH_PLANNING, PlannedPath, PlannedPath(points, end))
    np.testing.assert_array_equal(arrived.points, points)
    assert (arrived.end.x, arrived.end.y) == (1.0, 2.0)
    assert arrived.end.theta == pytest.approx(-2.5)
    (msg,) = PATH_PLANNING[1].convert(PlannedPath(points, end))
    assert (msg.header.frame_id, msg.header.stamp.to_sec()) == ("map", 12.5)


def test_a_lack_of_a_plan_arrives() -> None:
    arrived = handed_on(PATH_PLANNING, PlannedPath, NO_PATH)
    assert (arrived.end, arrived.points.shape) == (None, (0, 2))
    (msg,) = PATH_PLANNING[1].convert(NO_PATH)
    assert (msg.header.frame_id, msg.header.stamp.to_sec()) == ("map", 12.5)


def test_a_report_arrives() -> None:
    report = PlanReport("7", "failed", "no way")
    assert handed_on(PATH_PLANNING, PlanReport, report) == report


def test_what_driving_comes_to_arrives() -> None:
    command, report = NavigationCommand(Twist2D(0.25, -0.5)), NavigationReport("7", "blocked", "no scan")
    assert handed_on(OBSTACLE_AVOIDANCE, NavigationCommand, command) == command
    assert handed_on(OBSTACLE_AVOIDANCE, NavigationReport, report) == report


@pytest.mark.parametrize("active", [True, False])
def test_whether_a_human_has_the_robot_in_hand_arrives(active: bool) -> None:
    assert INLETS[TeleopActive].convert(Bool(active)) == TeleopActive(active)


def test_what_a_human_wants_arrives() -> None:
    assert handed_on(TELEOP, TeleopCommand, TeleopCommand(Twist2D(0.5, -0.25))) == TeleopCommand(Twist2D(0.5, -0.25))
    for active in (True, False):
        assert handed_on(TELEOP, TeleopActive, TeleopActive(active)) == TeleopActive(active)
    joystick = INLETS[Joystick].convert(Joy(axes=[0.5, -1.0], buttons=[0, 1]))
    assert joystick == Joystick((0.5, -1.0), (0, 1))


@pytest.mark.parametrize("what", [PlanReport, NavigationReport])
@pytest.mark.parametrize("text", ["", "{}", '{"goal_id": 1, "state": "idle"}', "[]"])
def test_a_text_that_is_no_report_is_refused(what: type, text: str) -> None:
    inlet = INLETS[what]
    with pytest.raises(MessageError, match=inlet.topic):
        inlet.convert(String(text))


def test_a_path_with_a_senseless_end_leads_nowhere() -> None:
    (msg,) = PATH_PLANNING[1].convert(PlannedPath(np.zeros((2, 2)), Pose2D()))
    msg.poses[-1].pose.orientation.w = 0.0
    assert math.isnan(INLETS[PlannedPath].convert(msg).end.theta)


def test_a_map_arrives_and_a_senseless_one_is_refused() -> None:
    grid = OccupancyGrid(np.arange(6).reshape(2, 3), 0.05, Pose2D(1.0, 2.0))
    convert = INLETS[OccupancyGrid].convert
    arrived = convert(grid_to_msg(grid, 0.0))
    np.testing.assert_array_equal(arrived.data, grid.data)
    bad = [OccupancyGridMsg(), grid_to_msg(grid, 0.0), grid_to_msg(grid, 0.0), grid_to_msg(grid, 0.0)]
    bad[1].data = bad[1].data[:-1]
    bad[2].info.resolution = 0.0
    bad[3].info.origin.position.x = math.nan
    for msg in bad:
        with pytest.raises(SensorDataError, match="map"):
            convert(msg)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"width": 0, "height": 0}, "0 x 0 cells and 6 values"),
        ({"width": 2**16, "height": 2**16}, "65536 x 65536 cells and 6 values"),
        ({"width": 4}, "4 x 2 cells and 6 values"),
        ({"height": 1}, "3 x 1 cells and 6 values"),
        ({"resolution": math.nan}, "resolution of nan"),
        ({"resolution": math.inf}, "resolution of inf"),
        ({"resolution": -0.05}, "resolution of -0.05"),
    ],
)
def test_of_a_senseless_map_it_is_said_what_is_wrong(change: dict[str, float], said: str) -> None:
    msg = grid_to_msg(OccupancyGrid(np.zeros((2, 3)), 0.05), 0.0)
    for name, value in change.items():
        setattr(msg.info, name, value)
    with pytest.raises(SensorDataError, match=f"^map has .*{said}.*, expected"):
        INLETS[OccupancyGrid].convert(msg)


def test_a_map_without_orientation_is_not_turned() -> None:
    grid = OccupancyGrid(np.arange(6).reshape(2, 3), 0.05, Pose2D(1.0, 2.0, 0.5))
    msg = grid_to_msg(grid, 0.0)
    msg.info.origin.orientation.z = msg.info.origin.orientation.w = 0.0
    assert INLETS[OccupancyGrid].convert(msg).origin == Pose2D(1.0, 2.0, 0.0)
    for bad in (math.nan, math.inf):
        msg.info.origin.orientation.w = bad
        with pytest.raises(SensorDataError, match="map has its origin at"):
            INLETS[OccupancyGrid].convert(msg)


def test_values_that_mean_nothing_are_unknown() -> None:
    msg = grid_to_msg(OccupancyGrid(np.zeros((1, 6)), 0.05), 0.0)
    msg.data = [-128, -2, -1, 100, 101, 127]
    assert INLETS[OccupancyGrid].convert(msg).data.tolist() == [[-1, -1, -1, 100, -1, -1]]


def test_a_depth_image_is_converted_when_it_is_looked_at() -> None:
    depth = np.array([(1.0, np.nan), (0.25, 2.0)], np.float32)
    arrived = INLETS[DepthImage].convert(image_to_msg(depth, 7.5, "camera", "32FC1"))
    assert arrived.stamp == 7.5
    np.testing.assert_array_equal(arrived.depth(), depth)
    strange = INLETS[DepthImage].convert(image_to_msg(np.zeros((2, 2, 3), np.uint8), 8.0, "camera", "rgb8"))
    assert strange.stamp == 8.0
    with pytest.raises(SensorDataError, match="rgb8"):
        strange.depth()


def test_the_calibration_of_the_depth_camera_is_not_that_of_the_camera() -> None:
    info = CameraInfo(4, 3, np.diag([5.0, 6.0, 1.0]))
    inlet = INLETS[DepthCameraInfo]
    arrived = inlet.convert(camera_info_to_msg(info, 0.0, "camera"))
    assert inlet.topic != INLETS[CameraInfo].topic
    assert (arrived.info.width, arrived.info.height) == (4, 3)
    np.testing.assert_array_equal(arrived.info.K, info.K)
