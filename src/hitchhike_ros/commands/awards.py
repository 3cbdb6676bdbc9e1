"""Shows what drivers earned: a total for each, most points first, and every ride, oldest first.

Reads award ledgers, as hitchhike_comm keeps them; a ride that is in several of them counts once. Needs no ROS master.
A FILE is a ledger; without one it is $ROS_HOME/hitchhike_awards.sqlite, where ROS_HOME is ~/.ros unless it is set.

As JSON it is {"drivers": [{driver, rides, ride_m, points}], "rides": [{driver, hitchhiker, ride_id, ride_m, points,
time}]}, with metres and seconds since 1970.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import msgspec

from hitchhike_ros.commands.command_line import SETTINGS, help_of, run
from hitchhike_ros.experiments.report.screen import console, show
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.protocol.award_ledger import AwardLedger, Credit, totals
from hitchhike_ros.ros_io.awards import default_ledger


@click.command("awards", help=help_of(__doc__), context_settings=SETTINGS)
@click.argument("files", nargs=-1, type=click.Path(path_type=Path), metavar="[FILE...]")
@click.option("--json", "as_json", is_flag=True, help="Print the same as JSON.")
def command(files: tuple[Path, ...], as_json: bool) -> None:
    """Read ledgers and print what is in them."""
    rides: dict[tuple[str, str, str], Credit] = {}
    for file in files or (default_ledger(),):
        for credit in AwardLedger(file).credits():
            rides.setdefault(credit.key, credit)
    credits = sorted(rides.values(), key=lambda credit: (credit.time, credit.key))
    if as_json:
        content = {"drivers": totals(credits), "rides": credits}
        print(msgspec.json.format(msgspec.json.encode(content), indent=2).decode())
    elif credits:
        show(console(), *tables(credits))
    else:
        print("No rides.")


def tables(credits: list[Credit]) -> list[Table]:
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


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros awards``."""
    run(command)
