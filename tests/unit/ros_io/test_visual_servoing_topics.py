"""visual_servoing in a node, from messages to messages."""

from __future__ import annotations

import numpy as np
import pytest
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import Image
from std_msgs.msg import String

import marker_images as images
from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from flat_world import TURTLEBOT
from hitchhike_ros.modules.visual_servoing import View, VisualServoing, VisualServoingParameters
from hitchhike_ros.protocol.observations import decode_observations
from hitchhike_ros.protocol.status import ModuleSwitches, ServoCommand, Status, encode_status
from hitchhike_ros.ros_io.conversions import header
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.images import camera_info_to_msg, image_to_msg
from hitchhike_ros.ros_io.outlets import visual_servoing_outlets
from hitchhike_ros.servoing.follow import FollowLaw
from hitchhike_ros.servoing.follow_parameters import FollowParameters
from hitchhike_ros.servoing.marker_tracker import MarkerTracker

OWN = "visual_servoing/"


def node(ros: FakeRos) -> ModuleHost:  # noqa: F811
    """That has been told to follow marker 0, and has a listener to everything that it says."""
    ros.listeners |= {"cmd_vel/servoing", *(outlet.topic for outlet in visual_servoing_outlets(""))}
    ros.params["/lockstep"] = True
    law = FollowLaw(FollowParameters(), TURTLEBOT, 0.1)
    module = VisualServoing(VisualServoingParameters(), MarkerTracker(), images.T_BASE_CAMERA, law)
    host = ModuleHost(Single(module), {module.name: visual_servoing_outlets("t/camera_optical")}, start=False)
    status = Status(0.0, "t", modules=ModuleSwitches(VS=True), servo=ServoCommand("follow", 0))
    ros.send("hhike_msg/status", String(encode_status(status)))
    host.turn(0.0)
    odometry = OdometryMsg(header=header(0.2, "odom"))
    odometry.pose.pose.orientation.w = 1.0
    ros.send("odom", odometry)
    ros.send("camera/camera_info", camera_info_to_msg(images.CAMERA, 0.0, ""))
    return host


def picture(encoding: str = "mono8", frame_id: str = "eye") -> Image:
    """Marker 0 at 1.2 m, seen at 0.25 s; reddish where it has colours."""
    gray = images.render_marker(0, images.marker_pose(1.2))
    if encoding == "mono8":
        return image_to_msg(gray, 0.25, frame_id, encoding)
    half = gray // 2
    channels = [gray, half, half] if encoding == "rgb8" else [half, half, gray]
    return image_to_msg(np.stack(channels, axis=-1), 0.25, frame_id, encoding)


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8"])
def test_what_is_seen_is_published_as_of_the_image(ros: FakeRos, encoding: str) -> None:  # noqa: F811
    host = node(ros)
    ros.send("camera/image_raw", picture(encoding))
    host.turn(0.3)
    said = {topic: messages[-1] for topic, messages in ros.published.items() if messages}
    observations = decode_observations(said[OWN + "observations"].data)
    assert (observations.stamp, observations.following) == (0.25, "following")
    assert observations.markers[0].pose.x == pytest.approx(1.3, abs=0.03)
    assert said["cmd_vel/servoing"].linear.x > 0.05
    pose, covariance = said[OWN + "object_position"], said[OWN + "object_position_covariance"]
    assert pose.header == covariance.header
    assert (pose.header.stamp.to_sec(), pose.header.frame_id) == (0.25, "eye")
    assert pose.pose == covariance.pose.pose
    assert pose.pose.position.z == pytest.approx(1.2, abs=0.03)
    assert (np.linalg.eigvalsh(np.reshape(covariance.pose.covariance, (6, 6))) > 0.0).all()
    assert said[OWN + "status"].data == View.SEEN
    assert said[OWN + "code_message"].data == "36h11 id: 0"
    assert said["lockstep/answer"].stamp.to_sec() == 0.25
    shown = said[OWN + "image_annotated"]
    assert (shown.encoding, shown.header.stamp.to_sec(), shown.header.frame_id) == ("rgb8", 0.25, "eye")
    pixels = np.frombuffer(shown.data, np.uint8).reshape(480, 640, 3)
    assert (pixels == (0, 255, 0)).all(axis=2).sum() > 100
    red, _, blue = pixels[470, 10].tolist()
    assert red - blue == pytest.approx(0 if encoding == "mono8" else 60, abs=20)


def test_a_camera_that_names_no_frame_has_that_of_the_model(ros: FakeRos) -> None:  # noqa: F811
    host = node(ros)
    ros.send("camera/image_raw", picture(frame_id=""))
    host.turn(0.3)
    assert ros.published[OWN + "object_position"][-1].header.frame_id == "t/camera_optical"


def test_of_an_image_that_is_none_there_is_neither_a_pose_nor_a_picture(ros: FakeRos) -> None:  # noqa: F811
    host, image = node(ros), picture()
    image.encoding = "nv21"
    ros.send("camera/image_raw", image)
    host.turn(0.3)
    assert [msg.data for msg in ros.published[OWN + "status"]] == [View.NO_IMAGE]
    assert not any(ros.published[OWN + name] for name in ("object_position", "code_message", "image_annotated"))
    assert "bayer_grbg8" in ros.said("visual_servoing")[1]
    assert ros.published["lockstep/answer"][-1].stamp.to_sec() == 0.25


def test_a_lens_that_opencv_does_not_know_is_named(ros: FakeRos) -> None:  # noqa: F811
    host, info = node(ros), camera_info_to_msg(images.CAMERA, 0.0, "")
    info.distortion_model = "equidistant"
    ros.send("camera/camera_info", info)
    ros.send("camera/image_raw", picture())
    host.turn(0.3)
    assert "no camera_info: distortion model 'equidistant' in it, expected one of" in ros.said("visual_servoing")[1]
