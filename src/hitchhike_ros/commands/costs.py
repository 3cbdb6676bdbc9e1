"""usage: rosrun hitchhike_ros costs RIDE ALONE [--json] [--check]

Prints what a ride costs its hitchhiker, beside driving the same way alone: CPU, memory, messages and bytes of every
module. Needs no ROS master. RIDE and ALONE are what two runs left, folders or record.json: after

  rosrun hitchhike_ros experiments p17_exp1 p17_exp1_alone --report DIR

they are DIR/p17_exp1/seed-0 and DIR/p17_exp1_alone/seed-0.

  --json   print the same as JSON
  --check  the exit status says whether every bound holds
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import msgspec

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.experiments.report.cost_tables import ledger
from hitchhike_ros.experiments.report.screen import console, show
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, load_record
from hitchhike_ros.experiments.scoring.cost_ledger import compare, cost_figures, modules_off, ride_steps
from hitchhike_ros.experiments.scoring.figures import all_hold
from hitchhike_ros.experiments.scoring.rides import find_ride


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros costs``."""
    parser = argparse.ArgumentParser("costs", usage=str(__doc__).removeprefix("usage: "), allow_abbrev=False)
    parser.add_argument("ride", type=_record_file, metavar="RIDE")
    parser.add_argument("alone", type=_record_file, metavar="ALONE")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    try:
        ridden, alone = load_record(arguments.ride), load_record(arguments.alone)
    except HitchhikeError as exc:
        sys.exit(f"costs: {exc}")
    figures = cost_figures(ridden, alone)
    if arguments.json:
        print(_json(ridden, alone))
    else:
        show(console(), *ledger(ridden, alone))
    sys.exit(1 if arguments.check and not all_hold(figures) else 0)


def _json(ridden: RideRecord, alone: RideRecord) -> str:
    ride = find_ride(ridden)
    content = {
        "figures": cost_figures(ridden, alone),
        "comparisons": compare(ridden, alone),
        "steps": ride_steps(ridden, ride) if ride is not None else [],
        "off": modules_off(ridden),
    }
    return msgspec.json.format(msgspec.json.encode(content), indent=2).decode()


def _record_file(text: str) -> Path:
    path = Path(text)
    return path / "record.json" if path.is_dir() else path
