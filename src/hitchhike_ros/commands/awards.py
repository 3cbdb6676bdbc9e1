"""usage: rosrun hitchhike_ros awards [FILE...] [--json]

Shows what drivers earned: a total for each, most points first, and every ride, oldest first. Reads award ledgers, as
hitchhike_comm keeps them; a ride that is in several of them counts once. Needs no ROS master.

  FILE    a ledger ($ROS_HOME/hitchhike_awards.sqlite; ROS_HOME is ~/.ros where it is not set)
  --json  the same as JSON: {"drivers": [{driver, rides, ride_m, points}], "rides": [{driver, hitchhiker, ride_id,
          ride_m, points, time}]}, with metres and seconds since 1970
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import msgspec

from hitchhike_ros.core.errors import LedgerError
from hitchhike_ros.experiments.report.screen import console, show
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.protocol.award_ledger import AwardLedger, Credit, totals
from hitchhike_ros.ros_io.awards import default_ledger


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros awards``."""
    parser = argparse.ArgumentParser("awards", usage=str(__doc__).removeprefix("usage: "), allow_abbrev=False)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rides: dict[tuple[str, str, str], Credit] = {}
    try:
        for file in arguments.files or [default_ledger()]:
            for credit in AwardLedger(file).credits():
                rides.setdefault(credit.key, credit)
    except LedgerError as exc:
        sys.exit(f"awards: {exc}")
    credits = sorted(rides.values(), key=lambda credit: (credit.time, credit.key))
    try:
        if arguments.json:
            content = {"drivers": totals(credits), "rides": credits}
            print(msgspec.json.format(msgspec.json.encode(content), indent=2).decode())
        else:
            show(console(), *_tables(credits)) if credits else print("No rides.")
        sys.stdout.flush()
    except BrokenPipeError:
        # A pager may be left before the end; what Python flushes when it ends goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _tables(credits: list[Credit]) -> list[Table]:
    """Totals and rides as a person reads them."""
    drivers = [[_shown(t.driver), str(t.rides), f"{t.ride_m:.1f} m", f"{t.points:.1f}"] for t in totals(credits)]
    rides = [
        [
            time.strftime("%Y-%m-%d %H:%M", time.localtime(c.time)),
            *(_shown(name) for name in (c.driver, c.hitchhiker)),
            f"{c.ride_m:.1f} m",
            f"{c.points:.1f}",
            _shown(c.ride_id),
        ]
        for c in credits
    ]
    return [
        Table("Drivers", ["", "rides", "ridden", "points"], drivers),
        Table("Rides", ["", "driver", "hitchhiker", "ridden", "points", "id"], rides),
    ]


def _shown(name: str) -> str:
    """A name from the network, without what would steer a terminal."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
