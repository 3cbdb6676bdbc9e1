"""visual_servoing: finds markers in the camera's image and rides behind one (module VS).

The marker that it rides behind, or alone the one marker that it is there for, is carried from image to image by a
model-based tracker between detections. What is published belongs to the image that it was seen in; a marker that is not
seen has a status, and no pose.

Alone it stands in for visp_auto_tracker and apriltag_ros, with one marker of any camera that has been calibrated:

    rosrun hitchhike_ros visual_servoing _always_on:=true _family:=36h11 _marker_id:=0 _marker_size_m:=0.16 \\
        camera/image_raw:=/usb_cam/image_raw camera/camera_info:=/usb_cam/camera_info

Subscribed:
    hhike_msg/status (std_msgs/String): whether the module is on, and which marker to follow or observe. To follow has
        to be said again and again: the robot stands when that is 3.5 s old
    camera/image_raw (sensor_msgs/Image: grey, colours, YUV 4:2:2 or Bayer, of 8 or 16 bits), or
        camera/image_raw/compressed (sensor_msgs/CompressedImage); camera/camera_info (sensor_msgs/CameraInfo: plumb_bob
        or rational_polynomial; images may be binned or cut out); odom (nav_msgs/Odometry): only while the module is on
    scan (sensor_msgs/LaserScan): only while the task is to follow, with a config and a URDF that has a laser: what
        comes between is braked for
Published, once an image, or every other one while it follows steadily:
    visual_servoing/observations (std_msgs/String): JSON of all markers seen, in base_footprint
    visual_servoing/object_position (geometry_msgs/PoseStamped), object_position_covariance
        (geometry_msgs/PoseWithCovarianceStamped): the marker in the frame of the image; x is its outward normal, z up
    visual_servoing/status (std_msgs/Int8): as visp_auto_tracker: 0 no usable image, 1 seeking the marker, 3 seen
    visual_servoing/code_message (std_msgs/String): family and id, e.g. ``36h11 id: 0``, or what the QR code says
    visual_servoing/image_annotated (sensor_msgs/Image): only when somebody subscribes
Published while the task is to follow:
    cmd_vel/servoing (geometry_msgs/Twist): likewise, and a stand when images are missing
Always:
    /diagnostics (diagnostic_msgs/DiagnosticArray): what is followed, or why the robot stands
Parameters:
    ~config (path), sections ``marker_detector`` (servoing.marker_detector.MarkerDetectorParameters), ``marker_tracker``
        (servoing.marker_tracker.MarkerTrackerParameters), ``follow`` (servoing.follow.FollowParameters),
        ``visual_servoing`` (modules.visual_servoing.VisualServoingParameters) and, to follow, ``robot``. A private
        parameter with the name of one of theirs replaces it, e.g. ~family (36h11; 25h9, 16h5, circle21h7 or qr) or
        ~steady_period_s (s, 0.19). With a marker that cannot be, of size 0 or of an unknown family, the node sees
        nothing and /diagnostics says why
    ~image_transport (string, raw): raw or compressed
    ~urdf (path): mount of the camera (link camera_optical); without it the camera is taken for the robot's base
    ~always_on (bool, false): on without anyone's status; then also
    ~marker_id (int, -1): the marker, -1 for whichever is nearest; ~code_message (string): instead, what its QR code
        says; ~marker_size_m (m, 0.16): side of the black square, or of the code; ~task (observe, or follow);
        ~gap_m (m, 0.8)
    ~tf_prefix: prefix of the camera's frame when the images name none
TF: none.
"""

from __future__ import annotations

import rospy

from hitchhike_ros.modules.visual_servoing import VisualServoing
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets
from hitchhike_ros.ros_io.parameters import is_given, parameter, private_parameters


def build() -> ModuleHost:
    """The node's host; its parameters are those of the parameter server."""
    own = private_parameters("task", "marker_id", "code_message", "marker_size_m", "gap_m")
    module = VisualServoing.build(
        NodeFiles(),
        follows=is_given("config"),
        alone=own if parameter("always_on", bool, False) else None,
        where=rospy.get_name(),
    )
    return ModuleHost(Single(module), {module.name: outlets(module.name)})


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros visual_servoing``."""
    run("visual_servoing", build)
