"""How a ride ended, and the files that it leaves: ride.json, record.json and map.png."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import msgspec

from hitchhike_ros.experiments.report.ride_picture import draw_ride
from hitchhike_ros.experiments.report.ride_report import ARRIVED, box_table, cpu_table, figure_table, progress
from hitchhike_ros.experiments.report.tables import Table
from hitchhike_ros.experiments.report.versions import versions
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, save_record
from hitchhike_ros.experiments.scoring.boxes import BoxMatch, match_boxes
from hitchhike_ros.experiments.scoring.figures import Figure, all_hold
from hitchhike_ros.experiments.scoring.node_costs import NodeCost, node_costs
from hitchhike_ros.experiments.scoring.ride_figures import ride_figures
from hitchhike_ros.experiments.scoring.rides import Ride, find_ride, module_changes
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.simulation.world_file import WorldFile

SUMMARY, RECORD, PICTURE = "ride.json", "record.json", "map.png"


@dataclass(frozen=True)
class RideEnd:
    """A run at its end. ``cause`` says why it was ended early, empty where every robot has come to its end.

    ``unreadable`` is how many messages could not be read.
    """

    record: RideRecord
    cause: str
    wall_s: float
    unreadable: int = 0

    @cached_property
    def ride(self) -> Ride | None:
        return find_ride(self.record)

    @cached_property
    def figures(self) -> list[Figure]:
        return ride_figures(self.record)

    @cached_property
    def boxes(self) -> list[BoxMatch]:
        found = self.record.robots[self.ride.hitchhiker].obstacles if self.ride is not None else ()
        return match_boxes(self.record.true_boxes, found)

    @cached_property
    def costs(self) -> list[NodeCost]:
        return node_costs(self.record, self.ride)

    @cached_property
    def step(self) -> str:
        return progress(self.record, self.ride, None).step

    @property
    def sim_s(self) -> float:
        return self.record.lasted[0]

    @property
    def completed(self) -> bool:
        """Whether there was a ride, it was handed over, and every robot is at its goal."""
        handed_over = self.ride is not None and self.ride.decouple_s is not None
        return not self.cause and handed_over and self.step == ARRIVED

    @property
    def verdict(self) -> str:
        """How it ended, in one line."""
        if self.completed:
            return "Ride completed"
        if not self.cause and self.ride is None and self.step == ARRIVED:
            return "No ride: every robot drove alone"
        return f"Ride not completed, at step {self.step!r}: {self.cause or 'no robot goes on'}"

    @property
    def all_hold(self) -> bool:
        """Whether no figure breaks its bound."""
        return all_hold(self.figures)

    @property
    def headline(self) -> str:
        """The verdict, with what it took."""
        seed = self.record.seed
        return f"{self.verdict}, {self.sim_s:.1f} s simulated in {self.wall_s:.1f} s, seed {seed}"

    def tables(self) -> list[Table]:
        """What a person reads of a ride that was handed over; else nothing."""
        if self.ride is None or self.ride.released_at is None:
            return []
        return [figure_table(self.figures), box_table(self.boxes), cpu_table(self.costs)]


def write_files(end: RideEnd, folder: Path, world: WorldFile, package: Path) -> None:
    """Leave the three files in ``folder``.

    Raises:
        OSError: it cannot be written.
        MapFileError: the world's map cannot be read.
    """
    record = end.record
    summary = {
        "completed": end.completed,
        "verdict": end.verdict,
        "scenario": record.scenario,
        "seed": record.seed,
        "versions": versions(package),
        "sim_s": end.sim_s,
        "wall_s": end.wall_s,
        "figures": end.figures,
        "boxes": end.boxes,
        "ride": end.ride,
        "modules": module_changes(record),
        "cpu": end.costs,
        "simulator": record.simulator,
        "unreadable_messages": end.unreadable,
    }
    (folder / SUMMARY).write_bytes(msgspec.json.format(msgspec.json.encode(summary), indent=2))
    save_record(record, folder / RECORD)
    title = f"{record.scenario}, seed {record.seed}: {end.verdict[0].lower()}{end.verdict[1:]}"
    draw_ride(folder / PICTURE, record, end.ride, load_map(world.map), world.sites, title)
