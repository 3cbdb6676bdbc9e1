"""Writes the map of a topic to NAME.yaml and NAME.pgm, as the map_saver of map_server does, and ends.

It subscribes map (nav_msgs/OccupancyGrid), which map:=TOPIC renames. When no map comes, or it cannot be saved, it says
why and ends with exit status 1.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import rospy
from nav_msgs.msg import OccupancyGrid

from hitchhike_ros.commands.command_line import SETTINGS, help_of, run
from hitchhike_ros.commands.next_message import wait_for
from hitchhike_ros.mapping.map_file import save_map, trinary
from hitchhike_ros.ros_io.conversions import grid_from_msg


@click.command("map_saver", help=help_of(__doc__), context_settings=SETTINGS)
@click.option("-f", "name", metavar="NAME", default="map", show_default=True, help="Files to write, without suffix.")
@click.option(
    "--occ",
    metavar="PERCENT",
    type=click.IntRange(0, 100),
    default=65,
    show_default=True,
    help="Cells of at least this are saved as occupied.",
)
@click.option(
    "--free",
    metavar="PERCENT",
    type=click.IntRange(0, 100),
    default=25,
    show_default=True,
    help="Cells of at most this are saved as free; those between, as unknown.",
)
@click.option(
    "--timeout", "timeout_s", metavar="S", type=float, default=60.0, show_default=True, help="Wall time to wait."
)
def command(name: str, occ: int, free: int, timeout_s: float) -> None:
    """Wait for one map and save it."""
    if not free < occ:
        raise click.UsageError(f"--free {free} --occ {occ}: expected 0 <= free < occ <= 100")
    rospy.init_node("map_saver", disable_signals=True)
    msg = wait_for("map", OccupancyGrid, "map", timeout_s)
    grid = grid_from_msg(msg)
    # Messages carry the resolution as float32: the shortest number that means the same is what was meant.
    grid = replace(grid, resolution=float(str(np.float32(grid.resolution))))
    path = Path(f"{name}.yaml")
    save_map(trinary(grid, free, occ), path)
    print(f"{path}: {grid.width} x {grid.height} cells of {grid.resolution:g} m")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros map_saver``."""
    run(command)
