"""The process in which roslaunch's API starts a launch file. It reports when all nodes have started, and which died.

roslaunch needs the main thread and the signals of a process, and leaves much behind; so each launch has a process of
its own. SIGINT ends it with all its nodes.

Usage: ``python3 -m hitchhike_ros.commands.launch_host EVENTS PORT FILE [NAME:=VALUE...]``, where EVENTS is the file
descriptor to which each event is written as a line of JSON, and PORT that of the ROS master, which is started too.
"""

from __future__ import annotations

import os
import sys
from typing import TextIO

import msgspec
import roslaunch
import roslaunch.parent
import roslaunch.pmon
import roslaunch.rlutil


class LaunchEvent(msgspec.Struct, frozen=True):
    """``died`` is a node with the status it ended with, None where nobody knows; without one all nodes have started."""

    died: str = ""
    exit_code: int | None = None


class _Deaths(roslaunch.pmon.ProcessListener):
    """Writes down each node that ends, but those that end as they should."""

    def __init__(self, events: TextIO) -> None:
        self._events = events

    def process_died(self, process_name: str, exit_code: int | None) -> None:
        if exit_code != 0:
            _write(self._events, LaunchEvent(process_name.rpartition("-")[0], exit_code))


def _write(events: TextIO, event: LaunchEvent) -> None:
    events.write(msgspec.json.encode(event).decode() + "\n")
    events.flush()


def main() -> None:
    """Start, and wait for the end."""
    descriptor, port, file, *arguments = sys.argv[1:]
    events = os.fdopen(int(descriptor), "w")
    run_id = roslaunch.rlutil.get_or_generate_uuid(None, False)
    roslaunch.configure_logging(run_id)
    deaths = _Deaths(events)
    parent = roslaunch.parent.ROSLaunchParent(
        run_id, [(file, arguments)], port=int(port), process_listeners=[deaths], show_summary=False
    )
    parent.start()
    # Listeners hear only of what happens after the start.
    for dead in parent.pm.dead_list:
        deaths.process_died(dead.name, dead.exit_code)
    _write(events, LaunchEvent())
    parent.spin()


if __name__ == "__main__":
    main()
