"""Draws the protocol's two machines from their tables: hitchhiker.dot and driver.dot, and the same as SVG by Graphviz.

Needs the Debian package graphviz, and no ROS master.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import click
import rospkg

from hitchhike_ros.commands.command_line import SETTINGS, help_of, run
from hitchhike_ros.protocol.diagrams import dot
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine

MACHINES: dict[str, type[Any]] = {"hitchhiker": HitchhikerMachine, "driver": DriverMachine}
_GRAPHVIZ_S = 60.0


@click.command("draw_machines", help=help_of(__doc__), context_settings=SETTINGS)
@click.option(
    "--output",
    metavar="DIR",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder to write to.  [default: docs of this package]",
)
def command(output: Path | None) -> None:
    """Write each machine's graph and its picture."""
    folder = output or Path(rospkg.RosPack().get_path("hitchhike_ros")) / "docs"
    graphviz = shutil.which("dot")
    try:
        for name, machine in MACHINES.items():
            file = folder / f"{name}.dot"
            file.write_text(dot(machine), encoding="utf-8")
            print(file)
            if graphviz is not None:
                picture = file.with_suffix(".svg")
                arguments = [graphviz, "-Tsvg", "-o", str(picture), str(file)]
                subprocess.run(arguments, check=True, timeout=_GRAPHVIZ_S)
                print(picture)
    except (OSError, subprocess.SubprocessError) as exc:
        raise click.ClickException(f"--output {folder}: {exc}") from exc
    if graphviz is None:
        raise click.ClickException("no SVG: there is no dot, expected the Debian package graphviz")


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros draw_machines``."""
    run(command)
