"""usage: rosrun hitchhike_ros draw_machines [--output DIR]

Draws the protocol's two machines from their tables: hitchhiker.dot and driver.dot, and the same as SVG by Graphviz
(Debian package graphviz). Needs no ROS master.

  --output DIR  folder to write to (docs of this package)
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
from pathlib import Path
from typing import Any

import rospkg

from hitchhike_ros.protocol.diagrams import dot
from hitchhike_ros.protocol.driver.machine import DriverMachine
from hitchhike_ros.protocol.driver.states import DriverState
from hitchhike_ros.protocol.hitchhiker.machine import HitchhikerMachine
from hitchhike_ros.protocol.hitchhiker.states import HitchhikerState
from hitchhike_ros.protocol.loose_machine import Machine

MACHINES: dict[str, tuple[type[Machine[Any]], Any]] = {
    "hitchhiker": (HitchhikerMachine, HitchhikerState.IDLE),
    "driver": (DriverMachine, DriverState.IDLE),
}
_GRAPHVIZ_S = 60.0


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros draw_machines``."""
    parser = argparse.ArgumentParser("draw_machines", usage=str(__doc__).removeprefix("usage: "))
    parser.add_argument("--output", type=Path)
    folder = parser.parse_args().output or Path(rospkg.RosPack().get_path("hitchhike_ros")) / "docs"
    graphviz = shutil.which("dot")
    try:
        for name, (machine, initial) in MACHINES.items():
            file = folder / f"{name}.dot"
            file.write_text(dot(machine, initial), encoding="utf-8")
            print(file)
            if graphviz is not None:
                picture = file.with_suffix(".svg")
                command = [graphviz, "-Tsvg", "-o", str(picture), str(file)]
                subprocess.run(command, check=True, timeout=_GRAPHVIZ_S)
                print(picture)
    except (OSError, subprocess.SubprocessError) as exc:
        parser.error(f"--output {folder}: {exc}")
    if graphviz is None:
        parser.error("no SVG: there is no dot, expected the Debian package graphviz")
