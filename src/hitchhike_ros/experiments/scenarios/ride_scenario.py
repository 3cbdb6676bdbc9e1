"""Scenarios: rides to be driven with the real nodes, each a YAML file that says how it should end and what the papers
measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import yaml

from hitchhike_ros.core.datatypes import NonNegative, Positive
from hitchhike_ros.core.errors import WorldFileError
from hitchhike_ros.core.parameters import convert, read_yaml
from hitchhike_ros.experiments.scenarios.paper import PaperTimes

SUFFIX = ".yaml"

# How a scenario ends: with its rides, with a denial, or with a driver that is lost on the way.
End = Literal["rides", "denied", "lost", "alone"]


@dataclass(frozen=True)
class ExpectedRide:
    """Who rides with whom, and what a paper measured there; None where it did not."""

    hitchhiker: str
    driver: str
    ride_m: Positive | None = None
    points: Positive | None = None
    paper: PaperTimes | None = None
    driver_waits_s: NonNegative | None = None
    """What the paper's driver waited for its hitchhiker; part of the driver's delay."""


@dataclass(frozen=True)
class ExpectedDenial:
    """Who is denied a ride, why, and how long it then waited in the paper."""

    hitchhiker: str
    reason: str
    paper_wait_s: Positive | None = None


@dataclass(frozen=True)
class RideScenario:
    """One scenario. ``world`` is what a world file holds, usually a ``base`` (relative to the scenario's file) and
    changes to it; ``launch`` are arguments of ride.launch; ``quick`` puts it into the quick set.

    ``alone_of`` is the scenario whose hitchhiker here drives the same route by itself, for the cost ledger.
    """

    title: str
    source: str
    world: dict[str, Any]
    end: End = "rides"
    paper: str = ""  # which numbers are the paper's
    chosen: str = ""  # and which are not
    launch: dict[str, str | float | bool] = field(default_factory=dict)
    rides: tuple[ExpectedRide, ...] = ()
    denial: ExpectedDenial | None = None
    alone_of: str = ""
    needs: str = ""  # a file or folder under the third-party data, without which the scenario is left out
    quick: bool = False
    name: str = ""
    file: str = ""

    def write_world(self, folder: Path) -> Path:
        """The world file of a run, ``<name>.world.yaml`` in ``folder``; its base by an absolute path."""
        content = dict(self.world)
        if "base" in content:
            content["base"] = str((Path(self.file).parent / content["base"]).resolve())
        path = folder / f"{self.name}.world.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        return path


def load_scenario(path: Path) -> RideScenario:
    """A scenario's file, checked but for its world, which is checked when it is loaded.

    Raises:
        WorldFileError: names the file, the field, its value and what was expected.
    """
    content = read_yaml(path, WorldFileError)
    for key in ("name", "file"):
        if key in content:
            raise WorldFileError(path, key, content[key], "no such field: it is the file's name")
    scenario = convert(
        {**content, "name": path.name.removesuffix(SUFFIX), "file": str(path)}, RideScenario, path, error=WorldFileError
    )
    if scenario.end == "denied" and scenario.denial is None:
        raise WorldFileError(path, "denial", None, "who is denied, and why")
    if scenario.end in ("rides", "lost") and not scenario.rides:
        raise WorldFileError(path, "rides", (), "who rides with whom")
    if (scenario.end == "alone") != bool(scenario.alone_of):
        raise WorldFileError(path, "alone_of", scenario.alone_of, "the scenario whose route is driven alone, if so")
    return scenario


def load_scenarios(folder: Path) -> dict[str, RideScenario]:
    """All scenarios of a folder by name, in the order of their names.

    Raises:
        WorldFileError: as :func:`load_scenario`.
    """
    return {s.name: s for s in (load_scenario(path) for path in sorted(folder.glob(f"*{SUFFIX}")))}


def in_order(scenarios: Iterable[RideScenario]) -> list[RideScenario]:
    """Those that are compared with others after these."""
    return sorted(scenarios, key=lambda scenario: bool(scenario.alone_of))
