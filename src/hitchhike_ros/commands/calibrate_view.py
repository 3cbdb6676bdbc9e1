"""calibrate_view: shows what the marker tracker sees, while somebody mounts a marker or a camera.

    rosrun hitchhike_ros calibrate_view [PARAMETERS and remappings of visual_servoing]
    rosrun hitchhike_ros calibrate_view __ns:=turtlebot _marker_id:=0

It is the node visual_servoing, always on and only observing, and besides one line in the terminal that lives: code,
range with its spread, bearing, yaw (0 when the marker faces the camera), share of the images in which the marker is
seen, and their rate; where the output is no terminal, a line each second. At the end, with Ctrl-C, all in one line.
Look at ``visual_servoing/image_annotated`` beside it, for example with rqt_image_view.

Topics, parameters, TF: as visual_servoing (``rosrun hitchhike_ros visual_servoing --help``); ~task is ``observe``.
"""

from __future__ import annotations

import rospy
from rich.text import Text

from hitchhike_ros.experiments.report.screen import LivingLine, console
from hitchhike_ros.modules.module import Outputs
from hitchhike_ros.modules.visual_servoing import View, VisualServoing, VisualServoingOutputs
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets
from hitchhike_ros.ros_io.parameters import private_parameters
from hitchhike_ros.servoing.view_statistics import ViewStatistics, sighting


class _Line:
    """Shows the terminal every image, and a file one a second."""

    def __init__(self) -> None:
        self._statistics = ViewStatistics()
        self._living = LivingLine(console())
        self._living.__enter__()

    def show(self, _name: str, outputs: Outputs) -> None:
        """What a step of the module gave; nothing where no image was looked at."""
        if not isinstance(outputs, VisualServoingOutputs) or outputs.observations is None:
            return
        stamp, target = outputs.observations.stamp, None if outputs.look is None else outputs.look.target
        self._statistics.add(stamp, None if target is None else sighting(target.code.message, target.T_camera_marker))
        unusable = outputs.view is View.NO_IMAGE
        line = "image cannot be used: see /diagnostics" if unusable else self._statistics.line()
        self._living.show(Text(line, no_wrap=True, overflow="crop"), f"{stamp:.0f}")

    def finish(self) -> None:
        """Say of all images what was seen."""
        self._living.__exit__()
        print(self._statistics.summary(), flush=True)


def build() -> ModuleHost:
    """The node's host; its parameters are those of the parameter server."""
    line = _Line()
    rospy.on_shutdown(line.finish)
    module = VisualServoing.build(
        NodeFiles(),
        follows=False,
        alone=private_parameters("marker_id", "code_message", "marker_size_m"),
        where=rospy.get_name(),
    )
    print(f"waiting for images on {rospy.resolve_name('camera/image_raw')}", flush=True)
    return ModuleHost(Single(module), {module.name: outlets(module.name)}, also=line.show)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros calibrate_view``."""
    run("calibrate_view", build)
