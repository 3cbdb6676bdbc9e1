"""Writes a robot's 3D map to a .bt file, as the octomap_saver of octomap_server does, and ends.

It subscribes octomap_binary (std_msgs/UInt8MultiArray) of mapping_3d, which octomap_binary:=TOPIC renames.
octomap-tools and octovis read FILE. When no map comes, or it cannot be saved, it says why and ends with exit status 1.
"""

from __future__ import annotations

from pathlib import Path

import click
import rospy
from std_msgs.msg import UInt8MultiArray

from hitchhike_ros.commands.command_line import SETTINGS, help_of, run
from hitchhike_ros.commands.next_message import wait_for
from hitchhike_ros.mapping.octree import save


@click.command("octomap_saver", help=help_of(__doc__), context_settings=SETTINGS)
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--timeout", "timeout_s", metavar="S", type=float, default=60.0, show_default=True, help="Wall time to wait."
)
def command(file: Path, timeout_s: float) -> None:
    """Wait for one map and save it."""
    rospy.init_node("octomap_saver", disable_signals=True)
    voxels = save(bytes(wait_for("octomap_binary", UInt8MultiArray, "map", timeout_s).data), file)
    print(f"{file}: {len(voxels.sides)} occupied voxels, {voxels.resolution_m:g} m")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros octomap_saver``."""
    run(command)
