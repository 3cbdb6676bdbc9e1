"""idle: does nothing but keep the time; what a module that is off is measured against (design §6).

Topics, parameters and TF: none.
"""

from __future__ import annotations

from hitchhike_ros.ros_io.node import run


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros idle``."""
    run("idle", lambda: None)
