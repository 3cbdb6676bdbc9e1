"""calibrate_view: shows what the marker tracker sees, while somebody mounts a plate or a camera.

    rosrun hitchhike_ros calibrate_view [PARAMETERS and remappings of visual_servoing]
    rosrun hitchhike_ros calibrate_view __ns:=turtlebot _marker_id:=0

It is the node visual_servoing, always on and only observing, and besides one line in the terminal that lives: code,
range with its spread, bearing, yaw (0 when the plate faces the camera), share of the images in which the marker is
seen, and their rate; where the output is no terminal, a line each second. At the end, with Ctrl-C, all in one line.
Look at ``visual_servoing/image_annotated`` beside it, for example with rqt_image_view.

Topics, parameters, TF: as visual_servoing (``rosrun hitchhike_ros visual_servoing --help``); ~task is ``observe``.
"""

from __future__ import annotations

import shutil
import sys

import rospy
from sensor_msgs.msg import Image

from hitchhike_ros.core.datatypes import MarkerObservation
from hitchhike_ros.nodes.robot.visual_servoing import VisualServoing
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.servoing.marker_detector import MarkerDetection
from hitchhike_ros.servoing.view_statistics import ViewStatistics, sighting

_LINE_PERIOD_S = 1.0  # where the output is no terminal


class CalibrateView(VisualServoing):
    """The node, which besides tells the terminal of every image."""

    def __init__(self) -> None:
        self._statistics = ViewStatistics()
        self._said_at = -_LINE_PERIOD_S
        rospy.set_param("~always_on", True)
        rospy.set_param("~task", "observe")
        rospy.on_shutdown(self._finish)
        super().__init__()
        print(f"waiting for images on {rospy.resolve_name('camera/image_raw')}", flush=True)

    def _publish(
        self,
        image: Image,
        stamp: float,
        observations: list[MarkerObservation],
        target: MarkerDetection | None,
        unusable: bool,
    ) -> None:
        super()._publish(image, stamp, observations, target, unusable)
        self._statistics.add(stamp, None if target is None else sighting(target.code.message, target.T_camera_marker))
        line = "image cannot be used: see /diagnostics" if unusable else self._statistics.line()
        if sys.stdout.isatty():
            print("\r" + line[: shutil.get_terminal_size().columns - 1], end="\x1b[K", flush=True)
        elif not 0.0 <= stamp - self._said_at < _LINE_PERIOD_S:
            self._said_at = stamp
            print(line, flush=True)

    def _finish(self) -> None:
        print(("\n" if sys.stdout.isatty() else "") + self._statistics.summary(), flush=True)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros calibrate_view``."""
    run("calibrate_view", CalibrateView)
