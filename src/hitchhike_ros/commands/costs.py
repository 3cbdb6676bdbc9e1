"""Prints what a ride costs its hitchhiker, beside driving the same way alone.

CPU, memory, messages and bytes of every module. Needs no ROS master. RIDE and ALONE are what two runs left, folders or
record.json. After

  rosrun hitchhike_ros experiments p17_exp1 p17_exp1_alone --report DIR

they are DIR/p17_exp1/seed-0 and DIR/p17_exp1_alone/seed-0.
"""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from hitchhike_ros.commands.command_line import SETTINGS, check_option, help_of, run
from hitchhike_ros.experiments.report.cost_tables import ledger
from hitchhike_ros.experiments.report.ride_files import RECORD
from hitchhike_ros.experiments.report.screen import console, show
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, load_record
from hitchhike_ros.experiments.scoring.cost_ledger import compare, cost_figures, modules_off, ride_steps
from hitchhike_ros.experiments.scoring.figures import all_hold
from hitchhike_ros.experiments.scoring.rides import find_ride


@click.command("costs", help=help_of(__doc__), context_settings=SETTINGS)
@click.argument("ride", type=click.Path(path_type=Path))
@click.argument("alone", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the same as JSON.")
@check_option
def command(ride: Path, alone: Path, as_json: bool, check: bool) -> int:
    """Compare two records."""
    ridden, driven = (load_record(path / RECORD if path.is_dir() else path) for path in (ride, alone))
    if as_json:
        print(_json(ridden, driven))
    else:
        show(console(), *ledger(ridden, driven))
    return 1 if check and not all_hold(cost_figures(ridden, driven)) else 0


def _json(ridden: RideRecord, alone: RideRecord) -> str:
    ride = find_ride(ridden)
    content = {
        "figures": cost_figures(ridden, alone),
        "comparisons": compare(ridden, alone),
        "steps": ride_steps(ridden, ride) if ride is not None else [],
        "off": modules_off(ridden),
    }
    return msgspec.json.format(msgspec.json.encode(content), indent=2).decode()


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros costs``."""
    run(command)
